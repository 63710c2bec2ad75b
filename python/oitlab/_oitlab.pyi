"""The compiled core. `oitlab` wraps every name here; import from there."""

from collections.abc import Callable
from typing import Any, Literal, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Camera",
    "CustomTechnique",
    "Fragments",
    "Frame",
    "Mesh",
    "Scene",
    "__version__",
    "build_features",
    "capture",
    "capture_gpu",
    "check",
    "check_gpu",
    "cost",
    "diagnose",
    "gpu_copy_bandwidth",
    "gpu_info",
    "order_sensitivity",
    "render",
    "render_gpu",
    "settle",
    "techniques",
    "transmittance",
]

__version__: str
build_features: tuple[str, ...]

_Vec3: TypeAlias = tuple[float, float, float]

@final
class Camera:
    def __new__(
        cls,
        eye: _Vec3,
        target: _Vec3,
        up: _Vec3,
        fov_y: float | None,
        ortho_height: float | None,
        near: float,
        far: float,
    ) -> Camera: ...

@final
class CustomTechnique:
    def __new__(
        cls,
        id: str,
        identity: str,
        submission_order: str,
        seed: int,
        sorted: bool,
        colored: bool,
        promises: list[bool],
        resolve: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]],
        transmittance: Callable[..., NDArray[np.float64]] | None,
    ) -> CustomTechnique: ...

@final
class Mesh:
    def __new__(
        cls,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int64],
        colors: NDArray[np.float32],
        color_domain: Literal["mesh", "vertex", "face"],
        alpha_mode: str,
        alpha_cutoff: float,
        shading: str,
        emission: _Vec3,
        double_sided: bool,
        opacity: float | None,
    ) -> Mesh: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.uint32]: ...
    @property
    def colors(self) -> NDArray[np.float32]: ...

@final
class Scene:
    def __new__(
        cls,
        meshes: list[Mesh],
        camera: Camera,
        width: int,
        height: int,
        background: _Vec3,
    ) -> Scene: ...
    @property
    def content_hash(self) -> str: ...

@final
class Fragments:
    def __new__(
        cls,
        width: int,
        height: int,
        offsets: NDArray[np.int64],
        depth: NDArray[np.float32],
        color: NDArray[np.float32],
        alpha: NDArray[np.float32],
        primitive: NDArray[np.uint32] | None,
        background: NDArray[np.float32],
        near: float,
        far: float,
        depth_range: tuple[float, float] | None,
        primitive_depth: NDArray[np.float64] | None,
    ) -> Fragments: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def offsets(self) -> NDArray[np.int64]: ...
    @property
    def depth(self) -> NDArray[np.float32]: ...
    @property
    def color(self) -> NDArray[np.float32]: ...
    @property
    def alpha(self) -> NDArray[np.float32]: ...
    @property
    def primitive(self) -> NDArray[np.uint32]: ...
    @property
    def background(self) -> NDArray[np.float32]: ...
    @property
    def near(self) -> float: ...
    @property
    def far(self) -> float: ...
    @property
    def depth_range(self) -> tuple[float, float]: ...
    @property
    def primitive_depth(self) -> NDArray[np.float64] | None: ...
    @property
    def content_hash(self) -> str: ...

@final
class Frame:
    @property
    def technique(self) -> str: ...
    @property
    def params(self) -> dict[str, Any]: ...
    @property
    def inactive_params(self) -> list[str]: ...
    @property
    def source_hash(self) -> str: ...
    @property
    def color(self) -> NDArray[np.float32] | NDArray[np.float64]: ...
    @property
    def transmittance(self) -> NDArray[np.float32] | NDArray[np.float64]: ...
    @property
    def first_depth(self) -> NDArray[np.float32]: ...
    @property
    def fragment_count(self) -> NDArray[np.uint32]: ...
    @property
    def invalid_weights(self) -> int: ...
    @property
    def stats(self) -> dict[str, Any]: ...

def render(
    source: Scene | Fragments,
    variants: list[tuple[str | CustomTechnique, dict[str, Any]]],
    threads: int | None,
    skip: bool,
    float64: bool,
) -> list[Frame]: ...
def render_gpu(
    source: Scene | Fragments,
    variants: list[tuple[str | CustomTechnique, dict[str, Any]]],
    threads: int | None,
    skip: bool,
    path: str,
) -> list[Frame]: ...
def check(
    source: Scene | Fragments, variants: list[tuple[str | CustomTechnique, dict[str, Any]]]
) -> None: ...
def check_gpu(
    source: Scene | Fragments,
    variants: list[tuple[str | CustomTechnique, dict[str, Any]]],
    path: str,
    asks_device: bool,
) -> None: ...
def capture_gpu(scene: Scene) -> Fragments: ...
def gpu_copy_bandwidth() -> float: ...
def gpu_info() -> dict[str, Any]: ...
def diagnose(
    source: Scene | Fragments,
    variants: list[tuple[str | CustomTechnique, dict[str, Any]]],
    threads: int | None,
) -> list[dict[str, NDArray[Any]]]: ...
def capture(scene: Scene, threads: int | None) -> Fragments: ...
def transmittance(
    fragments: Fragments,
    technique: str | CustomTechnique,
    params: dict[str, Any],
    pixel: tuple[int, int],
    depths: NDArray[np.float32],
) -> list[NDArray[np.float64]]: ...
def order_sensitivity(
    fragments: Fragments,
    technique: str | CustomTechnique,
    params: dict[str, Any],
    n: int,
    seed: int,
    threads: int | None,
) -> NDArray[np.float64]: ...
def cost(
    technique: str,
    params: dict[str, Any],
    depth_complexity_mean: float,
    depth_complexity_max: int,
) -> tuple[float, float]: ...
def settle() -> None: ...
def techniques() -> list[dict[str, Any]]: ...
