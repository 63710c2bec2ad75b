"""Arguments from Python to the exact dtypes and shapes that the compiled core takes.

Only form is checked here (shape, numeric kind); values are the core's business.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Vec3 = tuple[float, float, float]
_Text = TypeVar("_Text", bound=str)


def array(value: ArrayLike, name: str, dtype: DTypeLike, shape: tuple[int | str, ...]) -> NDArray[Any]:
    """Contiguous array of `dtype`; a string in `shape` stands for any length.

    Raises ValueError naming the argument for ragged, non-numeric, masked or wrongly shaped input, and for
    floats where integers are needed.
    """
    refuse_masked(value, name)
    try:
        given = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} is not a regular array of numbers: {error}") from error
    wanted = np.dtype(dtype)
    if given.size == 0 and given.ndim <= len(shape):
        given = _empty(given, wanted, shape)
    _check_kind(given, name, wanted)
    _check_shape(given, name, shape)
    if wanted.kind in "iu" and given.size:
        _check_integer_range(given, name, wanted)
    with np.errstate(over="ignore"):
        return np.asarray(given, dtype=wanted, order="C")


def refuse_masked(value: Any, name: str) -> None:
    """Raise on masked values, which NumPy would silently take for ordinary ones."""
    items = value if isinstance(value, list | tuple) else [value]
    if any(isinstance(item, np.ma.MaskedArray) and np.ma.is_masked(item) for item in items):
        raise ValueError(f"{name} has masked values, which have no meaning here; replace them by `filled`")


def _empty(given: NDArray[Any], wanted: np.dtype[Any], shape: tuple[int | str, ...]) -> NDArray[Any]:
    """Give `[]`, which has neither dtype nor columns of its own, those that are asked for."""
    if given.ndim == 1 and isinstance(shape[0], str) and wanted.kind in "iuf":
        return np.zeros([0 if isinstance(n, str) else n for n in shape], dtype=wanted)
    return given


def _check_kind(given: NDArray[Any], name: str, wanted: np.dtype[Any]) -> None:
    kinds = "iu" if wanted.kind in "iu" else "iuf"
    if given.dtype.kind not in kinds:
        needed = "integers" if kinds == "iu" else "real numbers"
        raise ValueError(f"{name} must hold {needed}, got dtype {given.dtype}")


def _check_shape(given: NDArray[Any], name: str, shape: tuple[int | str, ...]) -> None:
    fits = given.ndim == len(shape) and all(
        isinstance(want, str) or want == got for want, got in zip(shape, given.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name} must have shape {wanted}, got {given.shape}")


def _check_integer_range(given: NDArray[Any], name: str, wanted: np.dtype[Any]) -> None:
    limits = np.iinfo(wanted)
    low, high = int(given.min()), int(given.max())
    if low < limits.min or high > limits.max:
        culprit = low if low < limits.min else high
        raise ValueError(f"{name} holds {culprit}, which does not fit in {wanted}")


def vec3(value: ArrayLike, name: str) -> Vec3:
    """Three floats."""
    x, y, z = array(value, name, np.float64, (3,)).tolist()
    return (x, y, z)


def scalar(value: Any, name: str) -> float:
    """One float; refuses strings and booleans, which `float` would take."""
    try:
        return float(array(value, name, np.float64, ()))
    except ValueError:
        raise ValueError(f"{name} must be a number, got {value!r}") from None


def count(value: Any, name: str, *, bits: int = 63) -> int:
    """One integer that is not negative and fits in `bits`; its true upper range is the core's business."""
    number = integer(value, name)
    if number < 0:
        raise ValueError(f"{name} must not be negative, got {number}")
    if number >= 2**bits:
        raise ValueError(f"{name} must be less than 2**{bits}, got {number}")
    return number


def integer(value: Any, name: str) -> int:
    """One integer; refuses booleans, which `operator.index` would take."""
    try:
        if not isinstance(value, bool):
            return operator.index(value)
    except TypeError:
        pass
    raise ValueError(f"{name} must be an integer, got {value!r}")


def flag(value: Any, name: str) -> bool:
    """Take True or False; nothing else, because bool("no") is True."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def choice(value: _Text, name: str, literal: Any) -> _Text:
    """One of the strings of a `Literal`."""
    allowed = get_args(literal)
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
    return value


def params(value: Mapping[str, Any] | None, technique: str) -> dict[str, Any]:
    """Turn the NumPy scalars among a technique's params into Python's own."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError(f"params of {technique!r} must be a mapping, got {type(value).__name__}")
    for key in value:
        if not isinstance(key, str):
            raise ValueError(f"params of {technique!r} must have names for keys, got {key!r}")
    return {key: _python_value(item) for key, item in value.items()}


def _python_value(item: Any) -> Any:
    if isinstance(item, np.generic) or (isinstance(item, np.ndarray) and item.ndim == 0):
        return item.item()
    if isinstance(item, np.ndarray):
        return item.tolist()
    return item
