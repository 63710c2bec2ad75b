"""What trimesh passes over silently in OBJ files: numbers that are not finite, index 0, relative indices."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ._formats import as_utf8

NOT_FINITE = re.compile(rb"^[ \t]*v[ \t][^\n]*\b(?:nan|inf)", re.MULTILINE | re.IGNORECASE)
ZERO_OR_RELATIVE = re.compile(rb"^[ \t]*f[ \t](?:[^\n]*[ \t/])?(?:-|0+(?![0-9]))", re.MULTILINE)
LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE)


def prepare(data: bytes) -> bytes:
    """Refuse numbers that are not finite, and make relative face indices absolute.

    A relative index counts from the last element before its line; trimesh counts from the end of the file.
    """
    data = as_utf8(data)
    bad = NOT_FINITE.search(data)
    if bad:
        line = data.count(b"\n", 0, bad.end()) + 1
        raise ValueError(f"line {line} has a vertex that is not finite")
    if not ZERO_OR_RELATIVE.search(data):
        return data
    lines = data.replace(b"\\\n", b" ").split(b"\n")
    for line, corners in _absolute_faces(lines):
        lines[line] = b"f " + b" ".join(corners)
    return b"\n".join(lines)


def explain(data: bytes) -> None:
    """Raise the ValueError that says which face refers to what is not there, if one does."""
    vertices = len(re.findall(rb"^[ \t]*v[ \t]", data, re.MULTILINE))
    lines = data.replace(b"\\\n", b" ").split(b"\n")
    for face, (line, corners) in enumerate(_absolute_faces(lines)):
        for corner in corners:
            index = int(corner.split(b"/")[0])
            if not 1 <= index <= vertices:
                where = f"line {line + 1}: face {face}"
                raise ValueError(f"{where} refers to vertex {index}, but there are {vertices} vertices")


def missing_libraries(path: Path, data: bytes) -> list[str]:
    """Name the material files that are not beside the OBJ file."""
    names = [match.decode(errors="replace") for match in LIBRARY.findall(data)]
    return [f"material library {name!r} (not found)" for name in names if not (path.parent / name).is_file()]


def _absolute_faces(lines: list[bytes]) -> Iterator[tuple[int, list[bytes]]]:
    """Line numbers from 0 of all faces, and their corners v/vt/vn with absolute indices."""
    seen = {b"v": 0, b"vt": 0, b"vn": 0}
    for number, line in enumerate(lines):
        words = line.split(b"#")[0].split()
        if not words:
            continue
        if words[0] in seen:
            seen[words[0]] += 1
        elif words[0] == b"f":
            counts = list(seen.values())
            yield number, [_absolute(word, counts, number + 1) for word in words[1:]]


def _absolute(corner: bytes, counts: list[int], line: int) -> bytes:
    parts = corner.split(b"/")
    for place, part in enumerate(parts[:3]):
        if not part:
            continue
        index = int(part)
        if index == 0 or index < -counts[place]:
            what = ("vertex", "texture coordinate", "normal")[place]
            raise ValueError(f"line {line}: a face refers to {what} {index} of {counts[place]}")
        parts[place] = b"%d" % (index if index > 0 else counts[place] + 1 + index)
    return b"/".join(parts)
