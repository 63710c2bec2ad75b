"""Numbers without a place on an axis, zeros on a logarithmic one and infinities, are shown at its edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ._style import FONT_SIZE


@dataclass(frozen=True)
class Placed:
    """Which numbers of an axis are drawn where they are, and which at its lower and upper edge."""

    inside: NDArray[np.bool_]
    below: NDArray[np.bool_]
    above: NDArray[np.bool_]

    @property
    def missing(self) -> NDArray[np.bool_]:
        """NaN: drawn nowhere, and counted in a note."""
        return ~(self.inside | self.below | self.above)


def place(values: NDArray[np.float64], log: bool) -> Placed:
    """Sort numbers by where they can be drawn.

    Examples
    --------
    >>> found = place(np.array([0.0, 1.0, np.inf, np.nan]), log=True)
    >>> found.below.tolist(), found.above.tolist(), found.missing.tolist()
    ([True, False, False, False], [False, False, True, False], [False, False, False, True])
    """
    below = np.isneginf(values) | ((values == 0.0) & log)
    above = np.isposinf(values)
    return Placed(np.isfinite(values) & ~below, below, above)


def draw_at_edges(
    axes: Axes,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    log: tuple[bool, bool],
    floor: float = 0.0,
    **look: Any,
) -> list[str]:
    """Mark points that lack a place on one axis, or on both, at the edges; give what the marks mean.

    The marks are fixed to the edges, so that they never look like a number, whatever the limits become.
    """
    meanings = []
    across, up = place(x, log[0]), place(y, log[1])
    for index in np.flatnonzero(~(across.inside & up.inside) & ~(across.missing | up.missing)):
        at_x, at_y = across.inside[index], up.inside[index]
        place_x = float(x[index]) if at_x else float(across.above[index])
        place_y = float(y[index]) if at_y else float(up.above[index])
        marker = _marker(at_x, place_x, place_y)
        transforms = {
            (True, False): axes.get_xaxis_transform(),
            (False, True): axes.get_yaxis_transform(),
            (False, False): axes.transAxes,
        }
        axes.plot(
            place_x,
            place_y,
            marker=marker,
            markerfacecolor="white",
            markersize=5,
            linestyle="none",
            clip_on=False,
            zorder=5,
            transform=transforms[bool(at_x), bool(at_y)],
            gid="edge",
            **look,
        )
        for name, value, inside in (("x", x[index], at_x), ("y", y[index], at_y)):
            if not inside:
                least = (
                    f"{floor:g} or less".replace("e-0", "e-")
                    if name == "y" and value == 0 and floor
                    else f"{value:g}"
                )
                meanings.append(f"on the edge of {name}: {least}")
    return meanings


def _marker(at_x: bool, place_x: float, place_y: float) -> str:
    """Triangle that points out of the axes."""
    if at_x:
        return "^" if place_y else "v"
    return ">" if place_x else "<"


def meanings_note(meanings: list[str], missing: int) -> list[str]:
    """Explain marks on edges, and count what is drawn nowhere."""
    lines = ["; ".join(f"triangle {text}" for text in dict.fromkeys(meanings))] if meanings else []
    if missing:
        lines.append(f"not drawn: {missing:,} missing (NaN)")
    return lines


def small_print(axes: Axes, lines: list[str]) -> Any:
    """Write notes in small print below the axis's name; None where there are none."""
    if not lines:
        return None
    return axes.annotate(
        "\n".join(lines),
        (0.0, 0.0),
        xycoords=("axes fraction", axes.xaxis.label),
        xytext=(0.0, -2.0),
        textcoords="offset points",
        fontsize=FONT_SIZE,
        va="top",
        ha="left",
        color="#444444",
        annotation_clip=False,
        gid="note",
    )
