"""A task: variants of one scene, rendered together and measured; it runs here or in a worker."""

from __future__ import annotations

import functools
import os
import platform
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any

import numpy as np

from .._provenance import _commit, _cpu_model
from ..fragments import Fragments
from ..frame import Frame
from ..rendering import render, render_many, silent_weights
from ..scene import Scene
from .bind import Backend, Variant
from .devices import check_same
from .identity import shown
from .memory import peak_bytes_per_pixel
from .metrics import Measure

Row = dict[str, Any]
"""One finished variant: numbers, texts and None; params, metrics and skipped are dicts of such."""
THREADED_PIXELS = 1 << 17
"""Of an image that is worth a thread of its own."""
TIMES = ("resolve_ms", "raster_ms", "total_ms")


class VariantFailed(Exception):
    """One variant could not be rendered or measured; why is its cause.

    Attributes
    ----------
    key : str
        Its content key.
    what : str
        Technique and params.
    """

    def __init__(self, key: str, what: str) -> None:
        super().__init__(key, what)
        self.key, self.what = key, what


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

    def forget(self) -> None:
        """Free the reference image; many scenes have many."""
        with self._lock:
            self._exact = None

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
    device: str | None = None
    """The GPU that renders all its variants; None: the CPU does."""

    @property
    def backend(self) -> Backend:
        """What renders its variants."""
        return "cpu" if self.device is None else "gpu"

    def rows(self, package: Package) -> Iterator[tuple[str, Row]]:
        """Render, then measure one image after the other; (content key, row) as each is finished.

        Raises
        ------
        VariantFailed
            The first one that failed, after all others.
        """
        if self.device is not None:
            check_same(self.device)
        exact = package.exact(self.threads)
        try:
            frames, stats = self._rendered(package)
        except Exception as error:
            if len(self.variants) == 1:
                raise self._failed(0) from error
            yield from self._one_by_one(package)
            return
        failed: VariantFailed | None = None
        for index, metrics in enumerate(self._measured(frames, exact)):
            try:
                row = {**self._row(self.variants[index], frames[index], stats[index]), "metrics": metrics()}
                if self.measure_memory:
                    request = self.variants[index].request
                    row["bytes_per_pixel_measured"] = peak_bytes_per_pixel(
                        package.source, request, self.threads
                    )
            except Exception as error:
                failed = failed or self._failed(index, error)
                continue
            yield self.keys[index], row
        if failed is not None:
            raise failed

    def _one_by_one(self, package: Package) -> Iterator[tuple[str, Row]]:
        failed: VariantFailed | None = None
        for key, variant in zip(self.keys, self.variants, strict=True):
            try:
                yield from replace(self, keys=(key,), variants=(variant,)).rows(package)
            except VariantFailed as error:
                failed = failed or error
        if failed is not None:
            raise failed

    def _failed(self, index: int, cause: Exception | None = None) -> VariantFailed:
        technique, params = self.variants[index].request
        text = ", ".join(f"{name}={shown(value)!r}" for name, value in params.items())
        where = "" if self.backend == "cpu" else f" on the {self.backend}"
        what = f"{technique} ({text}){where}" if text else f"{technique}{where}"
        failed = VariantFailed(self.keys[index], what)
        failed.__cause__ = cause
        return failed

    def _rendered(self, package: Package) -> tuple[list[Frame], list[list[Any]]]:
        """Give the images, and for each the numbers of every time that it was rendered."""
        requests = [variant.request for variant in self.variants]
        where: dict[str, Any] = {"backend": self.backend, "threads": self.threads}
        with silent_weights():  # the sweep tells of all its rows at once
            frames = render_many(package.source, requests, **where)
            stats = [[frame.stats] for frame in frames]
            for _ in range(1, self.repeats):  # images are the same again; only times are wanted
                again = render_many(package.source, requests, **where)
                for kept, frame in zip(stats, again, strict=True):
                    kept.append(frame.stats)
        return frames, stats

    def _measured(self, frames: Sequence[Frame], exact: Any) -> Iterator[Callable[[], dict[str, float]]]:
        """Metrics of one image after the other; cheap ones of large images by all threads, an image each."""
        workers = min(self.threads or os.cpu_count() or 1, len(frames))
        pixels = frames[0].color[..., 0].size
        if workers == 1 or pixels < THREADED_PIXELS or not self.measure.may_be_threaded:
            yield from (functools.partial(self.measure, frame, exact) for frame in frames)
            return
        with ThreadPoolExecutor(workers) as pool:
            futures = [pool.submit(self.measure, frame, exact) for frame in frames]
            yield from (future.result for future in futures)

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
            "invalid_weights": first.invalid_weights,
            "skipped": dict(first.skipped),
            "versions": {**versions(), "gpu": self.device},
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
