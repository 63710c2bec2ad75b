"""Names beside points: none covers another, a point or the edge, and the same input gives the same places.

adjustText pushes texts apart by forces and stops after a while, overlapping or not; textalloc draws what
did not fit anywhere. What is wanted here is a guarantee, and a list of what had no room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from .._palette import GREY
from ._style import FONT_SIZE

_DIRECTIONS = (
    *((1, up, slope) for slope in (0.75, 1.8) for up in (1, -1)),
    *((-1, up, slope) for slope in (0.75, 1.8) for up in (1, -1)),
    *((1, 0, 1.0), (-1, 0, 1.0), (0, 1, 1.0), (0, -1, 1.0)),
)
"""Where a text lies beside its point, right, up, and how steeply, the best first."""
_DISTANCES = (3.0, 7.0, 12.0, 18.0, 25.0, 33.0, 42.0, 52.0, 64.0, 78.0)
"""Points (1/72 inch) between a point and its text, the best first."""
_LINE_FROM = 8.0
"""Farther away than this a thin line says whose text it is."""
_MARGIN = 3.0
"""Pixels between a text and anything else."""

Box = tuple[float, float, float, float]
"""Left, bottom, right, top in pixels."""


@dataclass(frozen=True)
class _Found:
    box: Box
    offset: tuple[float, float]
    align: tuple[str, str]
    line: bool


def place_labels(
    axes: Axes,
    spots: Sequence[tuple[float, float]],
    texts: Sequence[str],
    obstacles: tuple[NDArray[np.float64], NDArray[np.float64]],
    colors: Sequence[str],
) -> list[str]:
    """Write each text beside its spot, the first ones first; give those for which there is no room.

    Parameters
    ----------
    axes : Axes
        With its limits, its labels and its legend; the figure is laid out here.
    spots : (x, y) pairs
        In pixels, as `axes.transData` gives them.
    texts : str
        One per spot.
    obstacles : two (N, 4) float arrays
        Boxes in pixels that no text may cover: left, bottom, right, top. The lines from points to their
        texts may cross the second ones.
    colors : str
        One per spot.
    """
    figure: Any = axes.get_figure(root=True)
    scale = figure.dpi / 72.0
    renderer = figure._get_renderer()
    window = axes.get_window_extent(renderer)
    inside = (window.x0, window.y0, window.x1, window.y1)
    taken, lines = ([tuple(box) for box in boxes] for boxes in obstacles)
    lost = []
    for spot, text, color in zip(spots, texts, colors, strict=True):
        size = _size(axes, text, renderer)
        found = _best(spot, size, inside, (taken, lines), scale)
        if found is None:
            lost.append(text)
            continue
        taken.append(found.box)
        lines += [(x, y, x, y) for x, y in _between(spot, found.box)] if found.line else []
        _write(axes, spot, text, found, color, scale)
    return lost


def _size(axes: Axes, text: str, renderer: Any) -> tuple[float, float]:
    probe = axes.text(0.5, 0.5, text, fontsize=FONT_SIZE, transform=axes.transAxes)
    extent = probe.get_window_extent(renderer)
    probe.remove()
    return extent.width, extent.height


def _best(
    spot: tuple[float, float],
    size: tuple[float, float],
    inside: Box,
    taken: tuple[list[Any], ...],
    scale: float,
) -> _Found | None:
    solid, every = (np.array(boxes, dtype=float).reshape(-1, 4) for boxes in (taken[0], taken[0] + taken[1]))
    for distance in _DISTANCES:
        for right, up, slope in _DIRECTIONS:
            far = distance * scale
            offset = right * far, up * far * slope
            left = spot[0] + offset[0] - {1: 0.0, 0: 0.5, -1: 1.0}[right] * size[0]
            low = spot[1] + offset[1] - {1: 0.0, 0: 0.5, -1: 1.0}[up] * size[1]
            box = (left, low, left + size[0], low + size[1])
            line = distance >= _LINE_FROM
            if _fits(box, inside, every) and not (line and _crosses(spot, box, solid)):
                align = (
                    {1: "left", 0: "center", -1: "right"}[right],
                    {1: "bottom", 0: "center", -1: "top"}[up],
                )
                return _Found(box, offset, align, line)
    return None


def _fits(box: Box, inside: Box, taken: NDArray[np.float64]) -> bool:
    left, low, right, high = box
    if left < inside[0] or low < inside[1] or right > inside[2] or high > inside[3]:
        return False
    apart = (
        (taken[:, 0] > right + _MARGIN)
        | (taken[:, 2] < left - _MARGIN)
        | (taken[:, 1] > high + _MARGIN)
        | (taken[:, 3] < low - _MARGIN)
    )
    return bool(apart.all())


def _crosses(spot: tuple[float, float], box: Box, taken: NDArray[np.float64]) -> bool:
    """Whether the line from a spot to its text would run through another text or point."""
    points = _between(spot, box)
    points = points[np.hypot(*(points - np.asarray(spot)).T) > 6.0]
    x, y = points[:, :1], points[:, 1:]
    hit = (x > taken[:, 0]) & (x < taken[:, 2]) & (y > taken[:, 1]) & (y < taken[:, 3])
    return bool(hit.any())


def _between(spot: tuple[float, float], box: Box) -> NDArray[np.float64]:
    """Points on the way from a spot to a box."""
    end = np.clip(spot, box[:2], box[2:])
    along = np.linspace(0.0, 1.0, 24)[1:-1, None]
    return np.asarray(np.asarray(spot) * (1 - along) + end * along)


def _write(axes: Axes, spot: tuple[float, float], text: str, found: _Found, color: str, scale: float) -> None:
    place = axes.transAxes.inverted().transform(
        spot
    )  # fixed to the axes: points on its edge have labels, too
    end = np.clip(spot, found.box[:2], found.box[2:])
    size = np.subtract(found.box[2:], found.box[:2])
    corner = tuple(
        (end - found.box[:2]) / size
    )  # the text's nearest point, so that the line runs where it was tried
    arrow = {
        "arrowstyle": "-",
        "linewidth": 0.4,
        "color": GREY,
        "shrinkA": 0.0,
        "shrinkB": 2.0,
        "relpos": corner,
    }
    axes.annotate(
        text,
        tuple(place),
        xycoords="axes fraction",
        xytext=(found.offset[0] / scale, found.offset[1] / scale),
        textcoords="offset points",
        fontsize=FONT_SIZE,
        color=color,
        ha=found.align[0],
        va=found.align[1],
        arrowprops=arrow if found.line else None,
        zorder=6,
        path_effects=[withStroke(linewidth=1.2, foreground="white")],
        gid="label",
    )
