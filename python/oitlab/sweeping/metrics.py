"""How the images of a sweep are measured: names of `oitlab.compare`, or the user's own functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from ..metrics import CHEAP, METRICS, compare
from .identity import canonical

DEFAULT = ("mse", "max_error")
OPTIONS = ("data_range", "threshold", "luminance", "pixels_per_degree")
Metrics: TypeAlias = str | Iterable[str] | Mapping[str, Callable[[Any, Any], float] | None]
"""Names of `oitlab.compare`, or names with functions of (frame, reference)."""


@dataclass(frozen=True)
class Measure:
    """What is measured of every image."""

    names: tuple[str, ...] = ()
    """Of `oitlab.compare`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of `oitlab.compare`."""
    functions: Mapping[str, Callable[[Any, Any], float]] = field(default_factory=dict)

    @property
    def identity(self) -> str:
        """Canonical text, by which stored rows are found."""
        return canonical([self.names, self.options, self.functions])

    @property
    def may_be_threaded(self) -> bool:
        """Whether several images may be measured at once: neither packages nor users promise that."""
        return not self.functions and set(self.names) <= {*CHEAP, "psnr"}

    def __call__(self, frame: Any, reference: Any) -> dict[str, float]:
        """Values of all metrics."""
        values = compare(frame, reference, metrics=self.names, **self.options) if self.names else {}
        for name, function in self.functions.items():
            values[name] = _number(name, function(frame, reference))
        return values


def measure_of(metrics: Metrics | None, options: Mapping[str, Any] | None, *, has_reference: bool) -> Measure:
    """Check what a sweep is asked to measure.

    Raises
    ------
    ValueError
        Unknown metrics or options, metrics without a reference, an option that a metric lacks.
    ImportError
        A metric needs a package that is not there.
    """
    names, functions = _names_and_functions(metrics, has_reference)
    given = dict(options or {})
    unknown = sorted(map(str, given.keys() - set(OPTIONS)))
    if unknown:
        raise ValueError(f"metric_options: unknown {', '.join(unknown)}; known: {', '.join(OPTIONS)}")
    if names and not has_reference:
        raise ValueError(f"metrics: {', '.join(names)} need a reference, and reference is None")
    if names:
        grey = np.full((32, 32, 3), 0.5)  # room for FLIP's filters
        names = tuple(compare(grey, grey, metrics=names, **given))
    return Measure(names, given, functions)


def _names_and_functions(
    metrics: Metrics | None, has_reference: bool
) -> tuple[tuple[str, ...], dict[str, Callable[[Any, Any], float]]]:
    if metrics is None:
        return (DEFAULT if has_reference else ()), {}
    if isinstance(metrics, str):
        return (METRICS if metrics == "all" else (metrics,)), {}
    if not isinstance(metrics, Iterable):
        raise ValueError(f"metrics must be names or a mapping of names to functions, got {metrics!r}")
    items = metrics.items() if isinstance(metrics, Mapping) else ((name, None) for name in metrics)
    names: list[str] = []
    functions: dict[str, Callable[[Any, Any], float]] = {}
    for name, function in items:
        if not isinstance(name, str) or not name:
            raise ValueError(f"metrics: {name!r} is not a name")
        if function is None:
            names.append(name)
        elif not callable(function):
            raise ValueError(f"metrics: {name!r} must be a function of (frame, reference), got {function!r}")
        elif name in METRICS:
            raise ValueError(f"metrics: {name!r} is oitlab.compare's; give the function another name")
        else:
            functions[name] = function
    return tuple(names), functions


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"metric {name!r} gave {value!r}, which is no number") from None
