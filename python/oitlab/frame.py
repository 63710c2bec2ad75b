"""What a technique gives: the image and what it cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Stats:
    """What a frame cost.

    Times are wall-clock milliseconds; `raster_ms` covers the one rasterisation that all frames of a
    `render_many` call share. `geometry_passes` and `bytes_per_pixel` describe a streaming GPU implementation
    of the technique, not this renderer.
    """

    total_ms: float
    raster_ms: float
    resolve_ms: float
    fragments: int
    """Transparent fragments in the image."""
    depth_complexity_mean: float
    """Fragments per pixel, over all pixels of the image."""
    depth_complexity_max: int
    geometry_passes: int | str
    bytes_per_pixel: float | str
    dropped: int
    """Fragments that the technique's capacity had no room for."""
    skipped: dict[str, int]
    """How much work each shortcut avoided, by the shortcut's name."""
    backend: str
    threads: int


@dataclass(frozen=True, eq=False)
class Frame:
    """An image by one technique. Arrays belong to the frame and are writable; row 0 is on top.

    Attributes
    ----------
    color : (H, W, 3) float32 or float64
        Linear RGB (Rec. 709 primaries, D65), background included.
    transmittance : (H, W) or (H, W, 3), dtype of `color`
        The background's share, as the technique has it.
    technique : str
        The technique's id; aliases are resolved.
    params : dict
        Every parameter with its value, defaults included.
    scene_hash : str
        `content_hash` of what was rendered.
    stats : Stats
    first_depth : (H, W) float32
        Depth of the nearest transparent fragment, +inf where there is none.
    fragment_count : (H, W) uint32
    """

    color: NDArray[np.float32] | NDArray[np.float64]
    transmittance: NDArray[np.float32] | NDArray[np.float64]
    technique: str
    params: dict[str, Any]
    scene_hash: str
    stats: Stats
    first_depth: NDArray[np.float32]
    fragment_count: NDArray[np.uint32]

    def __repr__(self) -> str:
        height, width = self.color.shape[:2]
        return f"Frame({self.technique!r}, {self.params}, {width} x {height}, {self.stats.total_ms:.1f} ms)"
