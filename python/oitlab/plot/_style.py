"""How every figure looks: its size in print, its type, its colours; and how it shows itself."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal, TypeAlias, cast

import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, StrMethodFormatter

from .._convert import scalar
from .._palette import GREY, LIGHT_GREY

Width: TypeAlias = Literal["single", "double"] | float
WIDTHS = {"single": 3.3, "double": 7.0}
"""Inches of a column, and of a page of two columns, in the journals and proceedings of graphics."""
FONT_SIZE = 7.0
"""Points. Nothing is smaller."""
NOTEBOOK_DPI = 192
"""Dots per inch on a screen: twice the usual, since screens are."""
PRINT_DPI = 300

_RC: dict[str, Any] = {
    "font.size": FONT_SIZE,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same everywhere
    "axes.titlesize": FONT_SIZE + 1,
    "axes.labelsize": FONT_SIZE + 0.5,
    "xtick.labelsize": FONT_SIZE,
    "ytick.labelsize": FONT_SIZE,
    "legend.fontsize": FONT_SIZE,
    "legend.title_fontsize": FONT_SIZE,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.6,
    "grid.color": LIGHT_GREY,
    "grid.linewidth": 0.4,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "pdf.fonttype": 42,  # outlines that every publisher takes; the default, Type 3, some refuse
    "ps.fonttype": 42,
}


@contextmanager
def style() -> Iterator[None]:
    """Set type and lines for the time being; the user's own settings neither matter nor change."""
    with mpl_style.context(["default", _RC]):
        yield


class Plot(Figure):
    r"""A figure that belongs to nobody but you: no window, no global list, and it shows itself in notebooks.

    It is a `matplotlib.figure.Figure` in all respects; `savefig` takes 300 dpi unless told otherwise and
    embeds TrueType fonts in PDF.

    Examples
    --------
    >>> import matplotlib.figure
    >>> isinstance(Plot(), matplotlib.figure.Figure), Plot()._repr_png_()[:4]
    (True, b'\x89PNG')
    """

    def draw(self, renderer: Any) -> None:
        """Draw in the style in which the figure was made: ticks are made late."""
        with style():
            super().draw(renderer)

    def savefig(self, fname: Any, *, transparent: bool | None = None, **keywords: Any) -> None:
        """Write to a file or stream, as matplotlib does."""
        with style():
            super().savefig(fname, transparent=transparent, **{"dpi": PRINT_DPI, **keywords})

    def _repr_png_(self) -> bytes:
        image = io.BytesIO()
        self.savefig(image, format="png", dpi=NOTEBOOK_DPI)
        return image.getvalue()


def inches(width: Width) -> float:
    """Width of a figure in inches; ValueError unless "single", "double" or a number in [1.5, 40]."""
    if isinstance(width, str):
        if width in WIDTHS:
            return WIDTHS[width]
        raise ValueError(f'width must be "single", "double" or inches, got {width!r}')
    number = scalar(width, "width")
    if not 1.5 <= number <= 40.0:
        raise ValueError(f"width must be in [1.5, 40] inches, got {number}")
    return number


def new_axes(ax: Axes | None, width: Width, aspect: float = 0.72) -> tuple[Figure, Axes]:
    """Give the axes to draw in, and their figure: the caller's, or new ones of this width."""
    if ax is None:
        across = inches(width)
        figure: Figure = Plot(figsize=(across, aspect * across), layout="constrained")
        return figure, figure.subplots()
    if not isinstance(ax, Axes):
        raise ValueError(f"ax must be matplotlib Axes, got {type(ax).__name__}")
    return cast(Figure, ax.get_figure(root=True)), ax


def grow(figure: Figure, ax: Axes | None, lines: int) -> None:
    """Make room for lines of text outside new axes, so that these keep their size."""
    if ax is None and lines > 0:
        figure.set_figheight(figure.get_figheight() + lines * 1.45 * FONT_SIZE / 72.0)


def legend_name(text: str) -> str:
    """Give a line's name as legends show it: matplotlib hides those that begin with an underscore."""
    return f" {text}" if text.startswith("_") else text


def legend_above(axes: Axes, handles: list[Any], texts: list[str], title: str | None) -> int:
    """Draw a legend above the axes, in columns that fit; give its number of lines."""
    if not handles and title is None:
        return 0
    figure: Any = axes.get_figure(root=True)
    room = 72.0 * figure.get_size_inches()[0] - 12.0
    columns = max((n for n in range(1, len(texts) + 1) if _columns_width(texts, n) <= room), default=1)
    wrapped = title and "\n".join(textwrap.wrap(title, int(room / _LETTER)))
    axes.legend(
        handles,
        texts,
        title=wrapped,
        ncols=columns,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        borderaxespad=0.3,
        columnspacing=1.2,
        handlelength=2.0,
    )
    return math.ceil(len(texts) / columns) + (wrapped.count("\n") + 1 if wrapped else 0)


_LETTER = 0.6 * FONT_SIZE
"""Width of an average letter of the font in points, on the safe side."""


def _columns_width(texts: list[str], columns: int) -> float:
    """Give a legend's width in points; matplotlib fills columns from the top, the first with one more."""
    tall, more = divmod(len(texts), columns)
    width, start = 0.0, 0
    for column in range(columns):
        count = tall + (column < more)
        width += _LETTER * max(map(len, texts[start : start + count]), default=0) + 4.2 * FONT_SIZE
        start += count
    return width


def finish(axes: Axes) -> None:
    """Say on the axes themselves what ticks would look up when they are made, after the style is gone."""
    axes.tick_params(which="both", labelsize=FONT_SIZE)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_fontsize(FONT_SIZE + 0.5)


def log_axis(axes: Axes, which: Literal["x", "y"]) -> None:
    """Make an axis logarithmic, with numbers at 1, 2 and 5 where there are few decades."""
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    axis = axes.xaxis if which == "x" else axes.yaxis
    narrow = high / low < (1000.0 if which == "x" else 100.0)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,), numticks=8))
    short = low >= 0.001 and high < 100_000.0
    axis.set_major_formatter(StrMethodFormatter("{x:,g}") if short else LogFormatterSciNotation())
    axis.set_minor_formatter(NullFormatter())


def number(value: float) -> str:
    """Three significant digits, for captions."""
    return f"{value:.3g}" if value == 0 or 1e-4 <= abs(value) < 1e6 else f"{value:.2e}"


def count_text(value: int, singular: str) -> str:
    """Say how many: "1 row", "2 rows"."""
    return f"{value:,} {singular}{'' if value == 1 else 's'}"


def box_edges(axes: Axes, color: str = GREY, linewidth: float = 0.6) -> None:
    """Draw all four edges of an image, so that dark ones have a border; no ticks, no grid."""
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    axes.spines[:].set(visible=True, linewidth=linewidth, color=color)


def limits_of(values: Any, log: bool, margin: float = 0.06) -> tuple[float, float]:
    """Axis limits around numbers, with a margin in what is drawn; of those > 0 where logarithmic."""
    numbers = np.asarray(values, dtype=float)
    numbers = numbers[np.isfinite(numbers) & ((numbers > 0) if log else True)]
    if numbers.size == 0:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(numbers.min()), float(numbers.max())
    if log:
        room = max(margin * np.log(high / low), np.log(1.3))
        return low * float(np.exp(-room)), high * float(np.exp(room))
    room = margin * (high - low) or 0.5 * abs(high) or 0.5
    return low - room, high + room
