"""What a sweep is asked for: techniques with lists of values, multiplied out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from .._convert import integer
from ..registry import techniques

Params: TypeAlias = Mapping[str, Any] | None
Grid: TypeAlias = Mapping[str, Params] | Iterable[str | tuple[str, Params]]
"""Technique ids with their params, or several such pairs."""
Request: TypeAlias = tuple[str, dict[str, Any]]


def expanded(grid: Grid) -> list[Request]:
    """Every combination of the values of a grid, as (technique id, params).

    Parameters
    ----------
    grid : mapping, or iterable of ids and (id, params)
        Lists, ranges and 1-D arrays are swept; anything else, a tuple included, is one value.

    Returns
    -------
    list of (str, dict)
        In the grid's order; the last param runs fastest. Ids are aliases' originals.

    Raises
    ------
    ValueError
        Unknown techniques, empty lists, lists in lists, arrays of more than one dimension, sets, mappings
        and iterators as values.

    Examples
    --------
    >>> expanded({"over": None, "lwboit": {"bins": [8, 16], "range": (1.0, 2.0)}})
    [('a_buffer', {}), ('lwboit', {'bins': 8, 'range': (1.0, 2.0)}), ('lwboit', {'bins': 16, 'range': (1.0, 2.0)})]
    """  # noqa: E501
    return [request for technique, params in _items(grid) for request in _combinations(technique, params)]


def checked_seeds(seeds: Iterable[int] | None) -> list[int] | None:
    """Seeds as Python integers, each once; ValueError for an empty or wrong list."""
    if seeds is None:
        return None
    if isinstance(seeds, str | bytes) or not isinstance(seeds, Iterable):
        raise ValueError(f"seeds must be an iterable of integers, got {seeds!r}")
    given = [integer(seed, f"seeds[{index}]") for index, seed in enumerate(seeds)]
    if not given:
        raise ValueError("seeds is empty; leave it out to render each variant once")
    negative = [seed for seed in given if seed < 0]
    if negative:
        raise ValueError(f"seeds must be at least 0, got {negative[0]}")
    return list(dict.fromkeys(given))


def _items(grid: Grid) -> list[tuple[str, Params]]:
    if isinstance(grid, Mapping):
        pairs: list[Any] = list(grid.items())
    elif isinstance(grid, str) or not isinstance(grid, Iterable):
        raise ValueError(f"grid must map technique ids to params, or list (id, params), got {grid!r}")
    else:
        pairs = [(item, None) if isinstance(item, str) else item for item in grid]
    if not pairs:
        raise ValueError("grid is empty: there is nothing to sweep")
    return [_item(index, pair) for index, pair in enumerate(pairs)]


def _item(index: int, pair: Any) -> tuple[str, Params]:
    try:
        name, params = pair
    except (TypeError, ValueError):
        raise ValueError(f"grid[{index}] must be a technique id or (id, params), got {pair!r}") from None
    entry = techniques().get(name) if isinstance(name, str) else None
    if entry is None:
        raise ValueError(f"grid: unknown technique {name!r}; known: {', '.join(techniques().ids)}")
    if params is not None and not isinstance(params, Mapping):
        raise ValueError(f"grid: params of {name!r} must be a mapping, got {type(params).__name__}")
    return entry.id, params


def _combinations(technique: str, params: Params) -> list[Request]:
    for name in params or {}:
        if not isinstance(name, str):
            raise ValueError(f"grid: params of {technique!r} must have names for keys, got {name!r}")
    axes = {name: _values(technique, name, value) for name, value in (params or {}).items()}
    _check_uniforms(technique, axes)
    return [(technique, dict(zip(axes, values, strict=True))) for values in product(*axes.values())]


def _check_uniforms(technique: str, axes: Mapping[str, Sequence[Any]]) -> None:
    """Refuse uniforms that some functions of a mapping have and others cannot have."""
    for name in axes:
        base = name.partition(".")[0]
        if base == name:
            continue
        values = axes.get(base, ())
        without = [value for value in values if not isinstance(value, str) or value.isidentifier()]
        if without and len(without) < len(values):
            raise ValueError(
                f"grid: {technique}'s {name!r} is a uniform of one's own texts, which {without[0]!r} is not; "
                f"put the two in separate grid entries: [({technique!r}, {{...}}), ({technique!r}, {{...}})]"
            )


def _values(technique: str, name: str, value: Any) -> Sequence[Any]:
    where = f"grid: {technique}'s {name!r}"
    if isinstance(value, np.ndarray) or type(value).__name__ in ("Series", "Index"):
        value = _from_array(np.asarray(value), where)
    elif isinstance(value, range):
        value = list(value)
    elif isinstance(value, Mapping | set | frozenset) or (hasattr(value, "__next__")):
        raise ValueError(f"{where} must be a value or a list of values, got {type(value).__name__}")
    if not isinstance(value, list):
        return [value]
    if not value:
        raise ValueError(f"{where} is an empty list: no value to try")
    nested = [item for item in value if isinstance(item, list | Mapping | set)]
    if nested:
        raise ValueError(
            f"{where} has {nested[0]!r} among its values; one value of several numbers is a tuple"
        )
    return value


def _from_array(array: np.ndarray[Any, Any], where: str) -> Any:
    if array.ndim > 1:
        raise ValueError(f"{where}: arrays that are swept have one dimension, got shape {array.shape}")
    return array.tolist()
