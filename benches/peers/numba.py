"""A plain parallel A-buffer as one writes it with numba: bin to bands of rows, count, fill, sort, blend."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, floor
from typing import Any

import numba
import numpy as np

ROWS = 8
INSERTION_SORT = 48


@numba.njit(inline="always")
def _pixels(low: float, high: float, size: int) -> tuple[int, int]:
    """Range of pixels whose centres lie in [low, high]."""
    return max(0, ceil(low - 0.5)), min(size, floor(high - 0.5) + 1)


@numba.njit(inline="always")
def _edge(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    """Twice the signed area of (a, b, (x, y))."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@numba.njit(inline="always")
def _owns(ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether a pixel centre on the edge a -> b belongs to the triangle (top-left rule)."""
    return by < ay or (by == ay and bx > ax)


@numba.njit
def _draw(points: Any, faces: Any, face: int, y0: int, y1: int, width: int, where: Any, fill: bool,
          depths: Any, owners: Any) -> None:  # fmt: skip
    """Count (or store, with `fill`) the fragments of one triangle between the rows y0 and y1."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ax, ay, bx, by, cx, cy = (
        points[i, 0],
        points[i, 1],
        points[j, 0],
        points[j, 1],
        points[k, 0],
        points[k, 1],
    )
    area = _edge(ax, ay, bx, by, cx, cy)
    if area < 0:
        bx, by, cx, cy, j, k, area = cx, cy, bx, by, k, j, -area
    if area == 0:
        return
    top, bottom = _pixels(min(ay, by, cy), max(ay, by, cy), y1)
    left, right = _pixels(min(ax, bx, cx), max(ax, bx, cx), width)
    own_a, own_b, own_c = _owns(bx, by, cx, cy), _owns(cx, cy, ax, ay), _owns(ax, ay, bx, by)
    for y in range(max(top, y0), bottom):
        for x in range(left, right):
            u = _edge(bx, by, cx, cy, x + 0.5, y + 0.5)
            v = _edge(cx, cy, ax, ay, x + 0.5, y + 0.5)
            w = _edge(ax, ay, bx, by, x + 0.5, y + 0.5)
            if u < 0 or v < 0 or w < 0:
                continue
            if (u == 0 and not own_a) or (v == 0 and not own_b) or (w == 0 and not own_c):
                continue
            pixel = (y - y0) * width + x
            if fill:
                depths[where[pixel]] = (u * points[i, 2] + v * points[j, 2] + w * points[k, 2]) / area
                owners[where[pixel]] = face
            where[pixel] += 1


@numba.njit
def _sort(depths: Any, owners: Any) -> None:
    """Farthest first, that is by rising inverse depth."""
    if len(depths) > INSERTION_SORT:
        order = np.argsort(depths)
        owners[:] = owners[order]
        return
    for i in range(1, len(depths)):
        depth, owner, k = depths[i], owners[i], i
        while k > 0 and depths[k - 1] > depth:
            depths[k], owners[k] = depths[k - 1], owners[k - 1]
            k -= 1
        depths[k], owners[k] = depth, owner


@numba.njit(parallel=True)
def _bin(points: Any, faces: Any, height: int) -> tuple[Any, Any]:
    """Faces of each band of rows, in submission order: offsets and one flat list."""
    bands = (height + ROWS - 1) // ROWS
    spans = np.empty((len(faces), 2), np.int32)
    for f in numba.prange(len(faces)):
        y = points[faces[f, 0], 1], points[faces[f, 1], 1], points[faces[f, 2], 1]
        top, bottom = _pixels(min(y), max(y), height)
        spans[f, 0], spans[f, 1] = top // ROWS, (bottom + ROWS - 1) // ROWS
    offsets = np.zeros(bands + 1, np.int64)
    for f in range(len(faces)):
        for band in range(spans[f, 0], spans[f, 1]):
            offsets[band + 1] += 1
    offsets = np.cumsum(offsets)
    items, cursor = np.empty(offsets[-1], np.int32), offsets.copy()
    for f in range(len(faces)):
        for band in range(spans[f, 0], spans[f, 1]):
            items[cursor[band]] = f
            cursor[band] += 1
    return offsets, items


@numba.njit(parallel=True)
def _render(points: Any, faces: Any, rgba: Any, background: Any, width: int, height: int) -> Any:
    offsets, items = _bin(points, faces, height)
    image = np.empty((height, width, 3))
    for band in numba.prange(len(offsets) - 1):
        y0, y1 = band * ROWS, min(height, (band + 1) * ROWS)
        mine = items[offsets[band] : offsets[band + 1]]
        count = np.zeros((y1 - y0) * width + 1, np.int64)
        nothing, nobody = np.empty(0), np.empty(0, np.int32)
        for f in mine:
            _draw(points, faces, f, y0, y1, width, count[1:], False, nothing, nobody)
        start = np.cumsum(count)
        depths, owners, cursor = np.empty(start[-1]), np.empty(start[-1], np.int32), start[:-1].copy()
        for f in mine:
            _draw(points, faces, f, y0, y1, width, cursor, True, depths, owners)
        for pixel in range((y1 - y0) * width):
            one, end = start[pixel], start[pixel + 1]
            _sort(depths[one:end], owners[one:end])
            r, g, b = background
            for f in owners[one:end]:
                alpha = rgba[f, 3]
                r += alpha * (rgba[f, 0] - r)
                g += alpha * (rgba[f, 1] - g)
                b += alpha * (rgba[f, 2] - b)
            here = image[y0 + pixel // width, pixel % width]
            here[0], here[1], here[2] = r, g, b
    return image


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    rgba = arrays.face_colors.astype(float)
    background = tuple(arrays.background.tolist())

    def frame() -> Any:
        return _render(arrays.on_screen(), arrays.faces, rgba, background, arrays.width, arrays.height)

    frame.info = {"version": numba.__version__, "threads": numba.get_num_threads()}  # type: ignore[attr-defined]
    return frame
