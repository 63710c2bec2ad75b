"""pygfx on WebGPU (Mesa's lavapipe where there is no GPU), unlit, no anti-aliasing, 8-bit sRGB target.

pygfx blends in linear light; its target's sRGB encoding is undone outside the measured time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pygfx
from rendercanvas.offscreen import RenderCanvas


class ExactCamera(pygfx.PerspectiveCamera):
    """The scene's own frustum, whatever pygfx makes of its field of view."""

    def __init__(self, arrays: Any) -> None:
        # pygfx spreads `fov` over the mean of width and height
        half_height = np.tan(np.radians(arrays.fov_y) / 2)
        half_mean = half_height * (1 + arrays.width / arrays.height) / 2
        super().__init__(
            fov=2 * np.degrees(np.arctan(half_mean)),
            aspect=arrays.width / arrays.height,
            depth_range=(arrays.near, arrays.far),
        )
        self.local.position = arrays.eye
        self.local.reference_up = arrays.up
        self.look_at(arrays.target)


def _encoded(linear: Any) -> Any:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _decoded(image: Any) -> Any:
    code = np.arange(256) / 255
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)[image[..., :3]]


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    vertices, faces, colors = arrays.for_gpu()
    canvas = RenderCanvas(size=(arrays.width, arrays.height), pixel_ratio=1)
    renderer = pygfx.WgpuRenderer(canvas, pixel_ratio=1, pixel_filter="nearest", ppaa="none")
    material = pygfx.MeshBasicMaterial(color_mode="vertex", alpha_mode=mode, side="both")
    geometry = pygfx.Geometry(positions=vertices, indices=faces, colors=colors)
    world = pygfx.Scene()
    world.add(pygfx.Background.from_color(tuple(_encoded(arrays.background))), pygfx.Mesh(geometry, material))
    camera = ExactCamera(arrays)
    canvas.request_draw(lambda: renderer.render(world, camera))

    def frame() -> Any:
        return np.asarray(canvas.draw())

    frame.decode = _decoded  # type: ignore[attr-defined]
    frame.info = {"version": pygfx.__version__, "renderer": renderer.device.adapter.info["device"]}  # type: ignore[attr-defined]
    return frame
