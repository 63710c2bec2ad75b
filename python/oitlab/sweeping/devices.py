"""The devices of sweeps with `backend="gpu"`: that of this process, or that of an executor's workers."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from typing import Any

from .. import gpu
from ..fragments import Fragments
from ..rendering import check_variants
from ..scene import Scene
from .bind import Backend, Variant, _empty_pixel

BACKENDS: tuple[Backend, ...] = ("cpu", "gpu")


def checked_backends(backend: Any) -> list[Backend]:
    """Backends as a list, each once; ValueError for what is none."""
    several = isinstance(backend, Iterable) and not isinstance(backend, str | bytes)
    given: list[Any] = list(backend) if several else [backend]
    if not given:
        raise ValueError("backend is empty: there is nothing to render with")
    unknown = [name for name in given if not isinstance(name, str) or name not in BACKENDS]
    if unknown:
        raise ValueError(f"unknown backend {unknown[0]!r}; known: {', '.join(BACKENDS)}, or a list of them")
    return list(dict.fromkeys(given))


def device_of(
    executor: Executor | None, sources: Sequence[Scene | Fragments], variants: Sequence[Variant]
) -> str:
    """Name the device that is to render variants, once it has said that it can.

    Parameters
    ----------
    executor : Executor, optional
        Whose workers have the device; one of them is asked, of the variants alone. None: this process.
    sources : sequence of Scene or Fragments
        Of which they are rendered; there is one at least.
    variants : sequence of Variant
        All variants of the GPU.

    Raises
    ------
    RuntimeError
        No device, or one that a worker cannot use, because it was forked from a process that has used it.
    ValueError
        What the device lacks.
    """
    pixel, requests = _empty_pixel(sources[0]), [variant.request for variant in variants]
    if executor is not None:
        device: str = executor.submit(_able_worker, pickle.dumps((pixel, requests))).result()
        return device
    for source in sources:
        check_variants(source, [], "gpu")  # its size
    return _able(pixel, requests)


def _able_worker(message: bytes) -> str:
    return _able(*pickle.loads(message))


def _able(pixel: Scene | Fragments, requests: list[Any]) -> str:
    check_variants(pixel, requests, "gpu")
    return named()


def named() -> str:
    """Name the device of this process, with its driver: another one may round otherwise."""
    info = gpu.info()
    return f"{info.adapter}, {info.driver} {info.driver_info}".strip()


def check_same(device: str) -> None:
    """Refuse to fill rows of one device with the images of another: workers may be on several machines."""
    here = named()
    if here != device:
        raise RuntimeError(
            f"this sweep's rows are of the device {device!r}, and a worker has {here!r}; "
            "run one sweep per device"
        )
