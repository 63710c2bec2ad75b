"""Requests become variants: checked, resolved, and without the params that do nothing.

Everything here is asked of the core with an empty image of one pixel, so that a wrong value is found before
any work, and so that no rule about params is written down twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from ..fragments import Fragments
from ..frame import Frame
from ..registry import techniques
from ..rendering import check_variants, checked_variant, render, render_many
from ..scene import Scene
from .custom import technique_fingerprint
from .grid import Request
from .identity import canonical

Backend: TypeAlias = Literal["cpu", "gpu"]
_AT_ONCE = 32
"""Variants of one call: the core looks for duplicates by comparing all pairs."""


@dataclass(frozen=True)
class Variant:
    """One technique with params, as it is rendered and as it is told from others."""

    technique: str
    params: Mapping[str, Any]
    """As given, for the core."""
    inactive: frozenset[str]
    """Params of the technique that change nothing under the others."""
    identity: str
    """Canonical text of technique and active params, and of the backend unless it is the CPU."""
    backend: Backend = "cpu"

    @property
    def request(self) -> tuple[str, dict[str, Any]]:
        """What `render_many` takes."""
        return self.technique, dict(self.params)

    def on(self, backend: Backend) -> Variant:
        """Give the same variant of the CPU as one of another backend."""
        if backend == "cpu":
            return self
        return replace(self, backend=backend, identity=canonical([backend, self.identity]))


def bound(
    source: Scene | Fragments,
    requests: Iterable[Request],
    seeds: Sequence[int] | None,
    backends: Sequence[Backend] = ("cpu",),
) -> list[Variant]:
    """Resolve requests on a source; each distinct variant once, in order, its backends side by side.

    Parameters
    ----------
    source : Scene or Fragments
        Whose clip planes are some params' defaults.
    requests : iterable of (str, dict)
        Technique ids with params.
    seeds : sequence of int, optional
        For every variant that draws random numbers.
    backends : sequence of {"cpu", "gpu"}
        Where each variant is rendered. No device is asked for what it lacks.

    Raises
    ------
    ValueError
        Params that the core refuses, or that have no form on a backend; `seeds` though the grid has seeds of
        its own.
    """
    probe = _Probe(source)
    given = list(_seeded(requests, seeds))
    frames = probe.frames(given)
    for backend in backends:
        check_variants(probe.pixel, given, backend, asks_device=False)
    variants = (probe.variant(request, frame) for request, frame in zip(given, frames, strict=True))
    distinct: dict[str, Variant] = {}
    for variant in variants:
        for backend in backends:
            placed = variant.on(backend)
            distinct.setdefault(placed.identity, placed)
    return list(distinct.values())


def _seeded(requests: Iterable[Request], seeds: Sequence[int] | None) -> Iterator[Request]:
    for technique, params in requests:
        takes_seed = any(param.name == "seed" for param in techniques()[technique].params)
        if seeds is None or not takes_seed:
            yield technique, params
            continue
        if "seed" in params:
            raise ValueError(f"grid: {technique} has seeds of its own; give seeds in one place")
        yield from ((technique, {**params, "seed": seed}) for seed in seeds)


class _Probe:
    """Asks the core about params, on an image of one empty pixel that has the source's clip planes."""

    def __init__(self, source: Scene | Fragments) -> None:
        self.pixel = _empty_pixel(source)
        self._fingerprints: dict[str, str | None] = {}

    def frames(self, requests: Sequence[Request]) -> list[Frame]:
        """Frames whose params are resolved."""
        chunks = (requests[start : start + _AT_ONCE] for start in range(0, len(requests), _AT_ONCE))
        return [frame for chunk in chunks for frame in render_many(self.pixel, chunk, threads=1)]

    def variant(self, request: Request, frame: Frame) -> Variant:
        technique, params = request
        resolved, inactive = frame.params, frame.inactive_params
        active = {name: params[name] if callable(params.get(name)) else value
                  for name, value in resolved.items() if name not in inactive}  # fmt: skip
        if technique not in self._fingerprints:
            self._fingerprints[technique] = technique_fingerprint(technique)
        identity = canonical([technique, self._fingerprints[technique], active])
        return Variant(technique, checked_variant((technique, params))[1], inactive, identity)


def _empty_pixel(source: Scene | Fragments) -> Scene | Fragments:
    if isinstance(source, Scene):
        return source.replace(meshes=[], width=1, height=1)
    return Fragments(width=1, height=1, offsets=[0, 0], depth=[], color=np.zeros((0, 3)), alpha=[],
                     background=(0.0, 0.0, 0.0), near=source.near, far=source.far,
                     depth_range=source.depth_range)  # fmt: skip


def resolved_identity(source: Scene | Fragments, request: Request) -> str:
    """Identity of one request, for a reference."""
    probe = _Probe(source)
    frame = render(probe.pixel, *request, threads=1)
    return probe.variant((frame.technique, request[1]), frame).identity
