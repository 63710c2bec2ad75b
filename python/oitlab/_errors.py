"""The errors of two images that cost little, in one walk over both that stays in the cache."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_PIXELS = 1 << 15
"""Pixels of a block: its float64 channels take 768 KiB, about half a core's second cache."""


@dataclass(frozen=True)
class Errors:
    """Sums over all pixels and channels, in float64."""

    squared: float
    """Sum of squared errors."""
    largest: float
    """Largest absolute error; NaN or infinite where an image is."""
    bad_pixels: int
    """Pixels with a channel off by more than the threshold; 0 if none was given."""


def errors_of(test: NDArray[Any], exact: NDArray[Any], threshold: float | None = None) -> Errors:
    """Errors of one image.

    Parameters
    ----------
    test, exact : (H, W, 3) float arrays
        Of one shape.
    threshold : float, optional
        Absolute error above which a pixel is bad.

    Examples
    --------
    >>> import numpy as np
    >>> errors_of(np.full((1, 2, 3), 0.5), np.array([[(0.5, 0.5, 0.5), (0.5, 0.25, 1.0)]]), 0.3)
    Errors(squared=0.3125, largest=0.5, bad_pixels=1)
    """
    flat, flat_exact = test.reshape(-1), exact.reshape(-1)
    size = 3 * BLOCK_PIXELS
    room = np.empty(min(size, len(flat)))
    sums, largest, bad = [], 0.0, 0
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(flat), size):
            block = flat[start : start + size]
            difference = room[: len(block)]
            np.subtract(block, flat_exact[start : start + size], out=difference, dtype=np.float64)
            np.abs(difference, out=difference)
            most = float(difference.max())
            largest = most if most > largest or math.isnan(most) else largest  # NaN stays
            if threshold is not None and most > threshold:
                bad += _bad_pixels(difference, threshold)
            np.square(difference, out=difference)
            sums.append(float(difference.sum()))
    return Errors(math.fsum(sums) if math.isfinite(largest) else math.nan, largest, bad)


def _bad_pixels(difference: NDArray[np.float64], threshold: float) -> int:
    red, green, blue = (difference[channel::3] for channel in range(3))
    return int(np.count_nonzero(np.maximum(np.maximum(red, green), blue) > threshold))
