"""Error against time, memory or any other price, and the variants that none beats in both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from .._convert import choice, flag
from .._palette import BLACK, BLUE, GREY, series
from ._edges import draw_at_edges, meanings_note, place, small_print
from ._labels import place_labels
from ._style import FONT_SIZE, Width, finish, grow, inches, legend_above, limits_of, log_axis, new_axes, style
from ._table import (
    Spread,
    checked_floor,
    checked_table,
    floored,
    gather,
    name_rows,
    names,
    numbers,
    quantiles,
    refuse_mixtures,
    refuse_negative,
    rows_of,
    variant_columns,
)
from ._units import HIGHER_IS_BETTER, label

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Labels = Literal["front", "all", "none"]
_LOST = "not named, for lack of room: "
_MOST_NOTES = 4
"""Lines of names that had no room; how many more there are is said."""
_Scale: TypeAlias = tuple[tuple[bool, bool], float]
"""Which axes are logarithmic, and from where on down an error counts as zero."""


@dataclass(frozen=True)
class _Rows:
    x: NDArray[np.float64]
    y: NDArray[np.float64]


@dataclass(frozen=True)
class _Variant:
    name: str
    owner: str
    x: float
    y: float
    low: float
    high: float
    runs: int
    missing: int


def pareto(
    data: pd.DataFrame,
    x: str = "total_ms",
    y: str = "mse",
    *,
    name: str | Sequence[str] | None = None,
    hue: str | Sequence[str] | None = None,
    over: str | Sequence[str] = "seed",
    spread: Spread = "range",
    labels: Labels = "front",
    logx: bool = True,
    logy: bool = True,
    floor: float | None = None,
    xlabel: str | None = None,
    ylabel: str | None = None,
    width: Width = "double",
    ax: Axes | None = None,
) -> Figure:
    """Draw each variant's error against its price, and the front of those that none beats.

    A variant is beaten by one that is better in one and no worse in the other. Less is better on both axes,
    except for `psnr` and `factor`. Rows of one variant (several seeds) are one point, their median, with a
    line from the smallest to the largest error, or whatever `spread` asks for. Names never cover each
    other, a point or the front; those that have no room are listed below the axes, in four lines at most.
    Zeros on a logarithmic axis, such as the error of an exact technique, and infinities are hollow triangles
    on the axis's edge; what is NaN is counted below the axes.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per run, as `oitlab.sweep` gives it, or any table with these columns.
    x : str
        Column of the price: "total_ms", "resolve_ms", "bytes_per_pixel", ...
    y : str
        Column of the error.
    name : str or several, optional
        Columns that name a variant; left out, the technique and those params that differ within one.
    hue : str, several, or None
        Columns whose values get a colour, a marker and a line in the legend each. None: blue on the front,
        grey off it.
    over : str or several
        Columns that may differ within a variant.
    spread : {"range", "quartiles"} or (low, high)
        As in `convergence`, of y.
    labels : {"front", "all", "none"}
        Which points are named.
    logx, logy : bool
        Logarithmic axes.
    floor : float, optional
        As in `convergence`: errors from here on down count as 0.
    xlabel, ylabel : str, optional
        Names of the axes; left out, those of the columns with their units.
    width : {"single", "double"} or float
        Of the figure in print: a column (3.3 inches), a page (7), or inches.
    ax : matplotlib.axes.Axes, optional
        Draw there instead of in a figure of its own. Names are placed for the size that it has then.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        A column that is not there or does not hold numbers, no rows, numbers below 0 for a logarithmic
        axis, rows of one variant that differ in a scene or param that is not in `over`.

    Examples
    --------
    >>> import oitlab
    >>> import pandas as pd
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=40)
    >>> exact, *frames = oitlab.render_many(scene, ["a_buffer", "wboit", "mlab", ("lwboit", {"bins": 32})])
    >>> rows = [
    ...     {"technique": f.technique, "bytes_per_pixel": f.stats.bytes_per_pixel, **oitlab.compare(f, exact)}
    ...     for f in frames
    ... ]
    >>> figure = oitlab.plot.pareto(pd.DataFrame(rows), x="bytes_per_pixel", y="rmse", width="single")
    >>> figure.axes[0].get_xlabel(), figure.axes[0].get_xscale()
    ('memory (bytes per pixel)', 'log')
    """
    named, hues, overs = names(name, "name"), names(hue, "hue"), names(over, "over")
    table = checked_table(data, [x, y, *named, *hues])
    quantiles(spread)
    choice(labels, "labels", Labels)
    log = flag(logx, "logx"), flag(logy, "logy")
    for column, is_log in ((x, log[0]), (y, log[1])):
        values = numbers(table, column)
        if is_log:
            refuse_negative(values, column)
    least = checked_floor(floor, y, log[1])
    rows = _Rows(numbers(table, x), floored(numbers(table, y), least))
    variants = _variants(table, rows, named or variant_columns(table, overs), hues, overs, spread)
    if all(np.isnan((v.x, v.y)).any() for v in variants):
        raise ValueError(f"no row has numbers in both {x!r} and {y!r}")
    front = _front(variants, (x in HIGHER_IS_BETTER, y in HIGHER_IS_BETTER))
    with style():
        figure, axes = new_axes(ax, width, 0.72 if inches(width) < 5 else 0.55)
        _set_up(axes, variants, log, (xlabel or label(x), ylabel or label(y)))
        _draw_front(axes, variants, front)
        meanings = _draw_points(axes, variants, front, (log, least), bool(hues))
        lines = meanings_note(meanings, sum(v.missing for v in variants))
        grow(figure, ax, len(lines) + _legend(axes, variants, hues, spread, overs, len(front) > 1))
        finish(axes)
        printed = small_print(axes, lines)
        lost = _wrapped(_name_points(figure, axes, variants, front, log, labels), figure)
        if lost:
            grow(figure, ax, len(lost))
            if printed is not None:
                printed.remove()
            small_print(axes, [*lines, *lost])
    return figure


def _variants(
    table: pd.DataFrame,
    numbers_of: _Rows,
    named: list[str],
    hues: list[str],
    over: list[str],
    spread: Spread,
) -> list[_Variant]:
    titles = name_rows(table, named) if named else [f"row {index}" for index in range(len(table))]
    owners = name_rows(table, hues) if hues else [""] * len(table)
    keys = list(zip(titles, owners, strict=True))
    refuse_mixtures(table, keys, over, "choose among the rows, or name it in name or over")
    x, y = numbers_of.x, numbers_of.y
    found = []
    for key, rows in rows_of(keys).items():
        across, up = gather(0.0, x[rows], "range"), gather(0.0, y[rows], spread)
        missing = int((np.isnan(x[rows]) | np.isnan(y[rows])).sum())
        found.append(_Variant(*key, across.y, up.y, up.low, up.high, len(rows), missing))
    return found


def _front(variants: list[_Variant], higher: tuple[bool, bool]) -> list[int]:
    """Find those that none beats, cheapest first."""
    signs = [-1.0 if up else 1.0 for up in higher]
    points = [(signs[0] * v.x, signs[1] * v.y) for v in variants]
    order = sorted((p, i) for i, p in enumerate(points) if not np.isnan(p).any())
    front: list[int] = []
    for point, index in order:
        if not front or point[1] < points[front[-1]][1] or point == points[front[-1]]:
            front.append(index)
    return front


def _set_up(axes: Axes, variants: list[_Variant], log: tuple[bool, bool], labels: tuple[str, str]) -> None:
    for which, is_log, values in (
        ("x", log[0], [v.x for v in variants]),
        ("y", log[1], [n for v in variants for n in (v.y, v.low, v.high)]),
    ):
        limits = limits_of(values, is_log, 0.08)
        if which == "x":
            axes.set_xscale("log" if is_log else "linear")
            axes.set_xlim(*limits)
        else:
            axes.set_yscale("log" if is_log else "linear")
            axes.set_ylim(*limits)
        if is_log:
            log_axis(axes, "x" if which == "x" else "y")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])


def _draw_front(axes: Axes, variants: list[_Variant], front: list[int]) -> None:
    """Draw the border of what has been reached: a price buys the best error of all that cost no more."""
    if len(front) < 2:
        return
    x, y = [variants[i].x for i in front], [variants[i].y for i in front]
    axes.step(x, y, where="post", color=BLACK, linewidth=0.9, zorder=1.5, label="Pareto front", gid="front")


def _draw_points(
    axes: Axes, variants: list[_Variant], front: list[int], scale: _Scale, hued: bool
) -> list[str]:
    owners = list(dict.fromkeys(v.owner for v in variants))
    meanings = []
    for owner in owners:
        for on_front in (False, True):
            mine = [v for i, v in enumerate(variants) if v.owner == owner and (i in front) == on_front]
            if mine:
                look = _look(owners.index(owner), on_front, hued)
                meanings += _draw_some(axes, mine, scale, look)
    return meanings


def _look(index: int, on_front: bool, hued: bool) -> dict[str, Any]:
    if hued:
        color, _, marker = series(index)
        return {"color": color, "marker": marker, "markerfacecolor": color if on_front else "white"}
    return {"color": BLUE if on_front else GREY, "marker": "o" if on_front else "s"}


def _draw_some(axes: Axes, some: list[_Variant], scale: _Scale, look: dict[str, Any]) -> list[str]:
    log, floor = scale
    x, y, low, high = (np.array([getattr(v, n) for v in some]) for n in ("x", "y", "low", "high"))
    inside = place(x, log[0]).inside & place(y, log[1]).inside
    axes.plot(x[inside], y[inside], linestyle="none", zorder=3, gid="points", **look)
    wide = inside & (high > low)
    if wide.any():
        bottom, top = axes.get_ylim()
        ends = np.clip(low[wide], bottom, top), np.clip(high[wide], bottom, top)
        axes.vlines(x[wide], *ends, color=look["color"], linewidth=0.8, gid="spread")
    return draw_at_edges(axes, x, y, log, floor, color=look["color"])


def _legend(
    axes: Axes, variants: list[_Variant], hues: list[str], spread: Spread, over: list[str], joined: bool
) -> int:
    """Say what the marks mean; give the legend's number of lines."""
    handles, texts = axes.get_legend_handles_labels()
    if hues:
        for index, owner in enumerate(dict.fromkeys(v.owner for v in variants)):
            handles.append(Line2D([], [], linestyle="none", **_look(index, True, True)))
            texts.append(owner)
        handles.append(Line2D([], [], color=GREY, marker="o", markerfacecolor="white", linestyle="none"))
        texts.append("hollow: beaten")
    else:
        for on_front, text in ((True, "on it" if joined else "on the Pareto front"), (False, "beaten")):
            handles.append(Line2D([], [], linestyle="none", **_look(0, on_front, False)))
            texts.append(text)
    most = max(v.runs for v in variants)
    title = f"median and {quantiles(spread)[2]} of up to {most} runs ({', '.join(over) or 'rows'})"
    return legend_above(axes, handles, texts, title if most > 1 else None)


def _name_points(
    figure: Figure,
    axes: Axes,
    variants: list[_Variant],
    front: list[int],
    log: tuple[bool, bool],
    which: str,
) -> list[str]:
    """Write names beside points; give those that found no room."""
    if which == "none":
        return []
    figure.draw_without_rendering()  # the layout moves the axes, and labels keep their distance in print
    pixels = np.array([_pixel(axes, v, log) for v in variants])
    wanted = front if which == "front" else sorted(range(len(variants)), key=lambda i: i not in front)
    shown = [i for i in wanted if not np.isnan(pixels[i]).any()]
    radius = 3.0 * figure.dpi / 72.0
    seen = pixels[~np.isnan(pixels).any(axis=1)]
    obstacles = np.hstack([seen - radius, seen + radius])
    colors = [BLACK if i in front else "#555555" for i in shown]
    spots = [(float(pixels[i, 0]), float(pixels[i, 1])) for i in shown]
    steps = _steps(pixels[front], figure.dpi / 72.0)
    return place_labels(axes, spots, [variants[i].name for i in shown], (obstacles, steps), colors)


def _steps(front: NDArray[np.float64], half: float) -> NDArray[np.float64]:
    """Boxes around the front's line, which no name may cover."""
    boxes = []
    for (x, y), (next_x, next_y) in pairwise(front):
        low, high = sorted((y, next_y))
        boxes += [(x, y - half, next_x, y + half), (next_x - half, low, next_x + half, high)]
    return np.array(boxes).reshape(-1, 4)


def _pixel(axes: Axes, variant: _Variant, log: tuple[bool, bool]) -> NDArray[np.float64]:
    """Where a point is drawn, on an edge or inside."""
    window = axes.get_window_extent()
    place_of = axes.transData.transform
    spot = []
    for value, is_log, low, high, axis in (
        (variant.x, log[0], window.x0, window.x1, 0),
        (variant.y, log[1], window.y0, window.y1, 1),
    ):
        where = place(np.array([value]), is_log)
        if where.inside[0]:
            inner = [axes.get_xlim()[0], axes.get_ylim()[0]]
            inner[axis] = value
            spot.append(float(place_of(inner)[axis]))
        else:
            spot.append(np.nan if where.missing[0] else (high if where.above[0] else low))
    return np.array(spot)


def _wrapped(lost: list[str], figure: Figure) -> list[str]:
    """List the names without room, in lines that the figure has room for."""
    letters = max(20, int((figure.get_figwidth() * 72 - 50) / (0.6 * FONT_SIZE)))
    lines = wrap(_LOST + ", ".join(lost), letters)
    kept = len(lost)
    while len(lines) > _MOST_NOTES:  # a footnote as tall as the axes would be no footnote
        kept = min(kept - 1, kept * _MOST_NOTES // len(lines))
        lines = wrap(f"{_LOST}{', '.join(lost[:kept])} and {len(lost) - kept:,} more", letters)
    return lines if lost else []
