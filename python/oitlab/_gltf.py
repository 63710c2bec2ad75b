"""What trimesh loses of a glTF file: exact material factors, states it rounds, features it drops silently.

`prepare` reads the JSON of a .gltf or .glb file itself, takes the materials out of it, refuses what would
come out of trimesh silently wrong, and gives trimesh a simplified copy: geometry and nodes only, every
primitive with a material whose *name* is an index into our list.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

from ._material import Material
from .mesh import AlphaMode

Json = dict[str, Any]

MODES = ("points", "lines", "line loop", "line strip", "triangles", "triangle strip", "triangle fan")
UNREAD_MODES = (2, 3, 6)
"""Modes that trimesh passes over without a word."""
DRACO = "KHR_draco_mesh_compression"
HARMLESS_REQUIREMENTS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
    DRACO,
)
ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}
MAX_ITEMS_WITHOUT_DATA = 1 << 28


@dataclass(frozen=True)
class Prepared:
    """A simplified file for trimesh, and what was taken out of it."""

    data: bytes
    materials: list[Material]
    uses_draco: bool
    ignored: list[str] = field(default_factory=list)
    """Primitives that will not be drawn, in words."""


def prepare(data: bytes, *, binary: bool) -> Prepared:
    """Simplify one glTF (or, binary, GLB) file; ValueError or OSError says what is wrong with it."""
    text, rest = _split_glb(data) if binary else (data, b"")
    header = json.loads(text)
    if not isinstance(header, dict):
        raise ValueError("its JSON is not an object")
    _check_version(header)
    _check_requirements(header)
    _check_nodes(header)
    _check_views(header)
    primitives = list(_primitives(header))
    for where, primitive in primitives:
        _check_accessors(header, where, primitive)
    materials = [_material(raw, index) for index, raw in enumerate(header.get("materials", []))]
    materials.append(Material(name="no material", color=(1.0, 1.0, 1.0, 1.0)))
    _simplify(header, primitives, len(materials))
    simplified = json.dumps(header).encode()
    return Prepared(
        _join_glb(simplified, rest) if binary else simplified,
        materials,
        any(DRACO in primitive.get("extensions", {}) for _, primitive in primitives),
        [
            f"{where} ({MODES[primitive['mode']]})"
            for where, primitive in primitives
            if primitive.get("mode") in UNREAD_MODES
        ],
    )


def _split_glb(data: bytes) -> tuple[bytes, bytes]:
    """Split a GLB file into its JSON text and all bytes after that chunk."""
    if data[:4] != b"glTF":
        raise ValueError("it does not start with the GLB magic number")
    if len(data) < 20:
        raise OSError(f"truncated: {len(data)} bytes cannot hold a GLB header and its JSON chunk")
    version, length, json_length, kind = struct.unpack_from("<III4s", data, 4)
    if version != 2:
        raise ValueError(f"GLB version {version} is not supported, only 2")
    if kind != b"JSON":
        raise ValueError("its first chunk is not JSON")
    if length > len(data):
        raise OSError(f"truncated: the header announces {length} bytes, the file has {len(data)}")
    _check_chunks(data[:length])
    return data[20 : 20 + json_length], data[20 + json_length : length]


def _check_chunks(data: bytes) -> None:
    start = 12
    while start < len(data):
        if start + 8 > len(data):
            raise OSError(f"truncated: a chunk header at byte {start} is cut short")
        (length,) = struct.unpack_from("<I", data, start)
        start += 8 + length
        if start > len(data):
            raise OSError(f"truncated: a chunk of {length} bytes ends at byte {start} of {len(data)}")


def _join_glb(text: bytes, rest: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def _check_version(header: Json) -> None:
    version = str(header.get("asset", {}).get("version", "2.0"))
    if version.split(".")[0] != "2":
        raise ValueError(f"glTF version {version} is not supported, only 2")


def _check_requirements(header: Json) -> None:
    required = header.get("extensionsRequired", [])
    unknown = [name for name in required if not name.startswith(HARMLESS_REQUIREMENTS)]
    if unknown:
        raise ValueError(f"it requires the glTF extensions {', '.join(unknown)}, which are not supported")
    if DRACO in required and find_spec("DracoPy") is None:
        raise ValueError("it is Draco-compressed; reading it needs `pip install oitlab[draco]`")


def _check_nodes(header: Json) -> None:
    """Refuse node graphs that are no forest: a cycle would never end, a second parent would get lost."""
    nodes, scenes = header.get("nodes", []), header.get("scenes", [])
    if not scenes:
        return
    waiting = list(scenes[_index(header.get("scene", 0), scenes, "the file", "scene")].get("nodes", []))
    seen: set[int] = set()
    while waiting:
        index = _index(waiting.pop(), nodes, "the scene", "node")
        if index in seen:
            raise ValueError(f"node {index} is reached twice; glTF nodes must form a tree")
        seen.add(index)
        waiting.extend(nodes[index].get("children", []))


def _check_views(header: Json) -> None:
    buffers, views = header.get("buffers", []), header.get("bufferViews", [])
    for number, view in enumerate(views):
        where = f"buffer view {number}"
        buffer = buffers[_index(view["buffer"], buffers, where, "buffer")]
        end = _size(view, "byteOffset", where) + _size(view, "byteLength", where)
        if end > _size(buffer, "byteLength", f"the buffer of {where}"):
            raise ValueError(f"{where} ends at byte {end} of {buffer['byteLength']}")
    for number, accessor in enumerate(header.get("accessors", [])):
        _size(accessor, "count", f"accessor {number}")
        _size(accessor, "byteOffset", f"accessor {number}")
        if "bufferView" in accessor:
            _index(accessor["bufferView"], views, f"accessor {number}", "buffer view")


def _size(entry: Json, key: str, where: str) -> int:
    value = entry.get(key, 0)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{where}: {key} must be a whole number, got {value!r}")
    return value


def _primitives(header: Json) -> Iterator[tuple[str, Json]]:
    for index, mesh in enumerate(header.get("meshes", [])):
        for number, primitive in enumerate(mesh["primitives"]):
            yield f"primitive {number} of mesh {mesh.get('name', index)!r}", primitive


def _check_accessors(header: Json, where: str, primitive: Json) -> None:
    accessors = header.get("accessors", [])
    used = dict(primitive["attributes"])
    if "indices" in primitive:
        used["indices"] = primitive["indices"]
    for name, index in used.items():
        if name not in ("POSITION", "COLOR_0", "indices"):
            continue
        accessor = accessors[_index(index, accessors, where, "accessor")]
        if "sparse" in accessor:
            raise ValueError(f"{where}: {name} is a sparse accessor, which is not supported")
        if name == "POSITION" and accessor.get("normalized"):
            raise ValueError(f"{where}: normalized integer positions are not supported")
        if "bufferView" not in accessor and accessor["count"] > MAX_ITEMS_WITHOUT_DATA:
            raise ValueError(f"{where}: {name} announces {accessor['count']} items and has no data")


def _simplify(header: Json, primitives: list[tuple[str, Json]], materials: int) -> None:
    default = materials - 1
    for where, primitive in primitives:
        given = primitive.get("material", default)
        primitive["material"] = _index(given, range(materials), where, "material")
    for node in header.get("nodes", []):
        node.pop("camera", None)
    for key in ("textures", "images", "samplers", "cameras"):
        header.pop(key, None)
    header["materials"] = [{"name": str(index)} for index in range(materials)]


def _index(value: Any, sequence: Any, where: str, what: str) -> int:
    if not isinstance(value, int) or not 0 <= value < len(sequence):
        raise ValueError(f"{where} refers to {what} {value!r}, but there are {len(sequence)}")
    return value


def _material(raw: Json, index: int) -> Material:
    pbr, extensions = raw.get("pbrMetallicRoughness", {}), raw.get("extensions", {})
    factor, texture = pbr.get("baseColorFactor"), "baseColorTexture" in pbr
    glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
    if glossy is not None and not pbr:
        factor, texture = glossy.get("diffuseFactor"), "diffuseTexture" in glossy
    glowing_texture = "emissiveTexture" in raw
    emission = [0.0, 0.0, 0.0] if glowing_texture else raw.get("emissiveFactor", [0.0, 0.0, 0.0])
    strength = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    red, green, blue, alpha = [1.0, 1.0, 1.0, 1.0] if factor is None else map(float, factor)
    mode = raw.get("alphaMode", "OPAQUE")
    if mode not in ALPHA_MODES:
        raise ValueError(f"material {raw.get('name', index)!r} has the unknown alphaMode {mode!r}")
    glow = [float(value) * float(strength) for value in emission]
    return Material(
        name=str(raw.get("name", f"material {index}")),
        color=(red, green, blue, alpha),
        alpha_mode=ALPHA_MODES[mode],
        alpha_cutoff=float(raw.get("alphaCutoff", 0.5)),
        emission=(glow[0], glow[1], glow[2]),
        double_sided=raw.get("doubleSided", True) is not False,
        unlit="KHR_materials_unlit" in extensions,
        textured=texture or glowing_texture,
    )
