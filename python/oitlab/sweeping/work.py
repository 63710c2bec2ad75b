"""A task: variants of one scene, rendered together and measured; it runs here or in a worker."""

from __future__ import annotations

import functools
import os
import platform
import statistics
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np

from .._provenance import _commit, _cpu_model
from ..fragments import Fragments
from ..frame import Frame
from ..rendering import render, render_many
from ..scene import Scene
from .bind import Variant
from .grid import Request
from .identity import shown
from .memory import peak_bytes_per_pixel
from .metrics import Measure

Row = dict[str, Any]
"""One finished variant: numbers, texts and None; params, metrics and skipped are dicts of such."""
THREADED_PIXELS = 1 << 17
"""Of an image that is worth a thread of its own."""
TIMES = ("resolve_ms", "raster_ms", "total_ms")


@dataclass
class Package:
    """A scene and what its images are measured against; a process needs it once."""

    source: Scene | Fragments
    reference: Any
    """(technique, params), an image, or None."""
    _exact: Any = None
    _lock: Any = field(default_factory=Lock, repr=False)

    def exact(self, threads: int | None) -> Any:
        """Give the reference image, rendered when first asked for; its bits do not depend on `threads`."""
        with self._lock:
            if self._exact is None and self.reference is not None:
                is_request = isinstance(self.reference, tuple)
                self._exact = (
                    render(self.source, *self.reference, threads=threads) if is_request else self.reference
                )
            return self._exact

    def __reduce__(self) -> tuple[Any, ...]:
        return Package, (self.source, self.reference)


@dataclass(frozen=True)
class Task:
    """Variants of one scene that are rasterised together."""

    package: str
    """Key of the `Package`."""
    variants: tuple[Variant, ...]
    keys: tuple[str, ...]
    """Content keys of the variants."""
    measure: Measure
    repeats: int
    threads: int | None
    measure_memory: bool = False

    def rows(self, package: Package) -> Iterator[tuple[str, Row]]:
        """Render, then measure one image after the other; (content key, row) as each is finished."""
        requests = [variant.request for variant in self.variants]
        frames = render_many(package.source, requests, threads=self.threads)
        stats = [[frame.stats] for frame in frames]
        for _ in range(1, self.repeats):  # images are the same again; only times are wanted
            again = render_many(package.source, requests, threads=self.threads)
            for kept, frame in zip(stats, again, strict=True):
                kept.append(frame.stats)
        measured = self._measured(frames, package.exact(self.threads))
        each = zip(self.keys, self.variants, frames, stats, measured, strict=True)
        for key, variant, frame, kept, metrics in each:
            row = {**self._row(variant, frame, kept), "metrics": metrics}
            if self.measure_memory:
                row["bytes_per_pixel_measured"] = peak_bytes_per_pixel(
                    package.source, variant.request, self.threads
                )
            yield key, row

    def _measured(self, frames: Sequence[Frame], exact: Any) -> Iterator[dict[str, float]]:
        """Metrics of one image after the other; cheap ones of large images by all threads, an image each."""
        workers = min(self.threads or os.cpu_count() or 1, len(frames))
        pixels = frames[0].color[..., 0].size
        if workers == 1 or pixels < THREADED_PIXELS or not self.measure.may_be_threaded:
            yield from (self.measure(frame, exact) for frame in frames)
            return
        with ThreadPoolExecutor(workers) as pool:
            yield from pool.map(lambda frame: self.measure(frame, exact), frames)

    def _row(self, variant: Variant, frame: Frame, stats: Sequence[Any]) -> Row:
        first = stats[0]
        height, width = frame.color.shape[:2]
        params = _shown_params(variant, frame.params)
        return {
            "scene_hash": frame.scene_hash,
            "technique": frame.technique,
            "seed": params.pop("seed", None),
            "params": params,
            **_times(stats),
            "raster_share_ms": statistics.median(s.raster_ms for s in stats) / len(self.variants),
            "repeats": self.repeats,
            "shared_with": len(self.variants) - 1,
            "executor": None,
            "threads": first.threads,
            "backend": first.backend,
            "width": width,
            "height": height,
            "fragments": first.fragments,
            "depth_complexity_mean": first.depth_complexity_mean,
            "depth_complexity_max": first.depth_complexity_max,
            "geometry_passes": first.geometry_passes,
            "bytes_per_pixel": first.bytes_per_pixel,
            "bytes_per_pixel_measured": None,
            "dropped": first.dropped,
            "skipped": dict(first.skipped),
            "versions": versions(),
        }


def _shown_params(variant: Variant, resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Every param with its value; None for those that do nothing under the others."""
    given = {name: value for name, value in variant.params.items() if callable(value) or name not in resolved}
    return {
        name: None if name in variant.inactive else shown(value)
        for name, value in {**resolved, **given}.items()
    }


def _times(stats: Sequence[Any]) -> dict[str, float | None]:
    times: dict[str, float | None] = {}
    for name in TIMES:
        values = [getattr(one, name) for one in stats]
        times[name] = statistics.median(values)
        times[f"{name}_spread"] = max(values) - min(values) if len(values) > 1 else None
    return times


@functools.cache
def versions() -> dict[str, str | None]:
    """Tell what this process computes with, and where."""
    from .. import __version__

    return {
        "oitlab": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "commit": _commit(),
        "cpu": _cpu_model(),
        "cores": str(os.cpu_count()),
        "host": platform.node(),
    }


def reference_request(reference: Any) -> Request | None:
    """(technique, params) where the reference is to be rendered, None where it is an image."""
    return reference if isinstance(reference, tuple) else None
