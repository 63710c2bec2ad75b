"""Tiny glTF files made by hand, for tests of the loader."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

TRIANGLE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=np.float32)
COMPONENT = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}


def accessor(header: dict[str, Any], blob: bytearray, values: np.ndarray, **extra: Any) -> int:
    """Append an array; returns its accessor's index."""
    blob.extend(b"\0" * (-len(blob) % 4))
    view = {"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes}
    blob.extend(values.tobytes())
    header["bufferViews"].append(view)
    shape = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1] if values.ndim == 2 else 1]
    kind = COMPONENT[values.dtype.str[1:]]
    entry = {"bufferView": len(header["bufferViews"]) - 1, "componentType": kind, "count": len(values)}
    header["accessors"].append({**entry, "type": shape, **extra})
    return len(header["accessors"]) - 1


def document(
    *,
    material: dict[str, Any] | None = None,
    colors: np.ndarray | None = None,
    vertices: np.ndarray = TRIANGLE,
    faces: tuple[int, ...] = (0, 1, 2),
    nodes: list[dict[str, Any]] | None = None,
    **extra: Any,
) -> tuple[dict[str, Any], bytes]:
    """One mesh, one primitive; its nodes default to one without transform."""
    header: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}
    blob = bytearray()
    attributes = {"POSITION": accessor(header, blob, vertices)}
    if colors is not None:
        attributes["COLOR_0"] = accessor(header, blob, colors, normalized=colors.dtype.kind == "u")
    primitive: dict[str, Any] = {"attributes": attributes}
    primitive["indices"] = accessor(header, blob, np.array(faces, dtype=np.uint32))
    if material is not None:
        primitive["material"] = 0
        header["materials"] = [material]
    header["meshes"] = [{"name": "thing", "primitives": [primitive]}]
    header["nodes"] = nodes or [{"mesh": 0}]
    header["scenes"] = [{"nodes": [0]}]
    header["buffers"] = [{"byteLength": len(blob)}]
    return {**header, **extra}, bytes(blob)


def write_gltf(path: Path, header: dict[str, Any], blob: bytes) -> Path:
    """JSON with the buffer inside."""
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    path.write_text(json.dumps({**header, "buffers": [{"byteLength": len(blob), "uri": uri}]}))
    return path


def write_glb(path: Path, header: dict[str, Any], blob: bytes) -> Path:
    """The binary form."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path
