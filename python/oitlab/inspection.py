"""Looking inside a technique: its transmittance function, and how much it depends on submission order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oitlab
from ._convert import array, count, integer
from .fragments import Fragments
from .rendering import Bound, bind, capture, checked_variant, render, silent_weights, warn_of_weights
from .scene import Scene


@dataclass(frozen=True, eq=False)
class Transmittance:
    """A pixel's transmittance strictly in front of some depths.

    Attributes
    ----------
    depths : (N,) float32
        View-space distances.
    exact : (N,) float64 in [0, 1]
        The product of 1 - alpha over all fragments nearer than the depth.
    reconstructed : (N,) float64
        What the technique makes of it.
    """

    depths: NDArray[np.float32]
    exact: NDArray[np.float64]
    reconstructed: NDArray[np.float64]


def transmittance(
    source: Scene | Fragments,
    technique: str,
    params: Mapping[str, Any] | None = None,
    *,
    pixel: tuple[int, int],
    depths: ArrayLike | None = None,
) -> Transmittance:
    """Reconstruct a technique's transmittance function T(z) at one pixel, beside the exact one.

    Parameters
    ----------
    source : Scene or Fragments
        A scene is captured first; capture it yourself to look at many pixels.
    technique : str
        One that reconstructs a transmittance function.
    params : mapping, optional
        The technique's parameters.
    pixel : (x, y)
        Column from the left and row from the top.
    depths : (N,) floats >= 0, optional
        Where to evaluate. Left out: both sides of every fragment of the pixel and 200 depths between the
        nearest and farthest fragment, ascending, so that a plot shows the steps.

    Returns
    -------
    Transmittance

    Raises
    ------
    ValueError
        A pixel outside the image, depths that are not finite and >= 0, params that `render` would refuse, or
        a technique without a transmittance function.

    Examples
    --------
    >>> import oitlab
    >>> fragments = oitlab.Fragments(width=1, height=1, offsets=[0, 2], depth=[2, 4], alpha=[0.5, 0.5],
    ...     color=[[0.5, 0, 0], [0, 0.5, 0]], background=(0, 0, 0))
    >>> curve = oitlab.transmittance(fragments, "a_buffer", pixel=(0, 0), depths=[1, 3, 5])
    >>> curve.exact.tolist(), curve.reconstructed.tolist()
    ([1.0, 0.5, 0.25], [1.0, 0.5, 0.25])
    """
    fragments = _fragments(source)
    place = _place(pixel, fragments)
    if depths is None:
        where = _steps(fragments.pixel(*place)["depth"])
    else:
        where = array(depths, "depths", np.float32, ("N",))
    bound = _bound(technique, params)
    exact, reconstructed = _oitlab.transmittance(
        fragments._handle, bound.technique, bound.params, place, where
    )
    return Transmittance(where, exact, reconstructed)


def order_sensitivity(
    source: Scene | Fragments,
    technique: str,
    params: Mapping[str, Any] | None = None,
    n: int = 16,
    *,
    seed: int = 0,
    threads: int | None = None,
) -> NDArray[np.float64]:
    """Measure how much a technique's image depends on submission order.

    The fragments are handed over in `n` random orders of the primitives; everything else stays, the random
    numbers of random techniques included.

    Parameters
    ----------
    source : Scene or Fragments
        A scene is captured first.
    technique : str
        One that accepts any submission order.
    params : mapping, optional
        The technique's parameters, without `submission_order`.
    n : int in [2, 4096]
        Number of shuffles.
    seed : int >= 0
        Picks the shuffles.
    threads : int >= 1, optional
        All cores when absent.

    Returns
    -------
    (H, W) float64
        Per pixel the unbiased variance of linear RGB over the shuffles, averaged over the channels. Zero up
        to the rounding of sums for an order-independent technique; techniques that reconstruct from moments
        amplify that rounding where depths nearly coincide.

    Raises
    ------
    ValueError
        A bad `n`, `submission_order` among the params, a technique with an order of its own (`painter`), or
        params that `render` would refuse.

    Warns
    -----
    WeightWarning
        As `render`, with the fragments of one image.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=40)
    >>> bool(oitlab.order_sensitivity(scene, "alpha_compositing", n=4).max() > 1e-4)
    True
    >>> float(oitlab.order_sensitivity(scene, "a_buffer", n=4).max())
    0.0
    """
    fragments = _fragments(source)
    workers = None if threads is None else count(threads, "threads")
    bound = _bound(technique, params)
    if bound.definition is not None and "submission_order" in (params or {}):
        raise ValueError("params: submission_order is what order_sensitivity varies")
    shuffles, first = count(n, "n"), count(seed, "seed", bits=64)
    variance: NDArray[np.float64] = _oitlab.order_sensitivity(
        fragments._handle, bound.technique, bound.params, shuffles, first, workers
    )
    if bound.definition is None and any(map(_is_own_function, bound.params.values())):
        with silent_weights():
            frame = render(fragments, technique, params, threads=threads)
        # what is no weight in one order is none in any
        warn_of_weights([(frame.technique, frame.stats.invalid_weights)])
    return variance


def _is_own_function(value: Any) -> bool:
    """Whether it is a weight of one's own: callable, or text that is more than a published one's name."""
    return callable(value) or (isinstance(value, str) and not value.isidentifier())


def _bound(technique: str, params: Mapping[str, Any] | None) -> Bound:
    return bind(*checked_variant((technique, params)))


def _fragments(source: Scene | Fragments) -> Fragments:
    if isinstance(source, Scene):
        return capture(source)
    if isinstance(source, Fragments):
        return source
    raise ValueError(f"source must be a Scene or Fragments, got {type(source).__name__}")


def _place(pixel: tuple[int, int], fragments: Fragments) -> tuple[int, int]:
    try:
        x, y = pixel
    except (TypeError, ValueError):
        raise ValueError(f"pixel must be a pair (x, y), got {pixel!r}") from None
    place = integer(x, "pixel x"), integer(y, "pixel y")
    if not (0 <= place[0] < fragments.width and 0 <= place[1] < fragments.height):
        raise ValueError(f"pixel: {place} is not in the image of {fragments.width} x {fragments.height}")
    return place


def _steps(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    if len(depth) == 0:
        return np.empty(0, np.float32)
    between = np.linspace(depth.min(), depth.max(), 200, dtype=np.float32)
    return np.unique(np.concatenate([between, depth, np.nextafter(depth, np.float32(np.inf))]))
