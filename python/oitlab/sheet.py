"""The contact sheet: every image with its error map, on one page."""

from __future__ import annotations

import io
import math
import os
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._image import enlarged, reduced, srgb_bytes
from .metrics import error_map
from .png import save_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .report import Comparison

__all__ = ["write_contact_sheet"]

_ERROR_RANGE = (1e-4, 1.0)
_ERROR_TEXT = (
    "error: largest absolute difference of R, G and B in linear light, logarithmic; "
    "black is 0.0001 or less, pale yellow 1 or more"
)
_DPI = 100
_GAP = 14
_LABEL = 24
_HEADER = 56
_FOOTER = 116
_TEXT = 13
_GLYPH = 0.56
"""Width of an average letter of the font, in font sizes."""


@dataclass(frozen=True)
class _Cell:
    """One technique on the page: its picture above its map."""

    label: str
    numbers: str
    picture: NDArray[np.uint8]
    map: NDArray[np.float64]


@dataclass(frozen=True)
class _Page:
    """Positions in pixels, from the top left."""

    columns: int
    rows: int
    width: int
    height: int

    @property
    def size(self) -> tuple[int, int]:
        block = 2 * self.height + _LABEL + _GAP
        width = self.columns * (self.width + _GAP) + _GAP
        return width, _HEADER + self.rows * block + _FOOTER

    def corner(self, index: int) -> tuple[int, int]:
        """Give the top left pixel of a cell's label."""
        row, column = divmod(index, self.columns)
        return _GAP + column * (self.width + _GAP), _HEADER + row * (2 * self.height + _LABEL + _GAP)


def write_contact_sheet(
    path: str | os.PathLike[str],
    comparison: Comparison,
    title: str,
    *,
    exposure: float = 0.0,
    columns: int | None = None,
    cell_width: int = 460,
) -> None:
    """Write one PNG with the image and the error map of every technique.

    The first cell shows the reference over its number of fragments per pixel. Every other cell shows a
    technique's image, sRGB-encoded, over its error: the largest absolute channel error of linear RGB. All
    cells share one logarithmic scale, from 0.0001 or less (black) to 1 or more (pale yellow). Images larger
    than a cell are reduced by a whole factor: the mean of linear light for pictures, the maximum for maps,
    so that no isolated error vanishes. Smaller ones are enlarged by repeating pixels.

    Parameters
    ----------
    path : path-like
        The file to write; its folder must exist.
    comparison : Comparison
        What `oitlab.report.compare_techniques` gave.
    title : str
        Heading of the page.
    exposure : float
        Stops for the pictures, see `write_png`.
    columns : int, optional
        Cells in a row, >= 2. When absent: 3 to 5, whichever leaves the fewest places empty.
    cell_width : int
        Largest width of a picture in pixels, >= 64.

    Raises
    ------
    ValueError
        `columns` or `cell_width` too small, `exposure` out of range.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import oitlab
    >>> from oitlab.report import compare_techniques
    >>> result = compare_techniques(oitlab.scenes.squares(width=32, height=18), [("wboit", {})])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     sheet = pathlib.Path(folder, "sheet.png")
    ...     write_contact_sheet(sheet, result, "squares", cell_width=64)
    ...     sheet.stat().st_size > 0
    True
    """
    if columns is not None and columns < 2:
        raise ValueError(f"columns: expected >= 2, got {columns}")
    if cell_width < 64:
        raise ValueError(f"cell_width: expected >= 64, got {cell_width}")
    cells = list(_cells(comparison, exposure, cell_width))
    height, width = cells[0].picture.shape[:2]
    if columns is None:
        columns = min((4, 3, 5), key=lambda count: -len(cells) % count) if len(cells) > 4 else len(cells)
    columns = max(2, columns)
    page = _Page(columns, math.ceil(len(cells) / columns), width, height)
    save_bytes(path, _drawn(page, cells, title))


def _cells(comparison: Comparison, exposure: float, cell_width: int) -> Iterator[_Cell]:
    exact = comparison.reference
    width = exact.color.shape[1]
    down, up = math.ceil(width / cell_width), max(1, cell_width // width)
    yield _Cell(
        f"{exact.technique} (reference)",
        "fragments/pixel below",
        _picture(exact.color, exposure, down, up),
        enlarged(reduced(exact.fragment_count.astype(np.float64), down, np.max), up),
    )
    for row, frame in zip(comparison.rows, comparison.frames, strict=True):
        if row.label == exact.technique:
            continue
        errors = error_map(frame, exact, "absolute")
        yield _Cell(
            row.label,
            f"RMSE {row.rmse:.2g}, max {row.max_error:.2g}",
            _picture(frame.color, exposure, down, up),
            enlarged(reduced(errors, down, np.max), up),
        )


def _picture(linear: NDArray[Any], exposure: float, down: int, up: int) -> NDArray[np.uint8]:
    return srgb_bytes(enlarged(reduced(linear.astype(np.float64), down, np.mean), up), exposure)


def _drawn(page: _Page, cells: list[_Cell], title: str) -> NDArray[np.uint8]:
    from matplotlib import style
    from matplotlib.colors import LogNorm, Normalize

    counts = _Scale(Normalize(0.0, max(1.0, float(cells[0].map.max()))), "viridis", 0.0)
    errors = _Scale(LogNorm(*_ERROR_RANGE, clip=True), "inferno", _ERROR_RANGE[0])
    with style.context("default"):
        canvas = _Canvas(page)
        canvas.write(_GAP, _HEADER // 2, page.size[0] - 2 * _GAP, title, 17)
        for index, cell in enumerate(cells):
            canvas.draw(index, cell, errors if index else counts)
        canvas.bar(0, counts, "fragments per pixel", None)
        canvas.bar(1, errors, _ERROR_TEXT, [10.0**power for power in range(-4, 1)])
        return canvas.pixels()


@dataclass(frozen=True)
class _Scale:
    """How numbers become colours; what is below `lowest` looks like `lowest`."""

    norm: Any
    colors: str
    lowest: float


class _Canvas:
    """A matplotlib figure that is drawn on in pixels from the top left."""

    def __init__(self, page: _Page) -> None:
        from matplotlib.figure import Figure

        self.page = page
        width, height = page.size
        size = ((width + 1e-6) / _DPI, (height + 1e-6) / _DPI)  # matplotlib truncates to whole pixels
        self.figure = Figure(figsize=size, dpi=_DPI, facecolor="white")

    def draw(self, index: int, cell: _Cell, scale: _Scale) -> None:
        """Draw a cell: label and numbers on one line, the picture, the map."""
        x, y = self.page.corner(index)
        width, height = self.page.width, self.page.height
        numbers = min(width, math.ceil(_GLYPH * _TEXT * (len(cell.numbers) + 1)))
        self.write(x, y + _LABEL // 2, width - numbers, cell.label, _TEXT + 1)
        self.write(x + width, y + _LABEL // 2, numbers, cell.numbers, _TEXT, align="right")
        self.place(x, y + _LABEL, cell.picture)
        values = np.maximum(cell.map, scale.lowest)
        self.place(x, y + _LABEL + height, values, norm=scale.norm, cmap=scale.colors)

    def write(self, x: int, y: int, room: int, text: str, pixels: int, align: str = "left") -> None:
        """Write one line, shortened to the room that it has."""
        letters = int(room / (_GLYPH * pixels))
        if letters < 2:
            return
        shown = text if len(text) <= letters else text[: letters - 1] + "…"
        width, height = self.page.size
        place = (x / width, 1 - y / height)
        size = pixels * 72 / _DPI
        self.figure.text(*place, shown, fontsize=size, ha=align, va="center", family="DejaVu Sans")

    def place(self, x: int, y: int, image: NDArray[Any], **colors: Any) -> None:
        """Put an image of a cell's size on the page, one pixel for one pixel."""
        axes = self._axes(x, y, self.page.width, self.page.height)
        axes.set_axis_off()
        axes.imshow(image, interpolation="nearest", aspect="auto", **colors)

    def bar(self, column: int, scale: _Scale, text: str, ticks: list[float] | None) -> None:
        """Draw a colour bar at the foot: under the first column, or under all others."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.ticker import MaxNLocator

        width, height = self.page.size
        indent = column * min(2 * _GAP, self.page.width // 8)  # room for the outermost numbers
        start = self.page.corner(column)[0] + indent
        length = self.page.width if column == 0 else width - _GAP - indent - start
        axes = self._axes(start, height - _FOOTER + 20, length, 14)
        bar = self.figure.colorbar(
            ScalarMappable(scale.norm, scale.colors), cax=axes, orientation="horizontal"
        )
        bar.set_label(textwrap.fill(text, max(1, int(length / (_GLYPH * _TEXT)))), fontsize=_TEXT * 72 / _DPI)
        if ticks is None:
            bar.ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        else:
            bar.set_ticks(ticks, labels=[f"{tick:g}" if tick > 1e-4 else "0.0001" for tick in ticks])
        bar.ax.tick_params(labelsize=_TEXT * 72 / _DPI)

    def pixels(self) -> NDArray[np.uint8]:
        """Give the drawn page, (height, width, 3), sRGB."""
        width, height = self.page.size
        raw = io.BytesIO()
        self.figure.savefig(raw, format="rgba", dpi=_DPI)
        pixels = np.frombuffer(raw.getvalue(), np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[..., :3])

    def _axes(self, x: int, y: int, across: int, down: int) -> Axes:
        width, height = self.page.size
        return self.figure.add_axes((x / width, 1 - (y + down) / height, across / width, down / height))
