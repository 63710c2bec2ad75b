"""What the tests of plots share: tables by hand, figures of each kind, and what can be read off a figure."""

from collections.abc import Callable
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.text import Text

import oitlab
from oitlab import _palette, plot

PALETTE = {*_palette.SERIES, _palette.GREY}
"""Okabe and Ito's colours without yellow, and the grey of what is in the background."""
SMALLEST_TYPE = 7.0
WEIGHT_TOLERANCE = 2e-6
"""Weights are found from sums in float32, each rounded to 6e-8, and are themselves computed in it."""

_Make = Callable[[], Figure]


def seeds() -> pd.DataFrame:
    """Errors by hand: two techniques, three sizes, three seeds; and one technique without sizes."""
    rows = [
        {
            "scene": "blades",
            "technique": name,
            "samples": size,
            "seed": seed,
            "mse": factor * (seed + 1) / size,
        }
        for name, factor in (("slab", 0.1), ("stochastic_transparency", 0.3))
        for size in (1, 4, 16)
        for seed in (0, 1, 2)
    ]
    return pd.DataFrame([*rows, {"scene": "blades", "technique": "wboit", "mse": 0.02}])


def prices() -> pd.DataFrame:
    """Variants whose front is b, d, f: cheaper ones err more."""
    return pd.DataFrame(
        {
            "technique": ["wboit", "mlab", "slab", "lwboit", "a_buffer"],
            "total_ms": [1.0, 2.0, 4.0, 8.0, 16.0],
            "bytes_per_pixel": [20.0, 80.0, 40.0, 160.0, 320.0],
            "mse": [1e-2, 1e-3, 2e-3, 1e-4, 0.0],
        }
    )


def every_kind(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> dict[str, Figure]:
    """One figure of each kind."""
    exact, *others = frames
    return {
        "convergence": plot.convergence(seeds(), "samples"),
        "pareto": plot.pareto(prices()),
        "weight_curves": plot.weight_curves(),
        "depth_complexity": plot.depth_complexity(fragments),
        "error_map": plot.error_map(others, exact),
        "transmittance": plot.transmittance(fragments, ["avsm", "mboit_power"]),
        "strip": plot.strip(others, [(20, 10, 8, 4), (10, 5, 6, 6)], reference=exact),
        "axes_table": plot.axes_table(),
    }


def texts(figure: Figure) -> list[Text]:
    """Every text that is drawn."""
    figure.draw_without_rendering()
    unseen = {
        id(label)
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        for label in (tick.label1, tick.label2)
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    found = figure.findobj(Text)
    return [t for t in found if t.get_visible() and t.get_text().strip() and id(t) not in unseen]


def shown(figure: Figure) -> str:
    return "\n".join(t.get_text() for t in texts(figure))


def of_kind(artists: Any, gid: str) -> list[Any]:
    return [artist for artist in artists if artist.get_gid() == gid]


def legend(figure: Figure) -> list[str]:
    found = figure.axes[0].get_legend()
    assert found is not None
    return [t.get_text() for t in found.get_texts()]
