"""Digests by which a result is found again: of values, and of the core that made it."""

from __future__ import annotations

import functools
import hashlib
import json
import types
from pathlib import Path
from typing import Any

import numpy as np

from .. import _oitlab
from .._fingerprint import examined

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

    Callables into which the fingerprint cannot see are equal only to themselves, while this process lasts.

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
        return {"callable": _name(value), "fingerprint": told_apart(value)}
    return {"type": type(value).__qualname__, "repr": repr(value)}


def shown(value: Any) -> Any:
    """Give what a table shows of a param: a callable's qualified name, anything else itself.

    Only functions of a module are told by their names; others get a hash of what they compute.

    Examples
    --------
    >>> shown(canonical), shown(0.5)
    ('canonical', 0.5)
    """
    if not callable(value):
        return value
    name = _name(value)
    plain = isinstance(value, types.FunctionType) and "<" not in name and value.__closure__ is None
    return name if plain else f"{name}#{digest(told_apart(value))[:8]}"


def _name(value: Any) -> str:
    return str(getattr(value, "__qualname__", type(value).__qualname__))


def told_apart(*values: Any) -> str:
    """Give the fingerprint of callables, with their ids where it does not see everything."""
    found = examined(*values)
    return found.digest + "".join(f"@{id(value):x}" for value in values if found.unseen)


@functools.cache
def core_digest() -> str:
    """Digest of the compiled core: a rebuilt one may draw other bits."""
    return digest(Path(_oitlab.__file__).read_bytes())
