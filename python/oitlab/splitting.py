"""How much of an error is the algorithm's, and how much is its storage's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._storage import format_params, in_f64
from .fragments import Fragments
from .registry import techniques
from .rendering import checked_variant, render_many
from .scene import Scene


@dataclass(frozen=True, eq=False)
class ErrorPart:
    """One part of an error.

    Attributes
    ----------
    map : (H, W, 3) float64
        Signed differences of linear RGB.
    rmse : float
        Root of the mean of their squares, over pixels and channels.
    max : float
        Largest of their absolute values.
    """

    map: NDArray[np.float64]
    rmse: float
    max: float


@dataclass(frozen=True, eq=False)
class ErrorSplit:
    """An error in two parts, whose maps add up to that of the total.

    Attributes
    ----------
    algorithmic : ErrorPart
        The technique in float64 less the exact image: what no format can mend.
    storage : ErrorPart
        The technique in its formats less the technique in float64: what a wider format mends.
    total : ErrorPart
        The technique in its formats less the exact image.
    params : dict
        Every parameter of the technique in its formats.
    """

    algorithmic: ErrorPart
    storage: ErrorPart
    total: ErrorPart
    params: dict[str, Any]


def error_split(
    source: Scene | Fragments,
    technique: str,
    params: Mapping[str, Any] | None = None,
    format: str | None = None,
    *,
    threads: int | None = None,
) -> ErrorSplit:
    """Split a technique's error into the algorithm's and the storage's.

    The exact image is `a_buffer`'s [Carpenter1984]; that of the algorithm alone is the same technique with
    `format="f64"`, in which weights, blend factors and all that is stored are float64. What of the parts is
    larger says whether to look for another technique or for another format [McGuire2013, section 3.2].

    Parameters
    ----------
    source : Scene or Fragments
        What is drawn.
    technique : str
        An id or alias of a technique that has the parameter `format`.
    params : mapping, optional
        Its parameters; `<target>_format` and `summation` among them are part of the storage: the former
        are left out for the float64 form, the latter stays, for where sums exceed float64 too.
    format : str, optional
        Format of everything that is stored, such as "f16", if `params` do not say it.
    threads : int >= 1, optional
        All cores when absent.

    Returns
    -------
    ErrorSplit
        Differences of linear RGB (Rec. 709 primaries, D65), float64, and their totals.

    Raises
    ------
    ValueError
        A technique without formats, a format that it does not have, a format in `params` and beside them,
        an image that is not finite, or params that `render` would refuse.

    Examples
    --------
    A stack of faint layers behind each other: as an algorithm `wboit` is off by what averaging does to a
    gradient; 8 bits of revealage do not see the layers at all.

    >>> import numpy as np, oitlab
    >>> ramp = np.linspace(0, 1, 50)
    >>> stack = oitlab.Fragments(width=1, height=1, offsets=[0, 50], depth=1 + ramp, alpha=[1 / 600] * 50,
    ...     color=np.stack([ramp, ramp, ramp], axis=1) / 600, background=(1, 1, 1))
    >>> halves = oitlab.error_split(stack, "wboit", {"revealage_format": "unorm8"}, format="f16")
    >>> round(halves.algorithmic.max, 4), round(halves.storage.max, 2)
    (0.0089, 0.05)
    >>> bool(np.allclose(halves.algorithmic.map + halves.storage.map, halves.total.map, atol=1e-15))
    True
    """
    name, given = checked_variant((technique, params))
    entry = techniques().get(name)
    if entry is not None:
        if not format_params(entry):
            known = ", ".join(entry.id for entry in techniques() if format_params(entry))
            raise ValueError(f"{entry.id!r} has no storage formats; those that have: {known}")
        if format is not None and "format" in given:
            raise ValueError(
                f"format: params say {given['format']!r} already, which leaves no room for {format!r}"
            )
    stored = given if format is None else {**given, "format": format}
    whole = (in_f64(entry, given) if entry is not None else None) or {}
    frames = render_many(
        source, ["a_buffer", (name, whole), (name, stored)], threads=threads, dtype="float64"
    )
    exact, algorithm, got = (np.asarray(frame.color, np.float64) for frame in frames)
    for what, image in (("exact", exact), ("float64", algorithm), ("stored", got)):
        if not np.isfinite(image).all():
            y, x = np.argwhere(~np.isfinite(image).all(axis=2))[0].tolist()
            raise ValueError(f"source: the {what} image is not finite at pixel (x={x}, y={y})")
    return ErrorSplit(
        _part(algorithm - exact), _part(got - algorithm), _part(got - exact), dict(frames[2].params)
    )


def _part(difference: NDArray[np.float64]) -> ErrorPart:
    return ErrorPart(
        difference, math.sqrt(float(np.square(difference).mean())), float(np.abs(difference).max())
    )
