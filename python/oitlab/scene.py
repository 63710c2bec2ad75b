"""What is drawn: `Mesh`, `Camera` and `Scene`.

All three are immutable values: they compare by content, hash, pickle, and may be shared between threads.
Lengths share one arbitrary unit. Colours are linear RGB (Rec. 709 primaries, D65) with straight alpha.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oitlab
from ._convert import Vec3, count, vec3
from .camera import Camera
from .mesh import Mesh

__all__ = ["DEFAULT_BACKGROUND", "Camera", "Mesh", "Scene"]

DEFAULT_BACKGROUND: Vec3 = (0.2, 0.2, 0.2)


class Scene:
    """Meshes, the camera that sees them, the image size and the background.

    Parameters
    ----------
    meshes : iterable of Mesh
        Submission order is their order, and within a mesh the order of its faces.
    camera : Camera
    width, height : int >= 1
        Image size in pixels.
    background : (3,) floats
        Linear RGB behind everything, opaque.

    Raises
    ------
    ValueError
        A size of zero, a background that is not finite, or something that is no mesh among `meshes`.

    Examples
    --------
    >>> pane = Mesh([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], [(0, 1, 2)], color=(1, 0, 0, 0.5))
    >>> scene = Scene([pane], camera=Camera(), width=64, height=36)
    >>> scene.replace(width=32, height=18)
    Scene(1 meshes, 1 faces, 32 x 18)
    >>> scene.replace(width=32).meshes[0] is pane
    True
    """

    __slots__ = ("_background", "_camera", "_handle", "_height", "_meshes", "_width")

    def __init__(
        self,
        meshes: Iterable[Mesh],
        *,
        camera: Camera,
        width: int = 1280,
        height: int = 720,
        background: ArrayLike = DEFAULT_BACKGROUND,
    ) -> None:
        self._meshes = _checked_meshes(meshes)
        if not isinstance(camera, Camera):
            raise ValueError(f"camera must be a Camera, got {type(camera).__name__}")
        self._camera = camera
        self._width = count(width, "width")
        self._height = count(height, "height")
        self._background = vec3(background, "background")
        self._handle = _oitlab.Scene(
            [mesh._handle for mesh in self._meshes],
            camera._handle,
            self._width,
            self._height,
            self._background,
        )

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """The meshes, in submission order."""
        return self._meshes

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self._camera

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self._width

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self._height

    @property
    def background(self) -> Vec3:
        """Linear RGB behind everything."""
        return self._background

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) float64: smallest and largest corner of all vertices; NaN when there are none."""
        boxes = [mesh.bounds for mesh in self._meshes if len(mesh.vertices)]
        if not boxes:
            return np.full((2, 3), np.nan)
        low, high = zip(*boxes, strict=True)
        return np.stack([np.min(low, axis=0), np.max(high, axis=0)])

    @property
    def content_hash(self) -> str:
        """Hexadecimal digest of everything that the image depends on."""
        return self._handle.content_hash

    def replace(self, **changes: Any) -> Scene:
        """Copy with some constructor arguments changed; unchanged meshes are shared, not copied.

        Raises
        ------
        TypeError
            A name that the constructor does not have.
        """
        keywords = {name: getattr(self, name) for name in _FIELDS}
        unknown = changes.keys() - keywords.keys()
        if unknown:
            raise TypeError(f"Scene has no {sorted(unknown)}; it has {', '.join(_FIELDS)}")
        return Scene(**{**keywords, **changes})

    def __eq__(self, other: object) -> bool:
        return self.content_hash == other.content_hash if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.content_hash)

    def __repr__(self) -> str:
        faces = sum(len(mesh.faces) for mesh in self._meshes)
        return f"Scene({len(self._meshes)} meshes, {faces} faces, {self._width} x {self._height})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild_scene, tuple(getattr(self, name) for name in _FIELDS)


_FIELDS = ("meshes", "camera", "width", "height", "background")


def _rebuild_scene(
    meshes: tuple[Mesh, ...], camera: Camera, width: int, height: int, background: Vec3
) -> Scene:
    return Scene(meshes, camera=camera, width=width, height=height, background=background)


def _checked_meshes(meshes: Iterable[Mesh]) -> tuple[Mesh, ...]:
    try:
        given = tuple(meshes)
    except TypeError:
        raise ValueError(f"meshes must be an iterable of Mesh, got {type(meshes).__name__}") from None
    for index, mesh in enumerate(given):
        if not isinstance(mesh, Mesh):
            raise ValueError(f"meshes[{index}] must be a Mesh, got {type(mesh).__name__}")
    return given
