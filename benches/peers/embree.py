"""Embree through embreex: all hits of a ray per pixel, one hit at a time, blended front to back in NumPy.

embreex traces on one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

STEP = 4e-6
"""How far behind a hit the ray goes on, relative to the eye's distance from the origin (float32 has 6e-8)."""


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    world = EmbreeScene()
    TriangleMesh(world, arrays.vertices, arrays.faces)
    directions = arrays.rays()
    premultiplied = (arrays.face_colors[:, :3] * arrays.face_colors[:, 3:]).astype(float)
    passes_on = 1 - arrays.face_colors[:, 3].astype(float)
    step = STEP * np.linalg.norm(arrays.eye)

    def frame() -> Any:
        image, transmittance = np.zeros((len(directions), 3)), np.ones(len(directions))
        active = np.arange(len(directions))
        distance, previous = np.zeros(len(active)), np.full(len(active), -1)
        while len(active):
            rays = directions[active]
            origins = (arrays.eye + distance[:, None] * rays).astype(np.float32)
            hits = world.run(origins, rays, output=1)
            face, hit = hits["primID"], hits["primID"] >= 0
            active, face, before = active[hit], face[hit], previous[hit]
            distance = distance[hit] + np.maximum(hits["tfar"][hit], 0) + step
            other = face != before
            pixels, seen = active[other], face[other]
            image[pixels] += transmittance[pixels, None] * premultiplied[seen]
            transmittance[pixels] *= passes_on[seen]
            previous = face
        image += transmittance[:, None] * arrays.background
        return image.reshape(arrays.height, arrays.width, 3)

    frame.info = {"version": version("embreex"), "threads": 1}  # type: ignore[attr-defined]
    return frame
