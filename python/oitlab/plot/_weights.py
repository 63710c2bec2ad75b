"""Weight functions against depth [McGuire2013, Fig. 3]."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from .._convert import array, flag, scalar
from .._palette import DASHES, series
from ..fragments import Fragments
from ..registry import techniques
from ..rendering import WeightWarning, render
from ._edges import small_print
from ._style import (
    Width,
    finish,
    grow,
    inches,
    legend_above,
    legend_name,
    limits_of,
    log_axis,
    new_axes,
    style,
)
from ._table import several
from ._variants import value_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Weight: TypeAlias = str | Callable[..., Any] | Mapping[str, Any] | tuple[Any, Mapping[str, Any]]
"""What the param `weight` takes; alone, as a dict of params, or with further params."""

MCGUIRE = ("mb7", "mb8", "mb9", "mb10")
_DEPTHS = (0.1, 500.0)
"""The range that MB13 gives for its weights, and Fig. 3 shows."""
_SAMPLES = 600
_FAINT = (1e-6, 1e-12, 1e-24, 1e-36)
"""Alphas of the fragment that shows the absolute size of a weight, of up to 1e30; see `_absolute`."""
_LEAST = 1e-30
"""What `wboit` takes for a weight of one's own that is 0, negative or no number."""
_PARTS = ("weight", "weight_k", "weight_scale", "weight_shift", "near", "far")
"""Params of `wboit` that decide a weight, beside `weight.<name>`; others decide what is made of it."""
_LISTING3 = 1e-4
"""The sum of weights by which MB13's Listing 3 divides at least."""


def weight_curves(
    weights: Weight | Sequence[Weight] | Mapping[str, Weight] = MCGUIRE,
    *,
    z: ArrayLike | None = None,
    alpha: float | Sequence[float] = 1.0,
    near: float = 0.1,
    far: float = 500.0,
    logx: bool = True,
    logy: bool = True,
    width: Width = "single",
    ax: Axes | None = None,
) -> Figure:
    """Draw depth weights against depth: Fig. 3 of [McGuire2013], with its weights by default.

    No formula is written here: the weights are those that `wboit` uses, found from images of two fragments.

    Parameters
    ----------
    weights : one, several, or a mapping of labels to weights
        A weight is whatever the param `weight` of `wboit` takes ("mb7", ...), a dict of params (`{"weight":
        "inv_pow", "weight_k": 5}`), or a pair of both (`("inv_pow", {"weight_k": 5})`). Params are `weight`,
        `weight.<name>`, `weight_k`, `weight_scale`, `weight_shift`, `near` and `far`. Where a function of
        your own is no weight (0, negative, no number, or 1e-30 and less) its line has a gap.
    z : (N,) floats > 0, optional
        View-space depths, in scene units. Left out: 600 from 0.1 to 500, evenly spaced on the axis.
    alpha : float or several, in (0, 1]
        Coverage of the weighed fragment. Each value gets a dash of its own if there are several.
    near, far : float
        Clip planes, in scene units, for weights that see window depth (mb10, i3d16).
    logx, logy : bool
        Logarithmic axes.
    width : {"single", "double"} or float
        Of the figure in print: a column (3.3 inches), a page (7), or inches.
    ax : matplotlib.axes.Axes, optional
        Draw there instead of in a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        Depths or alphas out of range; no weights, or two of one label; a param that is no part of a weight,
        such as `format`; params that `wboit` would refuse.

    Examples
    --------
    >>> import oitlab
    >>> figure = oitlab.plot.weight_curves(["mb7", ("inv_pow", {"weight_k": 5})], z=[1.0, 10.0])
    >>> [line.get_label() for line in figure.axes[0].lines]
    ['mb7', 'inv_pow, weight_k=5']
    >>> [round(float(w), 8) for w in figure.axes[0].lines[1].get_ydata()]
    [1.0, 1e-05]
    """
    given = _named(weights)
    logs = flag(logx, "logx"), flag(logy, "logy")
    depths = _depths(z, logs[0])
    coverages = _coverages(alpha)
    view = {"near": scalar(near, "near"), "far": scalar(far, "far")}
    curves = [
        (name, coverage, evaluate(params, depths, coverage, **view))
        for name, params in given.items()
        for coverage in coverages
    ]
    with style():
        figure, axes = new_axes(ax, width, 0.72 if inches(width) < 5 else 0.5)
        axes.set_xscale("log" if logs[0] else "linear")
        axes.set_yscale("log" if logs[1] else "linear")
        axes.set_xlim(*limits_of(depths, logs[0], 0.0) if len(depths) == 1 else (depths.min(), depths.max()))
        axes.set_ylim(*limits_of([w for _, _, values in curves for w in values], logs[1]))
        for name, coverage, values in curves:
            _draw(
                axes, depths, values, (list(given).index(name), name), (coverages.index(coverage), coverages)
            )
        axes.set(xlabel="view depth z (scene units)", ylabel=_weight_label(coverages))
        for which, log in zip(("x", "y"), logs, strict=True):
            if log:
                log_axis(axes, "x" if which == "x" else "y")
        has_gaps = any(np.isnan(values).any() for _, _, values in curves)
        notes = ["gaps: no weight (0 or less, or no number)"] if has_gaps else []
        small_print(axes, notes)
        grow(figure, ax, len(notes) + legend_above(axes, *axes.get_legend_handles_labels(), None))
        finish(axes)
    return figure


def evaluate(
    params: Mapping[str, Any], z: NDArray[np.float32], alpha: float, near: float, far: float
) -> NDArray[np.float64]:
    """Give the weights that `wboit` has under these params, from images; NaN where there is none.

    They are exact to float32's rounding, in which a function of one's own is evaluated.

    A pixel of two fragments with red and green light of 1 shows the ratio of their weights, whatever their
    coverage: red is w1 / sum(w a) times what is covered, green w2 / sum(w a) times the same. The green one is
    the same in all pixels, and its own weight is known from `_absolute`.

    Examples
    --------
    >>> evaluate({"weight": "fig1"}, np.array([5.0, 15.0], np.float32), 0.5, 0.1, 100.0).round(6).tolist()
    [0.01, 0.0025]
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeightWarning)  # gaps say it, and where
        faint, known = _anchor(params, float(z[0]), near, far)
        found = _ratios(params, z, (alpha, faint), near, far) * known
    return np.where(np.abs(found / _LEAST - 1.0) < 1e-5, np.nan, found)


def _ratios(
    params: Mapping[str, Any], z: NDArray[np.float32], alphas: tuple[float, float], near: float, far: float
) -> NDArray[np.float64]:
    """Divide the weight at each depth by that at the first, each with its own alpha."""
    count = len(z)
    depth = np.stack([z, np.full(count, z[0])], axis=1).ravel()
    coverage = np.tile(np.array(alphas, np.float32), count)
    color = np.tile(np.eye(3, dtype=np.float32)[:2], (count, 1))
    offsets = np.arange(count + 1) * 2
    pixels = Fragments(
        width=count, height=1, offsets=offsets, depth=depth, color=color, alpha=coverage,
        background=(0, 0, 0), near=near, far=far,
    )  # fmt: skip
    image = _wboit(pixels, params)[0]
    return np.asarray(image[:, 0] / image[:, 1])


def _anchor(params: Mapping[str, Any], z: float, near: float, far: float) -> tuple[float, float]:
    """Give the alpha of a fragment whose weight can be told, and that weight."""
    for faint in _FAINT:
        known = _absolute(params, z, faint, near, far)
        if known is not None:
            return faint, known
    raise ValueError(f"weights {dict(params)!r} are too large for their absolute size to be found")


def _wboit(pixels: Fragments, params: Mapping[str, Any]) -> NDArray[np.float64]:
    """Render in float64 throughout: steep weights leave float32's range between near and far."""
    stored = {**params, "format": "f64"}
    frame = render(pixels, "wboit", stored, skip=False, dtype="float64")
    return np.asarray(frame.color, np.float64)


def _absolute(params: Mapping[str, Any], z: float, alpha: float, near: float, far: float) -> float | None:
    """Find the weight of one faint fragment; None if it is not small enough to tell.

    Any constant factor cancels in the average, except where Listing 3 of [McGuire2013] is followed to the
    letter: the sum of weights is raised to 1e-4 before it divides. Light of 1 then comes out as w / 1e-4
    times the coverage.
    """
    pixel = Fragments(
        width=1, height=1, offsets=[0, 1], depth=[z], color=[(1, 1, 1)], alpha=[alpha],
        background=(0, 0, 0), near=near, far=far,
    )  # fmt: skip
    seen = float(_wboit(pixel, {**params, "listing3_clamp": True})[0, 0, 0])
    covered = float(pixel.alpha[0])
    weight = seen / covered * _LISTING3
    return weight if weight * covered < 0.5 * _LISTING3 else None


def _named(weights: Any) -> dict[str, dict[str, Any]]:
    """Give label to params of wboit."""
    if isinstance(weights, Mapping) and not _is_params(weights):
        given = [(str(label), _params(weight)) for label, weight in weights.items()]
    else:
        all_weights = [weights] if _is_one(weights) else several(weights, "weights")
        given = [(_label(params), params) for params in map(_params, all_weights)]
    if not given:
        raise ValueError("weights is empty")
    labels = [label for label, _ in given]
    for label, params in given:
        _refuse_other_params(label, params)
    twice = [label for label in labels if labels.count(label) > 1]
    if twice:
        raise ValueError(f"weights has {twice[0]!r} twice; name them by a mapping of labels to weights")
    return dict(given)


def _refuse_other_params(label: str, params: Mapping[str, Any]) -> None:
    for key in params:
        if key not in _PARTS and not str(key).startswith("weight."):
            raise ValueError(
                f"weights: {label!r} has the param {key!r}, which is no part of a weight; those that are: "
                f"{', '.join(_PARTS)}, weight.<name>"
            )


def _is_params(value: Mapping[Any, Any]) -> bool:
    return "weight" in value and all(
        str(key).partition(".")[0] in {param.name for param in techniques()["wboit"].params} for key in value
    )


def _is_one(weights: Any) -> bool:
    pair = isinstance(weights, tuple) and len(weights) == 2 and isinstance(weights[1], Mapping)
    return pair or isinstance(weights, str | Mapping) or callable(weights)


def _params(weight: Any) -> dict[str, Any]:
    if isinstance(weight, Mapping):
        return dict(weight)
    if isinstance(weight, tuple) and len(weight) == 2 and isinstance(weight[1], Mapping):
        return {"weight": weight[0], **weight[1]}
    if isinstance(weight, str) or callable(weight):
        return {"weight": weight}
    raise ValueError(f"a weight is a name, a dict of params, or a pair of both, got {weight!r}")


def _label(params: Mapping[str, Any]) -> str:
    further = [f"{key}={value_name(value)}" for key, value in params.items() if key != "weight"]
    return ", ".join([value_name(params.get("weight", "mb7")), *further])


def _depths(z: ArrayLike | None, log: bool) -> NDArray[np.float32]:
    if z is None:
        spaced = np.geomspace if log else np.linspace
        return np.asarray(spaced(*_DEPTHS, _SAMPLES), np.float32)
    depths = array(z, "z", np.float32, ("N",))
    if len(depths) == 0:
        raise ValueError("z is empty")
    if not (np.isfinite(depths) & (depths > 0)).all():
        index = int(np.argmin(np.isfinite(depths) & (depths > 0)))
        raise ValueError(f"z[{index}] must be a finite depth > 0, got {depths[index]}")
    return np.asarray(np.sort(depths))


def _coverages(alpha: Any) -> list[float]:
    values = [alpha] if np.ndim(alpha) == 0 else several(alpha, "alpha")
    coverages = [scalar(value, "alpha") for value in values]
    if not coverages or len(set(coverages)) < len(coverages):
        raise ValueError(f"alpha must be a number or several different ones, got {alpha!r}")
    for value in coverages:
        if not 0.0 < value <= 1.0:
            raise ValueError(f"alpha must be in (0, 1], got {value}")
    if len(coverages) > len(DASHES):
        raise ValueError(f"alpha: at most {len(DASHES)} values can be told apart, got {len(coverages)}")
    return coverages


def _draw(
    axes: Axes,
    z: NDArray[np.float32],
    values: NDArray[np.float64],
    weight: tuple[int, str],
    alpha: tuple[int, list[float]],
) -> None:
    color, dash, _ = series(weight[0])
    several = len(alpha[1]) > 1
    look: Any = DASHES[alpha[0]] if several else dash
    label = f"{weight[1]}, α = {alpha[1][alpha[0]]:g}" if several else weight[1]
    axes.plot(z, values, color=color, linestyle=look, label=legend_name(label), gid="weight")


def _weight_label(coverages: list[float]) -> str:
    return "weight w(z, α)" if len(coverages) > 1 else f"weight w(z, α = {coverages[0]:g})"
