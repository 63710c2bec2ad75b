"""What trimesh stumbles over in simple formats: text that is not UTF-8, and files that are cut short."""

from __future__ import annotations

import struct

PLY_HEADER_END = b"end_header"
STL_HEADER = 84
STL_FACE = 50


def as_utf8(data: bytes) -> bytes:
    """Re-encode old text (names and comments in Latin-1); UTF-8 stays as it is."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def ply(data: bytes) -> bytes:
    """Re-encode the header; the rest may be binary."""
    head, mark, body = data.partition(PLY_HEADER_END)
    return as_utf8(head) + mark + body if mark else data


def stl(data: bytes) -> bytes:
    """Re-encode the text form; refuse a binary file with fewer faces than it announces."""
    faces = struct.unpack_from("<I", data, STL_HEADER - 4)[0] if len(data) >= STL_HEADER else 0
    if len(data) == STL_HEADER + faces * STL_FACE:
        return data
    if data.lstrip()[:5].lower() == b"solid":
        return as_utf8(data)
    if len(data) < STL_HEADER + faces * STL_FACE:
        raise OSError(f"truncated: {faces} faces are announced, {len(data)} bytes hold fewer")
    return data


def off(data: bytes) -> bytes:
    """Refuse a file with fewer lines than it announces, or a face with fewer corners than it announces."""
    rows = [line.split(b"#")[0].split() for line in data.splitlines()]
    rows = [row for row in rows if row]
    if rows and rows[0][0].upper() in (b"OFF", b"COFF"):
        rows[0] = rows[0][1:]
    rows = [row for row in rows if row]
    if not rows or len(rows[0]) < 2:
        raise ValueError("it does not announce its vertices and faces")
    vertices, faces = int(rows[0][0]), int(rows[0][1])
    if len(rows) < 1 + vertices + faces:
        raise OSError(
            f"truncated: {vertices} vertices and {faces} faces are announced in {len(rows) - 1} lines"
        )
    for index, row in enumerate(rows[1 + vertices : 1 + vertices + faces]):
        if len(row) <= int(row[0]):
            raise OSError(f"truncated: face {index} announces {int(row[0])} corners and has {len(row) - 1}")
    return as_utf8(data)
