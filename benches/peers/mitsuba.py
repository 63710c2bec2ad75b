"""Mitsuba 3 on the CPU (llvm_ad_rgb): a Dr.Jit loop that follows every ray through all its hits.

`Scene.ray_intersect_preliminary` calls Embree and leaves out the surface details that nobody needs here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

STEP = 4e-6
"""As in the Embree adapter."""

mi.set_variant("llvm_ad_rgb")


def _world(arrays: Any) -> Any:
    mesh = mi.Mesh("mesh", vertex_count=len(arrays.vertices), face_count=len(arrays.faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(arrays.vertices.ravel())
    parameters["faces"] = mi.UInt32(arrays.faces.astype(np.uint32).ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    world = _world(arrays)
    directions = _columns(arrays.rays())
    eye = mi.Point3f(*arrays.eye.tolist())
    rgba = mi.Float(arrays.face_colors.ravel())
    background = mi.Color3f(*arrays.background.tolist())
    step = STEP * float(np.linalg.norm(arrays.eye))

    def advance(active: Any, distance: Any, previous: Any, color: Any, transmittance: Any) -> Any:
        ray = mi.Ray3f(eye + distance * directions, directions)
        hit = world.ray_intersect_preliminary(ray, coherent=True, active=active)
        active = active & hit.is_valid()
        other = active & (hit.prim_index != previous)
        surface = dr.gather(mi.Vector4f, rgba, hit.prim_index, other)
        share = dr.select(other, surface.w, 0)
        color = color + transmittance * share * mi.Color3f(surface.x, surface.y, surface.z)
        distance = dr.select(active, distance + hit.t + step, distance)
        return active, distance, hit.prim_index, color, transmittance * (1 - share)

    def frame() -> Any:
        count = arrays.width * arrays.height
        start = (
            dr.full(mi.Bool, True, count),
            mi.Float(0),
            mi.UInt32(0xFFFFFFFF),
            mi.Color3f(0),
            mi.Float(1),
        )
        *_, color, transmittance = dr.while_loop(start, lambda active, *_: active, advance)
        image = np.array(color + transmittance * background)
        return image.T.reshape(arrays.height, arrays.width, 3)

    frame.info = {"version": mi.__version__, "threads": dr.thread_count()}  # type: ignore[attr-defined]
    return frame


def _columns(rays: Any) -> Any:
    return mi.Vector3f(*(mi.Float(np.ascontiguousarray(rays[:, i])) for i in range(3)))
