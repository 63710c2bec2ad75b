"""Heat maps whose scale is stated: depth complexity, and errors against the exact image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray

from .._convert import choice, flag, integer, scalar
from .._image import ImageLike
from ..fragments import Fragments
from ..frame import Frame
from ..metrics import error_map as evaluate
from ._images import Panels, named_images, reduced_to
from ._style import Width, count_text, inches, new_axes, number, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Metric = Literal["squared", "absolute", "delta_e_2000", "delta_e_itp", "flip"]
_SCALES: dict[str, tuple[tuple[float, float], bool, str]] = {
    "squared": ((1e-8, 1.0), True, "squared error, mean of R, G, B (linear RGB, squared)"),
    "absolute": ((1e-4, 1.0), True, "largest error of R, G, B (linear RGB, 1 = white)"),
    "delta_e_2000": ((0.0, 10.0), False, "CIEDE2000 (ΔE, 1 = just noticeable)"),
    "delta_e_itp": ((0.0, 10.0), False, "ΔE ITP (1 = just noticeable)"),
    "flip": ((0.0, 1.0), False, "FLIP (0 to 1)"),
}
"""Limits, whether logarithmic, and what the colours mean; fixed, so that figures can be compared."""
_ERRORS = "magma"
_COUNTS = "viridis"
_DISCRETE = 12
"""Up to so many fragments per pixel each number has a colour of its own."""
_EMPTY = "#FFFFFF"


def depth_complexity(
    source: Frame | Fragments,
    *,
    log: bool = False,
    limit: int | None = None,
    width: Width = "single",
    ax: Axes | None = None,
) -> Figure:
    """Draw how many transparent fragments each pixel has.

    Pixels without any are white. Up to 12 fragments each number has its own colour. Images with more pixels
    than the figure has dots in print are reduced by a whole factor, of which the largest number is shown.

    Parameters
    ----------
    source : Frame or Fragments
        Whose pixels are counted.
    log : bool
        Logarithmic colours.
    limit : int >= 1, optional
        Number of fragments with the last colour; more look the same, and the colour bar says so. Left out:
        the largest there is.
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
        Another kind of source, or a bad limit.

    Examples
    --------
    >>> import oitlab
    >>> fragments = oitlab.capture(oitlab.scenes.blades(width=32, height=18, count=40))
    >>> figure = oitlab.plot.depth_complexity(fragments)
    >>> figure.axes[1].get_ylabel()
    'fragments per pixel (number)'
    """
    if isinstance(source, Fragments):
        counts: NDArray[Any] = source.counts
    elif isinstance(source, Frame):
        counts = source.fragment_count
    else:
        raise ValueError(f"source must be a Frame or Fragments, got {type(source).__name__}")
    largest = int(counts.max())
    top = max(1, largest) if limit is None else integer(limit, "limit")
    if top < 1:
        raise ValueError(f"limit must be >= 1, got {limit}")
    norm, colors = _count_scale(top, flag(log, "log"))
    height, across = counts.shape
    with style():
        figure, axes = new_axes(ax, width, min(1.6, 0.8 * height / across + 0.14))
        panels = Panels([axes], 0.8 * inches(width))
        panels.draw(
            axes, np.ma.masked_equal(reduced_to(counts.astype(float), panels.dots, np.max), 0), norm, colors
        )
        extend: Any = "max" if largest > top else "neither"
        bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, extend=extend, fraction=0.06, pad=0.03)
        bar.set_label("fragments per pixel (number)")
        _count_ticks(bar, top, norm)
        mean = float(counts.mean())
        empty = count_text(int((counts == 0).sum()), "pixel")
        said = f"mean {number(mean)}, largest {largest:,}; white: {empty} without"
        panels.caption(axes, said)
    return figure


def error_map(
    frames: ImageLike | Sequence[ImageLike] | Mapping[str, ImageLike],
    reference: ImageLike,
    metric: Metric = "squared",
    *,
    limits: tuple[float, float] | None = None,
    log: bool | None = None,
    columns: int | None = None,
    luminance: float = 100.0,
    pixels_per_degree: float | None = None,
    width: Width | None = None,
) -> Figure:
    r"""Draw where images differ from the exact one, all on one stated scale.

    The scale is the same for every figure unless you change it: 1e-8 to 1 for "squared", 1e-4 to 1 for
    "absolute", both logarithmic, 0 to 10 for the ΔE, 0 to 1 for "flip". The colour bar's ends are pointed
    where errors lie outside. Under each map stand its mean and its largest error. Images with more pixels
    than the map has dots in print are reduced by a whole factor, of which the largest error is shown, so
    that no isolated one vanishes.

    Parameters
    ----------
    frames : Frame or (H, W, 3) array-like, several of them, or a mapping of labels to them
        Linear RGB.
    reference : Frame or (H, W, 3) array-like
        The exact image.
    metric : {"squared", "absolute", "delta_e_2000", "delta_e_itp", "flip"}
        As in `oitlab.error_map`.
    limits : (low, high), optional
        Errors with the first and the last colour.
    log : bool, optional
        Logarithmic colours; needs low > 0.
    columns : int >= 1, optional
        Maps side by side; left out, up to three.
    luminance, pixels_per_degree
        As in `oitlab.error_map`.
    width : {"single", "double"} or float, optional
        Of the figure in print: a column (3.3 inches), a page (7), or inches. Left out: a column for one map.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        As `oitlab.error_map`; no frames, bad limits.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=40)
    >>> exact, wboit, mlab = oitlab.render_many(scene, ["a_buffer", "wboit", "mlab"])
    >>> figure = oitlab.plot.error_map([wboit, mlab], exact, "absolute")
    >>> [axes.get_title() for axes in figure.axes[:2]], figure.axes[2].get_ylabel().split("\n")
    (['wboit', 'mlab'], ['largest error of R, G, B', '(linear RGB, 1 = white)'])
    """
    images = named_images(frames, "frames")
    choice(metric, "metric", Metric)
    options: dict[str, Any] = {"luminance": luminance, "pixels_per_degree": pixels_per_degree}
    maps = {label: evaluate(image, reference, metric, **options) for label, image in images.items()}
    norm, text = _error_scale(metric, limits, log)
    across = min(len(maps), 3) if columns is None else integer(columns, "columns")
    if across < 1:
        raise ValueError(f"columns must be >= 1, got {columns}")
    size = inches(("single" if across == 1 else "double") if width is None else width)
    with style():
        panels = Panels.grid(maps, across, size)
        for axes, (label, values) in zip(panels.axes, maps.items(), strict=True):
            shown = reduced_to(values, panels.dots, np.max)
            panels.draw(axes, np.maximum(shown, norm.vmin), norm, colormaps[_ERRORS])
            axes.set_title(label)
            panels.caption(
                axes, f"mean {number(float(values.mean()))}, largest {number(float(values.max()))}"
            )
        every = np.concatenate([values.ravel() for values in maps.values()])
        outside = bool((every < norm.vmin).any()), bool((every > norm.vmax).any())
        ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
        panels.bar(ScalarMappable(norm, colormaps[_ERRORS]), text, ends[outside])
    return panels.figure


def _count_scale(top: int, log: bool) -> tuple[Normalize, Colormap]:
    colors = colormaps[_COUNTS].with_extremes(bad=_EMPTY)
    if log and top > 1:
        return LogNorm(1, top, clip=True), colors
    if top <= _DISCRETE:
        return BoundaryNorm(np.arange(0.5, top + 1.0), colors.N, extend="neither", clip=True), colors
    return Normalize(1, top, clip=True), colors


def _count_ticks(bar: Any, top: int, norm: Normalize) -> None:
    if isinstance(norm, BoundaryNorm):
        bar.set_ticks(range(1, top + 1), labels=[str(n) for n in range(1, top + 1)])
        bar.ax.minorticks_off()
    elif isinstance(norm, LogNorm):
        ticks = [n for power in range(10) for n in (10**power, 2 * 10**power, 5 * 10**power) if n <= top]
        bar.set_ticks(ticks if len(ticks) < 10 else ticks[::3], labels=None)
        bar.ax.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        bar.ax.minorticks_off()
    else:
        bar.ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))


def _error_scale(metric: str, limits: tuple[float, float] | None, log: bool | None) -> tuple[Any, str]:
    (low, high), logarithmic, text = _SCALES[metric]
    logarithmic = logarithmic if log is None else flag(log, "log")
    if limits is not None:
        try:
            low, high = (scalar(value, "limits") for value in limits)
        except (TypeError, ValueError):
            raise ValueError(f"limits must be two numbers, got {limits!r}") from None
    elif logarithmic and low == 0.0:
        low = 1e-3 * high
    elif not logarithmic:
        low = 0.0
    if not (np.isfinite([low, high]).all() and low < high and (low > 0 or not logarithmic)):
        least = "0 < low < high" if logarithmic else "low < high"
        raise ValueError(f"limits must be finite with {least}, got ({low:g}, {high:g})")
    return (LogNorm if logarithmic else Normalize)(low, high, clip=True), text
