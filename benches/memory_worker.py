"""Render grey smoke by one technique, in a process of its own; print what it took as a JSON object.

python benches/memory_worker.py a_buffer facing --width 1280 --height 720 --quads 5650
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import oitlab

STACK = 12_000
"""Quads one behind the other in the middle of the image."""
HALF_SIDE = 4
"""Of the stack's farthest quad, in pixels."""
TILT = 0.1
"""Largest slope of a tilted quad."""
HUE = (0.6, 0.6, 0.6)
LAYOUTS = ("facing", "tilted")
"""Facing the camera, where sorting whole quads is enough, or tilted, where they cut through each other."""


def grey_smoke(layout: str, width: int, height: int, quads: int) -> oitlab.Scene:
    """Faint smoke of one hue, and a stack of small quads within its depths."""
    rng = np.random.default_rng(0)
    smoke = oitlab.scenes.smoke(width=width, height=height, count=quads)
    (mesh,) = smoke.meshes
    clouds = mesh.vertices.reshape(-1, 4, 3)
    column = _column(smoke.camera, height, clouds[..., 2].min(), clouds[..., 2].max(), rng)
    if layout == "tilted":
        clouds, column = _tilted(clouds, rng), _tilted(column, rng)
    camera = smoke.camera.tightened(np.concatenate([clouds, column]).reshape(-1, 3))
    return smoke.replace(meshes=[_grey(clouds, rng), _grey(column, rng)], camera=camera)


def _column(camera: oitlab.Camera, height: int, back: float, front: float, rng: np.random.Generator) -> Any:
    """The stack: squares around the line of sight, their depths evenly spaced and in random order."""
    pixel = 2 * (camera.eye[2] - back) * np.tan(np.radians(camera.fov_y / 2)) / height
    corners = np.zeros((STACK, 4, 3))
    corners[..., :2] = HALF_SIDE * pixel * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners[..., 2] = rng.permutation(np.linspace(back, front, STACK + 2)[1:-1])[:, None]
    return corners


def _grey(corners: Any, rng: np.random.Generator) -> oitlab.Mesh:
    """Quads of one hue, each with an alpha of its own."""
    faces = np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(len(corners))[:, None, None]
    colors = np.column_stack([np.tile(HUE, (len(corners), 1)), rng.uniform(0.001, 0.02, len(corners))])
    return oitlab.Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3), face_colors=colors.repeat(2, axis=0))


def _tilted(corners: Any, rng: np.random.Generator) -> Any:
    """Quads above the same squares that lean in random directions."""
    slopes = rng.uniform(-TILT, TILT, (len(corners), 1, 2))
    offsets = corners[..., :2] - corners[..., :2].mean(axis=1, keepdims=True)
    leaning = corners.copy()
    leaning[..., 2] += (slopes * offsets).sum(axis=-1)
    return leaning


def resident_bytes(field: str) -> int:
    """The kernel's word on this process: VmRSS is its memory now, VmHWM the most since the last reset."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith(f"{field}:"))
    return 1024 * int(kibibytes)


def measure(scene: oitlab.Scene, technique: str) -> dict[str, Any]:
    """Render once; memory first, for counting fragments per pixel takes some, too."""
    Path("/proc/self/clear_refs").write_text("5")  # VmHWM starts from what is there now
    before, start = resident_bytes("VmRSS"), time.perf_counter()
    frame = oitlab.render(scene, technique)
    seconds, peak = time.perf_counter() - start, resident_bytes("VmHWM")
    clouds, _ = scene.meshes
    others = oitlab.render(scene.replace(meshes=[clouds]), "wboit").fragment_count
    counts, stats = frame.fragment_count, frame.stats
    return {
        "before_bytes": before,
        "peak_bytes": peak - before,
        "seconds": seconds,
        "threads": stats.threads,
        "fragments": stats.fragments,
        "depth_complexity_max": stats.depth_complexity_max,
        "counted_fragments": int(counts.sum(dtype=np.int64)),
        "counted_max": int(counts.max()),
        "stack_max": int((counts - others).max()),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("technique")
    parser.add_argument("layout", choices=LAYOUTS)
    parser.add_argument("--width", type=int, required=True)
    parser.add_argument("--height", type=int, required=True)
    parser.add_argument("--quads", type=int, required=True, help="of the smoke")
    options = parser.parse_args()
    scene = grey_smoke(options.layout, options.width, options.height, options.quads)
    print(json.dumps(measure(scene, options.technique)))


if __name__ == "__main__":
    main()
