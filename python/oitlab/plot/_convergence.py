"""Error against a param."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._convert import choice, flag
from .._palette import series
from ._edges import draw_at_edges, meanings_note, place, small_print
from ._style import (
    Width,
    finish,
    grow,
    inches,
    legend_above,
    legend_name,
    limits_of,
    log_axis,
    new_axes,
    style,
)
from ._table import (
    Point,
    Spread,
    checked_floor,
    checked_table,
    floored,
    gather,
    is_text,
    name_rows,
    names,
    numbers,
    quantiles,
    refuse_mixtures,
    refuse_negative,
    rows_of,
)
from ._units import label

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Draw = Literal["band", "whiskers"]
_LOG_FROM = 8.0
"""An x axis is logarithmic by itself where its largest number is so many times its smallest."""
_MOST_LINES = 70


@dataclass(frozen=True)
class _Line:
    name: str
    points: list[Point]
    baseline: list[Point]
    """One point of the rows in which the param is missing, since the technique has none."""


def convergence(
    data: pd.DataFrame,
    x: str,
    y: str = "mse",
    hue: str | Sequence[str] | None = "technique",
    *,
    over: str | Sequence[str] = "seed",
    spread: Spread = "range",
    draw: Draw = "band",
    logx: bool | None = None,
    logy: bool = True,
    floor: float | None = None,
    xlabel: str | None = None,
    ylabel: str | None = None,
    width: Width = "single",
    ax: Axes | None = None,
) -> Figure:
    """Draw an error, or anything else that was measured, against a param.

    Each line is one value of `hue`. Where several rows share a point (several seeds) the line goes through
    their medians and their spread is drawn around it; the legend says so. Rows that lack the param, because
    their technique has none, are drawn as a horizontal line. A param that holds text gets one place per
    value.

    Zeros on a logarithmic axis and infinities are hollow triangles on the axis's edge; what is NaN is counted
    below the axes.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per run, as `oitlab.sweep` gives it, or any table with these columns.
    x : str
        Column of the param.
    y : str
        Column of the error, numbers.
    hue : str, several, or None
        Column or columns whose values get a line each; None draws one line. At most 70 lines.
    over : str or several
        Columns that may differ within a point: the spread is taken over them.
    spread : {"range", "quartiles"} or (low, high)
        From the smallest to the largest, the middle half, or between two quantiles in [0, 1].
    draw : {"band", "whiskers"}
        How the spread is drawn; a param of text always gets whiskers.
    logx, logy : bool
        Logarithmic axes. `logx` left out: where all numbers are > 0 and the largest is 8 times the smallest.
    floor : float, optional
        On a logarithmic y axis: numbers from here on down count as 0. Left out: 1e-14 for `mse`, 1e-7 for
        `rmse` and `max_error`, which is float32's rounding; 0 for other columns.
    xlabel, ylabel : str, optional
        Names of the axes; left out, those of the columns with their units.
    width : {"single", "double"} or float
        Of the figure in print: a column (3.3 inches), a page (7), or inches.
    ax : matplotlib.axes.Axes, optional
        Draw there instead of in a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        A column that is not there or does not hold numbers, no rows, numbers below 0 for a logarithmic
        axis, rows of one point that differ in a scene or param that is not in `over`, more than 70 lines.

    Examples
    --------
    >>> import oitlab
    >>> import pandas as pd
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=40)
    >>> exact = oitlab.render(scene, "a_buffer")
    >>> rows = []
    >>> for samples in (1, 4, 16):
    ...     for seed in (0, 1, 2):
    ...         params = {"samples": samples, "seed": seed}
    ...         frame = oitlab.render(scene, "stochastic_transparency", params)
    ...         rows.append({"technique": frame.technique, **params, **oitlab.compare(frame, exact)})
    >>> figure = oitlab.plot.convergence(pd.DataFrame(rows), "samples")
    >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
    ('samples (number)', 'MSE (linear RGB, squared)')
    """
    hues, overs = names(hue, "hue"), names(over, "over")
    table = checked_table(data, [x, y, *hues])
    quantiles(spread)
    choice(draw, "draw", Draw)
    places, texts = _places(table, x)
    logy, values = flag(logy, "logy"), numbers(table, y)
    horizontal = _is_log(places, logx, x) and texts is None
    least = checked_floor(floor, y, logy)
    if logy:
        refuse_negative(values, y)
        values = floored(values, least)
    lines = _lines(table, x, places, values, hues, overs, spread)
    with style():
        figure, axes = new_axes(ax, width, 0.72 if inches(width) < 5 else 0.5)
        if horizontal:
            axes.set_xscale("log")
        if logy:
            axes.set_yscale("log")
        _limit(axes, lines, (horizontal, logy), None if texts is None else len(texts))
        notes = []
        for index, line in enumerate(lines):
            shown = "whiskers" if texts is not None else draw
            notes += _draw(axes, line, (index, x), shown, (horizontal, logy), texts is None, least)
        _name_axes(axes, (xlabel or label(x), ylabel or label(y)), (horizontal, logy), texts)
        _tick_values(axes, places, horizontal)
        missing = sum(p.nan for line in lines for p in [*line.points, *line.baseline])
        printed = meanings_note(notes, missing)
        small_print(axes, printed)
        grow(figure, ax, len(printed) + _legend(axes, lines, spread, overs))
        finish(axes)
    return figure


def _places(table: pd.DataFrame, x: str) -> tuple[NDArray[np.float64], list[str] | None]:
    """Give rows' places along the axis, NaN where the param is missing; and texts at 0, 1, 2..., if any."""
    if not is_text(table, x):
        places = numbers(table, x)
        if not np.isfinite(places).any():
            raise ValueError(f"column {x!r} holds no finite number")
        return places, None
    texts = name_rows(table, [x])
    present = table[x].notna().to_numpy()
    known = list(dict.fromkeys(t for t, there in zip(texts, present, strict=True) if there))
    places = np.array([known.index(t) if p else np.nan for t, p in zip(texts, present, strict=True)])
    return places.astype(np.float64), known


def _is_log(places: NDArray[np.float64], asked: bool | None, x: str) -> bool:
    if asked:
        refuse_negative(places, x)
    if asked is not None:
        return asked
    finite = places[np.isfinite(places)]
    return bool(finite.min() > 0 and finite.max() >= _LOG_FROM * finite.min())


def _lines(
    table: pd.DataFrame,
    x: str,
    places: NDArray[np.float64],
    values: NDArray[np.float64],
    hues: list[str],
    over: list[str],
    spread: Spread,
) -> list[_Line]:
    owners = name_rows(table, hues) if hues else [""] * len(table)
    at = ["" if np.isnan(place) else f"{place!r}" for place in places]
    keys = list(zip(owners, at, strict=True))
    refuse_mixtures(table, keys, [*over, x], "choose among the rows, or name it in hue or over")
    mine = rows_of(owners)
    if len(mine) > _MOST_LINES:
        raise ValueError(f"hue makes {len(mine)} lines; more than {_MOST_LINES} cannot be told apart")
    return [_Line(owner, *_points(places[rows], values[rows], spread)) for owner, rows in mine.items()]


def _points(
    places: NDArray[np.float64], values: NDArray[np.float64], spread: Spread
) -> tuple[list[Point], list[Point]]:
    """Gather one line's points, from left to right, and that of its rows without the param."""
    missing = np.isnan(places)
    there, found = places[~missing], values[~missing]
    points = [gather(place, found[rows], spread) for place, rows in sorted(rows_of(there.tolist()).items())]
    return points, [gather(np.nan, values[missing], spread)] if missing.any() else []


def _limit(axes: Axes, lines: list[_Line], log: tuple[bool, bool], texts: int | None) -> None:
    points = [p for line in lines for p in line.points]
    every = points + [p for line in lines for p in line.baseline]
    if texts is None:
        axes.set_xlim(*limits_of([p.x for p in points], log[0]))
    else:
        axes.set_xlim(-0.5, texts - 0.5)
    axes.set_ylim(*limits_of([v for p in every for v in (p.low, p.y, p.high)], log[1]))


def _draw(
    axes: Axes,
    line: _Line,
    which: tuple[int, str],
    draw: str,
    log: tuple[bool, bool],
    joined: bool,
    floor: float,
) -> list[str]:
    """Draw one line with its spread; give what its marks on edges mean."""
    color, dash, marker = series(which[0])
    x, y, low, high = (np.array([getattr(p, n) for p in line.points]) for n in ("x", "y", "low", "high"))
    inside = place(x, log[0]).inside & place(y, log[1]).inside
    if line.points:
        shown = np.where(inside, x, np.nan), np.where(inside, y, np.nan)
        look: dict[str, Any] = {"linestyle": dash if joined else "none", "marker": marker, "color": color}
        axes.plot(*shown, label=legend_name(line.name) or None, gid="line", **look)
    repeated = np.array([p.runs - p.nan > 1 for p in line.points], dtype=bool)
    if repeated.any():
        _draw_spread(axes, (x, low, high), repeated, color, draw)
    notes = draw_at_edges(axes, x, y, log, floor, color=color)
    for flat in line.baseline:
        notes += _draw_baseline(
            axes, flat.y, f"{line.name} (without {which[1]})".strip(), which[0], log[1], floor
        )
    return notes


def _draw_baseline(axes: Axes, y: float, name: str, index: int, log: bool, floor: float) -> list[str]:
    color, dash, _ = series(index)
    if place(np.array([y]), log).inside[0]:
        line: Any = dash
        axes.axhline(y, color=color, linestyle=line, linewidth=0.9, label=legend_name(name), gid="baseline")
        return []
    right = np.array([axes.get_xlim()[1]])
    return draw_at_edges(
        axes, right, np.array([y]), (False, log), floor, color=color, label=legend_name(name)
    )


def _draw_spread(
    axes: Axes, bounds: tuple[NDArray[np.float64], ...], where: NDArray[np.bool_], color: str, draw: str
) -> None:
    x, low, high = bounds
    bottom, top = axes.get_ylim()
    low, high = np.clip(low, bottom, top), np.clip(high, bottom, top)
    alone = where
    if draw == "band":
        beside = np.concatenate([[False], where[:-1]]) | np.concatenate([where[1:], [False]])
        alone = where & ~beside  # a band of one point would have no area
        axes.fill_between(x, low, high, where=list(where), color=color, alpha=0.18, linewidth=0, gid="spread")
    if alone.any():
        axes.vlines(x[alone], low[alone], high[alone], color=color, linewidth=0.9, gid="spread")


def _name_axes(axes: Axes, labels: tuple[str, str], log: tuple[bool, bool], texts: list[str] | None) -> None:
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    if texts is not None:
        axes.set_xticks(range(len(texts)), texts, rotation=0 if len("".join(texts)) < 40 else 90)
        axes.grid(visible=False, axis="x")
    elif log[0]:
        log_axis(axes, "x")
    if log[1]:
        log_axis(axes, "y")


def _tick_values(axes: Axes, places: NDArray[np.float64], log: bool) -> None:
    """Put ticks where the param was tried, if that is at few places of a logarithmic axis."""
    tried = np.unique(places[np.isfinite(places) & (places > 0)])
    if log and 2 <= len(tried) <= 9 and (tried[1:] / tried[:-1]).min() >= 1.4:
        axes.set_xticks(tried, [f"{value:,g}" for value in tried])
        axes.set_xticks([], minor=True)


def _legend(axes: Axes, lines: list[_Line], spread: Spread, over: list[str]) -> int:
    """Name the lines and say what their spread is; give the legend's number of lines."""
    most = max(p.runs for line in lines for p in [*line.points, *line.baseline])
    title = None
    if most > 1:
        title = f"median and {quantiles(spread)[2]} of up to {most} runs ({', '.join(over) or 'rows'})"
    return legend_above(axes, *axes.get_legend_handles_labels(), title)
