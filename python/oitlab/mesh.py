"""Triangles and their material."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oitlab
from ._convert import Vec3, array, choice, flag, scalar, vec3

AlphaMode = Literal["blend", "opaque", "mask"]
Shading = Literal["unlit", "lambert"]
WHITE = (1.0, 1.0, 1.0, 1.0)


class Mesh:
    """Triangles with one material.

    Parameters
    ----------
    vertices : (V, 3) float array
        Positions.
    faces : (F, 3) integer array
        Three vertex indices in [0, V) per triangle; seen from its front, a face runs counter-clockwise.
    color : (4,) floats, optional
        One colour for the whole mesh; opaque white when no colour is given at all.
    vertex_colors : (V, 4) float array, optional
        A colour per vertex, interpolated premultiplied and perspective-correct.
    face_colors : (F, 4) float array, optional
        A colour per face. At most one of the three colour arguments may be given.
    alpha_mode : {"blend", "opaque", "mask"}
        "blend": every fragment is transparent, also where alpha = 1. "opaque": alpha is ignored and the mesh
        hides what lies behind it. "mask": opaque where alpha >= `alpha_cutoff`, absent elsewhere.
    alpha_cutoff : float >= 0
        Smallest alpha that "mask" draws.
    shading : {"unlit", "lambert"}
        "lambert" multiplies the colour by a headlight plus ambient term.
    emission : (3,) floats >= 0
        Linear RGB added to the premultiplied colour, whatever the alpha: transparency does not dim it.
    double_sided : bool
        False draws front faces only.
    opacity : float in [0, 1], optional
        After the mask test, replaces every alpha and makes the material blend.

    Raises
    ------
    ValueError
        Wrong shapes or dtypes, non-finite numbers, colours out of range, face indices out of range, unknown
        modes; the message names the argument and the first culprit.

    Examples
    --------
    >>> triangle = Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], color=(1, 0.5, 0, 0.35))
    >>> triangle
    Mesh(3 vertices, 1 faces, alpha_mode='blend', shading='unlit')
    >>> triangle == Mesh(triangle.vertices, triangle.faces, face_colors=[(1, 0.5, 0, 0.35)])
    False
    """

    __slots__ = (
        "_alpha_cutoff",
        "_alpha_mode",
        "_domain",
        "_double_sided",
        "_emission",
        "_handle",
        "_opacity",
        "_shading",
    )

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        color: ArrayLike | None = None,
        vertex_colors: ArrayLike | None = None,
        face_colors: ArrayLike | None = None,
        alpha_mode: AlphaMode = "blend",
        alpha_cutoff: float = 0.5,
        shading: Shading = "unlit",
        emission: ArrayLike = (0.0, 0.0, 0.0),
        double_sided: bool = True,
        opacity: float | None = None,
    ) -> None:
        points = array(vertices, "vertices", np.float64, ("V", 3))
        triangles = array(faces, "faces", np.int64, ("F", 3))
        self._domain, colors = _colors(color, vertex_colors, face_colors, len(points), len(triangles))
        self._alpha_mode = choice(alpha_mode, "alpha_mode", AlphaMode)
        self._alpha_cutoff = scalar(alpha_cutoff, "alpha_cutoff")
        self._shading = choice(shading, "shading", Shading)
        self._emission = vec3(emission, "emission")
        self._double_sided = flag(double_sided, "double_sided")
        self._opacity = None if opacity is None else scalar(opacity, "opacity")
        self._handle = _oitlab.Mesh(
            points,
            triangles,
            colors,
            self._domain,
            self._alpha_mode,
            self._alpha_cutoff,
            self._shading,
            self._emission,
            self._double_sided,
            self._opacity,
        )

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3) float64 positions."""
        return self._handle.vertices

    @property
    def faces(self) -> NDArray[np.uint32]:
        """(F, 3) uint32 vertex indices."""
        return self._handle.faces

    @property
    def colors(self) -> NDArray[np.float32]:
        """(1, 4), (V, 4) or (F, 4) float32 straight linear RGBA, as `color_domain` says."""
        return self._handle.colors

    @property
    def color_domain(self) -> Literal["mesh", "vertex", "face"]:
        """What a row of `colors` belongs to."""
        return self._domain

    @property
    def alpha_mode(self) -> AlphaMode:
        """How alpha is used; see the class."""
        return self._alpha_mode

    @property
    def alpha_cutoff(self) -> float:
        """Smallest alpha that "mask" draws."""
        return self._alpha_cutoff

    @property
    def shading(self) -> Shading:
        """The light model."""
        return self._shading

    @property
    def emission(self) -> Vec3:
        """Linear RGB radiance of the surface itself."""
        return self._emission

    @property
    def double_sided(self) -> bool:
        """Whether back faces are drawn."""
        return self._double_sided

    @property
    def opacity(self) -> float | None:
        """The alpha that replaces all others, or None."""
        return self._opacity

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) float64: smallest and largest corner of the vertices; NaN when there are none."""
        vertices = self.vertices
        if len(vertices) == 0:
            return np.full((2, 3), np.nan)
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    def _material(self) -> dict[str, Any]:
        return {
            "alpha_mode": self._alpha_mode,
            "alpha_cutoff": self._alpha_cutoff,
            "shading": self._shading,
            "emission": self._emission,
            "double_sided": self._double_sided,
            "opacity": self._opacity,
        }

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Mesh):
            return NotImplemented
        return self is other or (
            self._domain == other._domain
            and self._material() == other._material()
            and np.array_equal(self.colors, other.colors)
            and np.array_equal(self.faces, other.faces)
            and np.array_equal(self.vertices, other.vertices)
        )

    def __hash__(self) -> int:
        return hash((self.faces.shape, self.vertices.tobytes(), self._domain, *self._material().values()))

    def __repr__(self) -> str:
        return (
            f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces, "
            f"alpha_mode={self._alpha_mode!r}, shading={self._shading!r})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        keyword = {"mesh": "color", "vertex": "vertex_colors", "face": "face_colors"}[self._domain]
        colors = self.colors[0] if self._domain == "mesh" else self.colors
        return _rebuild_mesh, (self.vertices, self.faces, {keyword: colors, **self._material()})


def _rebuild_mesh(vertices: ArrayLike, faces: ArrayLike, keywords: dict[str, Any]) -> Mesh:
    return Mesh(vertices, faces, **keywords)


def _colors(
    color: ArrayLike | None,
    vertex_colors: ArrayLike | None,
    face_colors: ArrayLike | None,
    vertices: int,
    faces: int,
) -> tuple[Literal["mesh", "vertex", "face"], NDArray[np.float32]]:
    given = {"color": color, "vertex_colors": vertex_colors, "face_colors": face_colors}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ValueError(f"give one of color, vertex_colors and face_colors, not {' and '.join(names)}")
    if vertex_colors is not None:
        return "vertex", array(vertex_colors, "vertex_colors", np.float32, (vertices, 4))
    if face_colors is not None:
        return "face", array(face_colors, "face_colors", np.float32, (faces, 4))
    return "mesh", array(WHITE if color is None else color, "color", np.float32, (4,)).reshape(1, 4)
