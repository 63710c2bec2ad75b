"""Wyman's table of axes [Wyman2016, Table 1] as a figure."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .._palette import BLACK
from ..registry import TechniqueTable, TextTable
from ..registry import techniques as registry
from ._style import FONT_SIZE, Plot, Width, inches, style
from ._table import several
from ._text import width_of, wrapped

_PAD = 3.0
"""Points between a cell's text and its column's edge."""
_LINE = 1.25 * FONT_SIZE
_ROW = 0.35 * FONT_SIZE
_ASCENT = 0.95 * FONT_SIZE
_SHADE = "#F2F2F2"
_RULE = 0.8
_BOLD = 1.15
"""Width of bold type relative to the rest."""


def axes_table(techniques: str | Sequence[str] | None = None, *, width: Width = "double") -> Figure:
    """Draw each technique's choices on the axes of Table 1 of [Wyman2016], and what it promises.

    The cells are those of `oitlab.techniques().axes_table()`; texts break where their column ends.

    Parameters
    ----------
    techniques : str or several, optional
        Ids or aliases, in the order wanted; left out, all techniques.
    width : {"single", "double"} or float
        Of the figure in print: a column (3.3 inches), a page (7), or inches. As tall as it takes.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        No techniques, an unknown one, or one named twice; a width that has no room for nine columns.

    Examples
    --------
    >>> import oitlab
    >>> figure = oitlab.plot.axes_table(["wboit", "mlab"])
    >>> [text.get_text() for text in figure.texts if text.get_gid() == "id"]
    ['wboit', 'mlab']
    """
    table = _chosen(techniques).axes_table()
    across = inches(width)
    widths = _widths(table, 72.0 * across)
    with style():
        return _drawn(table, widths, across)


def _chosen(techniques: str | Sequence[str] | None) -> TechniqueTable:
    known = registry()
    if techniques is None:
        return known
    entries = []
    for name in [techniques] if isinstance(techniques, str) else several(techniques, "techniques"):
        entry = known.get(name) if isinstance(name, str) else None
        if entry is None:
            raise ValueError(f"techniques: unknown technique {name!r}; known: {', '.join(known.ids)}")
        if entry in entries:
            raise ValueError(f"techniques has {entry.id!r} twice")
        entries.append(entry)
    if not entries:
        raise ValueError("techniques is empty")
    return TechniqueTable(entries)


def _widths(table: TextTable, room: float) -> list[float]:
    """Share the room: a column gets its longest piece, and of the rest in proportion to what it lacks."""
    least, most = [], []
    for head, *cells in zip(table.columns, *table.rows, strict=True):
        pieces = [width_of(piece, FONT_SIZE) for cell in cells for piece in _pieces(cell)]
        least.append(2 * _PAD + max([*pieces, *(_BOLD * width_of(p, FONT_SIZE) for p in _pieces(head))]))
        whole = [width_of(cell, FONT_SIZE) for cell in cells]
        most.append(2 * _PAD + max(*whole, _BOLD * width_of(head, FONT_SIZE), least[-1] - 2 * _PAD))
    spare = room - sum(least)
    if spare < 0:
        raise ValueError(f"width must be at least {sum(least) / 72:.2f} inches here, got {room / 72:.2f}")
    lacking = sum(most) - sum(least)
    share = min(1.0, spare / lacking) if lacking else 0.0
    return [low + share * (high - low) + 0.01 for low, high in zip(least, most, strict=True)]


def _pieces(cell: str) -> list[str]:
    """Give what is never broken."""
    return cell.replace("_", "_ ").replace("/", "/ ").split()


def _drawn(table: TextTable, widths: list[float], across: float) -> Figure:
    rows = [
        [
            wrapped(cell, (w - 2 * _PAD) / (1 if index else _BOLD), FONT_SIZE)
            for cell, w in zip(row, widths, strict=True)
        ]
        for index, row in enumerate((table.columns, *table.rows))
    ]
    tall = [max(map(len, row)) * _LINE + 2 * _ROW for row in rows]
    width, height = 72.0 * across, sum(tall) + 4.0
    figure = Plot(figsize=(across, height / 72.0))
    top = height - 2.0
    _rule(figure, top / height, 1.4 * _RULE)
    for index, (row, high) in enumerate(zip(rows, tall, strict=True)):
        if index and index % 2 == 0:
            _shade(figure, (top - high) / height, high / height)
        left = 0.0
        for column, (lines, w) in enumerate(zip(row, widths, strict=True)):
            kind = "head" if index == 0 else ("id" if column == 0 else "cell")
            _cell(figure, lines, ((left + _PAD) / width, top - _ROW, height), kind)
            left += w
        top -= high
        if index == 0:
            _rule(figure, top / height, _RULE)
    _rule(figure, top / height, 1.4 * _RULE)
    return figure


def _cell(figure: Figure, lines: list[str], corner: tuple[float, float, float], kind: str) -> None:
    """Write a cell line by line, each on its row's baseline; matplotlib would align tops of letters."""
    x, top, height = corner
    for index, line in enumerate(lines):
        y = (top - _ASCENT - index * _LINE) / height
        weight = "bold" if kind == "head" else "normal"
        figure.text(x, y, line, fontsize=FONT_SIZE, fontweight=weight, va="baseline", gid=kind)


def _rule(figure: Figure, y: float, thick: float) -> None:
    line = Line2D([0.0, 1.0], [y, y], color=BLACK, linewidth=thick, transform=figure.transFigure)
    figure.add_artist(line)


def _shade(figure: Figure, y: float, high: float) -> None:
    figure.add_artist(
        Rectangle(
            (0.0, y), 1.0, high, facecolor=_SHADE, edgecolor="none", zorder=-1, transform=figure.transFigure
        )
    )
