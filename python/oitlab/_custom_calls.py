"""What a technique of one's own is called with, and what it gives back, checked before it is an image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._convert import refuse_masked

_ROUNDING = 1e-5
"""How far a share may leave [0, 1] by rounding: about a hundred float32 roundings. It is clipped then."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """The fragments of P pixels, N in all, as a technique of your own sees them.

    Pixel p has the fragments `offsets[p]:offsets[p + 1]` of the arrays below, at least one: pixels without
    fragments are background without a call. They come nearest first by (depth, primitive), or in submission
    order where the technique was registered with `order="submission"`. Fragments that neither cover nor emit
    are left out. Arrays are C-contiguous and read-only: `numba.njit` functions take them, those with an
    explicit signature if it names read-only arrays.

    Attributes
    ----------
    offsets : (P + 1,) int64
        Row bounds, from 0 to N.
    depth : (N,) float32
        View-space distances along the camera's forward axis, >= 0.
    color : (N, 3) float32
        Premultiplied linear RGB (Rec. 709 primaries, D65).
    alpha : (N,) float32 in [0, 1]
        Coverages.
    primitive : (N,) uint32
        Ids of the primitives.
    background : (P, 3) float32
        Linear RGB of what lies behind, opaque surfaces included.
    pixel : (P, 2) int32
        Columns x from the left and rows y from the top.
    near, far : float
        The camera's clip planes, view-space distances.
    depth_range : tuple of two floats
        Depths of the scene's nearest and farthest transparent geometry.

    Examples
    --------
    >>> import numpy as np, oitlab
    >>> def look(batch):
    ...     print(batch.offsets, batch.counts, batch.rows, batch.depth, batch.pixel.tolist())
    ...     return batch.background, np.ones(len(batch))
    >>> fragments = oitlab.Fragments(width=3, height=1, offsets=[0, 2, 2, 3], depth=[4, 2, 3],
    ...     alpha=[0.5] * 3, color=np.zeros((3, 3)), background=(0, 0, 0))
    >>> with oitlab.custom.temporary():
    ...     _ = oitlab.technique(look)
    ...     frame = oitlab.render(fragments, "look", threads=1)
    [0 2 3] [2 1] [0 0 1] [2. 4. 3.] [[0, 0], [2, 0]]
    """

    offsets: NDArray[np.int64]
    depth: NDArray[np.float32]
    color: NDArray[np.float32]
    alpha: NDArray[np.float32]
    primitive: NDArray[np.uint32]
    background: NDArray[np.float32]
    pixel: NDArray[np.int32]
    near: float
    far: float
    depth_range: tuple[float, float]

    def __len__(self) -> int:
        """P, the number of pixels."""
        return len(self.offsets) - 1

    @property
    def counts(self) -> NDArray[np.int64]:
        """(P,) int64: fragments of each pixel, at least 1."""
        return np.diff(self.offsets)

    @property
    def rows(self) -> NDArray[np.int64]:
        """(N,) int64: the place in the batch of the pixel that each fragment belongs to."""
        return np.repeat(np.arange(len(self)), self.counts)


@dataclass(frozen=True, slots=True)
class Call:
    """A function with its params, as the core calls it."""

    technique: str
    function: Callable[..., Any]
    params: Mapping[str, Any]
    colored: bool

    def resolve(self, *arrays: Any) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
        """Give colours (P, 3), shares (P, 1) or (P, 3) and dropped fragments (P,) of a batch's pixels."""
        batch = Batch(*arrays)
        given = self.function(batch, **self.params)
        if not isinstance(given, tuple | list) or len(given) not in (2, 3):
            raise ValueError(
                f"{self.technique}: returned {_described(given)}, not (color, transmittance) "
                "or (color, transmittance, dropped)"
            )
        color = self._color(given[0], batch)
        shares = self._transmittance(given[1], batch)
        return color, shares, self._dropped(given[2] if len(given) == 3 else None, batch)

    def transmittance(self, *arrays: Any) -> NDArray[np.float64]:
        """Give the transmittance in front of each of the depths, which come last."""
        *lists, depths = arrays
        batch = Batch(*lists)
        found = self._floats(self.function(batch, depths, **self.params), "the transmittance function")
        if found.shape != depths.shape:
            problem = f"the transmittance function returned shape {found.shape}"
            raise ValueError(f"{self.technique}: {problem} for {len(depths)} depths, not {depths.shape}")
        outside = _outside(found)
        if outside.any():
            i = int(np.flatnonzero(outside)[0])
            where = f"depth {depths[i]:g} of pixel {_place(batch, 0)}"
            raise ValueError(f"{self.technique}: the transmittance at {where} is {found[i]!r}, not in [0, 1]")
        return np.ascontiguousarray(np.clip(found, 0.0, 1.0), np.float64)

    def _color(self, given: Any, batch: Batch) -> NDArray[np.float64]:
        color = self._floats(given, "color")
        if color.shape != (len(batch), 3):
            raise ValueError(
                f"{self.technique}: color has shape {color.shape} for {len(batch)} pixels, "
                f"not {(len(batch), 3)}"
            )
        finite = np.isfinite(color)
        if not finite.all():
            row = int(np.flatnonzero(~finite.all(axis=1))[0])
            where = _place(batch, row)
            raise ValueError(
                f"{self.technique}: the color of pixel {where} is {color[row].tolist()}, not finite"
            )
        return np.ascontiguousarray(color, np.float64)

    def _transmittance(self, given: Any, batch: Batch) -> NDArray[np.float64]:
        shares = self._floats(given, "transmittance")
        allowed = [(len(batch),), *([(len(batch), 3)] if self.colored else [])]
        if shares.shape not in allowed:
            hint = "" if self.colored else "; three channels need colored_transmittance=True"
            raise ValueError(
                f"{self.technique}: transmittance has shape {shares.shape} for {len(batch)} pixels, "
                f"not {' or '.join(map(str, allowed))}{hint}"
            )
        table = shares.reshape(len(batch), -1)
        outside = _outside(table)
        if outside.any():
            row, channel = np.argwhere(outside)[0].tolist()
            raise ValueError(
                f"{self.technique}: the transmittance of pixel {_place(batch, row)} is "
                f"{table[row, channel].item()!r}, not in [0, 1]"
            )
        return np.ascontiguousarray(np.clip(table, 0.0, 1.0), np.float64)

    def _dropped(self, given: Any, batch: Batch) -> NDArray[np.uint64]:
        if given is None:
            return np.zeros(len(batch), np.uint64)
        dropped = np.asarray(given)
        if dropped.dtype.kind not in "iu" or dropped.shape != (len(batch),):
            raise ValueError(f"{self.technique}: dropped is {_described(given)}, not {len(batch)} integers")
        if (dropped < 0).any():
            row = int(np.flatnonzero(dropped < 0)[0])
            raise ValueError(
                f"{self.technique}: pixel {_place(batch, row)} dropped {dropped[row]} fragments, not >= 0"
            )
        if (dropped > batch.counts).any():
            row = int(np.flatnonzero(dropped > batch.counts)[0])
            raise ValueError(
                f"{self.technique}: pixel {_place(batch, row)} dropped {dropped[row]} fragments, "
                f"but has only {batch.counts[row]}"
            )
        return np.ascontiguousarray(dropped, np.uint64)

    def _floats(self, given: Any, what: str) -> NDArray[Any]:
        refuse_masked(given, f"{self.technique}: {what}")
        try:
            found = np.asarray(given)
        except ValueError as error:
            raise ValueError(f"{self.technique}: {what} is not a regular array: {error}") from None
        if found.dtype.kind != "f":
            raise ValueError(f"{self.technique}: {what} has dtype {found.dtype}, not a float's")
        return found


def _outside(shares: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which are not in [0, 1], NaN among them."""
    inside: NDArray[np.bool_] = (shares >= -_ROUNDING) & (shares <= 1.0 + _ROUNDING)
    return ~inside


def _place(batch: Batch, row: int) -> str:
    x, y = batch.pixel[row].tolist()
    return f"(x={x}, y={y})"


def _described(given: Any) -> str:
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape} and dtype {given.dtype}"
    if isinstance(given, tuple | list):
        return f"a {type(given).__name__} of {len(given)}"
    return repr(given)
