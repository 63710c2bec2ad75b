"""The GPU backend: what device there is, what it can do, and the fragments as it finds them.

`oitlab.render(..., backend="gpu")` renders with it. The CPU clips, projects and snaps the geometry and draws
opaque surfaces; the device covers the same pixels with the same primitives, and does the rest in single
precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from . import _oitlab
from .fragments import Fragments
from .frame import Frame
from .rendering import _render
from .scene import Scene


@dataclass(frozen=True)
class GpuInfo:
    """The device that `backend="gpu"` uses in this process."""

    adapter: str
    """Its name."""
    kind: str
    """DiscreteGpu, IntegratedGpu, VirtualGpu, Cpu or Other."""
    driver: str
    driver_info: str
    interface: str
    """vulkan, metal or dx12."""
    features: Mapping[str, bool]
    """Whether it has what some params want: timestamps (times are the device's own; without them they are
    those of the clock on the wall), float32_blending (format="f32" of blended techniques), unorm16."""
    limits: Mapping[str, int]
    """Pixels along an image's sides, bytes of a buffer and of what a shader sees of one, bytes per pixel of
    render targets. Geometry and fragment lists beyond them are drawn in parts."""
    techniques: tuple[str, ...]
    """The techniques that it renders with their default params."""
    refused: Mapping[str, str]
    """The others, and why not."""

    def __str__(self) -> str:
        lines = [
            f"{self.adapter} ({self.kind}, {self.interface}; {self.driver} {self.driver_info})",
            "features    " + ", ".join(name for name, there in self.features.items() if there),
            "limits      " + ", ".join(f"{name} {limit:,}" for name, limit in self.limits.items()),
            "techniques  " + ", ".join(self.techniques),
        ]
        reasons = dict.fromkeys(self.refused.values())
        for reason in reasons:
            ids = ", ".join(technique for technique, why in self.refused.items() if why == reason)
            lines.append(f"not         {ids}: {reason}")
        return "\n".join(lines)


def info() -> GpuInfo:
    """Describe the device: adapter, driver, features, limits, and which techniques they allow.

    Of several adapters the fastest is taken, or the one whose name contains the environment variable
    `WGPU_ADAPTER_NAME` when the device is first needed. `OITLAB_GPU_BUFFER_BYTES` caps what is used of a
    buffer at a time, should a device promise more than it has.

    Returns
    -------
    GpuInfo

    Raises
    ------
    RuntimeError
        No adapter or driver, with what would help; or a build without the backend.

    Examples
    --------
    >>> import oitlab
    >>> try:
    ...     runs = "wboit" in oitlab.gpu.info().techniques
    ... except RuntimeError as error:
    ...     runs = "driver" in str(error)  # there is none, and it says how to get one
    >>> runs
    True
    """
    raw = _oitlab.gpu_info()
    return GpuInfo(
        adapter=raw["adapter"],
        kind=raw["kind"],
        driver=raw["driver"],
        driver_info=raw["driver_info"],
        interface=raw["interface"],
        features=MappingProxyType(raw["features"]),
        limits=MappingProxyType(raw["limits"]),
        techniques=tuple(raw["techniques"]),
        refused=MappingProxyType(raw["refused"]),
    )


def copy_bandwidth() -> float:
    """Measure how fast the device's memory is, which bounds what blends fragments into render targets.

    Returns
    -------
    float
        Bytes per second that a compute shader reads and writes, taken together, while it copies up to
        256 MiB, or what `OITLAB_GPU_BUFFER_BYTES` leaves of a buffer; the best of six copies.

    Raises
    ------
    RuntimeError
        No device.
    MemoryError
        Not enough memory on the device.

    Examples
    --------
    >>> import oitlab
    >>> try:
    ...     is_fast = oitlab.gpu.copy_bandwidth() > 1e8
    ... except RuntimeError:  # no driver
    ...     is_fast = True
    >>> is_fast
    True
    """
    return _oitlab.gpu_copy_bandwidth()


def render(
    scene: Scene,
    technique: str,
    params: Mapping[str, Any] | None = None,
    *,
    path: Literal["hardware", "compute", "samples", "linked_lists"] = "hardware",
    threads: int | None = None,
    skip: bool = True,
) -> Frame:
    """One technique's image, drawn by the device's own raster, one in compute, sample masks or linked lists.

    Parameters
    ----------
    scene : Scene
        What is drawn.
    technique : str
        An id or alias of `oitlab.techniques()`.
    params : mapping, optional
        The technique's parameters, as `oitlab.render` takes them.
    path : {"hardware", "compute", "samples", "linked_lists"}
        "hardware" is what `oitlab.render(..., backend="gpu")` draws with: blend units, depth buffers, lists.
        "compute" sorts the primitives into tiles of 8 x 8 pixels and walks them in submission order, with
        what the technique keeps of a pixel in registers: no lists, no render targets while drawing. For
        techniques that look at all fragments of a pixel at once (`density_clustering`, `deep_shadow_maps`
        ...) tiles fill lists. It is for all techniques, with targets in f32 and maps of up to 1024 numbers
        per pixel. "samples" is for `stochastic_transparency`, whose masks are then sample masks of the
        device's. "linked_lists" is for
        what "hardware" draws into lists (`a_buffer`, `mlab`, `lwboit` with `storage="ll"` ...): one pass over
        the geometry into per-pixel linked lists (Yang et al. 2010), where "hardware" counts in one and stores
        in another. A pool of nodes that was too small grows, which draws again, and nothing is lost.
    threads, skip
        As in `oitlab.render`.

    Returns
    -------
    Frame
        The same image on all paths but for rounding: they cover the same pixels.

    Raises
    ------
    RuntimeError
        No device.
    ValueError
        Params that the path has no form for; "samples" or "linked_lists" for another technique.
    MemoryError
        Not enough memory on the device. On "compute": a few rows of the image (64 to 128, or 8 where there
        are lists) that have more primitives, or fragments, than a buffer holds.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> try:
    ...     frame = oitlab.gpu.render(scene, "mlab", {"layers": 2}, path="compute")
    ... except RuntimeError:  # no driver
    ...     frame = oitlab.render(scene, "mlab", {"layers": 2})
    >>> frame.color.shape
    (18, 32, 3)
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, got {type(scene).__name__}")
    if not isinstance(path, str):
        raise ValueError(f"path: {path!r}; known: 'hardware', 'compute', 'samples', 'linked_lists'")
    return _render(scene, [(technique, params)], "gpu", threads, skip, "float32", False, path)[0]


def capture(scene: Scene) -> Fragments:
    """Rasterise on the GPU and keep every transparent fragment, as `oitlab.capture` does on the CPU.

    Parameters
    ----------
    scene : Scene
        What is rasterised.

    Returns
    -------
    Fragments
        The same pixels, primitives and order as those of `oitlab.capture`. Where a triangle is not clipped,
        depths are one unit in the last place off at most; colours that vary over a triangle about 1e-6.

    Raises
    ------
    RuntimeError
        No device.
    ValueError
        An image beyond the device's limits.
    MemoryError
        Not enough memory on the device.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> try:
    ...     fragments = oitlab.gpu.capture(scene)
    ... except RuntimeError:  # no driver
    ...     fragments = oitlab.capture(scene)
    >>> len(fragments) == len(oitlab.capture(scene))
    True
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, got {type(scene).__name__}")
    return Fragments._wrap(_oitlab.capture_gpu(scene._handle))
