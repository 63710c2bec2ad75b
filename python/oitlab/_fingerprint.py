"""What a function computes, as a hash: its code and everything of its author's that the code reaches."""

from __future__ import annotations

import builtins
import copyreg
import dis
import functools
import hashlib
import importlib.metadata
import platform
import sys
import threading
import types
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

_NOT_COMPUTED = {
    "__abstractmethods__", "__annotate__", "__annotate_func__", "__annotations__", "__annotations_cache__",
    "__classcell__", "__dataclass_fields__", "__dataclass_params__", "__dict__", "__doc__",
    "__firstlineno__", "__match_args__", "__module__", "__orig_bases__", "__parameters__", "__qualname__",
    "__static_attributes__", "__type_params__", "__weakref__", "_abc_impl",
}  # fmt: skip
_ATOMS = {type(None), bool, int, float, complex, str, bytes, type(Ellipsis), type(NotImplemented)}
_CONTAINERS = {tuple, list, dict, set, frozenset}
_LOCKS = (type(threading.Lock()), type(threading.RLock()))
_CACHES = (weakref.WeakKeyDictionary, weakref.WeakValueDictionary, weakref.WeakSet)
_LRU_CACHE = type(functools.lru_cache(abs))
_DESCRIPTORS = (
    types.GetSetDescriptorType, types.MemberDescriptorType, types.MethodDescriptorType,
    types.WrapperDescriptorType, types.ClassMethodDescriptorType,
)  # fmt: skip
_GLOBALS = {"LOAD_GLOBAL", "LOAD_NAME", "STORE_GLOBAL", "DELETE_GLOBAL"}
_WRAPPED = ("func", "py_func", "pyfunc", "__func__", "__wrapped__")


_PUBLISHED = {"numpy", "scipy", "numba", "pandas", "torch", "oitlab", *sys.stdlib_module_names} - {"__main__"}
"""Packages that are never looked into, though a value be from them: their versions say it all."""


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """A hash, and what it could not see."""

    digest: str
    unseen: tuple[str, ...]
    """Descriptions of objects whose content is not in the hash: different ones may share it."""


def fingerprint(*values: Any) -> str:
    """Hash functions and data by content: 32 hexadecimal digits, the same in every process.

    A function counts with its byte code, constants, defaults, attributes, what it closes over, and the
    globals that it names, through modules too: data by value, functions and classes of its own package, of
    `__main__` and of packages without a version in turn, everything else by name and version. Comments,
    names of local variables and line numbers do not count. What cannot be seen: what is reached by name at
    run time, and files; `examined` tells of objects whose inside cannot be seen. Byte code is that of a
    Python version: another version gives another hash.

    Examples
    --------
    >>> def scaled(k):
    ...     return lambda x: k * x
    >>> fingerprint(scaled(2)) == fingerprint(scaled(2)), fingerprint(scaled(2)) == fingerprint(scaled(3))
    (True, False)
    """
    return examined(*values).digest


def examined(*values: Any) -> Fingerprint:
    """Give the hash of `fingerprint` and tell what it could not see.

    Examples
    --------
    >>> import numpy as np
    >>> examined(np.frompyfunc(lambda x: x, 1, 1)).unseen
    ("ufunc '<lambda> (vectorized)'",)
    """
    writer = _Writer({"__main__", *map(_package, values)} - {"", *_PUBLISHED})
    try:
        for value in values:
            writer.value(value)
    except RecursionError:
        writer.unseen.append("structure too deep to walk")
    return Fingerprint(writer.digest(), tuple(dict.fromkeys(writer.unseen)))


def _package(value: Any) -> str:
    """Name the package that a function or class is from, looking through what wraps it."""
    for inner in _WRAPPED:
        value = getattr(value, inner, value)
    return str(getattr(value, "__module__", "")).partition(".")[0]


@functools.cache
def _version(package: str) -> str | None:
    """Give what tells a package's states apart; None for files that change without notice."""
    if package in sys.stdlib_module_names and package != "__main__":
        return platform.python_version()
    given = getattr(sys.modules.get(package), "__version__", None)
    if given is not None:
        return str(given)
    try:
        return importlib.metadata.version(package) if package else None
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None


class _Writer:
    """Feeds values to a hash; functions and classes of `packages` by content, others by name."""

    def __init__(self, packages: set[str]) -> None:
        self.unseen: list[str] = []
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
        kind = type(value)
        if kind in _ATOMS:
            self._tag(kind.__name__, repr(value))
        elif kind in _CONTAINERS:
            self._container(value)
        elif isinstance(value, types.CodeType):
            self._code(value)
        elif isinstance(value, types.ModuleType):
            self._tag("module", value.__name__, str(_version(value.__name__.partition(".")[0])))
        elif kind is np.ndarray and value.dtype.kind != "O" and not value.dtype.hasobject:
            self._tag("array", value.dtype.str, str(value.dtype.descr), str(value.shape))
            self._hash.update(np.ascontiguousarray(value).tobytes())
        elif id(value) in self._seen:
            self._tag("again", str(self._seen[id(value)][0]))
        else:
            # equal constants may be one object in one process and two in another, but these are what they are
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
            found = [examined(item) for item in value]
            self._tag("set", *sorted(item.digest for item in found))
            self.unseen += sorted(text for item in found for text in item.unseen)
        else:
            self._parts(type(value).__name__, *value)
        self._inside.pop()

    def _object(self, value: Any) -> None:
        compiled = _compiled(value)
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, types.MethodType):
            self._parts("method", value.__func__, value.__self__)
        elif isinstance(value, functools.partial):
            self._parts("partial", value.func, value.args, value.keywords, vars(value))
        elif isinstance(value, staticmethod | classmethod):
            self._parts(type(value).__name__, value.__func__)
        elif isinstance(value, property):
            self._parts("property", value.fget, value.fset)
        elif compiled is not None:
            options = sorted(getattr(value, "targetoptions", {}).items())
            self._parts("compiled", compiled, repr(options))
        elif isinstance(value, np.ufunc):
            self._ufunc(value)
        elif isinstance(value, types.BuiltinFunctionType | types.MethodWrapperType):
            self._builtin(value)
        elif isinstance(value, _DESCRIPTORS):
            self._parts("descriptor", value.__name__, value.__objclass__)
        elif isinstance(value, _LRU_CACHE):
            self._parts("cached", value.__wrapped__)
        elif isinstance(value, types.MappingProxyType):
            self._parts("proxy", dict(value))
        elif isinstance(value, _LOCKS + _CACHES):
            self._tag("lock")  # decides when something is computed, not what
        else:
            self._instance(value)

    def _parts(self, tag: str, *parts: Any) -> None:
        self._tag(tag, str(len(parts)))
        for part in parts:
            self.value(part)

    def _ufunc(self, value: np.ufunc) -> None:
        for home in ("numpy", "scipy.special"):
            if getattr(sys.modules.get(home), value.__name__, None) is value:
                self._tag("ufunc", home, value.__name__, str(_version(home.partition(".")[0])))
                return
        self._tag("ufunc")
        self.unseen.append(f"ufunc {value.__name__!r}")

    def _builtin(self, value: Any) -> None:
        if value.__self__ is None or isinstance(value.__self__, types.ModuleType):
            self._named(value, value.__qualname__)
        else:
            self._parts("method", value.__name__, value.__self__)

    def _named(self, value: Any, name: str) -> None:
        """Write something without a content of its own: it is told by where it is from, if that is known."""
        version = _version(_package(value))
        self._tag("named", str(getattr(value, "__module__", "")), name, str(version))
        if version is None:
            self.unseen.append(f"{type(value).__name__} {name!r}")

    def _instance(self, value: Any) -> None:
        """Write an object by its class and by what pickle would take of it, down to what pickle refuses."""
        kind = type(value)
        try:
            reduced = copyreg.dispatch_table[kind](value) if kind in copyreg.dispatch_table \
                else value.__reduce_ex__(4)  # fmt: skip
        except Exception:  # objects raise whatever they like when they cannot be pickled
            self._parts("object", kind)
            self._state(value)
            self.unseen.append(f"{kind.__qualname__} object")
            return
        if isinstance(reduced, str):
            if self._is_own(kind):
                self._parts("object", kind)
                self._state(value)
            else:
                self._named(value, reduced)
            return
        made, arguments, *rest = reduced
        self._parts("object", kind, made, arguments)
        self._parts("state", *map(_listed, rest))
        if self._is_own(kind):  # which may keep from pickle what it computes with
            self._state(value)

    def _state(self, value: Any) -> None:
        state = dict(getattr(value, "__dict__", {}))
        slots = (getattr(base, "__slots__", ()) for base in type(value).__mro__)
        for names in slots:
            for name in (names,) if isinstance(names, str) else names:
                if name not in ("__dict__", "__weakref__") and hasattr(value, name):
                    state[name] = getattr(value, name)
        self._parts("state", state)

    def _is_own(self, value: Any) -> bool:
        """Whether its content counts: its name and version do not tell what it is."""
        package = _package(value)
        local = isinstance(value, types.FunctionType) and "<" in value.__qualname__
        return package in self._packages or local or _version(package) is None

    def _foreign(self, value: Any) -> None:
        self._tag(str(value.__module__), value.__qualname__, str(_version(_package(value))))

    def _function(self, function: types.FunctionType) -> None:
        if not self._is_own(function):
            self._foreign(function)
            return
        self._parts("function", function.__code__, function.__defaults__, function.__kwdefaults__)
        if vars(function):
            self._parts("attributes", vars(function))
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._tag("cell", name)
            try:
                self.value(cell.cell_contents)
            except ValueError:
                self._tag("empty")
        every = {name for code in _codes(function.__code__) for name in code.co_names}
        for name in sorted(set(_global_names(function.__code__))):
            if name in function.__globals__:
                self._tag("global", name)
                self._global(function.__globals__[name], every)
            elif not hasattr(builtins, name):
                self._tag("missing", name)

    def _global(self, value: Any, names: set[str]) -> None:
        """Write what a global name stands for; of one's own modules also what the code may name in them."""
        self.value(value)
        if not isinstance(value, types.ModuleType) or id(value) in self._inside or not self._is_mine(value):
            return
        self._inside.append(id(value))
        for name in sorted(names & vars(value).keys()):
            self._tag("attribute", name)
            self._global(vars(value)[name], names)
        self._inside.pop()

    def _is_mine(self, module: types.ModuleType) -> bool:
        package = module.__name__.partition(".")[0]
        return package in self._packages or _version(package) is None

    def _code(self, code: types.CodeType) -> None:
        self._hash.update(code.co_code)
        self._tag(str(code.co_argcount), str(code.co_kwonlyargcount), str(code.co_flags), *code.co_names)
        self._parts("constants", *code.co_consts)

    def _class(self, kind: type) -> None:
        self._foreign(kind)
        if not self._is_own(kind):
            return
        self._parts("bases", *kind.__bases__)
        for name, member in sorted(vars(kind).items()):
            if name not in _NOT_COMPUTED:
                self._tag("member", name)
                self.value(member)


def _compiled(value: Any) -> types.FunctionType | None:
    """Give the Python function of what numba compiled."""
    if not str(type(value).__module__).startswith("numba"):
        return None
    function = getattr(value, "py_func", getattr(getattr(value, "_dispatcher", None), "py_func", None))
    return function if isinstance(function, types.FunctionType) else None


def _listed(part: Any) -> Any:
    """Give the items of an iterator, which tells nothing by itself."""
    return list(part) if hasattr(part, "__next__") else part


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Give the code and that of the functions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _global_names(code: types.CodeType) -> Iterator[str]:
    """Give the globals that the code and the functions in it name; attributes of the same name are none."""
    for inner in _codes(code):
        yield from (i.argval for i in dis.get_instructions(inner) if i.opname in _GLOBALS)
