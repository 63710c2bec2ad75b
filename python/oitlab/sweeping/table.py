"""Rows as tables: a tidy pandas DataFrame, and from it an xarray Dataset."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_FIRST = ("scene", "technique")
_AFTER = (
    "resolve_ms",
    "resolve_ms_spread",
    "raster_ms",
    "raster_ms_spread",
    "total_ms",
    "total_ms_spread",
    "raster_share_ms",
    "repeats",
    "shared_with",
    "executor",
    "threads",
    "backend",
    "width",
    "height",
    "fragments",
    "depth_complexity_mean",
    "depth_complexity_max",
    "geometry_passes",
    "bytes_per_pixel",
    "bytes_per_pixel_measured",
    "dropped",
    "invalid_weights",
)
_REAL = {name for name in _AFTER if "_ms" in name} | {
    "depth_complexity_mean",
    "geometry_passes",
    "bytes_per_pixel",
    "bytes_per_pixel_measured",
}
_VERSIONS = {
    "oitlab": "oitlab_version",
    "python": "python_version",
    "numpy": "numpy_version",
    "commit": "commit",
    "cpu": "cpu",
    "cores": "cores",
    "host": "host",
    "gpu": "gpu",
}
_LAST = ("scene_hash", *_VERSIONS.values())
_TYPES: tuple[tuple[set[type], Any], ...] = (
    ({bool}, "boolean"),
    ({int}, "Int64"),
    ({int, float}, "Float64"),
    ({str}, "string"),
)
FIXED = frozenset({*_FIRST, "seed", *_AFTER, *_LAST})
"""Columns that every table has; a param or metric of such a name gets a prefix."""


def from_rows(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Make the table: a line per row, params and metrics as columns, missing values as <NA>."""
    import pandas as pd

    params = _names(rows, "params")
    metrics = _names(rows, "metrics")
    metric_columns = {name: _column_name("metric", name, params) for name in metrics}
    columns: dict[str, Any] = {name: _column([row[name] for row in rows]) for name in _FIRST}
    for name in params:
        columns[_column_name("param", name)] = _column([row["params"].get(name) for row in rows])
    columns["seed"] = pd.array([row["seed"] for row in rows], dtype="Int64")
    for name, column in metric_columns.items():
        columns[column] = _reals([row["metrics"].get(name) for row in rows])
    for name in _AFTER:
        values = [row[name] for row in rows]
        columns[name] = _reals(values) if name in _REAL else _column(values)
    for name in _names(rows, "skipped"):
        columns[f"skipped.{name}"] = pd.array([row["skipped"].get(name) for row in rows], dtype="Int64")
    columns["scene_hash"] = _column([row["scene_hash"] for row in rows])
    for name, column in _VERSIONS.items():
        columns[column] = _column([row["versions"].get(name) for row in rows])
    frame = pd.DataFrame(columns)
    frame.attrs["keys"] = [*_FIRST, "backend", *(_column_name("param", name) for name in params), "seed"]
    frame.attrs["metrics"] = list(metric_columns.values())
    return frame


def to_xarray(table: pd.DataFrame, dims: str | Iterable[str] | None = None) -> xr.Dataset:
    """Spread a table of `sweep` over the dimensions of what was swept.

    Parameters
    ----------
    table : pandas.DataFrame
        Of `oitlab.sweep` or `oitlab.read_study`, or a part of one.
    dims : str or iterable of str, optional
        Columns that become dimensions. They must have a value in every row, and no two rows the same
        values. None takes, of scene, technique, backend, params and seed, those that vary.

    Returns
    -------
    xarray.Dataset
        The other columns, NaN or None where the grid has no row; those with one value throughout become
        attributes.

    Raises
    ------
    ValueError
        Columns that do not exist, have missing values, or do not tell the rows apart.
    ImportError
        `xarray` is not installed (`pip install 'oitlab[sweep]'`).

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=20)
    >>> grid = {"lwboit": {"bins": [4, 8, 16], "bin_function": ["bell", "tent"]}}
    >>> table = oitlab.sweep(scene, grid, progress=False)
    >>> errors = oitlab.to_xarray(table, dims=["bins", "bin_function"])
    >>> dict(errors["mse"].sizes)
    {'bins': 3, 'bin_function': 2}
    >>> int(errors["mse"].sel(bin_function="tent").idxmin()) in (4, 8, 16)
    True
    """
    import pandas as pd

    try:
        import xarray  # noqa: F401
    except ImportError as error:
        raise ImportError("to_xarray needs xarray: pip install 'oitlab[sweep]'") from error
    if not isinstance(table, pd.DataFrame):
        raise ValueError(f"table must be a DataFrame of oitlab.sweep, got {type(table).__name__}")
    if dims is not None and not isinstance(dims, Iterable):
        raise ValueError(f"dims must be names of columns, got {dims!r}")
    names = _varying(table) if dims is None else [dims] if isinstance(dims, str) else list(dims)
    _check_dims(table, names)
    rest = [name for name in table.columns if name not in names]
    constant = {name for name in rest if _is_constant(table[name])}
    indexed = table.set_index(names)[[name for name in rest if name not in constant]]
    indexed = indexed.apply(_plain).set_axis(_plain_index(indexed.index))
    dataset: xr.Dataset = indexed.to_xarray()
    first = {name: table[name].iloc[0] for name in rest if name in constant}
    dataset.attrs = {str(name): value for name, value in first.items() if not _is_missing(value)}
    return dataset


def _names(rows: Iterable[dict[str, Any]], field: str) -> list[str]:
    """Keys of a field over all rows, in the order of their first appearance."""
    return [name for name in dict.fromkeys(name for row in rows for name in row[field]) if name != "seed"]


def _column_name(kind: str, name: str, taken: Iterable[str] = ()) -> str:
    return f"{kind}.{name}" if name in FIXED or name in taken else name


def _reals(values: list[Any]) -> np.ndarray[Any, Any]:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _column(values: list[Any]) -> Any:
    """Values with the narrowest of pandas' types that knows <NA>; object where they are of several kinds."""
    import pandas as pd

    kinds = {type(value) for value in values if value is not None}
    if not kinds:
        return np.full(len(values), pd.NA, dtype=object)
    filled = [pd.NA if value is None else value for value in values]
    for allowed, dtype in _TYPES:
        if kinds <= allowed and not any(map(_is_large, values)):
            return pd.Series(filled, dtype=dtype).array
    column = np.empty(len(filled), dtype=object)
    for index, value in enumerate(filled):  # at once, NumPy would make tuples of one length an axis
        column[index] = value
    return column


def _is_large(value: Any) -> bool:
    """Whether an integer does not fit pandas' own."""
    return isinstance(value, int) and not -(2**63) <= value < 2**63


def _varying(table: pd.DataFrame) -> list[str]:
    keys = [name for name in table.attrs.get("keys", ()) if name in table.columns]
    if not keys:
        raise ValueError("dims: name the columns; this table does not say which of its columns were swept")
    return [name for name in keys if not _is_constant(table[name])] or keys[:1]


def _check_dims(table: pd.DataFrame, names: Sequence[Hashable]) -> None:
    if table.empty or not names:
        raise ValueError("to_xarray needs at least one row and one dimension")
    unknown = [name for name in names if name not in table.columns]
    if unknown:
        raise ValueError(f"dims: no column {unknown[0]!r}; known: {', '.join(map(str, table.columns))}")
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ValueError(f"dims: {repeated[0]!r} is named twice")
    for name in names:
        missing = table[name].isna()
        if missing.any():
            techniques = ", ".join(sorted(map(str, table.loc[missing, "technique"].unique())))
            raise ValueError(
                f"dims: {name!r} has no value in {int(missing.sum())} rows (of {techniques}); "
                "select the rows that have one first"
            )
    duplicates = table.duplicated(list(names), keep=False)
    if duplicates.any():
        others = [str(name) for name in table.attrs.get("keys", ())
                  if name in table.columns and name not in names
                  and table.loc[duplicates, name].astype(object).map(repr).nunique() > 1]  # fmt: skip
        hint = f"; add {' or '.join(others)}" if others else ""
        raise ValueError(f"dims: {int(duplicates.sum())} rows share their {', '.join(map(str, names))}{hint}")


def _is_missing(value: Any) -> bool:
    import pandas as pd

    return not isinstance(value, tuple) and bool(pd.isna(value))


def _is_constant(column: pd.Series[Any]) -> bool:
    return int(column.astype(object).map(repr).nunique()) <= 1


def _plain(column: pd.Series[Any]) -> pd.Series[Any]:
    """NumPy's types, which xarray computes with, for pandas' own."""
    import pandas as pd

    if not pd.api.types.is_extension_array_dtype(column.dtype):
        return column
    if pd.api.types.is_numeric_dtype(column.dtype) and not pd.api.types.is_bool_dtype(column.dtype):
        missing = bool(column.isna().any())
        is_integer = pd.api.types.is_integer_dtype(column.dtype) and not missing
        return column.astype("int64" if is_integer else "float64")
    plain = column.astype(object)
    return plain.where(column.notna(), None)


def _plain_index(index: pd.Index[Any]) -> pd.Index[Any]:
    import pandas as pd

    frame = index.to_frame(index=False).apply(_plain)
    single = len(frame.columns) == 1
    plain: pd.Index[Any] = pd.Index(frame.iloc[:, 0]) if single else pd.MultiIndex.from_frame(frame)
    return plain
