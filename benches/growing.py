"""Scenes that grow: in one image, whose pixels get deeper, or with it, so that pixels stay as they are."""

from __future__ import annotations

import numpy as np
from harness import Run

import oitlab

HALF_SIDE = 0.0042
"""Standard deviation of a tiny triangle's corners: some seven fragments each at 720 rows."""
DEPTH, SIDE, ROWS_PER_COLUMN = 24, 32, 9 / 16
"""Fragments of a pixel, pixels of a square's side and the shape of an image that grows with the scene."""


def smoke_of(fragments: float, run: Run) -> oitlab.Scene:
    """Smoke with about that many fragments: first one with few quads tells how many there are per quad."""
    trial = oitlab.scenes.smoke(**run.size, count=100)
    per_quad = oitlab.render(trial, "wboit").stats.fragments / 100
    return oitlab.scenes.smoke(**run.size, count=max(1, round(fragments / per_quad)))


def fog_of(fragments: float, _: Run) -> oitlab.Scene:
    """Faint squares of `SIDE` pixels that face the camera, in an image whose pixels are `DEPTH` deep."""
    width, height = sides(fragments / DEPTH)
    # a unit is a pixel; some squares are half outside, or pixels near the image's edge would have fewer
    field = np.array([width + SIDE, height + SIDE, height])
    rng, count = np.random.default_rng(0), round(DEPTH * field[0] * field[1] / SIDE**2)
    centres = (rng.random((count, 3)) - 0.5) * field
    angles = rng.uniform(0, np.pi / 2, (count, 1)) + np.arange(4) * np.pi / 2
    corners = SIDE / np.sqrt(2) * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=2)
    vertices = (centres[:, None] + corners).reshape(-1, 3)
    faces = (4 * np.arange(count)[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    colors = np.column_stack([rng.random((count, 3)), rng.uniform(0.05, 0.2, count)]).repeat(2, axis=0)
    camera = oitlab.Camera(eye=(0, 0, height), ortho_height=height).tightened(vertices)
    mesh = oitlab.Mesh(vertices, faces, face_colors=colors)
    return oitlab.Scene([mesh], camera=camera, width=width, height=height)


def dust_of(triangles: float, run: Run) -> oitlab.Scene:
    """Triangles of a few pixels in random order: their set-up matters more than their fragments."""
    return dust(round(triangles), HALF_SIDE, **run.size)


def haze_of(triangles: float, _: Run) -> oitlab.Scene:
    """Dust of the same few pixels each, in an image with as many pixels as triangles."""
    width, height = sides(triangles)
    return dust(round(triangles), HALF_SIDE * 720 / height, width, height)


def dust(count: int, half_side: float, width: int, height: int) -> oitlab.Scene:
    """Tiny triangles strewn through a cube."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-0.5, 0.5, (count, 1, 3)) + rng.normal(0, half_side, (count, 3, 3))
    colors = np.column_stack([rng.random((count, 3)), np.full(count, 0.3)])
    vertices = corners.reshape(-1, 3)
    mesh = oitlab.Mesh(vertices, np.arange(3 * count).reshape(-1, 3), face_colors=colors)
    camera = oitlab.Camera(eye=(0.78, 0.61, 1.22), fov_y=40.0).tightened(vertices)
    return oitlab.Scene([mesh], camera=camera, width=width, height=height)


def sides(pixels: float) -> tuple[int, int]:
    """Width and height of an image with about so many pixels."""
    height = max(1, round((pixels * ROWS_PER_COLUMN) ** 0.5))
    return round(height / ROWS_PER_COLUMN), height
