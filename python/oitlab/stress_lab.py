"""The stress lab: a fixed battery of layers that are hard on numbers, and what they do to a technique."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._convert import count, flag, scalar
from ._storage import accepted, described, format_params, in_f64, stored_in
from ._stress_cases import CASES, Case
from .fragments import Fragments
from .frame import Frame
from .inspection import transmittance
from .registry import TechniqueInfo, techniques
from .rendering import checked_variant, render_many

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FORMATS", "stress", "stress_cases"]

FORMATS = ("f32", "f16", "unorm8")
"""What `stress` stores in by default."""
TOLERANCE = 1.0 / 255.0
"""One step of an 8-bit display."""
_EXACT_SHARE = 2.0**-24
"""Half a unit in the last place of a float32 next to 1: a share that is off by no more is exact."""
_ROUNDING = 1e-9
"""Steps up of a transmittance function that are no more than the rounding of its evaluation."""
_LOOKED_AT = 100
"""Layers of the pixel whose transmittance function is evaluated: the exact one takes quadratic time."""
_INTEGERS = ("layers", "rescued", "layers_storage", "layers_exact")
_MARKS = ("finite", "monotone", "exact_coverage")


def stress_cases() -> pd.DataFrame:
    """Name the battery: what each case is and how many layers it has at most.

    Returns
    -------
    pandas.DataFrame
        Columns `case`, `layers` (of the deepest pixel) and `doc`.

    Examples
    --------
    >>> cases = stress_cases()
    >>> int(cases["layers"].max()), "mb13_overflow" in set(cases["case"])
    (100000, True)
    """
    import pandas as pd

    rows = [{"case": case.name, "layers": max(case.layers), "doc": case.doc} for case in CASES]
    return pd.DataFrame(rows)


def stress(
    technique: str,
    params: Mapping[str, Any] | None = None,
    formats: Iterable[str] = FORMATS,
    seed: int = 0,
    *,
    cases: Iterable[str] | None = None,
    tolerance: float = TOLERANCE,
    per_layers: bool = False,
    threads: int | None = None,
) -> pd.DataFrame:
    """Run the battery on a technique, stored in several formats.

    A case is a stack of layers that is hard on one kind of number: many layers, faint and opaque ones, wide
    and tight depths, colours beyond what a half can hold, weights at their clamps, every order of submission,
    and what McGuire and Bavoil say of 16-bit targets [McGuire2013]. Its pixels have the first 1, 2, 5, ...
    layers of the stack. `stress_cases` names them all.

    Errors are the largest difference of a channel, divided by the brightest channel of the reference where
    that exceeds 1. Where not every target can be in a format, those that can are, and the others are in f16:
    "unorm8" of `wboit` is 8 bits of revealage beside half sums. A technique without formats is run in "f32"
    alone, as it is; a format that no target can have gives no row.

    Parameters
    ----------
    technique : str
        An id or alias of `oitlab.techniques()`.
    params : mapping, optional
        Its parameters, without formats; they win over those that a case asks for.
    formats : iterable of str
        Storage formats.
    seed : int >= 0
        Picks colours and depths.
    cases : iterable of str, optional
        Names of cases; all of them when absent.
    tolerance : float > 0
        Error from which on a result has left the tolerance.
    per_layers : bool
        One row for each number of layers instead of one for all, with the errors at that number.
    threads : int >= 1, optional
        All cores when absent.

    Returns
    -------
    pandas.DataFrame
        One row per case and format:

        | column | meaning |
        |---|---|
        | `technique`, `case`, `format` | what was run |
        | `stored_as` | the formats of all targets |
        | `layers` | number of layers: of the deepest pixel, or of the row's |
        | `error_f64` | largest error against the technique in float64; NaN where it has no such form |
        | `error_exact` | largest error against `a_buffer` |
        | `finite` | whether the image is |
        | `rescued` | stored numbers that were not and read as the largest one; missing where not looked for |
        | `monotone` | whether T(z) falls from 1 towards 0 only; missing where there is no such function |
        | `exact_coverage` | whether the background's share is within 2^-24 of the product of 1 - alpha |
        | `layers_storage` | first number of layers at which `error_f64` exceeds the tolerance, if any |
        | `layers_exact` | the same for `error_exact` |

        With `per_layers` the last two, `rescued` and `monotone` are left out.

    Raises
    ------
    ValueError
        An unknown technique, case or format; formats among the params; params that `render` would refuse.

    Examples
    --------
    Twenty-one opaque layers at the upper clamp of the weights are what halves can take:

    >>> table = stress("wboit", formats=["f32", "f16"], cases=["mb13_overflow"])
    >>> print(table[["format", "finite", "rescued", "layers_storage"]].to_string(index=False))
    format  finite  rescued  layers_storage
       f32    True        0            <NA>
       f16    True       10              22
    """
    import pandas as pd

    name, given = checked_variant((technique, params))
    battery = _Battery(
        entry=_entry(name),
        params=given,
        formats=_formats(formats, name, given),
        seed=count(seed, "seed"),
        threads=None if threads is None else count(threads, "threads"),
        tolerance=_tolerance(tolerance),
    )
    chosen, split = _chosen(cases), flag(per_layers, "per_layers")
    rows = [row for case in chosen for row in battery.rows(case, split)]
    table = pd.DataFrame(rows, columns=_columns(split))
    kinds = {name: "Int64" for name in _INTEGERS} | {name: "boolean" for name in _MARKS}
    return table.astype({name: kind for name, kind in kinds.items() if name in table})


def _columns(split: bool) -> list[str]:
    last = ["finite", "exact_coverage"]
    if not split:
        last = ["finite", "rescued", "monotone", "exact_coverage", "layers_storage", "layers_exact"]
    return ["technique", "case", "format", "stored_as", "layers", "error_f64", "error_exact", *last]


@dataclass(frozen=True)
class _Battery:
    """What all cases of a run have in common."""

    entry: TechniqueInfo
    params: dict[str, Any]
    formats: list[str]
    seed: int
    threads: int | None
    tolerance: float

    def rows(self, case: Case, split: bool) -> Iterator[dict[str, Any]]:
        """Run a case in every format."""
        asked = self._asked(case)
        if asked is None:
            return
        exact = _exact(case.name, self.seed)
        variants = [(name, stored_in(self.entry, asked, name)) for name in self.formats]
        stored = {name: params for name, params in variants if params is not None}
        whole = in_f64(self.entry, asked)
        jobs = [*([whole] if whole is not None else []), *stored.values()]
        frames = render_many(
            exact.fragments,
            [(self.entry.id, job) for job in jobs],
            threads=self.threads,
            dtype="float64",
            diagnostics=not split,
        )
        algorithm = np.asarray(frames.pop(0).color)[0] if whole is not None else None
        for (name, params), frame in zip(stored.items(), frames, strict=True):
            found = _Errors.of(frame, exact, algorithm)
            labels = {
                "technique": self.entry.id,
                "case": case.name,
                "format": name,
                "stored_as": described(self.entry, params),
            }
            if split:
                yield from ({**labels, **row} for row in found.each(case.layers))
            else:
                yield {
                    **labels,
                    **found.all(case.layers, self.tolerance),
                    **self._looks(frame, exact, params),
                }

    def _asked(self, case: Case) -> dict[str, Any] | None:
        """Give the params of a case; None where it says nothing about the technique."""
        wanted = accepted(self.entry, case.params)
        if any(name not in wanted and name not in self.params for name in case.needs):
            return None
        return {**wanted, **self.params}

    def _looks(self, frame: Frame, exact: _Exact, params: Mapping[str, Any]) -> dict[str, Any]:
        broken = frame.diagnostics.get("non_finite")
        return {
            "rescued": None if broken is None else int(broken.sum()),
            "monotone": _is_monotone(self.entry.id, params, exact),
        }


@dataclass(frozen=True, eq=False)
class _Exact:
    """A case's fragments and their exact image."""

    fragments: Fragments
    color: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    looked_at: int
    """The pixel whose transmittance function is evaluated."""


@lru_cache(maxsize=2 * len(CASES))
def _exact(name: str, seed: int) -> _Exact:
    case = next(case for case in CASES if case.name == name)
    fragments = case.fragments(seed)
    (frame,) = render_many(fragments, ["a_buffer"], dtype="float64")
    looked_at = int(np.searchsorted(case.layers, _LOOKED_AT, side="right")) - 1
    return _Exact(fragments, np.asarray(frame.color)[0], np.asarray(frame.transmittance)[0], looked_at)


@dataclass(frozen=True, eq=False)
class _Errors:
    """What is wrong with each pixel of a case."""

    storage: NDArray[np.float64]
    exact: NDArray[np.float64]
    finite: NDArray[np.bool_]
    covered: NDArray[np.bool_]

    @classmethod
    def of(cls, frame: Frame, exact: _Exact, algorithm: NDArray[np.float64] | None) -> _Errors:
        color, share = np.asarray(frame.color)[0], np.asarray(frame.transmittance)[0]
        share = share if share.ndim == 1 else share[:, 0]
        unknown = np.full(len(color), np.nan)
        return cls(
            storage=unknown if algorithm is None else _relative(color, algorithm),
            exact=_relative(color, exact.color),
            finite=np.isfinite(color).all(axis=1),
            covered=np.abs(share - exact.transmittance) <= _EXACT_SHARE,
        )

    def each(self, layers: tuple[int, ...]) -> Iterator[dict[str, Any]]:
        for i, number in enumerate(layers):
            yield {
                "layers": number,
                "error_f64": float(self.storage[i]),
                "error_exact": float(self.exact[i]),
                "finite": bool(self.finite[i]),
                "exact_coverage": bool(self.covered[i]),
            }

    def all(self, layers: tuple[int, ...], tolerance: float) -> dict[str, Any]:
        return {
            "layers": max(layers),
            "error_f64": float(self.storage.max()),
            "error_exact": float(self.exact.max()),
            "finite": bool(self.finite.all()),
            "exact_coverage": bool(self.covered.all()),
            "layers_storage": _first_beyond(self.storage, layers, tolerance),
            "layers_exact": _first_beyond(self.exact, layers, tolerance),
        }


def _relative(color: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give each pixel's largest error, relative to the reference where that is brighter than 1."""
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(color - reference).max(axis=1) / np.maximum(np.abs(reference).max(axis=1), 1.0)
    return np.where(np.isnan(error), np.inf, error)


def _first_beyond(error: NDArray[np.float64], layers: tuple[int, ...], tolerance: float) -> int | None:
    beyond = np.flatnonzero(error > tolerance)
    return int(layers[beyond[0]]) if len(beyond) else None


def _is_monotone(technique: str, params: Mapping[str, Any], exact: _Exact) -> bool | None:
    try:
        curve = transmittance(exact.fragments, technique, params, pixel=(exact.looked_at, 0)).reconstructed
    except ValueError as error:
        if "transmittance function" in str(error):
            return None
        raise
    inside = bool(((curve >= 0.0) & (curve <= 1.0)).all())
    return inside and bool((np.diff(curve) <= _ROUNDING).all())


def _entry(technique: str) -> TechniqueInfo:
    entry = techniques().get(technique)
    if entry is None:
        raise ValueError(f"unknown technique {technique!r}; known: {', '.join(techniques().ids)}")
    return entry


def _formats(formats: Iterable[str], technique: str, params: Mapping[str, Any]) -> list[str]:
    if isinstance(formats, str) or not isinstance(formats, Iterable):
        raise ValueError(f"formats must be an iterable of names, got {formats!r}")
    wanted = _names(formats, "formats")
    known = dict.fromkeys(
        name for entry in techniques() for names in format_params(entry).values() for name in names
    )
    for name in wanted:
        if name not in known:
            raise ValueError(f"formats: unknown {name!r}; known: {', '.join(known)}")
    chosen = sorted(format_params(_entry(technique)).keys() & params.keys())
    if chosen:
        raise ValueError(f"params: {', '.join(chosen)} would overrule what `formats` goes through")
    return wanted


def _names(given: Iterable[str], argument: str) -> list[str]:
    names = list(given)
    for i, name in enumerate(names):
        if not isinstance(name, str):
            raise ValueError(f"{argument}[{i}] must be a name, got {name!r}")
    return list(dict.fromkeys(names))


def _chosen(names: Iterable[str] | None) -> list[Case]:
    known = {case.name: case for case in CASES}
    if names is None:
        return list(CASES)
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise ValueError(f"cases must be an iterable of names, got {names!r}")
    wanted = _names(names, "cases")
    for name in wanted:
        if name not in known:
            raise ValueError(f"cases: unknown {name!r}; known: {', '.join(known)}")
    return [known[name] for name in wanted]


def _tolerance(value: float) -> float:
    value = scalar(value, "tolerance")
    if not 0.0 < value < np.inf:
        raise ValueError(f"tolerance: expected a finite number > 0, got {value}")
    return value
