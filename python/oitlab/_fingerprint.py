"""What a function computes, as a hash: its code and everything of its author's that the code reaches."""

from __future__ import annotations

import builtins
import functools
import hashlib
import pickle
import sys
import types
from collections.abc import Iterator
from typing import Any

import numpy as np

_ATOMS = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))


def fingerprint(*values: Any) -> str:
    """Hash functions and data by content: 32 hexadecimal digits, the same in every process.

    A function counts with its byte code, constants, defaults, what it closes over, and the globals that it
    names: data by value, functions and classes of its own package (or of `__main__`) in turn, everything else
    by name and, for modules, version. Docstrings, comments, names of local variables and line numbers do not
    count. What cannot be seen: what is reached through an attribute of a module or by name at run time, files,
    and objects that cannot be pickled, of which the type alone counts. Byte code is that of a Python version:
    another version gives another hash.

    Examples
    --------
    >>> def scaled(k):
    ...     return lambda x: k * x
    >>> fingerprint(scaled(2)) == fingerprint(scaled(2)), fingerprint(scaled(2)) == fingerprint(scaled(3))
    (True, False)
    """
    writer = _Writer({"__main__", *filter(None, map(_package, values))})
    for value in values:
        writer.value(value)
    return writer.digest()


def _package(value: Any) -> str:
    """Name the package that a function or class is from, looking through what wraps it."""
    for inner in ("func", "py_func", "__func__"):
        value = getattr(value, inner, value)
    return str(getattr(value, "__module__", "")).partition(".")[0]


class _Writer:
    """Feeds values to a hash; functions and classes of `packages` by content, others by name."""

    def __init__(self, packages: set[str]) -> None:
        self._hash = hashlib.blake2b(digest_size=16)
        self._packages = packages
        self._seen: dict[int, tuple[int, Any]] = {}
        """By id, how many came before, and the object itself, so that it stays alive."""
        self._inside: list[int] = []
        """Ids of the containers that are being written."""

    def digest(self) -> str:
        return self._hash.hexdigest()

    def _tag(self, *texts: str) -> None:
        for text in texts:
            data = text.encode("utf-8", "surrogatepass")
            self._hash.update(len(data).to_bytes(8, "little") + data)

    def value(self, value: Any) -> None:
        if isinstance(value, _ATOMS):
            self._tag(type(value).__name__, repr(value))
            return
        if isinstance(value, tuple | list | dict | set | frozenset):
            self._container(value)
            return
        # equal constants may be one object in one process and two in another, but what is named is named once
        if isinstance(value, types.FunctionType | type):
            if id(value) in self._seen:
                self._tag("again", str(self._seen[id(value)][0]))
                return
            self._seen[id(value)] = (len(self._seen), value)
        self._object(value)

    def _container(self, value: Any) -> None:
        if id(value) in self._inside:
            self._tag("cycle", str(len(self._inside) - self._inside.index(id(value))))
            return
        self._inside.append(id(value))
        if isinstance(value, dict):
            self._parts("dict", *(part for item in value.items() for part in item))
        elif isinstance(value, set | frozenset):
            self._tag("set", *sorted(fingerprint(item) for item in value))
        else:
            self._parts(type(value).__name__, *value)
        self._inside.pop()

    def _object(self, value: Any) -> None:
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, types.CodeType):
            self._code(value)
        elif isinstance(value, types.MethodType):
            self._parts("method", value.__func__, value.__self__)
        elif isinstance(value, types.ModuleType):
            self._tag("module", value.__name__, str(getattr(value, "__version__", "")))
        elif isinstance(value, functools.partial):
            self._parts("partial", value.func, value.args, value.keywords)
        elif isinstance(getattr(value, "py_func", None), types.FunctionType):  # numba's dispatchers
            options = sorted(getattr(value, "targetoptions", {}).items())
            self._parts("compiled", value.py_func, repr(options))
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind != "O":
            self._tag("array", value.dtype.str, str(value.shape))
            self._hash.update(np.ascontiguousarray(value).tobytes())
        else:
            self._opaque(value)

    def _parts(self, tag: str, *parts: Any) -> None:
        self._tag(tag, str(len(parts)))
        for part in parts:
            self.value(part)

    def _opaque(self, value: Any) -> None:
        kind = type(value)
        self._tag(kind.__module__, kind.__qualname__)
        if isinstance(value, types.BuiltinFunctionType | np.ufunc):
            self._tag(value.__name__)
            return
        if self._is_own(kind):
            self.value(kind)
        try:
            self._hash.update(pickle.dumps(value, protocol=4))
        except Exception:  # objects raise whatever they like when they cannot be pickled
            self._tag("unknown")

    def _is_own(self, value: Any) -> bool:
        return _package(value) in self._packages

    def _foreign(self, value: Any) -> None:
        version = getattr(sys.modules.get(_package(value)), "__version__", "")
        self._tag(str(value.__module__), value.__qualname__, str(version))

    def _function(self, function: types.FunctionType) -> None:
        if not self._is_own(function):
            self._foreign(function)
            return
        self._tag("function")
        self._code(function.__code__, function.__doc__)
        self._parts("defaults", function.__defaults__, function.__kwdefaults__)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._tag("cell", name)
            try:
                self.value(cell.cell_contents)
            except ValueError:
                self._tag("empty")
        for name in sorted(set(_names(function.__code__))):
            if name in function.__globals__:
                self._tag("global", name)
                self.value(function.__globals__[name])
            elif not hasattr(builtins, name):
                self._tag("attribute", name)

    def _code(self, code: types.CodeType, doc: str | None = None) -> None:
        self._hash.update(code.co_code)
        self._tag(str(code.co_argcount), str(code.co_kwonlyargcount), str(code.co_flags), *code.co_names)
        constants = code.co_consts
        has_doc = doc is not None and constants[:1] == (doc,)
        self._parts("constants", *(constants[1:] if has_doc else constants))

    def _class(self, kind: type) -> None:
        self._foreign(kind)
        if not self._is_own(kind):
            return
        for name, member in sorted(vars(kind).items()):
            unwrapped = getattr(member, "__func__", getattr(member, "fget", member))
            if isinstance(unwrapped, types.FunctionType | _ATOMS) and name not in ("__module__", "__doc__"):
                self._tag("member", name)
                self.value(unwrapped)


def _names(code: types.CodeType) -> Iterator[str]:
    """Give the names that the code and the functions in it use."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)
