"""Digests by which a result is found again: of values, of functions, of the code that made it."""

from __future__ import annotations

import functools
import hashlib
import json
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .. import _oitlab

_DIGITS = 32


def digest(*parts: bytes | str) -> str:
    """Hexadecimal digest of parts whose borders count."""
    hasher = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        hasher.update(len(data).to_bytes(8, "little") + data)
    return hasher.hexdigest()[:_DIGITS]


def canonical(value: Any) -> str:
    """JSON text of params and options that is the same for equal ones; callables as their fingerprints.

    Examples
    --------
    >>> canonical({"b": (1.0, 2.0), "a": None})
    '{"a":null,"b":[1.0,2.0]}'
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=_as_json)


def _as_json(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if callable(value):
        return {"callable": shown(value), "fingerprint": fingerprint(value)}
    return {"type": type(value).__qualname__, "repr": repr(value)}


def shown(value: Any) -> Any:
    """Give what a table shows of a param: a callable's qualified name, anything else itself.

    Examples
    --------
    >>> shown(canonical), shown(0.5)
    ('canonical', 0.5)
    """
    if not callable(value):
        return value
    name = str(getattr(value, "__qualname__", type(value).__qualname__))
    return f"{name}#{fingerprint(value)[:8]}" if "<lambda>" in name else name


def fingerprint(function: Callable[..., Any]) -> str:
    """Content digest of a callable: bytecode, constants, defaults, closure, and the globals that it reads.

    Functions among those are followed within the same module; what comes from other modules counts by name
    alone. Callables that are not functions count by their pickle. Another Python version gives another
    digest, since bytecode differs.
    """
    return digest(*_function_parts(function, set()))


def _function_parts(function: Any, seen: set[int]) -> list[bytes | str]:
    if isinstance(function, functools.partial):
        bound = [_value_part(item, "", seen) for item in (*function.args, *sorted(function.keywords.items()))]
        return ["partial", *_function_parts(function.func, seen), *bound]
    if isinstance(function, types.MethodType):
        owner = _value_part(function.__self__, "", seen)
        return ["method", owner, *_function_parts(function.__func__, seen)]
    if not isinstance(function, types.FunctionType):
        return ["object", _pickled(function)]
    if id(function) in seen:
        return ["again"]
    seen.add(id(function))
    module = function.__module__ or ""
    cells = [cell.cell_contents for cell in function.__closure__ or () if not _is_empty(cell)]
    names = sorted(_names(function.__code__) & function.__globals__.keys())
    values = [*(function.__defaults__ or ()), *sorted((function.__kwdefaults__ or {}).items()), *cells]
    parts = [_value_part(value, module, seen) for value in values]
    used = (part for name in names for part in (name, _value_part(function.__globals__[name], module, seen)))
    return ["function", *_code_parts(function.__code__), *parts, *used]


def _is_empty(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018
    except ValueError:
        return True
    return False


def _names(code: types.CodeType) -> set[str]:
    inner = [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*map(_names, inner))


def _code_parts(code: types.CodeType) -> list[bytes | str]:
    """Bytecode and what it refers to, but neither file nor line, which move without a change."""
    parts: list[bytes | str] = [code.co_code, " ".join(code.co_names), " ".join(code.co_varnames)]
    for constant in code.co_consts:
        parts += _code_parts(constant) if isinstance(constant, types.CodeType) else [_text(constant)]
    return parts


def _text(constant: Any) -> str:
    if isinstance(constant, frozenset):  # their order changes from process to process
        return f"frozenset {sorted(map(repr, constant))}"
    return f"{type(constant).__name__} {constant!r}"


def _value_part(value: Any, module: str, seen: set[int]) -> str:
    if isinstance(value, types.ModuleType):
        return f"module {value.__name__}"
    if isinstance(value, type):
        return f"class {value.__module__}.{value.__qualname__}"
    if isinstance(value, bool | int | float | complex | str | bytes | tuple | frozenset | None):
        return _text(value)
    if callable(value) and getattr(value, "__module__", None) != module and hasattr(value, "__qualname__"):
        return f"elsewhere {value.__module__}.{value.__qualname__}"
    if callable(value):
        return digest(*_function_parts(value, seen))
    if isinstance(value, np.ndarray) and value.dtype != object:
        return digest(str(value.dtype), str(value.shape), np.ascontiguousarray(value).tobytes())
    return digest(_pickled(value))


def _pickled(value: Any) -> bytes:
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(value)
    except Exception as error:
        raise ValueError(
            f"{value!r} cannot be pickled, so its results could not be told apart: {error}"
        ) from error
    return data


@functools.cache
def core_digest() -> str:
    """Digest of the compiled core: a rebuilt one may draw other bits."""
    return digest(Path(_oitlab.__file__).read_bytes())
