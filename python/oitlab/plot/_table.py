"""Tidy tables: what is asked of them is checked, rows of one point are gathered, nothing vanishes."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._convert import scalar
from ._units import ROUNDING, identity

if TYPE_CHECKING:
    import pandas as pd

_Key = TypeVar("_Key", bound=Hashable)
Spread: TypeAlias = Literal["range", "quartiles"] | tuple[float, float]


@dataclass(frozen=True)
class Point:
    """What several runs of one variant gave."""

    x: float
    y: float
    """The median; NaN where all runs gave NaN."""
    low: float
    high: float
    runs: int
    nan: int
    """Runs whose number is NaN or missing; they have no part in the rest."""


def checked_table(data: Any, columns: Iterable[str]) -> pd.DataFrame:
    """Refuse what is no DataFrame, has no rows, or lacks a column, by name."""
    import pandas as pd

    if not isinstance(data, pd.DataFrame):
        raise ValueError(f"data must be a pandas DataFrame, got {type(data).__name__}")
    if not data.columns.is_unique:
        twice = data.columns[data.columns.duplicated()][0]
        raise ValueError(f"data has two columns {twice!r}")
    there = list(map(str, data.columns))
    for name in columns:
        if name not in there:
            raise ValueError(f"data has no column {name!r}; it has: {', '.join(there) or 'none'}")
    if data.empty:
        raise ValueError("data has no rows")
    return data


def several(value: Any, argument: str) -> list[Any]:
    """Give a list of what must be a sequence or another iterable."""
    try:
        return list(value)
    except TypeError:
        raise ValueError(f"{argument} must be one or several, got {value!r}") from None


def names(value: str | Sequence[str] | None, argument: str) -> list[str]:
    """One column's name, several, or none."""
    if value is None:
        return []
    given = [value] if isinstance(value, str) else several(value, argument)
    if not all(isinstance(name, str) for name in given):
        raise ValueError(f"{argument} must be a column's name or several, got {value!r}")
    return given


def numbers(data: pd.DataFrame, column: str) -> NDArray[np.float64]:
    """Give a column as floats, NaN where something is missing; ValueError if it holds anything else."""
    import pandas as pd

    found = data[column]
    if pd.api.types.is_bool_dtype(found.dtype) or not _is_numeric(found):
        first = next(repr(v) for v in found if not _is_missing(v))
        raise ValueError(f"column {column!r} must hold numbers, but has {first}")
    return found.to_numpy(dtype=np.float64, na_value=np.nan)


def is_text(data: pd.DataFrame, column: str) -> bool:
    """Whether a column holds something that has no place on an axis of numbers."""
    return not _is_numeric(data[column])


def _is_numeric(found: Any) -> bool:
    import pandas as pd

    if pd.api.types.is_numeric_dtype(found.dtype):
        return not pd.api.types.is_bool_dtype(found.dtype) and not pd.api.types.is_complex_dtype(found.dtype)
    kinds = int, float, np.integer, np.floating
    return found.dtype == object and all(
        _is_missing(v) or (isinstance(v, kinds) and not isinstance(v, bool)) for v in found
    )


def _is_missing(value: Any) -> bool:
    import pandas as pd

    return value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value))


def text(value: Any) -> str:
    """Show a value of a column as `--param` takes it: 4 for 4.0, true for True."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, float | np.floating):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(text, value)) + ")"
    return str(value)


def name_rows(data: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Name each row by some columns: the first's value, then `name=value` of those that are not missing."""
    named = []
    for row in data[list(columns)].itertuples(index=False):
        parts = []
        for column, value in zip(columns, row, strict=True):
            if not _is_missing(value):
                plain = column in ("technique", "scene") or len(columns) == 1
                parts.append(text(value) if plain else f"{column}={text(value)}")
        named.append(" ".join(parts) or "all")
    return named


def variant_columns(data: pd.DataFrame, over: Sequence[str]) -> list[str]:
    """Columns that tell variants apart: the technique, and every param that differs within one.

    That a param is missing in some rows, because others make it inactive, is no difference worth telling,
    unless it is the only one.
    """
    found = ["technique"] if "technique" in data.columns else []
    groups = [group for _, group in data.groupby("technique", sort=False)] if found else [data]
    params = [column for column in identity(data) if column not in ("technique", "scene", *over)]
    found += [c for c in params if any(_distinct(group[c].dropna()) > 1 for group in groups)]
    for column in params:
        if column not in found and _separates(groups, found, column):
            found.append(column)
    return found


def _separates(groups: Iterable[pd.DataFrame], found: Sequence[str], column: str) -> bool:
    """Whether a column tells rows apart that the ones found do not."""
    for group in groups:
        titles = name_rows(group, found) if found else [""] * len(group)
        seen: dict[str, set[bool]] = {}
        for title, value in zip(titles, group[column], strict=True):
            seen.setdefault(title, set()).add(_is_missing(value))
        if any(len(kinds) > 1 for kinds in seen.values()):
            return True
    return False


def _distinct(values: Any) -> int:
    """Count different values."""
    return len(set(_fingerprints(values)))


def _fingerprints(values: Iterable[Any]) -> list[str]:
    """Give values by their text, since some cannot be hashed."""
    return ["" if _is_missing(value) else f"{type(value).__name__} {value!r}" for value in values]


def rows_of(keys: Iterable[_Key]) -> dict[_Key, NDArray[np.intp]]:
    """Give the rows of each key, in the order in which keys appear.

    Examples
    --------
    >>> {key: rows.tolist() for key, rows in rows_of(["b", "a", "b"]).items()}
    {'b': [0, 2], 'a': [1]}
    """
    found: dict[_Key, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    return {key: np.array(rows, dtype=np.intp) for key, rows in found.items()}


def refuse_mixtures(data: pd.DataFrame, keys: Sequence[Any], over: Sequence[str], advice: str) -> None:
    """Refuse rows of one point that differ in more than what a spread is taken over.

    Their median would be a number that belongs to no scene and no technique.
    """
    watched = [name for name in identity(data) if name not in over]
    groups = [rows for rows in rows_of(keys).values() if len(rows) > 1]
    for column in watched if groups else ():
        prints = _fingerprints(data[column])
        if len(set(prints)) == 1:
            continue
        for rows in groups:
            if len({prints[row] for row in rows}) > 1:
                shown = ", ".join(dict.fromkeys(text(v) for v in data[column].iloc[rows]))
                raise ValueError(f"rows of one point differ in {column!r} ({shown}): {advice}")


def quantiles(spread: Spread) -> tuple[float, float, str]:
    """Lower and upper quantile, and what a legend says of them."""
    if spread == "range":
        return 0.0, 1.0, "smallest to largest"
    if spread == "quartiles":
        return 0.25, 0.75, "quartiles"
    try:
        low, high = map(float, spread)
    except (TypeError, ValueError):
        low, high = 1.0, 0.0
    if isinstance(spread, str) or not 0.0 <= low < high <= 1.0:
        raise ValueError(
            f'spread must be "range", "quartiles" or two quantiles 0 <= low < high <= 1, got {spread!r}'
        )
    return low, high, f"{100 * low:g} % to {100 * high:g} %"


def gather(x: float, runs: NDArray[np.float64], spread: Spread) -> Point:
    """Sum several runs up."""
    low, high, _ = quantiles(spread)
    good = runs[~np.isnan(runs)]
    missing = len(runs) - len(good)
    if good.size == 0:
        return Point(x, np.nan, np.nan, np.nan, len(runs), missing)
    # between infinities there is no middle; then one of the runs is taken
    method: Any = "linear" if np.isfinite(good).all() else "nearest"
    middle, bottom, top = (float(np.quantile(good, q, method=method)) for q in (0.5, low, high))
    return Point(x, middle, bottom, top, len(runs), missing)


def refuse_negative(values: NDArray[np.float64], column: str) -> None:
    """Refuse what a logarithmic axis has no place for, not even at its edge."""
    if (values < 0).any():
        first = int(np.argmax(values < 0))
        raise ValueError(
            f"column {column!r} holds {values[first]:g} in row {first}: a logarithmic axis takes none below 0"
        )


def floored(values: NDArray[np.float64], floor: float) -> NDArray[np.float64]:
    """Count what is as good as zero as zero, which has a mark of its own."""
    return np.where(values <= floor, 0.0, values) if floor > 0.0 else values


def checked_floor(floor: float | None, column: str, log: bool) -> float:
    """Give the value from which on down a column counts as zero; None takes the column's own."""
    if not log:
        return 0.0
    if floor is None:
        return ROUNDING.get(column, 0.0)
    value = scalar(floor, "floor")
    if not 0.0 <= value < np.inf:
        raise ValueError(f"floor must be a finite number >= 0, got {value}")
    return value
