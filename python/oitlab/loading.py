"""Scenes from files."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _formats, _gltf, _obj
from ._convert import count
from ._material import Material, bytes_to_linear, from_trimesh
from .camera import Camera
from .mesh import Mesh
from .scene import DEFAULT_BACKGROUND, Scene

PREPARE: Mapping[str, Callable[[bytes], bytes]] = {
    ".obj": _obj.prepare,
    ".off": _formats.off,
    ".ply": _formats.ply,
    ".stl": _formats.stl,
}
"""What is done to a file's bytes before trimesh sees them."""


class LoadWarning(UserWarning):
    """Something in a file is not drawn, or not drawn as its author meant."""


class TextureWarning(LoadWarning):
    """Materials whose textures are not read: only their factors are used."""


def load(
    path: str | os.PathLike[str],
    opacity: float | None = None,
    *,
    camera: Camera | None = None,
    width: int = 1280,
    height: int = 720,
    background: ArrayLike = DEFAULT_BACKGROUND,
    shading: Literal["lambert", "unlit"] = "lambert",
) -> Scene:
    r"""Read a scene from a mesh file: glTF, GLB, OBJ, PLY, STL, OFF and whatever else trimesh reads.

    Every placement of the file's scene graph becomes one mesh, its transform applied to the vertices (and
    its winding turned where the transform mirrors). A file without geometry gives a scene without meshes.

    *Colours.* glTF factors are linear and taken exactly as written, times COLOR_0, which is linear too. All
    other colours (vertex and face colours of PLY, OBJ, OFF; `Kd` of MTL) are taken as sRGB-encoded, as is
    their habit, and decoded; alpha is linear everywhere. What has no colour is grey (0.6), in glTF white.
    Textures are not read: their factor is used alone, except that a surface with an emissive texture does not
    glow.

    *Transparency.* glTF's `alphaMode` and `alphaCutoff` are kept. MTL gives alpha by `d`, or by `Tr` = 1 - d.
    In formats without a mode, a mesh blends when any of its alphas is below 1 and is opaque otherwise.

    *Sides.* A glTF material that states `doubleSided: false` hides its back faces; all else shows both.

    Parameters
    ----------
    path : str or path
        Its suffix says what kind of file it is.
    opacity : float in [0, 1], optional
        Replaces every alpha and makes every material blend, after mask tests have run.
    camera : Camera, optional
        Frames the whole model with tight clip planes when absent.
    width, height : int >= 1
        Image size in pixels.
    background : (3,) floats
        Linear RGB.
    shading : {"lambert", "unlit"}
        Of every material, except those that glTF calls unlit.

    Raises
    ------
    OSError
        The file is missing, cannot be opened, or is cut short.
    ValueError
        The file cannot be understood; a face refers to a vertex that is not there; numbers are not finite.
        The message names the file, the geometry and the reason.

    Warns
    -----
    TextureWarning
        Once per call, naming the materials whose textures are not read.
    LoadWarning
        Once per call, naming points, lines and other contents that are not drawn.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.obj"
    >>> _ = path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    >>> load(path, opacity=0.35, width=64, height=36)
    Scene(1 meshes, 1 faces, 64 x 36)
    """
    file = Path(path)
    size = count(width, "width"), count(height, "height")
    model = _read(file)
    meshes = [_mesh(file, part, opacity, shading) for part in _parts(file, model)]
    if model.ignored:
        warnings.warn(f"{file}: passed over: {', '.join(model.ignored)}", LoadWarning, stacklevel=2)
    if model.textured:
        message = (
            f"{file}: textures are not read yet; only the factors are used of: {', '.join(model.textured)}"
        )
        warnings.warn(message, TextureWarning, stacklevel=2)
    if camera is None:
        camera = _framing(file, meshes, max(size[0], 1) / max(size[1], 1))
    return Scene(meshes, camera=camera, width=width, height=height, background=background)


@dataclass
class _Model:
    """A file as trimesh read it, and what became of its contents."""

    scene: Any
    gltf: _gltf.Prepared | None
    ignored: list[str]
    textured: list[str]

    def material_of(self, visual: Any) -> Material:
        material = getattr(visual, "material", None)
        if material is None:
            return Material(name="no material")
        if self.gltf is not None:
            return self.gltf.materials[int(material.name)]
        return from_trimesh(material)


@dataclass(frozen=True)
class _Part:
    """One placement of one geometry, in world space."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material
    domain: Literal["mesh", "vertex", "face"]
    colors: NDArray[np.float64]


def _read(file: Path) -> _Model:
    data = file.read_bytes()
    kind = file.suffix.lower()
    try:
        prepared = _gltf.prepare(data, binary=kind == ".glb") if kind in (".gltf", ".glb") else None
        if prepared is not None:
            data = prepared.data
        elif kind in PREPARE:
            data = PREPARE[kind](data)
        scene = _trimesh_scene(file, data)
    except OSError as error:
        raise OSError(f"cannot read {file}: {_reason(error)}") from error
    except Exception as error:
        raise ValueError(f"cannot read {file}: {_reason(error)}") from error
    passed_over = prepared.ignored if prepared is not None else []
    if kind == ".obj":
        passed_over = _obj.missing_libraries(file, data)
    return _Model(scene, prepared, passed_over, [])


def _trimesh_scene(file: Path, data: bytes) -> Any:
    import trimesh

    class Resolver(trimesh.resolvers.FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            data: bytes = super().get(name)
            return _formats.as_utf8(data) if name.lower().endswith(".mtl") else data

    kind = trimesh.util.split_extension(str(file), special=["tar.gz", "tar.bz2"]).lower()
    resolver = Resolver(str(file.absolute()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message="string or file could not be read to its end")
        try:
            return trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=resolver, process=False)
        except IndexError:
            if kind == "obj":
                _obj.explain(data)
            raise


def _reason(error: Exception) -> str:
    """Give an error's message; its kind too, where the message means little without it."""
    text = str(error) or "no reason given"
    plain = isinstance(error, ValueError | OSError | NotImplementedError)
    return text if plain and str(error) else f"{type(error).__name__}: {text}"


def _parts(file: Path, model: _Model) -> Iterator[_Part]:
    """Every placement of every triangle mesh; notes what is passed over in `model`."""
    import trimesh

    drawable = {}
    for name, geometry in model.scene.geometry.items():
        if not isinstance(geometry, trimesh.Trimesh):
            model.ignored.append(f"{name!r} ({type(geometry).__name__})")
            continue
        drawable[name] = _local_part(file, model, name, geometry)
    placed = set()
    for node in model.scene.graph.nodes_geometry:
        matrix, name = model.scene.graph[node]
        if name in drawable:
            placed.add(name)
            if not np.isfinite(matrix).all():
                raise ValueError(f"{file}: geometry {name!r} is placed by a transform that is not finite")
            yield _placed(drawable[name], np.asarray(matrix, dtype=np.float64))
    model.ignored.extend(f"{name!r} (in no scene)" for name in drawable if name not in placed)


def _local_part(file: Path, model: _Model, name: str, geometry: Any) -> _Part:
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"{file}: geometry {name!r}: vertices have {vertices.shape[-1]} coordinates, not 3")
    faces = np.asarray(geometry.faces, dtype=np.int64).reshape(-1, 3)
    _check_indices(file, name, faces, len(vertices))
    if model.gltf is not None and model.gltf.uses_draco and len(vertices) and not vertices.any():
        raise ValueError(f"cannot read {file}: geometry {name!r}: its Draco data could not be decoded")
    try:
        material = model.material_of(geometry.visual)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if material.textured and material.name not in model.textured:
        model.textured.append(material.name)
    domain, colors, material = _colors(geometry.visual, material, len(vertices))
    return _Part(name, vertices, faces, material, domain, colors)


def _check_indices(file: Path, name: str, faces: NDArray[np.int64], vertices: int) -> None:
    wrong = np.argwhere((faces < 0) | (faces >= vertices))
    if len(wrong):
        face, corner = wrong[0]
        raise ValueError(
            f"{file}: geometry {name!r}: face {face} refers to vertex {faces[face, corner]}, "
            f"but there are {vertices} vertices"
        )


def _colors(
    visual: Any, material: Material, vertices: int
) -> tuple[Literal["mesh", "vertex", "face"], NDArray[np.float64], Material]:
    """Straight linear RGBA, what it belongs to, and the material with the alpha mode that follows from it."""
    attribute = getattr(visual, "vertex_attributes", {}).get("color")
    if attribute is not None and len(attribute) == vertices:
        return "vertex", np.array(material.color) * _color_attribute(attribute), material
    if visual.kind not in ("vertex", "face"):
        return "mesh", np.array(material.color), material
    domain: Literal["vertex", "face"] = visual.kind
    colors = bytes_to_linear(visual.vertex_colors if domain == "vertex" else visual.face_colors)
    mode: Literal["opaque", "blend"] = "blend" if (colors[:, 3] < 1).any() else "opaque"
    return domain, colors, Material(name=material.name, alpha_mode=mode)


def _color_attribute(values: NDArray[Any]) -> NDArray[np.float64]:
    """Turn COLOR_0 into (V, 4) floats: integers are normalised, a missing alpha is 1."""
    scale = np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 1.0
    colors = np.ones((len(values), 4))
    colors[:, : values.shape[1]] = values / scale
    return colors


def _placed(part: _Part, matrix: NDArray[np.float64]) -> _Part:
    vertices = part.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    mirrors = np.linalg.det(matrix[:3, :3]) < 0
    faces = part.faces[:, ::-1] if mirrors else part.faces
    return _Part(part.name, vertices, faces, part.material, part.domain, part.colors)


def _mesh(file: Path, part: _Part, opacity: float | None, shading: Literal["lambert", "unlit"]) -> Mesh:
    material = part.material
    keyword = {"mesh": "color", "vertex": "vertex_colors", "face": "face_colors"}[part.domain]
    keywords: dict[str, Any] = {keyword: part.colors}
    try:
        return Mesh(
            part.vertices,
            part.faces,
            alpha_mode=material.alpha_mode,
            alpha_cutoff=material.alpha_cutoff,
            shading="unlit" if material.unlit else shading,
            emission=material.emission,
            double_sided=material.double_sided,
            opacity=opacity,
            **keywords,
        )
    except ValueError as error:
        raise ValueError(f"{file}: geometry {part.name!r}: {error}") from error


def _framing(file: Path, meshes: list[Mesh], aspect: float) -> Camera:
    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes if len(mesh.faces)]
    if not used:
        return Camera()
    points = np.concatenate(used)
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    try:
        return Camera.framing(bounds, aspect=aspect, points=points)
    except ValueError as error:
        raise ValueError(f"{file}: no camera can frame it: {error}") from error
