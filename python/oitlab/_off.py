"""What trimesh passes over silently in OFF files: faces that are cut short."""

from __future__ import annotations


def check(data: bytes) -> None:
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
