"""A captured image: every pixel's fragments in arrival order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oitlab
from ._convert import array, count, scalar


class Fragments:
    """Per-pixel lists of transparent fragments, as `oitlab.capture` keeps them or as you make them.

    Pixel (x, y) owns the fragments `offsets[y * width + x]` up to `offsets[y * width + x + 1]`, in the order
    in which they arrived. Rows count from the top. A technique sees a capture exactly as it sees its scene.

    Parameters
    ----------
    width, height : int >= 1
    offsets : (H*W+1,) integer array
        Starts at 0, never falls, ends at N.
    depth : (N,) float array
        Distance along the camera's forward axis, positive.
    color : (N, 3) float array
        Premultiplied linear RGB.
    alpha : (N,) float array in [0, 1]
    primitive : (N,) integer array, optional
        Which triangle a fragment came from; ties in depth are broken by it. The fragment's place in its list
        when absent. Fragments of a pixel with depth and primitive in common, which no scene makes, lie in
        order of arrival for lists; maps of two-pass techniques take them for one place, where neither hides
        the other.
    background : (3,) or (H, W, 3) float array
        Linear RGB behind the fragments, opaque surfaces included.
    near, far : floats
        The camera's clip planes.
    depth_range : (2,) floats, optional
        Smallest and largest depth of the scene, for techniques that scale to it; the fragments' when absent.
    primitive_depth : (P,) float array, optional
        Depth of each primitive's centroid, by which `painter` sorts; `primitive` indexes it.

    Raises
    ------
    ValueError
        Arrays that do not fit each other, and numbers that are not finite or out of range, by name and index.

    Examples
    --------
    >>> two_layers = Fragments(
    ...     width=1, height=1, offsets=[0, 2], depth=[2.0, 1.0], color=[(0.5, 0, 0), (0, 0.25, 0)],
    ...     alpha=[0.5, 0.25], background=(1, 1, 1), near=0.1, far=10.0,
    ... )
    >>> two_layers
    Fragments(1 x 1 pixels, 2 fragments)
    >>> two_layers.pixel(0, 0)["depth"].tolist()
    [2.0, 1.0]
    """

    __slots__ = ("_handle",)

    def __init__(
        self,
        *,
        width: int,
        height: int,
        offsets: ArrayLike,
        depth: ArrayLike,
        color: ArrayLike,
        alpha: ArrayLike,
        primitive: ArrayLike | None = None,
        background: ArrayLike,
        near: float = 0.1,
        far: float = 100.0,
        depth_range: tuple[float, float] | None = None,
        primitive_depth: ArrayLike | None = None,
    ) -> None:
        columns, rows = count(width, "width"), count(height, "height")
        self._handle = _oitlab.Fragments(
            columns,
            rows,
            array(offsets, "offsets", np.int64, ("H*W+1",)),
            array(depth, "depth", np.float32, ("N",)),
            array(color, "color", np.float32, ("N", 3)),
            array(alpha, "alpha", np.float32, ("N",)),
            None if primitive is None else array(primitive, "primitive", np.uint32, ("N",)),
            _background(background, columns, rows),
            scalar(near, "near"),
            scalar(far, "far"),
            None if depth_range is None else _pair(depth_range),
            None
            if primitive_depth is None
            else array(primitive_depth, "primitive_depth", np.float64, ("P",)),
        )

    @classmethod
    def _wrap(cls, handle: _oitlab.Fragments) -> Fragments:
        self = cls.__new__(cls)
        self._handle = handle
        return self

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self._handle.width

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self._handle.height

    @property
    def offsets(self) -> NDArray[np.int64]:
        """(H*W+1,) int64: where each pixel's list starts."""
        return self._handle.offsets

    @property
    def depth(self) -> NDArray[np.float32]:
        """(N,) float32 view-space depths."""
        return self._handle.depth

    @property
    def color(self) -> NDArray[np.float32]:
        """(N, 3) float32 premultiplied linear RGB."""
        return self._handle.color

    @property
    def alpha(self) -> NDArray[np.float32]:
        """(N,) float32 in [0, 1]."""
        return self._handle.alpha

    @property
    def primitive(self) -> NDArray[np.uint32]:
        """(N,) uint32 primitive ids."""
        return self._handle.primitive

    @property
    def background(self) -> NDArray[np.float32]:
        """(3,) or (H, W, 3) float32 linear RGB behind the fragments."""
        return self._handle.background

    @property
    def near(self) -> float:
        """Depth of the near plane."""
        return self._handle.near

    @property
    def far(self) -> float:
        """Depth of the far plane."""
        return self._handle.far

    @property
    def depth_range(self) -> tuple[float, float]:
        """Smallest and largest depth that techniques scale to."""
        return self._handle.depth_range

    @property
    def primitive_depth(self) -> NDArray[np.float64] | None:
        """(P,) float64 depths of the primitives' centroids, or None."""
        return self._handle.primitive_depth

    @property
    def counts(self) -> NDArray[np.int64]:
        """(H, W) int64: number of fragments of each pixel."""
        return np.diff(self.offsets).reshape(self.height, self.width)

    @property
    def content_hash(self) -> str:
        """Hexadecimal digest of everything that the image depends on."""
        return self._handle.content_hash

    def pixel(self, x: int, y: int) -> dict[str, NDArray[Any]]:
        """Arrays `depth`, `color`, `alpha` and `primitive` of pixel (x, y), in arrival order.

        Raises
        ------
        IndexError
            Outside the image; negative coordinates do not count from the end.
        """
        if not (0 <= x < self.width and 0 <= y < self.height):
            raise IndexError(f"pixel ({x}, {y}) is outside the {self.width} x {self.height} image")
        start, end = self.offsets[y * self.width + x : y * self.width + x + 2]
        return {name: getattr(self, name)[start:end] for name in ("depth", "color", "alpha", "primitive")}

    def __len__(self) -> int:
        return len(self.depth)

    def __eq__(self, other: object) -> bool:
        return self.content_hash == other.content_hash if isinstance(other, Fragments) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.content_hash)

    def __repr__(self) -> str:
        return f"Fragments({self.width} x {self.height} pixels, {len(self)} fragments)"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, ({name: getattr(self, name) for name in _FIELDS},)


_FIELDS = (
    "width",
    "height",
    "offsets",
    "depth",
    "color",
    "alpha",
    "primitive",
    "background",
    "near",
    "far",
    "depth_range",
    "primitive_depth",
)


def _rebuild(keywords: dict[str, Any]) -> Fragments:
    return Fragments(**keywords)


def _background(value: ArrayLike, columns: int, rows: int) -> NDArray[np.float32]:
    try:
        flat = np.ndim(value) == 1
    except ValueError:  # ragged: refused by name below
        flat = True
    return array(value, "background", np.float32, (3,) if flat else (rows, columns, 3))


def _pair(value: tuple[float, float]) -> tuple[float, float]:
    low, high = array(value, "depth_range", np.float64, (2,)).tolist()
    return low, high
