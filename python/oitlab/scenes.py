"""Procedural scenes: stand-ins for those of the papers, the same on every machine for the same seed.

Every function takes a seed, the image size, and counts that tests can make small. Colours are linear RGB with
straight alpha, one per face. Faces come in shuffled order, so that the submission order says nothing about
depth, and the clip planes are tight, because depth weights depend on them.

Examples
--------
>>> sorted(SCENES)
['blades', 'shells', 'smoke', 'soup', 'squares', 'torus_knot']
>>> squares(seed=1, width=64, height=36, count=8)
Scene(1 meshes, 16 faces, 64 x 36)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._convert import array, scalar
from ._convert import count as checked_count
from .camera import Camera
from .mesh import Mesh
from .scene import Scene

__all__ = ["SCENES", "blades", "shells", "smoke", "soup", "squares", "torus_knot"]

Floats = NDArray[np.float64]
FOV_Y = 40.0


def squares(
    seed: int = 0, width: int = 1280, height: int = 720, *, count: int = 64, alpha: float = 0.9
) -> Scene:
    """Camera-facing squares, nearly opaque, in a stack of evenly spaced layers.

    Parameters
    ----------
    seed : int
        Of all random choices.
    width, height : int
        Image size in pixels.
    count : int
        Squares, one per layer, depths evenly spaced over 3 units.
    alpha : float in [0, 1]
        Of every square.
    """
    rng, count = _rng(seed), checked_count(count, "count")
    centres = np.column_stack(
        [rng.uniform(-1.6, 1.6, count), rng.uniform(-0.8, 0.8, count), np.linspace(-1.5, 1.5, count)]
    )
    vertices, faces = _quads(centres, rng.uniform(0.25, 0.55, count), rng.uniform(0, np.pi / 2, count))
    colors = _with_alpha(rng.random((count, 3)), alpha)
    return _scene(rng, vertices, faces, colors.repeat(2, axis=0), (0, 0, 5), width, height)


def smoke(seed: int = 0, width: int = 1280, height: int = 720, *, count: int = 1050) -> Scene:
    """Large faint camera-facing squares in two hues, normally distributed over the image.

    Parameters
    ----------
    seed : int
        Of all random choices.
    width, height : int
        Image size in pixels.
    count : int
        Squares; their alphas lie in [0.05, 0.2], their depths are evenly spaced over 3 units.
    """
    rng, count = _rng(seed), checked_count(count, "count")
    depths = rng.permutation(np.linspace(-1.5, 1.5, count))
    centres = np.column_stack([rng.normal(0, 1.05, count), rng.normal(0, 0.6, count), depths])
    vertices, faces = _quads(centres, rng.uniform(0.3, 0.8, count), rng.uniform(0, np.pi / 2, count))
    hues = np.array([(0.3, 0.4, 0.6), (0.9, 0.55, 0.25)])[rng.integers(0, 2, count)]
    colors = np.column_stack([hues, rng.uniform(0.05, 0.2, count)])
    return _scene(rng, vertices, faces, colors.repeat(2, axis=0), (0, 0, 5), width, height)


def soup(
    seed: int = 0, width: int = 1280, height: int = 720, *, count: int = 200_000, alpha: float = 0.3
) -> Scene:
    """Tiny triangles strewn through a cube: a cloud of unconnected fragments.

    Parameters
    ----------
    seed : int
        Of all random choices.
    width, height : int
        Image size in pixels.
    count : int
        Triangles.
    alpha : float in [0, 1]
        Of every triangle.
    """
    rng, count = _rng(seed), checked_count(count, "count")
    corners = rng.uniform(-0.5, 0.5, (count, 1, 3)) + rng.normal(0, 0.0085, (count, 3, 3))
    return _triangles(rng, corners, alpha, (0.78, 0.61, 1.22), width, height)


def blades(
    seed: int = 0, width: int = 1280, height: int = 720, *, count: int = 400, alpha: float = 0.3
) -> Scene:
    """Large triangles that cut through each other: no order of whole triangles is right.

    Parameters
    ----------
    seed : int
        Of all random choices.
    width, height : int
        Image size in pixels.
    count : int
        Triangles.
    alpha : float in [0, 1]
        Of every triangle.
    """
    rng, count = _rng(seed), checked_count(count, "count")
    corners = rng.normal(0, 0.35, (count, 1, 3)) + rng.normal(0, 0.45, (count, 3, 3))
    return _triangles(rng, corners, alpha, (0, 0, 5), width, height)


def shells(
    seed: int = 0,
    width: int = 1280,
    height: int = 720,
    *,
    count: int = 8,
    subdivisions: int = 6,
    alpha: float = 0.35,
) -> Scene:
    """Finely tessellated spheres around nearly the same point: long curved layers that intersect.

    Parameters
    ----------
    seed : int
        Of all random choices.
    width, height : int
        Image size in pixels.
    count : int
        Spheres, radii evenly spaced from 0.45 to 1.15.
    subdivisions : int
        Each sphere has 20 * 4**subdivisions faces.
    alpha : float in [0, 1]
        Of every sphere.
    """
    rng, count = _rng(seed), checked_count(count, "count")
    sphere, triangles = _icosphere(checked_count(subdivisions, "subdivisions"))
    radii = np.linspace(0.45, 1.15, count)
    centres = rng.uniform(-0.25, 0.25, (count, 3)) * (1, 0.6, 1)
    vertices = centres[:, None] + radii[:, None, None] * sphere
    faces = triangles + len(sphere) * np.arange(count)[:, None, None]
    colors = _with_alpha(rng.random((count, 3)), alpha).repeat(len(triangles), axis=0)
    eye = (0.34, 0.25, 3.5)
    return _scene(rng, vertices.reshape(-1, 3), faces.reshape(-1, 3), colors, eye, width, height)


def torus_knot(
    seed: int = 0,
    width: int = 1280,
    height: int = 720,
    *,
    windings: tuple[int, int] = (2, 3),
    segments: int = 400,
    sides: int = 32,
    alpha: tuple[float, float] = (0.15, 0.75),
) -> Scene:
    """Wind a tube along a torus knot, its hue running once around: layers that a viewer can follow.

    Parameters
    ----------
    seed : int
        Turns the hue and shuffles the faces.
    width, height : int
        Image size in pixels.
    windings : (int, int)
        Turns around the torus' axis and through its hole; a knot when they share no factor.
    segments, sides : int >= 3
        Points along and around the tube; it has 2 * segments * sides faces.
    alpha : (float, float) in [0, 1]
        Smallest and largest, half a turn apart along the knot.
    """
    rng, segments, sides = _rng(seed), checked_count(segments, "segments"), checked_count(sides, "sides")
    if segments < 3 or sides < 3:
        raise ValueError(f"segments and sides must be at least 3, got {segments} and {sides}")
    turn = np.arange(segments) / segments
    vertices = _tube(_knot(2 * np.pi * turn, windings), sides, radius=0.3)
    faces = _grid_faces(segments, sides)
    hue = 0.5 + 0.5 * np.cos(2 * np.pi * (turn[:, None] + rng.random() + np.array([0, 1 / 3, 2 / 3])))
    lo, hi = array(alpha, "alpha", np.float64, (2,))
    opacity = lo + (hi - lo) * (0.5 - 0.5 * np.cos(2 * np.pi * turn))
    colors = np.column_stack([hue, opacity]).repeat(2 * sides, axis=0)
    return _scene(rng, vertices, faces, colors, (0.6, 1.2, 6.5), width, height)


SCENES: Mapping[str, Callable[..., Scene]] = MappingProxyType(
    {function.__name__: function for function in (squares, soup, shells, smoke, blades, torus_knot)}
)
"""Every procedural scene, by name."""


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(checked_count(seed, "seed"))


def _scene(
    rng: np.random.Generator,
    vertices: Floats,
    faces: NDArray[np.int64],
    face_colors: Floats,
    eye: tuple[float, float, float],
    width: int,
    height: int,
) -> Scene:
    order = rng.permutation(len(faces))
    mesh = Mesh(vertices, faces[order], face_colors=face_colors[order])
    camera = Camera(eye=eye, fov_y=FOV_Y).tightened(vertices)
    return Scene([mesh], camera=camera, width=width, height=height)


def _triangles(
    rng: np.random.Generator, corners: Floats, alpha: float, eye: Any, width: int, height: int
) -> Scene:
    colors = _with_alpha(rng.random((len(corners), 3)), alpha)
    vertices = corners.reshape(-1, 3)
    return _scene(rng, vertices, np.arange(len(vertices)).reshape(-1, 3), colors, eye, width, height)


def _with_alpha(rgb: Floats, alpha: float) -> Floats:
    return np.column_stack([rgb, np.full(len(rgb), scalar(alpha, "alpha"))])


def _quads(centres: Floats, half: Floats, angle: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Squares of half side `half`, turned by `angle` in planes of constant z."""
    corner = angle[:, None] + np.pi / 4 + np.pi / 2 * np.arange(4)
    reach = np.sqrt(2) * half[:, None]
    offsets = np.stack([reach * np.cos(corner), reach * np.sin(corner), np.zeros_like(corner)], axis=-1)
    vertices = (centres[:, None] + offsets).reshape(-1, 3)
    pair = np.array([(0, 1, 2), (0, 2, 3)])
    return vertices, (pair + 4 * np.arange(len(centres))[:, None, None]).reshape(-1, 3)


def _icosphere(subdivisions: int) -> tuple[Floats, NDArray[np.int64]]:
    """Split every face of an icosahedron into four, `subdivisions` times; faces turn outwards."""
    vertices, faces = _icosahedron()
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = (len(vertices) + which).reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        around = np.stack([faces, middle, np.roll(middle, 1, axis=1)], axis=-1).reshape(-1, 3)
        faces = np.concatenate([around, middle])
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def _icosahedron() -> tuple[Floats, NDArray[np.int64]]:
    golden = (1 + 5**0.5) / 2
    rectangle = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    vertices = np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
    distance = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    neighbours = np.abs(distance - 2) < 1e-9
    triples = [t for t in combinations(range(12), 3) if all(neighbours[p] for p in combinations(t, 2))]
    faces = np.array(triples)
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def _knot(turn: Floats, windings: tuple[int, int]) -> Floats:
    around, through = windings
    radius = 1.4 + 0.6 * np.cos(through * turn)
    ring = [radius * np.cos(around * turn), radius * np.sin(around * turn), 0.6 * np.sin(through * turn)]
    return np.stack(ring, axis=-1)


def _tube(path: Floats, sides: int, radius: float) -> Floats:
    """Rings of points around a closed path, each in the plane across it."""
    along = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outward = path - along * np.sum(path * along, axis=1, keepdims=True)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    across = np.cross(along, outward)
    angle = 2 * np.pi * np.arange(sides)[:, None] / sides
    ring = np.cos(angle) * outward[:, None] + np.sin(angle) * across[:, None]
    vertices: Floats = path[:, None] + radius * ring
    return vertices.reshape(-1, 3)


def _grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two triangles per cell of a grid that closes in both directions."""
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    here, right = row * columns + column, row * columns + (column + 1) % columns
    below, diagonal = (row + 1) % rows * columns + column, (row + 1) % rows * columns + (column + 1) % columns
    cells = [(here, diagonal, below), (here, right, diagonal)]
    return np.stack([np.stack(cell, axis=-1) for cell in cells], axis=-2).reshape(-1, 3)
