"""What the metrics and the file writers agree on about images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._convert import refuse_masked, scalar

if TYPE_CHECKING:
    from .frame import Frame

ImageLike: TypeAlias = "Frame | ArrayLike"
"""A `Frame`, or an (H, W, 3) array of linear RGB (Rec. 709 primaries, D65), row 0 on top."""


def as_image(image: ImageLike, name: str) -> NDArray[Any]:
    """Give the (H, W, 3) floats of a frame or an array, all finite.

    Parameters
    ----------
    image : Frame or array-like
        A `Frame`, whose `color` is taken, or an (H, W, 3) array of linear RGB.
    name : str
        What an error message calls the image.

    Returns
    -------
    (H, W, 3) array
        In the input's float dtype; integers and booleans become float64. Not copied when already float.

    Raises
    ------
    ValueError
        Wrong shape, not numeric, masked, or a value that is not finite, with the first bad pixel.

    Examples
    --------
    >>> as_image([[[0, 0.5, 1]]], "image").shape
    (1, 1, 3)
    >>> as_image([[[0.0, 0.0, 0.0], [0.0, float("nan"), 0.0]]], "image")
    Traceback (most recent call last):
        ...
    ValueError: image: pixel (x=1, y=0) is not finite: nan in channel 1
    """
    array = as_shaped_image(image, name)
    refuse_non_finite(array, name)
    return array


def as_shaped_image(image: ImageLike, name: str) -> NDArray[Any]:
    """Do what `as_image` does, but let through what is not finite."""
    pixels: Any = image
    array = as_numbers(getattr(pixels, "color", pixels), name)
    if array.ndim != 3 or array.shape[2] != 3:
        raise ValueError(f"{name}: expected shape (H, W, 3), got {array.shape}")
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def as_numbers(value: ArrayLike, name: str) -> NDArray[Any]:
    """Give an array of numbers of any shape; ValueError naming it when ragged, masked or of another kind.

    Examples
    --------
    >>> as_numbers([["a"]], "error")
    Traceback (most recent call last):
        ...
    ValueError: error: expected numbers, got dtype <U1
    """
    refuse_masked(value, name)
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{name}: not an array: {error}") from error
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name}: expected numbers, got dtype {array.dtype}")
    return array


def refuse_non_finite(array: NDArray[Any], name: str, *, infinity: bool = False) -> None:
    """Raise on the first value, in row order, that is NaN or infinite.

    Parameters
    ----------
    array : (H, W) or (H, W, C) float array
        (H, W) or (H, W, C) floats.
    name : str
        What the message calls the array.
    infinity : bool
        Let +inf pass (a depth map is +inf where nothing was hit).

    Raises
    ------
    ValueError
        With the pixel's x and y, the value and, for (H, W, C), the channel.

    Examples
    --------
    >>> import numpy as np
    >>> refuse_non_finite(np.array([[1.0, np.inf]]), "depth", infinity=True)
    >>> refuse_non_finite(np.array([[1.0, np.inf]]), "depth")
    Traceback (most recent call last):
        ...
    ValueError: depth: pixel (x=1, y=0) is not finite: inf
    """
    good = np.isfinite(array)
    if infinity:
        good |= np.isposinf(array)
    if good.all():
        return
    first = np.unravel_index(int(np.argmin(good)), array.shape)
    where = f"{name}: pixel (x={first[1]}, y={first[0]}) is not finite: {float(array[first])}"
    raise ValueError(where + (f" in channel {first[2]}" if array.ndim == 3 else ""))


def srgb_encode(linear: NDArray[Any]) -> NDArray[np.float64]:
    """Encode linear light in [0, 1] with the sRGB curve [IEC1999].

    Parameters
    ----------
    linear : float array of any shape
        values outside [0, 1] are clipped.

    Returns
    -------
    float64 array
        Of the same shape, in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> srgb_encode(np.array([0.0, 0.002, 0.2, 1.0])).round(4).tolist()
    [0.0, 0.0258, 0.4845, 1.0]
    """
    clipped = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    curve = 1.055 * np.power(clipped, 1.0 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, 12.92 * clipped, curve)


def srgb_bytes(linear: NDArray[Any], exposure: float = 0.0) -> NDArray[np.uint8]:
    """Give the 8-bit sRGB picture of linear light, rounded to nearest.

    Parameters
    ----------
    linear : float array of any shape
        Linear light; 1 is the display's white.
    exposure : float
        Stops in [-100, 100]: the light is multiplied by 2 ** exposure, clipped and encoded.

    Returns
    -------
    uint8 array
        Of the same shape.

    Raises
    ------
    ValueError
        `exposure` is not a number or out of range.

    Examples
    --------
    >>> import numpy as np
    >>> srgb_bytes(np.array([0.0, 0.2, 1.0, 7.0])).tolist()
    [0, 124, 255, 255]
    """
    stops = scalar(exposure, "exposure")
    if not -100.0 <= stops <= 100.0:
        raise ValueError(f"exposure: expected stops in [-100, 100], got {exposure}")
    with np.errstate(over="ignore"):
        scaled = np.asarray(linear, dtype=np.float64) * 2.0**stops
    return np.floor(255.0 * srgb_encode(scaled) + 0.5).astype(np.uint8)


def reduced(image: NDArray[np.float64], factor: int, statistic: Any) -> NDArray[np.float64]:
    """Reduce by a whole factor; the edges are repeated to fill the last block.

    Examples
    --------
    >>> import numpy as np
    >>> reduced(np.array([[1.0, 3.0, 5.0]]), 2, np.mean).tolist()
    [[2.0, 5.0]]
    """
    bottom, right = -image.shape[0] % factor, -image.shape[1] % factor
    padded = np.pad(image, ((0, bottom), (0, right), *[(0, 0)] * (image.ndim - 2)), mode="edge")
    height, width = padded.shape[0] // factor, padded.shape[1] // factor
    blocks = padded.reshape(height, factor, width, factor, *image.shape[2:])
    return np.asarray(statistic(blocks, axis=(1, 3)))


def enlarged(image: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Repeat every pixel `factor` times in both directions.

    Examples
    --------
    >>> import numpy as np
    >>> enlarged(np.array([[1.0, 3.0]]), 2).tolist()
    [[1.0, 1.0, 3.0, 3.0], [1.0, 1.0, 3.0, 3.0]]
    """
    return image.repeat(factor, axis=0).repeat(factor, axis=1)
