"""Images side by side with the same details enlarged under each, as papers show them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from .._convert import flag, integer, scalar
from .._image import ImageLike, as_image, srgb_bytes
from .._palette import BLUE, GREEN, ORANGE, PINK, RED, SKY
from ..metrics import METRICS, compare
from ._images import named_images, reduced_to
from ._style import FONT_SIZE, PRINT_DPI, Plot, Width, box_edges, inches, number, style
from ._table import several
from ._text import wrapped

Inset: TypeAlias = tuple[int, int, int, int]
"""Column and row of the top left pixel, columns, rows."""

_FRAMES = (ORANGE, SKY, GREEN, RED, PINK, BLUE)
"""Colours of insets: bright first, since images are often dark."""
_GAP = 0.05
_LINE = 1.35 * FONT_SIZE / 72.0
_EDGE = 1.6
_NAMES = {
    "mse": "MSE",
    "rmse": "RMSE",
    "psnr": "PSNR",
    "max_error": "largest error",
    "mse_255": "MSE (0 to 255)",
    "bad_pixels": "bad pixels",
    "delta_e_2000": "CIEDE2000",
    "delta_e_itp": "ΔE ITP",
    "flip": "FLIP",
}
_UNITS = {"psnr": " dB"}


@dataclass(frozen=True)
class _Page:
    """Sizes in inches, from the top left."""

    columns: int
    rows: int
    column: float
    image: float
    inset: tuple[float, float]
    per_line: int
    lines: int
    title: float
    below: float
    footer: float

    @property
    def block(self) -> float:
        """Height of one row of images with all that belongs to them."""
        return self.title + self.image + self.lines * (self.inset[1] + _GAP) + self.below

    @property
    def height(self) -> float:
        return self.rows * self.block + self.footer

    def corner(self, index: int) -> tuple[float, float]:
        """Top left corner of an image's block."""
        row, column = divmod(index, self.columns)
        return _GAP + column * (self.column + _GAP), row * self.block


def strip(
    frames: ImageLike | Sequence[ImageLike] | Mapping[str, ImageLike],
    insets: Sequence[Inset] = (),
    *,
    labels: Sequence[str] | None = None,
    reference: ImageLike | None = None,
    show_reference: bool = True,
    metrics: str | Sequence[str] = "rmse",
    exposure: float = 0.0,
    columns: int | None = None,
    width: Width = "double",
    **options: Any,
) -> Figure:
    """Draw images side by side, the same rectangles of each enlarged below it, and its errors below those.

    Every inset shows exactly the pixels of its rectangle, each as a square of one colour; its edge has the
    colour of the rectangle in the image. Light is multiplied by 2 ** exposure, clipped to [0, 1] and
    encoded as sRGB, as by `oitlab.write_png`; the last line says so, and how many pixels were clipped.
    Whole images with more than twice as many pixels as the page has dots are reduced by a whole factor, by
    the mean of linear light.

    Parameters
    ----------
    frames : Frame or (H, W, 3) array-like, several of them, or a mapping of labels to them
        Linear RGB, all of one size. Named by technique, and by the params in which equal techniques differ.
    insets : sequence of (x, y, w, h)
        Rectangles in pixels: column and row of the top left pixel, columns, rows. At most 6.
    labels : sequence of str, optional
        Names, one per frame.
    reference : Frame or (H, W, 3) array-like, optional
        The exact image, against which errors are measured.
    show_reference : bool
        Whether the reference is the first image.
    metrics : str or several
        What is written below each image, as in `oitlab.compare`, if there is a reference.
    exposure : float
        Stops in [-100, 100].
    columns : int >= 1, optional
        Images side by side; left out, all of them up to five.
    width : {"single", "double"} or float
        Of the figure in print: a column (3.3 inches), a page (7), or inches.
    **options
        Passed to `oitlab.compare`: `data_range`, `threshold`, `luminance`, `pixels_per_degree`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        No frames, frames of different sizes, an inset that is empty or leaves the image, labels that are
        too many or too few, a metric that `oitlab.compare` refuses.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=40)
    >>> exact, wboit, mlab = oitlab.render_many(scene, ["a_buffer", "wboit", "mlab"])
    >>> figure = oitlab.plot.strip([wboit, mlab], [(12, 6, 8, 4)], reference=exact)
    >>> [axes.get_title() for axes in figure.axes if axes.get_title()]
    ['a_buffer (reference)', 'wboit', 'mlab']
    """
    images = _images(frames, labels)
    errors = _errors(images, reference, metrics, options)
    if reference is not None and flag(show_reference, "show_reference"):
        exact = as_image(reference, "reference")
        name = f"{getattr(reference, 'technique', '')} (reference)".strip()
        images, errors = {name: exact, **images}, {name: [], **errors}
    height, across = next(iter(images.values())).shape[:2]
    rectangles = [
        _inset(inset, index, across, height) for index, inset in enumerate(several(insets, "insets"))
    ]
    if len(rectangles) > len(_FRAMES):
        raise ValueError(f"insets: at most {len(_FRAMES)} can be told apart, got {len(rectangles)}")
    srgb_bytes(np.zeros(1), exposure)
    beside = min(len(images), 5) if columns is None else integer(columns, "columns")
    if beside < 1:
        raise ValueError(f"columns must be >= 1, got {columns}")
    with style():
        return _drawn(images, errors, rectangles, exposure, min(beside, len(images)), inches(width))


def _images(frames: Any, labels: Sequence[str] | None) -> dict[str, NDArray[Any]]:
    images = named_images(frames, "frames")
    sizes = {label: image.shape[:2] for label, image in images.items()}
    first = next(iter(sizes.values()))
    for label, size in sizes.items():
        if size != first:
            raise ValueError(
                f"frames[{label!r}] is {size[1]} x {size[0]} pixels, the first {first[1]} x {first[0]}"
            )
    if 0 in first:
        raise ValueError("frames have no pixels")
    if labels is None:
        return images
    if isinstance(labels, str) or len(several(labels, "labels")) != len(images):
        raise ValueError(f"labels: expected {len(images)}, one per frame, got {labels!r}")
    if len(set(labels)) < len(labels):
        raise ValueError(f"labels must differ, got {list(labels)!r}")
    return dict(zip(map(str, labels), images.values(), strict=True))


def _errors(
    images: dict[str, NDArray[Any]], reference: Any, metrics: str | Sequence[str], options: dict[str, Any]
) -> dict[str, list[str]]:
    """Give the lines under each image."""
    if reference is None:
        return {label: [] for label in images}
    asked = [metrics] if isinstance(metrics, str) and metrics != "all" else metrics
    found = {label: compare(image, reference, metrics=asked, **options) for label, image in images.items()}
    return {
        label: [f"{_NAMES[m]} {number(values[m])}{_UNITS.get(m, '')}" for m in METRICS if m in values]
        for label, values in found.items()
    }


def _inset(inset: Any, index: int, width: int, height: int) -> Inset:
    name = f"insets[{index}]"
    try:
        x, y, w, h = inset
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be (x, y, w, h), got {inset!r}") from None
    x, y, w, h = (integer(value, f"{name} {part}") for part, value in zip("xywh", (x, y, w, h), strict=True))
    if w < 1 or h < 1 or x < 0 or y < 0 or x + w > width or y + h > height:
        raise ValueError(f"{name} is {(x, y, w, h)}, which is empty or leaves the {width} x {height} image")
    return x, y, w, h


def _page(
    images: dict[str, NDArray[Any]],
    errors: dict[str, list[str]],
    insets: list[Inset],
    columns: int,
    width: float,
    titles: list[str],
    footer: int,
) -> _Page:
    height, across = next(iter(images.values())).shape[:2]
    column = (width - _GAP) / columns - _GAP
    per_line = min(len(insets), 2) if len(insets) != 3 else 3
    room = (column - (per_line - 1) * _GAP) / max(1, per_line)
    tall = max((h / w for _, _, w, h in insets), default=0.0) * room
    return _Page(
        columns=columns,
        rows=math.ceil(len(images) / columns),
        column=column,
        image=column * height / across,
        inset=(room, min(tall, 1.5 * room)),
        per_line=per_line,
        lines=math.ceil(len(insets) / per_line) if insets else 0,
        title=_LINE * max(title.count("\n") + 1 for title in titles) + 0.08,
        below=_LINE * max(map(len, errors.values())) + 0.06,
        footer=_LINE * footer + 0.04,
    )


def _drawn(
    images: dict[str, NDArray[Any]],
    errors: dict[str, list[str]],
    insets: list[Inset],
    exposure: float,
    columns: int,
    width: float,
) -> Figure:
    column = (width - _GAP) / columns - _GAP
    titles = ["\n".join(wrapped(label, 72 * column, FONT_SIZE)) for label in images]
    below = {label: [part for line in lines for part in wrapped(line, 72 * column, FONT_SIZE)]
             for label, lines in errors.items()}  # fmt: skip
    said = wrapped(_caption(images, exposure), 72 * (width - 2 * _GAP), FONT_SIZE)
    page = _page(images, below, insets, columns, width, titles, len(said))
    figure = Plot(figsize=(width, page.height))
    for index, (label, image) in enumerate(images.items()):
        x, y = page.corner(index)
        y += page.title
        axes = _axes(figure, page, x, y, page.column, page.image)
        _show(axes, reduced_to(image, int(PRINT_DPI * page.column), np.mean), exposure, image.shape)
        axes.set_title(titles[index], fontsize=FONT_SIZE, pad=3.0)
        for number_of, inset in enumerate(insets):
            _draw_inset(figure, page, (x, y + page.image + _GAP), axes, image, (number_of, inset), exposure)
        bottom = y + page.image + page.lines * (page.inset[1] + _GAP)
        _write(figure, page, x + page.column / 2, bottom + 0.03, below[label])
    _write(figure, page, _GAP, page.height - page.footer, said, "left")
    return figure


def _caption(images: dict[str, NDArray[Any]], exposure: float) -> str:
    clipped = max(float((image.max(axis=2) > 2.0**-exposure).mean()) for image in images.values())
    share = f"at most {100 * clipped:.2g} % of an image's pixels" if clipped else "no pixel exceeds 1"
    stops = scalar(exposure, "exposure")
    return f"sRGB, exposure {stops:+g} stops, clipped to [0, 1] ({share}); no tone mapping."


def _show(axes: Axes, image: NDArray[Any], exposure: float, shape: tuple[int, ...]) -> None:
    """Draw linear light; the axes count the pixels of the whole image, reduced or not."""
    height, width = shape[:2]
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(srgb_bytes(image, exposure), interpolation="auto", extent=extent, aspect="auto")
    box_edges(axes)


def _draw_inset(
    figure: Figure,
    page: _Page,
    corner: tuple[float, float],
    whole: Axes,
    image: NDArray[Any],
    inset: tuple[int, Inset],
    exposure: float,
) -> None:
    index, (x, y, w, h) = inset
    color = _FRAMES[index]
    outline = Rectangle((x - 0.5, y - 0.5), w, h, fill=False, edgecolor=color, linewidth=1.0, gid="inset")
    whole.add_patch(outline)
    row, column = divmod(index, page.per_line)
    room, tall = page.inset
    scale = min(room / w, tall / h)
    left = corner[0] + column * (room + _GAP) + (room - scale * w) / 2
    top = corner[1] + row * (tall + _GAP)
    axes = _axes(figure, page, left, top, scale * w, scale * h)
    axes.imshow(srgb_bytes(image[y : y + h, x : x + w], exposure), interpolation="nearest", aspect="auto")
    box_edges(axes, color, _EDGE)
    axes.set_gid("inset")


def _axes(figure: Figure, page: _Page, x: float, y: float, across: float, down: float) -> Axes:
    width = figure.get_figwidth()
    return figure.add_axes((x / width, 1 - (y + down) / page.height, across / width, down / page.height))


def _write(figure: Figure, page: _Page, x: float, y: float, lines: list[str], align: str = "center") -> None:
    if lines:
        place = x / figure.get_figwidth(), 1 - y / page.height
        figure.text(*place, "\n".join(lines), ha=align, va="top", fontsize=FONT_SIZE, linespacing=1.2)
