"""oitlab itself: whole calls from Python to NumPy array, default params, all cores."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import oitlab


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    mesh = oitlab.Mesh(arrays.vertices, arrays.faces, face_colors=arrays.face_colors)
    camera = oitlab.Camera(
        eye=arrays.eye,
        target=arrays.target,
        up=arrays.up,
        fov_y=arrays.fov_y,
        near=arrays.near,
        far=arrays.far,
    )
    scene = oitlab.Scene(
        [mesh], camera=camera, width=arrays.width, height=arrays.height, background=arrays.background
    )

    def frame() -> Any:
        result = oitlab.render(scene, mode)
        if not frame.info:  # type: ignore[attr-defined]
            stats = result.stats
            frame.info = {"fragments": stats.fragments, "threads": stats.threads}  # type: ignore[attr-defined]
        return result.color

    frame.info = {}  # type: ignore[attr-defined]
    return frame
