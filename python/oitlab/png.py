"""Pictures to look at: 8-bit sRGB PNG."""

from __future__ import annotations

import os
from typing import Any

from numpy.typing import NDArray

from ._atomic import replacing
from ._image import ImageLike, as_image, srgb_bytes

__all__ = ["write_png"]


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
    from PIL import Image, PngImagePlugin

    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\x00")  # rendering intent: perceptual
    with replacing(path) as temporary, open(temporary, "xb") as file:
        Image.fromarray(pixels).save(file, format="PNG", pnginfo=chunks)
