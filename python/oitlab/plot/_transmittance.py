"""T(z) of a pixel, exact and as techniques reconstruct it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from .._convert import array, flag, integer
from .._palette import BLACK, GREY, series
from ..fragments import Fragments
from ..inspection import transmittance as evaluate
from ..rendering import Variant, capture
from ..scene import Scene
from ._edges import place, small_print
from ._style import (
    Width,
    count_text,
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
from ._variants import named_variants

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SAMPLES = 400
_AROUND = 0.06
"""How much of the fragments' depth range is shown before the nearest and behind the farthest."""


def transmittance(
    source: Scene | Fragments,
    techniques: Variant | Sequence[Variant] | Mapping[str, Variant],
    pixel: tuple[int, int] | None = None,
    *,
    depths: ArrayLike | None = None,
    logy: bool = False,
    width: Width = "single",
    ax: Axes | None = None,
) -> Figure:
    """Draw a pixel's transmittance function, the exact steps behind what techniques make of them.

    T(z) is the share of light that passes everything nearer than z. Ticks on the upper edge are fragments.
    Values outside [0, 1] (ringing) are shown as they are; on a logarithmic axis what is 0 or less is drawn
    at the lower edge.

    Parameters
    ----------
    source : Scene or Fragments
        A scene is captured first; capture it yourself to look at many pixels.
    techniques : technique, (technique, params), several of them, or a mapping of labels to them
        Those that reconstruct a transmittance function.
    pixel : (x, y), optional
        Column from the left and row from the top; left out, the first of those with the most fragments.
    depths : (N,) floats >= 0, optional
        Where to evaluate, in scene units. Left out: both sides of every fragment, and 400 depths from a
        little before the nearest to a little behind the farthest.
    logy : bool
        Logarithmic transmittance.
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
        A pixel outside the image or without fragments, bad depths, no techniques, a technique without a
        transmittance function, or params that `render` would refuse.

    Examples
    --------
    >>> import oitlab
    >>> fragments = oitlab.capture(oitlab.scenes.blades(width=32, height=18, count=40))
    >>> figure = oitlab.plot.transmittance(fragments, ["avsm", ("fourier_opacity_maps", {"frequencies": 4})])
    >>> [line.get_label() for line in figure.axes[0].lines]
    ['exact', 'avsm', 'fourier_opacity_maps frequencies=4']
    """
    given = named_variants(techniques, "techniques")
    if not isinstance(source, Scene | Fragments):
        raise ValueError(f"source must be a Scene or Fragments, got {type(source).__name__}")
    log = flag(logy, "logy")
    fragments = capture(source) if isinstance(source, Scene) else source
    where = _pixel(fragments, pixel)
    at = fragments.pixel(*where)["depth"]
    z = _depths(at) if depths is None else np.sort(array(depths, "depths", np.float32, ("N",)))
    if len(z) == 0:
        raise ValueError("depths is empty")
    curves = {label: evaluate(fragments, *variant, pixel=where, depths=z) for label, variant in given.items()}
    exact = next(iter(curves.values())).exact
    with style():
        figure, axes = new_axes(ax, width, 0.72 if inches(width) < 5 else 0.5)
        if log:
            axes.set_yscale("log")
        lines = [exact, *(curve.reconstructed for curve in curves.values())]
        axes.set_xlim(*((float(z[0]), float(z[-1])) if z[-1] > z[0] else limits_of(z, False)))
        axes.set_ylim(*_shown(lines, log))
        axes.plot(z, _drawn(exact, log), color=BLACK, linewidth=2.4, alpha=0.35, label="exact", gid="exact")
        for index, (label, curve) in enumerate(curves.items()):
            color, dash, _ = series(index)
            look: Any = dash
            shown = _drawn(curve.reconstructed, log)
            axes.plot(z, shown, color=color, linestyle=look, label=legend_name(label), gid="reconstructed")
        axes.vlines(
            at, 0.97, 1.0, transform=axes.get_xaxis_transform(), color=GREY, linewidth=0.5, gid="fragments"
        )
        axes.set(xlabel="view depth z (scene units)", ylabel="transmittance T(z) (share of light)")
        if log:
            log_axis(axes, "y")
        printed = [f"pixel (x={where[0]}, y={where[1]}), {count_text(len(at), 'fragment')}: ticks on top"]
        if log and any((values <= 0).any() for values in lines):
            printed.append("0 or less: at the lower edge")
        small_print(axes, printed)
        legend = legend_above(axes, *axes.get_legend_handles_labels(), None)
        grow(figure, ax, len(printed) + legend)
        finish(axes)
    return figure


def _pixel(fragments: Fragments, pixel: tuple[int, int] | None) -> tuple[int, int]:
    counts = fragments.counts
    y, x = map(int, np.unravel_index(int(np.argmax(counts)), counts.shape))
    if pixel is not None:
        deepest = f"the deepest pixel is ({x}, {y})"
        try:
            x, y = (integer(value, "pixel") for value in pixel)
        except (TypeError, ValueError):
            raise ValueError(f"pixel must be a pair (x, y), got {pixel!r}") from None
        if not (0 <= x < fragments.width and 0 <= y < fragments.height):
            raise ValueError(f"pixel ({x}, {y}) is outside the {fragments.width} x {fragments.height} image")
        if counts[y, x] == 0:
            raise ValueError(f"pixel ({x}, {y}) has no fragments; {deepest}")
    if counts[y, x] == 0:
        raise ValueError("source has no fragments")
    return x, y


def _depths(at: NDArray[np.float32]) -> NDArray[np.float32]:
    low, high = float(at.min()), float(at.max())
    room = _AROUND * (high - low) or 0.05 * high
    between = np.linspace(max(0.0, low - room), high + room, _SAMPLES, dtype=np.float32)
    return np.unique(np.concatenate([between, at, np.nextafter(at, np.float32(np.inf))]))


def _shown(lines: list[NDArray[np.float64]], log: bool) -> tuple[float, float]:
    values = np.concatenate(lines)
    if log:
        low, high = limits_of(np.append(values, 1.0), True)
        return low, high
    low, high = min(0.0, float(values.min())), max(1.0, float(values.max()))
    return low - 0.03 * (high - low), high + 0.03 * (high - low)


def _drawn(values: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """Move what a logarithmic axis has no place for below its lower edge: the line leaves the axes."""
    return np.where(place(values, log).inside & (values > 0), values, 1e-300) if log else values
