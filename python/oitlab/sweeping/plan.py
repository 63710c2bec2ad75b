"""What a sweep has to do: rows that are wanted, and the tasks that make those that are not there yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from .. import __version__
from .._image import as_image
from ..fragments import Fragments
from ..frame import Frame
from ..rendering import checked_variant
from ..scene import Scene
from .bind import Backend, Variant, bound, resolved_identity
from .grid import Request
from .identity import core_digest, digest
from .work import Package, Task

Source: TypeAlias = Scene | Fragments
GROUP_BYTES = 1 << 28
"""Most memory that the images of a group may take, unless one image takes more."""
LARGEST_GROUP, LARGEST_TASK = 64, 8
"""Most variants that share a rasterisation: here, and in a task of an executor, which wants many tasks."""
_PIXEL_BYTES = 16


@dataclass(frozen=True)
class Wanted:
    """One row of the table."""

    scene: str
    package: str
    key: str
    variant: Variant


def named_scenes(scenes: Any) -> dict[str, Source]:
    """Scenes by name; those of a list are scene0, scene1, ..."""
    if isinstance(scenes, Scene | Fragments):
        return {"scene0": scenes}
    if isinstance(scenes, Mapping):
        given = dict(scenes)
    elif isinstance(scenes, Iterable) and not isinstance(scenes, str | bytes):
        given = {f"scene{index}": scene for index, scene in enumerate(scenes)}
    else:
        raise ValueError(
            f"scenes must be a Scene, Fragments, or several of them, got {type(scenes).__name__}"
        )
    if not given:
        raise ValueError("scenes is empty: there is nothing to render")
    for name, scene in given.items():
        if not isinstance(name, str):
            raise ValueError(f"scenes must be named by strings, got {name!r}")
        if not isinstance(scene, Scene | Fragments):
            raise ValueError(f"scenes[{name!r}] must be a Scene or Fragments, got {type(scene).__name__}")
    return given


def packages_of(scenes: Mapping[str, Source], reference: Any) -> dict[str, tuple[str, Package]]:
    """Give every scene's package and the package's key, by the scene's name."""
    by_name: Mapping[str, Any] = dict.fromkeys(scenes, reference)
    if isinstance(reference, Mapping):
        if reference.keys() != scenes.keys():
            raise ValueError(
                f"reference names {sorted(map(str, reference))}, but the scenes are {sorted(scenes)}"
            )
        by_name = reference
    found = {}
    for name, source in scenes.items():
        given, identity = _reference(by_name[name], source, name)
        key = digest(source.content_hash, identity)
        found[name] = key, Package(source, given)
    return found


def _reference(reference: Any, source: Source, scene: str) -> tuple[Any, str]:
    """Give a reference as a package has it, and what tells it from others."""
    if reference is None:
        return None, "none"
    if isinstance(reference, str | tuple):
        request: Request = checked_variant(reference)
        return request, resolved_identity(source, request)
    if not isinstance(reference, Frame | np.ndarray | list):
        raise ValueError(
            "reference must be a technique id, (id, params), a Frame, an (H, W, 3) array, a mapping of "
            f"scenes' names to such, or None; got {reference!r}"
        )
    image = as_image(reference, "reference")
    if image.shape[:2] != (source.height, source.width):
        raise ValueError(
            f"reference: an image of shape {image.shape} does not fit {scene!r}, which has "
            f"{source.height} rows of {source.width} pixels"
        )
    return reference, digest(str(image.dtype), str(image.shape), np.ascontiguousarray(image).tobytes())


def wanted_rows(
    scenes: Mapping[str, Source],
    packages: Mapping[str, tuple[str, Package]],
    requests: list[Request],
    seeds: list[int] | None,
    conditions: Iterable[str],
    backends: Sequence[Backend] = ("cpu",),
) -> list[Wanted]:
    """Every row of the table, in order; `conditions` are what else its numbers depend on.

    The keys of rows of the GPU do not say yet which device that is: see `on_device`.
    """
    same = tuple(conditions)
    rows = []
    for name, source in scenes.items():
        package = packages[name][0]
        for variant in bound(source, requests, seeds, backends):
            key = digest(package, variant.identity, __version__, core_digest(), *same)
            rows.append(Wanted(name, package, key, variant))
    return rows


def on_device(wanted: Iterable[Wanted], device: str) -> list[Wanted]:
    """Give rows whose keys say which device those of the GPU are of: devices round each in its own way."""
    return [
        row if row.variant.backend == "cpu" else replace(row, key=digest(row.key, device)) for row in wanted
    ]


def tasks_of(
    wanted: Iterable[Wanted],
    packages: Mapping[str, Package],
    make: Callable[..., Task],
    group: int | None,
    largest: int,
    device: str | None = None,
) -> Iterator[Task]:
    """Tasks that make these rows, each variant once, those of a backend together.

    Parameters
    ----------
    wanted : iterable of Wanted
        Rows that are not there yet.
    packages : mapping of str to Package
        By key.
    make : function
        `Task` with everything that all tasks have in common.
    group : int, optional
        Most variants of a task.
    largest : int
        The same where `group` is None, and the image's size allows as many.
    device : str, optional
        The GPU, if there are variants for it.
    """
    by_package: dict[str, dict[Backend, dict[str, Variant]]] = {}
    for row in wanted:
        variants = by_package.setdefault(row.package, {}).setdefault(row.variant.backend, {})
        variants[row.key] = row.variant
    for package, backends in by_package.items():
        source = packages[package].source
        size = group or min(largest, max(1, GROUP_BYTES // (_PIXEL_BYTES * source.width * source.height)))
        for backend, variants in backends.items():
            items, where = list(variants.items()), device if backend == "gpu" else None
            for start in range(0, len(items), size):
                keys, some = zip(*items[start : start + size], strict=True)
                yield make(package=package, variants=some, keys=keys, device=where)
