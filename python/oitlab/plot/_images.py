"""Images on a page: panels of one size, with titles above and captions below."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._image import as_image, reduced
from ..frame import Frame
from ..registry import techniques
from ._style import FONT_SIZE, PRINT_DPI, Plot, box_edges
from ._table import several
from ._variants import name_of


def named_images(value: Any, argument: str) -> dict[str, NDArray[Any]]:
    """Give label to pixels, from one image, several, or a mapping of labels to images."""
    if isinstance(value, Mapping):
        given = [(str(label), image) for label, image in value.items()]
    else:
        given_images = [value] if isinstance(value, Frame) or _is_image(value) else several(value, argument)
        given = [(name, image) for name, image in zip(_names(given_images), given_images, strict=True)]
    if not given:
        raise ValueError(f"{argument} is empty")
    return {label: as_image(image, f"{argument}[{label!r}]") for label, image in given}


def _is_image(value: Any) -> bool:
    try:
        return np.ndim(value) == 3 and not any(isinstance(item, Frame) for item in value)
    except ValueError:
        return False


def _names(images: list[Any]) -> list[str]:
    """Name frames by technique and params that are not its defaults or differ; arrays by number."""
    ids = [image.technique if isinstance(image, Frame) else "" for image in images]
    names = []
    for index, (image, technique) in enumerate(zip(images, ids, strict=True)):
        if not isinstance(image, Frame):
            names.append(f"image {index}")
            continue
        others = [o for o, t in zip(images, ids, strict=True) if t == technique and o is not image]
        usual = _defaults(technique)
        differing = {
            key: value
            for key, value in image.params.items()
            if any(o.params.get(key) != value for o in others) or usual.get(key, value) != value
        }
        names.append(name_of(technique, differing))
    return [
        f"{name} ({names[:i].count(name) + 1})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def _defaults(technique: str) -> dict[str, Any]:
    """Give the defaults that are values; others are texts that say what they follow from."""
    entry = techniques().get(technique)
    params = () if entry is None else entry.params
    return {
        param.name: param.default
        for param in params
        if isinstance(param.default, bool | int | float) or f'"{param.default}"' in param.range
    }


def reduced_to(image: NDArray[Any], dots: int, statistic: Any) -> NDArray[np.float64]:
    """Reduce an image by a whole factor until it has at most twice as many columns as the page has dots.

    Examples
    --------
    >>> reduced_to(np.arange(8.0).reshape(1, 8), 2, np.max).tolist()
    [[1.0, 3.0, 5.0, 7.0]]
    """
    factor = max(1, math.ceil(image.shape[1] / (2 * dots)))
    return reduced(image.astype(np.float64), factor, statistic) if factor > 1 else image.astype(np.float64)


class Panels:
    """Axes for images that are `across` inches wide each.

    Examples
    --------
    >>> panels = Panels.grid({"a": np.zeros((9, 16)), "b": np.zeros((9, 16))}, 2, 7.0)
    >>> len(panels.axes), panels.dots > 300
    (2, True)
    """

    def __init__(self, axes: list[Axes], across: float) -> None:
        self.axes = axes
        self.dots = max(1, int(PRINT_DPI * across))
        figure: Any = axes[0].get_figure(root=True)
        self.figure: Figure = figure

    @classmethod
    def grid(cls, images: Mapping[str, NDArray[Any]], columns: int, width: float) -> Panels:
        """Lay out panels in rows, with room for titles, captions and a colour bar on the right."""
        height, across = next(iter(images.values())).shape[:2]
        columns = min(columns, len(images))
        rows = math.ceil(len(images) / columns)
        inner = (width - 0.8) / columns
        tall = min(2.0, height / across) * inner + 0.42
        figure = Plot(figsize=(width, rows * tall), layout="constrained")
        grid = list(figure.subplots(rows, columns, squeeze=False).flat)
        for empty in grid[len(images) :]:
            empty.remove()
        return cls(grid[: len(images)], inner)

    def draw(self, axes: Axes, values: Any, norm: Any, colors: Any) -> None:
        """Draw numbers as colours, a pixel as a square."""
        axes.imshow(values, norm=norm, cmap=colors, interpolation="nearest")
        box_edges(axes)

    def caption(self, axes: Axes, text: str) -> None:
        """Write under an image."""
        axes.set_xlabel(text, fontsize=FONT_SIZE, labelpad=3.0)

    def bar(self, mappable: Any, text: str, extend: Any) -> None:
        """Draw one colour bar for all."""
        rows = len({round(axes.get_position().y0, 3) for axes in self.axes})
        bar = self.figure.colorbar(
            mappable, ax=self.axes, extend=extend, fraction=0.05, pad=0.02, aspect=14 * rows
        )
        bar.set_label("\n".join(_two_lines(text)))


def _two_lines(text: str) -> list[str]:
    """Break what is long before its unit."""
    head, bracket, unit = text.partition(" (")
    return [head, f"({unit}"] if bracket and len(text) > 24 else [text]
