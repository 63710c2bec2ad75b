"""Parameters of techniques of one's own: declared, checked and completed like those of the built-in ones."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from . import _oitlab
from ._convert import params as python_params
from .metrics import METRICS
from .registry import ParamInfo

_SCALARS = (bool, int, float, str)
ORDER, SEED = "submission_order", "seed"
"""What every technique takes beside its own parameters."""
_INT64 = range(-(2**63), 2**63)
"""What tables and files have room for."""


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter of a technique of your own, with what it may be.

    Parameters
    ----------
    default : bool, int, float, str, or tuple of them
        Its value when nobody says otherwise; whatever is given has to be of the same type. Ints have 64 bits.
        An int passes for a float; a tuple has the same length and types, and may be given as a list or a
        NumPy array.
    min, max : number, optional
        Ends of the range, both allowed; of numbers, or of every number in a tuple.
    choices : sequence, optional
        The only values that are allowed.
    doc : str
        Its meaning, in a sentence.

    Raises
    ------
    ValueError
        A default of another type, or one that its own range or choices exclude.

    Examples
    --------
    >>> Param(0.5, min=0, max=1, doc="coverage from which on a fragment hides what is behind it").range
    'a number in [0, 1]'
    >>> Param("near", choices=("near", "far")).range
    'one of "near", "far"'
    """

    default: Any
    min: float | None = None
    max: float | None = None
    choices: tuple[Any, ...] | None = None
    doc: str = ""

    def __post_init__(self) -> None:
        if type(self.default) not in (*_SCALARS, tuple):
            raise ValueError(f"default must be a bool, int, float, str or tuple, got {self.default!r}")
        if isinstance(self.default, tuple) and not (
            self.default and all(type(item) in _SCALARS for item in self.default)
        ):
            raise ValueError(f"default must hold bools, ints, floats or strings, got {self.default!r}")
        if not isinstance(self.doc, str):
            raise ValueError(f"doc must be text, got {self.doc!r}")
        self._check_bounds()
        if self.choices is not None:
            object.__setattr__(self, "choices", self._all_choices())
        if not self._allows(self.default):
            raise ValueError(f"default: {self.default!r} is not {self.range}")

    def _check_bounds(self) -> None:
        items = self.default if isinstance(self.default, tuple) else (self.default,)
        bounds = {"min": self.min, "max": self.max}
        for name, bound in bounds.items():
            if bound is None:
                continue
            if any(type(item) not in (int, float) for item in items):
                raise ValueError(f"{name} is for numbers, and the default is {self.default!r}")
            if isinstance(bound, bool) or not isinstance(bound, int | float) or math.isnan(bound):
                raise ValueError(f"{name} must be a number, got {bound!r}")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min: {self.min} is greater than max = {self.max}")

    def _all_choices(self) -> tuple[Any, ...]:
        if isinstance(self.choices, str) or not self.choices:
            raise ValueError(f"choices must be a sequence of values, got {self.choices!r}")
        read = [_read(self.default, choice) for choice in self.choices]
        for given, choice in zip(self.choices, read, strict=True):
            if choice is None:
                raise ValueError(f"choices: {given!r} is not of the type of the default {self.default!r}")
        return tuple(read)

    def _allows(self, value: Any) -> bool:
        items = value if isinstance(value, tuple) else (value,)
        numbers = [item for item in items if type(item) in (int, float)]
        return (
            all(number in _INT64 if type(number) is int else math.isfinite(number) for number in numbers)
            and (self.min is None or all(number >= self.min for number in numbers))
            and (self.max is None or all(number <= self.max for number in numbers))
            and (self.choices is None or value in self.choices)
        )

    def read(self, value: Any) -> Any:
        """Give the value in the default's type; None where it does not fit."""
        read = _read(self.default, value)
        return read if read is not None and self._allows(read) else None

    @property
    def type(self) -> str:
        """The type's name, as in `ParamInfo.type`."""
        return type(self.default).__name__

    @property
    def range(self) -> str:
        """What is allowed, in words."""
        if self.choices is not None:
            return "one of " + ", ".join(f'"{c}"' if isinstance(c, str) else repr(c) for c in self.choices)
        if isinstance(self.default, tuple):
            names = ", ".join(type(item).__name__ for item in self.default)
            every = self._interval("")
            return f"a tuple ({names}{',' * (len(self.default) == 1)})" + (f", each{every}" if every else "")
        nouns = {bool: "True or False", int: "an integer", float: "a number", str: "text"}
        noun = nouns[type(self.default)]
        if isinstance(self.default, float) and self.min is None and self.max is None:
            noun = "a finite number"
        if isinstance(self.default, int) and not isinstance(self.default, bool):
            return self._interval(noun, ", of 64 bits") or f"{noun} of 64 bits"
        return self._interval(noun) or noun

    def _interval(self, noun: str, room: str = "") -> str:
        """Say the range, and what holds on the side that it leaves open; nothing where it has no end."""
        if self.min is not None and self.max is not None:
            return f"{noun} in [{self.min}, {self.max}]"
        if self.min is not None:
            return f"{noun} >= {self.min}{room}"
        return f"{noun} <= {self.max}{room}" if self.max is not None else ""


def _read(default: Any, value: Any) -> Any:
    """Give `value` as the type of `default`; None where it is of another."""
    if isinstance(default, tuple):
        if not isinstance(value, tuple | list) or len(value) != len(default):
            return None
        items = tuple(_read(one, item) for one, item in zip(default, value, strict=True))
        return None if None in items else items
    if isinstance(default, float) and type(value) in (int, float):
        return float(value)
    return value if type(value) is type(default) else None


def declared(function: Callable[..., Any], params: Mapping[str, Any] | None) -> dict[str, Param]:
    """Give the parameters of a function: those named, or else its keyword-only ones with their defaults.

    Raises
    ------
    ValueError
        A default that no parameter can have, a name that is taken, a parameter that the function does not
        take, one of the function's that has no value, or one that has a default but is not keyword-only.
    """
    _refuse_positional(function)
    keywords, takes_any = _keywords(function)
    if params is None:
        params = {
            name: default for name, default in keywords.items() if default is not inspect.Parameter.empty
        }
    elif not isinstance(params, Mapping):
        raise ValueError(f"params must be a mapping of names to defaults, got {params!r}")
    table = {name: _param(name, default) for name, default in params.items()}
    for name in table:
        if name not in keywords and not takes_any:
            raise ValueError(f"params: the function takes no keyword-only argument {name!r}")
    for name, default in keywords.items():
        if default is inspect.Parameter.empty and name not in table:
            raise ValueError(f"params: the function's argument {name!r} has no default and is not among them")
    return table


def check_callable(
    function: Callable[..., Any], what: str, arguments: tuple[str, ...], names: Iterable[str]
) -> None:
    """Raise ValueError unless the function can be called with these arguments and keywords."""
    if not callable(function):
        raise ValueError(f"{what} must be a function, got {function!r}")
    signature = inspect.signature(function)
    try:
        signature.bind(*arguments, **dict.fromkeys(names))
    except TypeError as error:
        called = ", ".join([*arguments, *(f"{name}=..." for name in names)])
        raise ValueError(f"{what}{signature} cannot be called as ({called}): {error}") from None


def _refuse_positional(function: Callable[..., Any]) -> None:
    """Refuse arguments that look like parameters and would keep their default whatever is asked for."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    positional = [a for a in inspect.signature(function).parameters.values() if a.kind in kinds]
    for argument in positional[1:]:
        if argument.default is not inspect.Parameter.empty:
            name = argument.name
            raise ValueError(
                f"params: the function's argument {name!r} has a default but can be positional: "
                f"make {name} keyword-only, as in ({positional[0].name}, *, {name}={argument.default!r})"
            )


def _keywords(function: Callable[..., Any]) -> tuple[dict[str, Any], bool]:
    """Give the keyword-only arguments with their defaults, and whether the function takes any others."""
    arguments = inspect.signature(function).parameters.values()
    names = {a.name: a.default for a in arguments if a.kind is inspect.Parameter.KEYWORD_ONLY}
    return names, any(a.kind is inspect.Parameter.VAR_KEYWORD for a in arguments)


def _param(name: str, default: Any) -> Param:
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(f"params: {name!r} is not a name")
    if name in (ORDER, "batch"):
        raise ValueError(f"params: the name {name!r} is taken")
    if name != SEED and name in _table_columns():
        raise ValueError(f"params: the name {name!r} is taken by a column of the tables of oitlab.sweep")
    try:
        param = default if isinstance(default, Param) else Param(default)
    except ValueError as error:
        raise ValueError(f"params: {name}: {error}") from None
    if name != SEED:
        return param
    if param.type != "int" or param.default != 0:
        raise ValueError(
            f"params: seed is an integer >= 0 and 0 by default for every technique, got {default!r}"
        )
    return Param(0, min=0, max=2**63 - 1)


@cache
def _table_columns() -> frozenset[str]:
    """Give the columns that are not params in a table of `oitlab.sweep`."""
    from .sweeping.table import FIXED  # which imports this module

    return FIXED | set(METRICS)


@cache
def every_technique_takes() -> dict[str, ParamInfo]:
    """Give the two parameters that every technique has, as the core describes them."""
    params = {param["name"]: ParamInfo(**param) for param in _oitlab.techniques()[0]["params"]}
    return {name: params[name] for name in (ORDER, SEED)}


def table(own: Mapping[str, Param]) -> tuple[ParamInfo, ...]:
    """Describe a technique's own parameters and the two that every technique has."""
    infos = (
        ParamInfo(name, param.type, param.range, param.default, param.doc)
        for name, param in own.items()
        if name != SEED
    )
    return (*infos, *every_technique_takes().values())


def resolved(technique: str, own: Mapping[str, Param], given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Check the params that somebody gave and complete them; None stands for a default.

    Raises
    ------
    ValueError
        For the first unknown name, wrong type or value out of range, worded as the core's own.
    """
    order, seed = every_technique_takes().values()
    orders = tuple(text.strip().strip('"') for text in order.range.removeprefix("one of ").split(","))
    params = {
        **{name: param for name, param in own.items() if name != SEED},
        ORDER: Param(order.default, choices=orders),
        SEED: Param(seed.default, min=0, max=2**63 - 1),
    }
    values = {name: param.default for name, param in params.items()}
    for name, value in python_params(given, technique).items():
        if name not in params:
            known = ", ".join(f"{name} ({param.range})" for name, param in params.items())
            raise ValueError(f'{technique}: unknown parameter "{name}"; its parameters are {known}')
        if value is None:
            continue
        read = params[name].read(value)
        if read is None:
            raise ValueError(
                f'{technique}: parameter "{name}" is {value!r}; allowed is {params[name].range}; '
                f"its parameters are {', '.join(params)}"
            )
        values[name] = read
    return values
