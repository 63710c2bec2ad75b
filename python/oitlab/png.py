"""Pictures to look at: 8-bit sRGB PNG."""

from __future__ import annotations

import io
import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._atomic import replacing
from ._image import ImageLike, as_image, reduced, srgb_bytes

__all__ = ["write_png"]

_LARGEST = 2048
"""Pixels of a picture in a notebook, each way."""
_NOT_FINITE = (1.0, 0.0, 1.0)


def write_png(path: str | os.PathLike[str], image: ImageLike, *, exposure: float = 0.0) -> None:
    r"""Write an image as an 8-bit sRGB PNG.

    Linear light is multiplied by 2 ** `exposure`, clipped to [0, 1], encoded with the sRGB curve
    [IEC1999] and rounded to nearest. Nothing else: no tone map, no dither. The file says that it is
    sRGB. It is for eyes; `write_exr` keeps the numbers.

    The file is written beside its place and renamed into it, so that a crash leaves the old file whole.

    Parameters
    ----------
    path : path-like
        The file to write; its folder must exist.
    image : Frame or (H, W, 3) array-like
        A `Frame`, or (H, W, 3) linear RGB (Rec. 709 primaries, D65), row 0 on top, finite.
    exposure : float
        Stops in [-100, 100]: 0 leaves the light as it is, +1 doubles it.

    Raises
    ------
    ValueError
        Wrong shape or dtype, an image without pixels, an exposure that is not a number or out of range, or a
        non-finite value (the message names the first bad pixel).
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "grey.png")
    ...     write_png(file, np.full((2, 3, 3), 0.2))
    ...     file.read_bytes()[:4]
    b'\x89PNG'
    """
    pixels = as_image(image, "image")
    if pixels.size == 0:
        raise ValueError(f"image: an image of shape {pixels.shape} has no pixels to write")
    save_bytes(path, srgb_bytes(pixels, exposure))


def save_bytes(path: str | os.PathLike[str], pixels: NDArray[Any]) -> None:
    """Write (H, W, 3) uint8 pixels that are sRGB-encoded already, atomically.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "black.png")
    ...     save_bytes(file, np.zeros((1, 1, 3), np.uint8))
    ...     file.stat().st_size > 0
    True
    """
    with replacing(path) as temporary:
        temporary.write_bytes(encoded(pixels))


def encoded(pixels: NDArray[Any]) -> bytes:
    r"""Give the PNG of (H, W, 3) uint8 pixels that are sRGB-encoded already; it says that it is sRGB.

    Examples
    --------
    >>> import numpy as np
    >>> encoded(np.zeros((1, 1, 3), np.uint8))[:4]
    b'\x89PNG'
    """
    from PIL import Image, PngImagePlugin

    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\x00")  # rendering intent: perceptual
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, format="PNG", pnginfo=chunks)
    return data.getvalue()


def picture(linear: NDArray[Any]) -> bytes | None:
    r"""Give the PNG that a notebook shows of (H, W, 3) linear light; None if it has no pixels.

    As `write_png` without exposure, except that images of more than 2048 pixels either way are reduced by a
    whole factor, by the mean of clipped linear light, and that pixels that are not finite are magenta.

    Examples
    --------
    >>> import numpy as np
    >>> picture(np.full((1, 1, 3), np.nan))[:4]
    b'\x89PNG'
    """
    if linear.size == 0:
        return None
    good = np.isfinite(linear).all(axis=2, keepdims=True)
    light = np.where(good, linear.astype(np.float64), _NOT_FINITE)
    factor = math.ceil(max(linear.shape[:2]) / _LARGEST)
    return encoded(srgb_bytes(reduced(np.clip(light, 0.0, 1.0), factor, np.mean) if factor > 1 else light))
