"""Fingerprints: what computes something else has another; what cannot be seen is told."""

import functools
import pickle
import sys
import textwrap
import threading
import types
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, Generic, TypeVar

import cloudpickle
import numpy as np
import pytest

from oitlab._fingerprint import examined, fingerprint


class Weight:
    """As a user writes one; `held` may be anything."""

    def __init__(self, k: float, held: Any = None) -> None:
        self.k, self.held = k, held

    def __call__(self, z: Any, alpha: Any) -> Any:
        return alpha * z**self.k

    def other(self, z: Any, alpha: Any) -> Any:
        return z**self.k


class Secretive(Weight):
    def __reduce__(self) -> Any:
        raise TypeError("no")


class Keeping(Weight):
    """Hides from pickle what it computes with."""

    def __getstate__(self) -> Any:
        return {}


class Slotted:
    __slots__ = ("k",)

    def __init__(self, k: float) -> None:
        self.k = k

    def __call__(self, z: Any, alpha: Any) -> Any:
        return z**self.k


T = TypeVar("T")


class Holder(Generic[T]):
    def __init__(self, k: T) -> None:
        self.k = k

    def __call__(self, z: Any, alpha: Any) -> Any:
        return z * self.k


class Sentinel(Slotted):
    def __reduce__(self) -> Any:
        return "SENTINEL"


def nested(depth: int) -> Any:
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value


def scaled(k: float) -> Any:
    return lambda z, alpha=1: alpha * z**k


def with_attribute(k: float) -> Any:
    def weight(z: Any, alpha: Any) -> Any:
        return weight.k * z  # type: ignore[attr-defined]

    weight.k = k  # type: ignore[attr-defined]
    return weight


def with_class(**members: Any) -> Any:
    return type("Weight", (), {**members, "__call__": lambda self, z, alpha: z})()


def two_lambdas(first: bool) -> Any:
    return (lambda z, a: z) if first else (lambda z, a: a * z)


class Ordered(dict[str, float]):
    def __call__(self, z: Any, alpha: Any) -> Any:
        return self["k"] * z


MAKERS = {
    "closure": scaled,
    "vectorize": lambda k: np.vectorize(scaled(k)),
    "two lambdas under vectorize": lambda k: np.vectorize(two_lambdas(k == 1)),
    "partial": lambda k: functools.partial(scaled(1), alpha=k),
    "instance": Weight,
    "method": lambda k: Weight(k).other,
    "holds a lambda": lambda k: Weight(1, scaled(k)),
    "holds a lock": lambda k: Weight(k, threading.Lock()),
    "holds another": lambda k: Weight(1, [Weight(k)]),
    "hides from pickle": Keeping,
    "slots": Slotted,
    "function's attribute": with_attribute,
    "class's tuple": lambda k: with_class(table=(1.0, k)),
    "class's array": lambda k: with_class(table=np.array([1.0, k])),
    "class's dict": lambda k: with_class(table={"a": [k]}),
    "class's property": lambda k: with_class(table=property(scaled(k))),
    "class's static method": lambda k: with_class(table=staticmethod(scaled(k))),
    "base class": lambda k: type("W", (type("Base", (), {"k": k}),), {})(),
    "subclass of dict": lambda k: Ordered(k=k),
    "array of objects": lambda k: np.array([scaled(k), None], dtype=object),
    "lru_cache": lambda k: functools.lru_cache(scaled(k)),
    "singledispatch": lambda k: functools.singledispatch(scaled(k)),
    "generic class": lambda k: Holder(k),
    "calls itself a name": Sentinel,
    "generator's method": lambda k: np.random.default_rng(k).random,
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_different_ones_differ_and_equal_ones_agree(make: Any) -> None:
    one, same, two = examined(make(1)), examined(make(1)), examined(make(2))
    assert one.digest == same.digest != two.digest
    assert one.unseen == ()


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (np.frompyfunc(lambda z, a: z, 2, 1), "ufunc"),
        (Weight(1, np.frompyfunc(lambda z: z, 1, 1)), "ufunc"),
        ([{np.frompyfunc(lambda z: z, 1, 1)}], "ufunc"),
        (Secretive(1), "Secretive object"),
        (scaled(n for n in range(3)), "generator object"),  # type: ignore[arg-type]
        (nested(100_000), "structure too deep"),
        (threading.local(), "_local object"),
        (types.BuiltinFunctionType, None),
        (np.hypot, None),
        (len, None),
        (str.upper, None),
        (np.linalg.norm, None),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_cannot_be_seen_is_told(value: Any, what: str | None) -> None:
    unseen = examined(value).unseen
    assert (what is None and unseen == ()) or (what is not None and unseen[0].startswith(what))


def test_even_what_refuses_pickle_is_walked() -> None:
    assert fingerprint(Secretive(1)) != fingerprint(Secretive(2))


def test_own_modules_are_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    helper = types.ModuleType("helper_of_fingerprints")
    monkeypatch.setitem(sys.modules, helper.__name__, helper)
    scope: dict[str, Any] = {"helper": helper, "__name__": "__main__"}
    exec("def weight(z, alpha):\n    return helper.half(z)", scope)
    found = []
    for factor in (0.5, 0.25, 0.5):
        exec(f"def half(z):\n    return {factor} * z\ndef unused():\n    return {len(found)}", vars(helper))
        found.append(fingerprint(scope["weight"]))
    assert found[0] == found[2] != found[1]


def test_an_attribute_is_no_global() -> None:
    source = "def weight(z, alpha):\n    return z.scale"
    found = []
    for k in (1, 2):
        scope: dict[str, Any] = {"scale": k, "__name__": "__main__"}
        exec(textwrap.dedent(source), scope)
        found.append(fingerprint(scope["weight"]))
    assert found[0] == found[1]


def test_numba_counts_by_its_python_code() -> None:
    numba = pytest.importorskip("numba")
    one, two = (numba.njit(two_lambdas(first)) for first in (True, False))
    assert fingerprint(one) == fingerprint(numba.njit(two_lambdas(True))) != fingerprint(two)
    universal = [numba.vectorize(two_lambdas(first)) for first in (True, False)]
    assert fingerprint(universal[0]) != fingerprint(universal[1])
    assert examined(*universal).unseen == ()


def _elsewhere(message: bytes) -> list[str]:
    return [fingerprint(value) for value in pickle.loads(message)]


def test_another_process_finds_the_same() -> None:
    stuck = ("holds a lock", "hides from pickle", "lru_cache", "singledispatch", "calls itself a name")
    values = [make(2) for name, make in MAKERS.items() if name not in stuck]
    here = [fingerprint(value) for value in values]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(_elsewhere, cloudpickle.dumps(values)).result(60) == here
