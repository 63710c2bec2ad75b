"""The verbs: `render`, `render_many` and `capture`."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from . import _oitlab
from ._callers import outside
from ._convert import count, flag
from ._convert import params as python_params
from ._custom_definition import Definition
from .diagnostics import Diagnostics
from .fragments import Fragments
from .frame import Frame, Stats
from .registry import techniques
from .scene import Scene


class WeightWarning(UserWarning):
    """A weight or bin function of one's own gave what is none; `Stats.invalid_weights` says how often."""


Variant = str | tuple[str, Mapping[str, Any] | None]
"""A technique's id, alone or with its params."""

_is_silent: ContextVar[bool] = ContextVar("_is_silent", default=False)
"""Of this thread: filters of warnings are the whole process's."""


def render(
    source: Scene | Fragments,
    technique: str,
    params: Mapping[str, Any] | None = None,
    *,
    backend: Literal["cpu", "gpu"] = "cpu",
    threads: int | None = None,
    skip: bool = True,
    dtype: Any = "float32",
    diagnostics: bool = False,
) -> Frame:
    """One technique's image of a scene or of captured fragments.

    Parameters
    ----------
    source : Scene or Fragments
        What is drawn.
    technique : str
        An id or alias of `oitlab.techniques()`.
    params : mapping, optional
        The technique's parameters; those left out take their defaults. Where the table of
        `oitlab.techniques()` says "str or callable" (`weight`, `bin_function`) functions of one's own are
        taken, see the notes.
    backend : {"cpu", "gpu"}
        "cpu" is the definition. A technique without a GPU form refuses "gpu", which
        computes in single precision; times in `Frame.stats` are the device's, `total_ms` is that of the call.
    threads : int >= 1, optional
        All cores when absent. The image never depends on it.
    skip : bool
        False does the work that is provably unnecessary too.
    dtype : {"float32", "float64"}
        Of `Frame.color` and `Frame.transmittance`.
    diagnostics : bool
        True fills `Frame.diagnostics`: per pixel, what overflowed, underflowed, cancelled and so on.
        Everything is rasterised and computed once more for it; False costs nothing.

    Returns
    -------
    Frame

    Raises
    ------
    ValueError
        Unknown technique, backend or dtype; a parameter that is unknown, of the wrong type or out of range; a
        text that is not WGSL, shown with what is wrong with it. What a callable raises is raised as it is.
    RuntimeError
        `backend="gpu"` without a device; the message says what would help.

    Warns
    -----
    WeightWarning
        A function of one's own gave weights that are not finite numbers above 0, or shares that are not
        finite numbers from 0 up. `Frame.stats.invalid_weights` counts their fragments; the least weight
        (1e-30) or no share takes their place.

    Notes
    -----
    A weight of one's own is text in WGSL or a Python callable.

    Text is an expression of ``z``, the depth that weights see (``weight_scale * depth + weight_shift``, at
    least 1e-4), ``a``, alpha, and ``d``, window depth in [0, 1] between the params ``near`` and ``far``
    (McGuire2013 eq. 11); or a module with ``fn weight(z: f32, a: f32, d: f32) -> f32``, which may take fewer
    of these, in any order. Every other name in an expression, and every other argument of ``weight``, is a
    uniform, whose value is a param with a dotted name. Helper functions, constants, structures, vectors,
    branches and loops are run; textures, buffers, matrices and arrays are refused. Numbers are float32, and
    each operation is rounded. A fragment whose loops take 4096 turns in all gets NaN. Text has at most 8192
    bytes; a text that is but a name is that of a published function or of an argument.

    A callable ``weight(z, alpha)`` is given two float32 arrays of one length and returns as many weights. It
    is called for some thousand fragments at a time, in any order, from several threads, by one of them at a
    time; it cannot render.

    A bin function is an expression of ``x``, the signed distance from a bin's centre in bin widths, a module
    with ``fn bin(x: f32) -> f32``, or a callable of one array. It is asked for abs(x) <= 2.5 and is 0 beyond.
    A fragment that it gives no share in any bin is lost, and counted.

    Two texts are one variant if they and their uniforms are equal, two callables if they are one object.

    Examples
    --------
    >>> import numpy as np
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> frame = oitlab.render(scene, "wboit", {"weight": "mb7"})
    >>> frame.color.shape, str(frame.color.dtype), frame.technique
    ((18, 32, 3), 'float32', 'wboit')

    A weight of one's own, with a uniform, and the same as a function of arrays:

    >>> mine = oitlab.render(scene, "wboit", {"weight": "a * exp(-k * z)", "weight.k": 0.5})
    >>> same = oitlab.render(scene, "wboit", {"weight": lambda z, alpha: alpha * np.exp(-0.5 * z)})
    >>> bool(abs(mine.color - same.color).max() < 1e-5), mine.stats.invalid_weights
    (True, 0)
    """
    options = backend, threads, skip, dtype, diagnostics
    return _render(source, [(technique, params)], *options)[0]


def render_many(
    source: Scene | Fragments,
    variants: Iterable[Variant],
    *,
    backend: Literal["cpu", "gpu"] = "cpu",
    threads: int | None = None,
    skip: bool = True,
    dtype: Any = "float32",
    diagnostics: bool = False,
) -> list[Frame]:
    """Several images of one source for one rasterisation.

    Parameters
    ----------
    source : Scene or Fragments
        What is drawn.
    variants : iterable of (technique, params) or of technique ids
        May be empty, and may repeat itself.
    backend, threads, skip, dtype, diagnostics
        As in `render`.

    Returns
    -------
    list of Frame
        In the order of `variants`.

    Raises
    ------
    ValueError
        As `render`; nothing is drawn when one variant is wrong.

    Warns
    -----
    WeightWarning
        As `render`; one for all variants.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> exact, fast = oitlab.render_many(scene, ["a_buffer", ("wboit", {"weight": "mb9"})])
    >>> exact.scene_hash == fast.scene_hash == scene.content_hash
    True
    """
    return _render(source, variants, backend, threads, skip, dtype, diagnostics)


def _render(
    source: Scene | Fragments,
    variants: Iterable[Variant],
    backend: Literal["cpu", "gpu"],
    threads: int | None,
    skip: bool,
    dtype: Any,
    diagnostics: bool,
    path: str = "hardware",
) -> list[Frame]:
    if isinstance(variants, str) or not isinstance(variants, Iterable):
        raise ValueError(f"variants must be an iterable of ids or (id, params), got {variants!r}")
    requested = [checked_variant(variant) for variant in variants]
    _check_source(source)
    _check_backend(backend, requested)
    diagnosed = flag(diagnostics, "diagnostics")
    options = _threads(threads), flag(skip, "skip"), _is_float64(dtype)
    bound = [bind(*variant) for variant in requested]
    jobs = [(one.technique, one.params) for one in bound]
    if backend == "gpu":
        _check_gpu_options(diagnosed, options[2])
        raws = _oitlab.render_gpu(source._handle, jobs, *options[:2], path)
    else:
        raws = _oitlab.render(source._handle, jobs, *options)
    warn_of_weights((raw.technique, raw.invalid_weights) for raw in raws)
    frames = [_frame(raw, one) for raw, one in zip(raws, bound, strict=True)]
    if not diagnosed:
        return frames
    found = _oitlab.diagnose(source._handle, jobs, options[0])
    return [_diagnosed(frame, images) for frame, images in zip(frames, found, strict=True)]


def check_variants(
    source: Scene | Fragments,
    variants: Iterable[Variant],
    backend: str = "cpu",
    *,
    asks_device: bool = True,
) -> None:
    """Refuse what `render_many` would refuse of variants before it draws anything.

    Parameters
    ----------
    source : Scene or Fragments
        What they are to be rendered of.
    variants : iterable of (technique, params) or of technique ids
        Of which nothing is rendered.
    backend : {"cpu", "gpu"}
        Where.
    asks_device : bool
        Whether the device of this process is asked for what it lacks, too; False needs no device.

    Raises
    ------
    ValueError, RuntimeError
        As `render`.
    """
    requested = [checked_variant(variant) for variant in variants]
    _check_source(source)
    _check_backend(backend, requested)
    jobs = [(one.technique, one.params) for one in (bind(*variant) for variant in requested)]
    if backend == "gpu":
        _oitlab.check_gpu(source._handle, jobs, "hardware", asks_device)
    else:
        _oitlab.check(source._handle, jobs)


@contextmanager
def silent_weights() -> Iterator[None]:
    """Leave it to the caller to tell of `Stats.invalid_weights`."""
    token = _is_silent.set(True)
    try:
        yield
    finally:
        _is_silent.reset(token)


def warn_of_weights(counts: Iterable[tuple[str, int]]) -> None:
    """Warn whoever called oitlab, once, of everything that was no weight: techniques, and how often."""
    found = [(technique, times) for technique, times in counts if times]
    if found and not _is_silent.get():
        told = ", ".join(f"{times} of {technique}" for technique, times in found)
        message = (
            "a function of one's own gave what is no weight (a finite number above 0) or no share (one from 0"
            f" up); the least there is took its place. Fragments: {told}"
        )
        warnings.warn(message, WeightWarning, stacklevel=outside())


def capture(scene: Scene, *, threads: int | None = None) -> Fragments:
    """Rasterise once and keep every transparent fragment.

    Parameters
    ----------
    scene : Scene
        What is rasterised.
    threads : int >= 1, optional
        All cores when absent.

    Returns
    -------
    Fragments
        Rendering them gives the same bits as rendering `scene`.

    Examples
    --------
    >>> import oitlab
    >>> fragments = oitlab.capture(oitlab.scenes.squares(width=32, height=18))
    >>> int(fragments.counts.sum()) == len(fragments)
    True
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, got {type(scene).__name__}")
    return Fragments._wrap(_oitlab.capture(scene._handle, _threads(threads)))


def checked_variant(variant: Variant) -> tuple[str, dict[str, Any]]:
    """Give the id and the params as the core takes them."""
    if isinstance(variant, str):
        return variant, {}
    try:
        technique, params = variant
    except (TypeError, ValueError):
        raise ValueError(f"a variant is a technique id or (id, params), got {variant!r}") from None
    if not isinstance(technique, str):
        raise ValueError(f"a technique is named by its id, got {technique!r}")
    return technique, python_params(params, technique)


@dataclass(frozen=True, slots=True)
class Bound:
    """A variant as the core takes it."""

    technique: str | _oitlab.CustomTechnique
    params: dict[str, Any]
    """As requested; complete for a technique of one's own."""
    definition: Definition | None = None


def bind(technique: str, params: dict[str, Any]) -> Bound:
    """Find a technique of one's own under the id and check its params; others are the core's business."""
    entry = techniques().get(technique)
    if entry is None:
        known = ", ".join(techniques().ids)
        raise ValueError(f'unknown technique "{technique}"; the techniques are {known}')
    if entry.definition is None:
        return Bound(technique, params)
    resolved = entry.definition.resolved(params)
    return Bound(entry.definition.bound(resolved), resolved, entry.definition)


def _check_source(source: Any) -> None:
    if not isinstance(source, Scene | Fragments):
        raise ValueError(f"source must be a Scene or Fragments, got {type(source).__name__}")


def _check_backend(backend: str, variants: Iterable[tuple[str, dict[str, Any]]]) -> None:
    if backend not in ("cpu", "gpu"):
        raise ValueError(f"unknown backend {backend!r}; known: cpu, gpu")
    for technique, _ in variants:
        entry = techniques().get(technique)
        if entry is not None and backend not in entry.backends:
            known = ", ".join(entry.backends)
            raise ValueError(f"{entry.id!r} has no {backend.upper()} form yet; its backends: {known}")


def _check_gpu_options(diagnosed: bool, float64: bool) -> None:
    if diagnosed:
        raise ValueError('diagnostics: numbers are watched on backend "cpu"; "gpu" has none')
    if float64:
        raise ValueError('dtype: backend "gpu" computes in single precision; \'float64\' is for "cpu"')


def _threads(threads: int | None) -> int | None:
    return None if threads is None else count(threads, "threads")


_FLOAT32, _FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)


def _is_float64(dtype: Any) -> bool:
    if dtype is not None:  # NumPy takes None for float64
        try:
            asked = np.dtype(dtype)
        except TypeError:
            asked = np.dtype(object)
        for known, is_float64 in ((_FLOAT32, False), (_FLOAT64, True)):
            if asked == known:
                return is_float64
    raise ValueError(f"dtype must be 'float32' or 'float64', got {dtype!r}")


def _diagnosed(frame: Frame, images: dict[str, Any]) -> Frame:
    diagnostics = Diagnostics(images, frame.technique)
    stats = dataclasses.replace(frame.stats, diagnostics=diagnostics.pixels)
    return frame.replace(stats=stats, diagnostics=diagnostics)


def _frame(raw: _oitlab.Frame, bound: Bound) -> Frame:
    own = bound.definition
    return Frame(
        color=lambda: raw.color,
        transmittance=lambda: raw.transmittance,
        technique=raw.technique,
        params=(lambda: raw.params) if own is None else bound.params,
        inactive_params=lambda: frozenset(raw.inactive_params),
        scene_hash=lambda: raw.source_hash,
        # what a technique of one's own says of itself is asked for now, and may raise
        stats=(lambda: Stats(**raw.stats)) if own is None else _with_cost(raw, own, bound.params),
        first_depth=lambda: raw.first_depth,
        fragment_count=lambda: raw.fragment_count,
    )


def _with_cost(raw: _oitlab.Frame, definition: Definition, params: Mapping[str, Any]) -> Stats:
    """Fill in what the core cannot know: what a technique of one's own says of itself."""
    stats = Stats(**raw.stats)
    cost = definition.cost(params, stats.depth_complexity_mean, stats.depth_complexity_max)
    return dataclasses.replace(
        stats, geometry_passes=cost.geometry_passes, bytes_per_pixel=cost.bytes_per_pixel
    )
