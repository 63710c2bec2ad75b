"""Frames written by hand, for tests that need no renderer."""

import inspect
from typing import Any

import numpy as np

from oitlab.frame import Frame, Stats

STATS = Stats(
    total_ms=3.5,
    raster_ms=2.0,
    resolve_ms=1.25,
    fragments=12345,
    depth_complexity_mean=2.5,
    depth_complexity_max=7,
    geometry_passes=1,
    bytes_per_pixel=10.0,
    dropped=3,
    skipped={"empty_tiles": 4},
    backend="cpu",
    threads=2,
)

FIELDS = tuple(inspect.signature(Frame).parameters)


def frame(color: Any, *, technique: str = "wboit", **fields: Any) -> Frame:
    """Make a frame around an image; every other field can be replaced by keyword."""
    color = np.asarray(color)
    size = color.shape[:2]
    depth = np.full(size, np.inf, np.float32)
    depth[:1, :1] = 1.5
    given = {
        "color": color,
        "transmittance": np.full(size, 0.25, np.float32),
        "technique": technique,
        "params": {"weight": "mb7", "weight_k": 2.5, "smooth": True, "bins": 64, "seed": None},
        "scene_hash": "0123abcd",
        "stats": STATS,
        "first_depth": depth,
        "fragment_count": np.arange(np.prod(size), dtype=np.uint32).reshape(size),
    }
    return Frame(**(given | fields))


def random_image(seed: int, height: int = 5, width: int = 7) -> Any:
    return np.random.default_rng(seed).random((height, width, 3), dtype=np.float32)
