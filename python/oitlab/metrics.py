"""How far an image is from the exact one.

Images are linear RGB with Rec. 709 primaries and a D65 white point. All arithmetic is in float64. A metric
that needs to know something about the viewer (the luminance of 1.0, the pixels per degree, the data range)
takes it as an argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._convert import scalar
from ._errors import errors_of
from ._image import ImageLike, as_image, as_shaped_image

__all__ = ["ERROR_MAPS", "METRICS", "compare", "error_map"]

METRICS = (
    "mse",
    "rmse",
    "psnr",
    "max_error",
    "mse_255",
    "bad_pixels",
    "delta_e_2000",
    "delta_e_itp",
    "flip",
)
"""Every metric of `compare`, in the order of its result."""

ERROR_MAPS = ("squared", "absolute", "delta_e_2000", "delta_e_itp", "flip")
"""Every map of `error_map`."""

_LARGEST_ERROR = 1e149
"""Largest difference whose squares, summed over a billion channels and scaled by 255^2, fit in float64."""
CHEAP = ("mse", "rmse", "max_error", "mse_255", "bad_pixels")
"""Metrics that come from one walk over the images and need no argument."""
_Pixels: TypeAlias = NDArray[np.float64]


def compare(
    image: ImageLike,
    reference: ImageLike,
    *,
    metrics: str | Iterable[str] | None = None,
    data_range: float | None = None,
    threshold: float = 1.0 / 255.0,
    luminance: float = 100.0,
    pixels_per_degree: float | None = None,
) -> dict[str, float]:
    """Measure an image against a reference.

    | metric | value | image as |
    |---|---|---|
    | `mse` | mean squared error over pixels and channels | linear, not clipped |
    | `rmse` | its square root | |
    | `psnr` | 10 log10(data_range^2 / mse) in dB, inf for equal images; needs `data_range` | |
    | `max_error` | largest absolute error of any channel | |
    | `mse_255` | 255^2 mse: the same on a 0..255 scale, as [Friederichs2021] reports it; not rounded | |
    | `bad_pixels` | share of pixels with a channel off by more than `threshold`, in [0, 1] | |
    | `delta_e_2000` | mean CIEDE2000 [Sharma2005], D65, 1 is about just noticeable | clipped to [0, 1] |
    | `delta_e_itp` | mean Delta E ITP [ITU2019], 1 is just noticeable | PQ range, see `luminance` |
    | `flip` | mean LDR FLIP [Andersson2020], in [0, 1] | clipped to [0, 1] |

    Parameters
    ----------
    image : Frame or (H, W, 3) array-like
        A `Frame`, or (H, W, 3) linear RGB (Rec. 709 primaries, D65), finite.
    reference : Frame or (H, W, 3) array-like
        The same shape.
    metrics : str or iterable of str, optional
        One name, several, or "all". None gives every metric that costs little: `mse`, `rmse`,
        `max_error`, `mse_255`, `bad_pixels`, and `psnr` when `data_range` is given.
    data_range : float, optional
        Largest possible difference of two channels, > 0, for `psnr`. There is no default:
        linear light has none.
    threshold : float
        Linear error above which a pixel is bad, >= 0.
    luminance : float
        Luminance of 1.0 in cd/m2, > 0, for `delta_e_itp`. The signal is clipped to what PQ
        can express, 0 to 10,000 cd/m2.
    pixels_per_degree : float, optional
        Of visual angle, > 0, for `flip`. There is no default: it depends on the
        viewer's distance.

    Returns
    -------
    dict of str to float
        Metric name to value, in the order of `METRICS`.

    Raises
    ------
    ValueError
        Shapes differ or are not (H, W, 3), no pixels, a value that is not finite or off by more than 1e149
        (the first bad pixel is named), an unknown metric, an argument that is not a number or out of range,
        or missing though a requested metric needs it.
    ImportError
        `flip` is asked for and `flip-evaluator` is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> grey = np.full((2, 2, 3), 0.5)
    >>> off = grey.copy()
    >>> off[0, 0, 0] = 0.75
    >>> result = compare(off, grey, data_range=1.0)
    >>> round(result["mse"], 6), result["max_error"], result["bad_pixels"], round(result["psnr"], 2)
    (0.005208, 0.25, 0.25, 22.83)
    >>> compare(grey, grey, metrics=["delta_e_2000", "delta_e_itp"])
    {'delta_e_2000': 0.0, 'delta_e_itp': 0.0}
    """
    names = _requested(metrics, data_range)
    threshold = _positive("threshold", threshold, zero=True)
    luminance = _positive("luminance", luminance)
    data_range = None if data_range is None else _positive("data_range", data_range)
    pixels_per_degree = _degree(pixels_per_degree)
    given = _shaped(image, reference)
    errors = errors_of(*given, threshold if "bad_pixels" in names else None)
    if not errors.largest <= _LARGEST_ERROR:
        _pair(*given)  # says where
    mse = errors.squared / given[0].size
    values: dict[str, Callable[[], float]] = {
        "mse": lambda: mse,
        "rmse": lambda: math.sqrt(mse),
        "psnr": lambda: _psnr(mse, data_range),
        "max_error": lambda: errors.largest,
        "mse_255": lambda: 255.0**2 * mse,
        "bad_pixels": lambda: errors.bad_pixels * 3 / given[0].size,
    }
    if not values.keys() >= set(names):
        test, exact = (array.astype(np.float64) for array in given)
        values |= {
            "delta_e_2000": lambda: float(_delta_e_2000(test, exact).mean()),
            "delta_e_itp": lambda: float(_delta_e_itp(test, exact, luminance).mean()),
            "flip": lambda: float(_flip(test, exact, pixels_per_degree).mean()),
        }
    return {name: values[name]() for name in names}


def error_map(
    image: ImageLike,
    reference: ImageLike,
    metric: Literal["squared", "absolute", "delta_e_2000", "delta_e_itp", "flip"] = "squared",
    *,
    luminance: float = 100.0,
    pixels_per_degree: float | None = None,
) -> NDArray[np.float64]:
    """Measure every pixel against a reference.

    Parameters
    ----------
    image : Frame or (H, W, 3) array-like
        A `Frame`, or (H, W, 3) linear RGB (Rec. 709 primaries, D65), finite.
    reference : Frame or (H, W, 3) array-like
        The same shape.
    metric : str
        "squared": mean of the channels' squared errors, so that the map's mean is `mse`.
        "absolute": largest absolute channel error, so that the map's maximum is `max_error`.
        "delta_e_2000", "delta_e_itp", "flip": as in `compare`, which gives their means.
    luminance : float
        As in `compare`.
    pixels_per_degree : float, optional
        As in `compare`.

    Returns
    -------
    (H, W) float64 array
        Not negative.

    Raises
    ------
    ValueError
        As in `compare`.
    ImportError
        As in `compare`.

    Examples
    --------
    >>> import numpy as np
    >>> error_map(np.full((1, 2, 3), 0.5), np.zeros((1, 2, 3))).tolist()
    [[0.25, 0.25]]
    """
    luminance = _positive("luminance", luminance)
    pixels_per_degree = _degree(pixels_per_degree)
    test, exact = _pair(image, reference)
    if metric == "squared":
        return np.asarray(np.square(test - exact).mean(axis=2), dtype=np.float64)
    if metric == "absolute":
        return np.asarray(np.abs(test - exact).max(axis=2), dtype=np.float64)
    if metric == "delta_e_2000":
        return _delta_e_2000(test, exact)
    if metric == "delta_e_itp":
        return _delta_e_itp(test, exact, luminance)
    if metric == "flip":
        return _flip(test, exact, pixels_per_degree)
    raise ValueError(f"metric: unknown error map {metric!r}; known: {', '.join(ERROR_MAPS)}")


def _requested(metrics: str | Iterable[str] | None, data_range: float | None) -> list[str]:
    if metrics is None:
        wanted = {*CHEAP, *(["psnr"] if data_range is not None else [])}
    elif isinstance(metrics, str):
        wanted = set(METRICS) if metrics == "all" else {metrics}
    else:
        try:
            wanted = set(metrics)
        except TypeError:
            raise ValueError(f"metrics: expected names among {', '.join(METRICS)}, got {metrics!r}") from None
    unknown = sorted(str(name) for name in wanted.difference(METRICS))
    if unknown:
        raise ValueError(f"metrics: unknown {', '.join(unknown)}; known: {', '.join(METRICS)}, or all")
    return [name for name in METRICS if name in wanted]


def _shaped(image: ImageLike, reference: ImageLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """Images of one shape; whether they are finite is seen while they are compared."""
    test, exact = as_shaped_image(image, "image"), as_shaped_image(reference, "reference")
    if test.shape != exact.shape:
        raise ValueError(f"image and reference differ in shape: {test.shape} and {exact.shape}")
    if test.size == 0:
        raise ValueError(f"image: an image of shape {test.shape} has no pixels to compare")
    return test, exact


def _pair(image: ImageLike, reference: ImageLike) -> tuple[_Pixels, _Pixels]:
    shaped = _shaped(image, reference)
    test = as_image(shaped[0], "image").astype(np.float64)
    exact = as_image(shaped[1], "reference").astype(np.float64)
    with np.errstate(over="ignore"):
        errors = np.abs(test - exact)
    if errors.max() > _LARGEST_ERROR:
        y, x, channel = np.argwhere(errors > _LARGEST_ERROR)[0].tolist()
        raise ValueError(
            f"image and reference: pixel (x={x}, y={y}) is off by {errors[y, x, channel]:.3g} in channel "
            f"{channel}; at most {_LARGEST_ERROR:g} can be squared"
        )
    return test, exact


def _positive(name: str, value: float, *, zero: bool = False) -> float:
    value = scalar(value, name)
    if not (math.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise ValueError(f"{name}: expected a finite number {'>=' if zero else '>'} 0, got {value}")
    return value


def _degree(pixels_per_degree: float | None) -> float | None:
    return None if pixels_per_degree is None else _positive("pixels_per_degree", pixels_per_degree)


def _psnr(mse: float, data_range: float | None) -> float:
    if data_range is None:
        raise ValueError("psnr needs data_range: the largest difference that two channels can have")
    return math.inf if mse == 0.0 else 20.0 * math.log10(data_range) - 10.0 * math.log10(mse)


def _colour() -> Any:
    """Import colour-science, which otherwise changes how the user's arrays print."""
    with np.printoptions():
        import colour

    return colour


def _delta_e_2000(test: _Pixels, exact: _Pixels) -> _Pixels:
    colour = _colour()

    with colour.domain_range_scale("Reference"):
        return np.asarray(colour.difference.delta_E_CIE2000(_lab(test), _lab(exact)), dtype=np.float64)


def _lab(linear: _Pixels) -> NDArray[Any]:
    colour = _colour()

    space = colour.RGB_COLOURSPACES["ITU-R BT.709"]
    xyz = np.clip(linear, 0.0, 1.0) @ space.matrix_RGB_to_XYZ.T
    return np.asarray(colour.XYZ_to_Lab(xyz, space.whitepoint))


def _delta_e_itp(test: _Pixels, exact: _Pixels, luminance: float) -> _Pixels:
    colour = _colour()

    with colour.domain_range_scale("Reference"):
        signals = _ictcp(test, luminance), _ictcp(exact, luminance)
        return np.asarray(colour.difference.delta_E_ITP(*signals), dtype=np.float64)


def _ictcp(linear: _Pixels, luminance: float) -> NDArray[Any]:
    colour = _colour()

    to_2020 = colour.matrix_RGB_to_RGB(
        colour.RGB_COLOURSPACES["ITU-R BT.709"], colour.RGB_COLOURSPACES["ITU-R BT.2020"], None
    )
    with np.errstate(over="ignore"):
        absolute = np.clip(luminance * (linear @ to_2020.T), 0.0, 10_000.0)
    return np.asarray(colour.RGB_to_ICtCp(absolute))


def _flip(test: _Pixels, exact: _Pixels, pixels_per_degree: float | None) -> _Pixels:
    if pixels_per_degree is None:
        raise ValueError("flip needs pixels_per_degree: 67 is a 0.7 m wide 4K display seen from 0.7 m")
    try:
        from flip_evaluator import evaluate
    except ImportError as error:
        raise ImportError("flip needs flip-evaluator: pip install 'oitlab[flip]'") from error
    errors, _, _ = evaluate(
        np.ascontiguousarray(np.clip(exact, 0.0, 1.0), dtype=np.float32),
        np.ascontiguousarray(np.clip(test, 0.0, 1.0), dtype=np.float32),
        "LDR",
        inputsRGB=False,
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": pixels_per_degree},
    )
    return np.asarray(errors, dtype=np.float64).reshape(test.shape[:2])
