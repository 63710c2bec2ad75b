"""What a technique gives: the image and what it cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import RLock
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from .diagnostics import Diagnostics

Floats: TypeAlias = NDArray[np.float32] | NDArray[np.float64]
_T = TypeVar("_T")
Later: TypeAlias = _T | Callable[[], _T]
"""A value, or a function without arguments that makes it."""


@dataclass(frozen=True)
class Stats:
    """What a frame cost.

    Times are wall-clock milliseconds; `raster_ms` covers the one rasterisation that all frames of a
    `render_many` call share. With `backend="gpu"`, `raster_ms` and `resolve_ms` are the device's own times of
    this frame's passes; set-up, compiling and readback are in `total_ms` of a single frame alone. Some
    drivers compile while they draw, so that a second frame tells more.

    `geometry_passes` and `bytes_per_pixel` describe a streaming GPU implementation
    of the technique, not this renderer; NaN where a technique of one's own does not say.
    """

    total_ms: float
    raster_ms: float
    resolve_ms: float
    fragments: int
    """Transparent fragments in the image."""
    depth_complexity_mean: float
    """Fragments per pixel, over all pixels of the image."""
    depth_complexity_max: int
    geometry_passes: float
    bytes_per_pixel: float
    dropped: int
    """Fragments that the technique's capacity had no room for."""
    skipped: dict[str, int]
    """How much work each shortcut avoided, by the shortcut's name."""
    backend: str
    threads: int
    invalid_weights: int = 0
    """Fragments for which a function of one's own gave no weight (a finite number above 0; the least weight
    took its place) or no share (a finite number from 0 up; it got none). Published ones are not looked at."""
    diagnostics: dict[str, int] = field(default_factory=dict)
    """Pixels that each kind of `Frame.diagnostics` befell; empty unless it was asked for."""


class _Cell(Generic[_T]):
    """A field that may be made later."""

    __slots__ = ("_lock", "given")

    def __init__(self, given: Later[_T]) -> None:
        self.given = given
        self._lock = RLock()  # a signal's handler may ask for what is being made

    def get(self) -> _T:
        """Make the value unless it is there; threads that ask at the same time get the same one."""
        with self._lock:
            if callable(self.given):
                self.given = self.given()
            return self.given


_FIELDS = (
    "color",
    "transmittance",
    "technique",
    "params",
    "inactive_params",
    "scene_hash",
    "stats",
    "first_depth",
    "fragment_count",
    "diagnostics",
)


class Frame:
    """An image by one technique. Arrays belong to the frame and are writable; row 0 is on top.

    A notebook shows a frame as a picture: 8-bit sRGB, clipped to [0, 1], as `write_png` writes it. One of
    more than 2048 pixels either way is reduced by a whole factor; pixels that are not finite are magenta.

    The fields themselves cannot be set; `replace` makes a changed copy. Frames compare by identity and can be
    pickled. What is given as a function is made when it is first asked for and then kept, so that a rendered
    frame costs nothing that nobody looks at; until then it keeps alive what it was rendered from.

    Parameters
    ----------
    color : (H, W, 3) float32 or float64, or a function that gives it
        Linear RGB (Rec. 709 primaries, D65), background included.
    transmittance : (H, W) or (H, W, 3), dtype of `color`, or a function that gives it
        The background's share, as the technique has it.
    technique : str
        The technique's id; aliases are resolved.
    params : dict, or a function that gives it
        Every parameter with its value, defaults included.
    inactive_params : frozenset of str, or a function that gives it, optional
        Names of those that do nothing under the others, such as `weight_k` with `weight="mb7"`.
    scene_hash : str, or a function that gives it
        `content_hash` of what was rendered.
    stats : Stats, or a function that gives them
    first_depth : (H, W) float32, or a function that gives it
        Depth of the nearest transparent fragment, +inf where there is none.
    fragment_count : (H, W) uint32, or a function that gives it
    diagnostics : Diagnostics, optional
        What went wrong with each pixel's numbers, where that was asked for.

    Examples
    --------
    >>> import oitlab
    >>> frame = oitlab.render(oitlab.scenes.squares(width=32, height=18), "wboit")
    >>> frame.first_depth.shape, frame.first_depth is frame.first_depth
    ((18, 32), True)
    >>> frame.replace(technique="mine").technique
    'mine'
    """

    __slots__ = tuple(f"_{name}" for name in _FIELDS)

    def __init__(
        self,
        *,
        color: Later[Floats],
        transmittance: Later[Floats],
        technique: str,
        params: Later[dict[str, Any]],
        scene_hash: Later[str],
        stats: Later[Stats],
        first_depth: Later[NDArray[np.float32]],
        fragment_count: Later[NDArray[np.uint32]],
        diagnostics: Diagnostics | None = None,
        inactive_params: Later[frozenset[str]] = frozenset(),
    ) -> None:
        self._color: _Cell[Floats] = _Cell(color)
        self._transmittance: _Cell[Floats] = _Cell(transmittance)
        self._technique = technique
        self._params = _Cell(params)
        self._inactive_params = _Cell(inactive_params)
        self._scene_hash = _Cell(scene_hash)
        self._stats = _Cell(stats)
        self._first_depth = _Cell(first_depth)
        self._fragment_count = _Cell(fragment_count)
        self._diagnostics = diagnostics or Diagnostics({}, technique, asked=diagnostics is not None)

    @property
    def color(self) -> Floats:
        """(H, W, 3) linear RGB, background included."""
        return self._color.get()

    @property
    def transmittance(self) -> Floats:
        """(H, W) or (H, W, 3): the background's share."""
        return self._transmittance.get()

    @property
    def technique(self) -> str:
        """The technique's id."""
        return self._technique

    @property
    def params(self) -> dict[str, Any]:
        """Every parameter with its value."""
        return self._params.get()

    @property
    def inactive_params(self) -> frozenset[str]:
        """Names of the parameters that do nothing under the others."""
        return self._inactive_params.get()

    @property
    def scene_hash(self) -> str:
        """`content_hash` of what was rendered."""
        return self._scene_hash.get()

    @property
    def stats(self) -> Stats:
        """What the frame cost."""
        return self._stats.get()

    @property
    def first_depth(self) -> NDArray[np.float32]:
        """(H, W) float32 depth of the nearest transparent fragment, +inf where there is none."""
        return self._first_depth.get()

    @property
    def fragment_count(self) -> NDArray[np.uint32]:
        """(H, W) uint32: transparent fragments of each pixel."""
        return self._fragment_count.get()

    @property
    def diagnostics(self) -> Diagnostics:
        """Images of what went wrong, by kind; none unless rendered with `diagnostics=True`."""
        return self._diagnostics

    def replace(self, **changes: Any) -> Frame:
        """Copy with some constructor arguments changed; what nobody asked for yet stays unmade.

        Raises
        ------
        TypeError
            A name that the constructor does not have.
        """
        unknown = changes.keys() - set(_FIELDS)
        if unknown:
            raise TypeError(f"Frame has no {sorted(unknown)}; it has {', '.join(_FIELDS)}")
        fields = {name: getattr(self, f"_{name}") for name in _FIELDS}
        given = {name: item.given if isinstance(item, _Cell) else item for name, item in fields.items()}
        return Frame(**{**given, **changes})

    def __repr__(self) -> str:
        height, width = self.color.shape[:2]
        return f"Frame({self.technique!r}, {self.params}, {width} x {height}, {self.stats.total_ms:.1f} ms)"

    def _repr_png_(self) -> bytes | None:
        from .png import picture

        return picture(self.color)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, ({name: getattr(self, name) for name in _FIELDS},)


def _rebuild(keywords: dict[str, Any]) -> Frame:
    return Frame(**keywords)
