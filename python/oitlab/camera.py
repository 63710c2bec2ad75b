"""Where the scene is seen from."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oitlab
from ._convert import Vec3, array, scalar, vec3

CLIP_SLACK = 0.02
"""Room that clip planes leave before and behind what they enclose, as a share of its depth."""
NEAR_OVER_FAR = 1e-4
"""Smallest near / far of fitted clip planes: the near plane when something lies at or behind the eye."""


class Camera:
    """A pinhole or an orthographic camera.

    Depth is the distance along the forward axis (from `eye` to `target`), positive in front of the eye.

    Parameters
    ----------
    eye, target, up : (3,) floats
        Position, a point in the middle of the image, and a direction that points up in the image.
    fov_y : float, optional
        Vertical field of view in degrees, in (0, 180); 45 unless `ortho_height` is given.
    near, far : floats
        Depths of the clip planes, in scene units: 0 < near < far, for orthographic cameras, too.
    ortho_height : float, optional
        Height of the view in scene units; makes the camera orthographic, instead of `fov_y`.

    Raises
    ------
    ValueError
        Numbers out of range or not finite, eye = target, `up` parallel to the view, or both `fov_y` and
        `ortho_height`.

    Examples
    --------
    >>> Camera(eye=(0, 0, 2)).depths([(0, 0, 0), (1, 1, -3)]).tolist()
    [2.0, 5.0]
    """

    __slots__ = ("_eye", "_far", "_fov_y", "_handle", "_near", "_ortho_height", "_target", "_up")

    def __init__(
        self,
        eye: ArrayLike = (0.0, 0.0, 5.0),
        target: ArrayLike = (0.0, 0.0, 0.0),
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov_y: float | None = None,
        near: float = 0.1,
        far: float = 100.0,
        *,
        ortho_height: float | None = None,
    ) -> None:
        if fov_y is not None and ortho_height is not None:
            raise ValueError("give fov_y (a pinhole camera) or ortho_height (an orthographic one), not both")
        if fov_y is None and ortho_height is None:
            fov_y = 45.0
        self._eye = vec3(eye, "eye")
        self._target = vec3(target, "target")
        self._up = vec3(up, "up")
        self._fov_y = None if fov_y is None else scalar(fov_y, "fov_y")
        self._ortho_height = None if ortho_height is None else scalar(ortho_height, "ortho_height")
        self._near = scalar(near, "near")
        self._far = scalar(far, "far")
        self._handle = _oitlab.Camera(*self._state())

    def _state(self) -> tuple[Vec3, Vec3, Vec3, float | None, float | None, float, float]:
        return (
            self._eye,
            self._target,
            self._up,
            self._fov_y,
            self._ortho_height,
            self._near,
            self._far,
        )

    @property
    def eye(self) -> Vec3:
        """Position."""
        return self._eye

    @property
    def target(self) -> Vec3:
        """A point in the middle of the image."""
        return self._target

    @property
    def up(self) -> Vec3:
        """The direction that points up in the image."""
        return self._up

    @property
    def fov_y(self) -> float | None:
        """Vertical field of view in degrees, or None when orthographic."""
        return self._fov_y

    @property
    def ortho_height(self) -> float | None:
        """Height of the view in scene units, or None for a pinhole camera."""
        return self._ortho_height

    @property
    def near(self) -> float:
        """Depth of the near plane."""
        return self._near

    @property
    def far(self) -> float:
        """Depth of the far plane."""
        return self._far

    @classmethod
    def framing(
        cls,
        bounds: ArrayLike,
        *,
        direction: ArrayLike = (0.35, 0.25, 1.0),
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov_y: float = 45.0,
        ortho_height: float | Literal["fit"] | None = None,
        aspect: float = 16 / 9,
        margin: float = 1.05,
        points: ArrayLike | None = None,
    ) -> Camera:
        """Look at the middle of a box from outside, the box just inside the image and the clip planes.

        Parameters
        ----------
        bounds : (2, 3) floats
            Smallest and largest corner.
        direction : (3,) floats
            From the middle of the box towards the eye.
        up : (3,) floats
            Up in the image; an axis across the view is taken where it is parallel to `direction`.
        fov_y : float
            Degrees; unused when orthographic.
        ortho_height : float, "fit" or None
            None for a pinhole camera; otherwise the height of the view, "fit" choosing it.
        aspect : float
            Width over height of the image.
        margin : float >= 1
            How much further than needed the eye stands (or how much larger the view is).
        points : (N, 3) floats, optional
            What has to be in the image, when it does not fill the box; the box's corners when absent.

        Raises
        ------
        ValueError
            Corners that are not finite or not ordered, `direction` = 0, `aspect` <= 0, `margin` < 1.

        Examples
        --------
        >>> camera = Camera.framing([(-1, -1, -1), (1, 1, 1)], direction=(0, 0, 1), aspect=1.0, margin=1.0)
        >>> round(camera.eye[2], 3), round(camera.near, 3), round(camera.far, 3)
        (3.414, 2.366, 4.502)
        """
        low, high = _checked_bounds(bounds)
        fov, ratio, room = scalar(fov_y, "fov_y"), scalar(aspect, "aspect"), scalar(margin, "margin")
        if not (0 < ratio < np.inf and 1 <= room < np.inf and 0 < fov < 180):
            raise ValueError(
                f"aspect must be positive, margin >= 1 and fov_y in (0, 180); got {aspect}, {margin}, {fov_y}"
            )
        back = _unit(np.array(vec3(direction, "direction")), "direction")
        right, upward = _image_axes(np.array(vec3(up, "up")), back)
        middle = (low + high) / 2
        shown = _corners(low, high) if points is None else array(points, "points", np.float64, ("N", 3))
        x, y, towards = np.stack([right, upward, back]) @ (shown - middle).T
        half_height = room * max(np.abs(y).max(), np.abs(x).max() / ratio)
        if ortho_height is None:
            tangent = np.tan(np.radians(fov) / 2)
            reach = np.maximum(np.abs(y), np.abs(x) / ratio) / tangent
            distance = room * (towards + reach).max()
        else:
            distance = 2 * max(towards.max(), half_height)
        distance = max(distance, 1e-6 * np.abs(middle).max()) or 1.0
        height = (2 * half_height or 1.0) if ortho_height == "fit" else ortho_height
        near, far = _clip_planes(distance - towards)
        return cls(
            middle + distance * back,
            middle,
            upward,
            fov if height is None else None,
            near,
            far,
            ortho_height=height,
        )

    def depths(self, points: ArrayLike) -> NDArray[np.float64]:
        """Depths (N,) float64 of (N, 3) points."""
        offsets = array(points, "points", np.float64, ("N", 3)) - self._eye
        return offsets @ _unit(np.subtract(self._target, self._eye), "target - eye")

    def tightened(self, points: ArrayLike) -> Camera:
        """Put the clip planes just before and just behind (N, 3) points.

        Depth weights depend on the clip planes, so loose ones change a technique's image. The planes leave
        2 % of the depth as room; points at or behind the eye leave near = far / 10,000. Without points the
        camera is returned as it is.

        Examples
        --------
        >>> camera = Camera(eye=(0, 0, 10)).tightened([(0, 0, 0), (0, 0, 5)])
        >>> round(camera.near, 6), round(camera.far, 6)
        (4.9, 10.2)
        """
        depths = self.depths(points)
        if len(depths) == 0:
            return self
        near, far = _clip_planes(depths)
        return self.replace(near=near, far=far)

    def replace(self, **changes: Any) -> Camera:
        """Copy with some constructor arguments changed; `fov_y` and `ortho_height` replace each other.

        Examples
        --------
        >>> Camera().replace(ortho_height=2.0).fov_y is None
        True
        """
        keywords = {name: getattr(self, name) for name in _FIELDS}
        unknown = changes.keys() - keywords.keys()
        if unknown:
            raise TypeError(f"Camera has no {sorted(unknown)}; it has {', '.join(_FIELDS)}")
        for one, other in (("fov_y", "ortho_height"), ("ortho_height", "fov_y")):
            if changes.get(one) is not None and other not in changes:
                keywords[other] = None
        return Camera(**{**keywords, **changes})

    def __eq__(self, other: object) -> bool:
        return self._state() == other._state() if isinstance(other, Camera) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._state())

    def __repr__(self) -> str:
        shown = {name: getattr(self, name) for name in _FIELDS}
        return f"Camera({', '.join(f'{name}={value}' for name, value in shown.items() if value is not None)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild_camera, self._state()


_FIELDS = ("eye", "target", "up", "fov_y", "ortho_height", "near", "far")


def _rebuild_camera(
    eye: Vec3,
    target: Vec3,
    up: Vec3,
    fov_y: float | None,
    ortho_height: float | None,
    near: float,
    far: float,
) -> Camera:
    return Camera(eye, target, up, fov_y, near, far, ortho_height=ortho_height)


def _checked_bounds(bounds: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = array(bounds, "bounds", np.float64, (2, 3))
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
        raise ValueError(f"bounds must be a finite smallest and largest corner, got {low} and {high}")
    return low, high


def _corners(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    choice = np.indices((2, 2, 2)).reshape(3, 8).T
    return np.where(choice == 0, low, high)


def _unit(vector: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    length = np.linalg.norm(vector)
    if not 0 < length < np.inf:
        raise ValueError(f"{name} must be finite and not zero, got {tuple(vector.tolist())}")
    return vector / length


def _image_axes(
    up: NDArray[np.float64], back: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find unit vectors to the right and up in the image; some pair when `up` is along the view."""
    right = np.cross(_unit(up, "up"), back)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(np.eye(3)[np.abs(back).argmin()], back)
    right = _unit(right, "up")
    return right, np.cross(back, right)


def _clip_planes(depths: NDArray[np.float64]) -> tuple[float, float]:
    nearest, furthest = float(depths.min()), float(depths.max())
    far = (1 + CLIP_SLACK) * furthest if furthest > 0 else 1.0
    return max((1 - CLIP_SLACK) * nearest, NEAR_OVER_FAR * far), far
