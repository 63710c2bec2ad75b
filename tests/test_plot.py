"""Plots: what they show is what was measured, and it can be read in print."""

import io
import math
import pickle
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import handmade
import oitlab
from oitlab import _palette, plot
from oitlab._image import srgb_bytes
from oitlab.plot._weights import MCGUIRE, evaluate

PALETTE = {*_palette.SERIES, _palette.GREY}
"""Okabe and Ito's colours without yellow, and the grey of what is in the background."""
SMALLEST_TYPE = 7.0
WEIGHT_TOLERANCE = 2e-6
"""Weights are found from sums in float32, each rounded to 6e-8, and are themselves computed in it."""

_Make = Callable[[], Figure]


@pytest.fixture(scope="module")
def fragments() -> oitlab.Fragments:
    return oitlab.capture(oitlab.scenes.blades(width=48, height=27, count=60))


@pytest.fixture(scope="module")
def frames(fragments: oitlab.Fragments) -> list[oitlab.Frame]:
    return oitlab.render_many(fragments, ["a_buffer", "wboit", "mlab", ("lwboit", {"bins": 4})])


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


@pytest.fixture(scope="module")
def figures(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> dict[str, Figure]:
    return every_kind(fragments, frames)


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


# All kinds ----------------------------------------


def test_every_public_function_is_tried(figures: dict[str, Figure]) -> None:
    assert sorted(figures) == sorted(plot.__all__)


def test_type_is_readable_at_the_printed_size(figures: dict[str, Figure]) -> None:
    for kind, figure in figures.items():
        assert figure.get_figwidth() in (3.3, 7.0), kind
        for text in texts(figure):
            assert text.get_fontsize() >= SMALLEST_TYPE, (kind, text.get_text())


def test_no_text_leaves_the_page(figures: dict[str, Figure]) -> None:
    for kind, figure in figures.items():
        width, height = figure.get_size_inches() * figure.dpi
        for text in texts(figure):
            box = text.get_window_extent()
            inside = box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1
            assert inside, (kind, text.get_text(), box)


def test_titles_captions_and_cells_do_not_cover_each_other(figures: dict[str, Figure]) -> None:
    for kind in ("strip", "axes_table", "error_map"):
        found = [t for t in texts(figures[kind]) if not re.search(r"10\^|^\$", t.get_text())]
        boxes = [(t.get_text(), t.get_window_extent()) for t in found]
        for index, (one, box) in enumerate(boxes):
            for other, its in boxes[index + 1 :]:
                apart = (
                    box.x1 <= its.x0 + 1
                    or its.x1 <= box.x0 + 1
                    or box.y1 <= its.y0 + 1
                    or its.y1 <= box.y0 + 1
                )
                assert apart, (kind, one, other)


def test_lines_have_colours_of_the_palette_and_differ_without_them(figures: dict[str, Figure]) -> None:
    for kind in ("convergence", "weight_curves", "transmittance"):
        lines = [line for line in figures[kind].axes[0].lines if line.get_label()[0] != "_"]
        assert len(lines) >= 3
        assert {to_hex(line.get_color()).upper() for line in lines} <= PALETTE
        looks = {(line.get_linestyle(), line.get_marker(), line.get_linewidth()) for line in lines}
        assert len(looks) == len(lines), kind


def test_the_palette_has_seventy_looks() -> None:
    assert len({_palette.series(index)[::2] for index in range(70)}) == 70


def test_axes_have_units(figures: dict[str, Figure]) -> None:
    labelled = ("convergence", "pareto", "weight_curves", "transmittance")
    for kind in labelled:
        axes = figures[kind].axes[0]
        assert "(" in axes.get_xlabel(), kind
        assert "(" in axes.get_ylabel(), kind
    for kind in ("depth_complexity", "error_map"):
        assert "(" in figures[kind].axes[-1].get_ylabel(), kind


def test_nothing_global_changes(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> None:
    import matplotlib.pyplot as plt

    windows = plt.get_fignums()
    with mpl.rc_context():
        before = dict(mpl.rcParams)
        for figure in every_kind(fragments, frames).values():
            figure.savefig(io.BytesIO(), dpi=20)
        assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == windows


def test_the_users_settings_do_not_matter() -> None:
    def pixels() -> bytes:
        data = io.BytesIO()
        plot.convergence(seeds(), "samples").savefig(data, format="rgba", dpi=60)
        return data.getvalue()

    plain = pixels()
    assert pixels() == plain
    with mpl.rc_context(
        {"font.size": 30, "xtick.labelsize": 2, "lines.linewidth": 9, "axes.facecolor": "red"}
    ):
        assert pixels() == plain


def test_figures_show_themselves_once_and_survive_pickling(figures: dict[str, Figure]) -> None:
    for figure in figures.values():
        assert figure._repr_png_()[:4] == b"\x89PNG"  # type: ignore[attr-defined]
    again = {kind: pickle.loads(pickle.dumps(figure)) for kind, figure in figures.items()}
    assert len(again["weight_curves"].axes[0].lines) == len(MCGUIRE)


def test_pdf_has_truetype_fonts(figures: dict[str, Figure]) -> None:
    data = io.BytesIO()
    figures["convergence"].savefig(data, format="pdf")
    assert b"/FontType 3" not in data.getvalue()
    assert b"/Type0" in data.getvalue()


def test_axes_of_ones_own_are_drawn_in() -> None:
    figure = Figure(figsize=(7, 3), layout="constrained")
    left, right = figure.subplots(1, 2)
    assert plot.convergence(seeds(), "samples", ax=left) is figure
    assert plot.pareto(prices(), ax=right) is figure
    figure.savefig(io.BytesIO(), dpi=30)
    assert left.lines
    assert right.lines
    assert figure.get_figheight() == 3
    assert all(t.get_fontsize() >= SMALLEST_TYPE for t in texts(figure) if t.get_text() != "x")
    with pytest.raises(ValueError, match="ax must be matplotlib Axes, got Figure"):
        plot.convergence(seeds(), "samples", ax=figure)  # type: ignore[arg-type]


def test_widths() -> None:
    assert plot.weight_curves(["one"], z=[1, 2], width=5).get_figwidth() == 5
    for wrong, message in (
        ("wide", "single"),
        (1, r"\[1.5, 40\]"),
        (math.nan, r"\[1.5, 40\]"),
        (None, "number"),
    ):
        with pytest.raises(ValueError, match=f"width must be .*{message}"):
            plot.weight_curves(["one"], z=[1, 2], width=wrong)  # type: ignore[arg-type]


def test_import_is_lazy() -> None:
    code = "import sys, oitlab; assert 'matplotlib' not in sys.modules and 'plot' in dir(oitlab)"
    code += "; oitlab.plot.pareto"
    subprocess.run(
        [sys.executable, "-c", code + "; assert 'matplotlib.pyplot' not in sys.modules"], check=True
    )
    with pytest.raises(AttributeError, match="no attribute 'plots'"):
        oitlab.plots  # type: ignore[attr-defined]  # noqa: B018


# Convergence ----------------------------------------


def test_convergence_draws_medians_ranges_and_baselines() -> None:
    figure = plot.convergence(seeds(), "samples")
    axes = figure.axes[0]
    lines = of_kind(axes.lines, "line")
    assert [line.get_label() for line in lines] == ["slab", "stochastic_transparency"]
    assert lines[0].get_xdata().tolist() == [1, 4, 16]
    assert lines[0].get_ydata() == pytest.approx([0.2, 0.05, 0.0125])
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("samples (number)", "MSE (linear RGB, squared)")
    (flat,) = of_kind(axes.lines, "baseline")
    assert flat.get_ydata() == [0.02, 0.02]
    assert legend(figure)[-1] == "wboit (without samples)"
    band = of_kind(axes.collections, "spread")[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(0.1 / 16)
    assert band[:, 1].max() == pytest.approx(0.3)
    title = axes.get_legend().get_title().get_text()
    assert " ".join(title.split()) == "median and smallest to largest of up to 3 runs (seed)"
    assert [t.get_text() for t in axes.get_xticklabels()] == ["1", "4", "16"]


@pytest.mark.parametrize(
    ("spread", "low", "high", "text"),
    [("quartiles", 0.15, 0.25, "quartiles"), ((0.25, 1), 0.15, 0.3, "25 % to 100 %")],
)
def test_convergence_spreads(spread: Any, low: float, high: float, text: str) -> None:
    axes = plot.convergence(seeds(), "samples", spread=spread, draw="whiskers").axes[0]
    whiskers = of_kind(axes.collections, "spread")[0]
    assert isinstance(whiskers, LineCollection)
    assert whiskers.get_segments()[0][:, 1] == pytest.approx([low, high])
    assert text in axes.get_legend().get_title().get_text()


def test_convergence_shows_zeros_at_the_edge_and_counts_what_is_missing() -> None:
    table = pd.DataFrame({"technique": "mlab", "layers": [1, 2, 4, 8], "mse": [0.1, np.nan, 1e-16, 0.0]})
    figure = plot.convergence(table, "layers")
    axes = figure.axes[0]
    edge = of_kind(axes.lines, "edge")
    assert [line.get_xdata()[0] for line in edge] == [4, 8]
    bottom = axes.transAxes.transform((0, 0))[1]
    assert all(
        line.get_transform().transform((4, line.get_ydata()[0]))[1] == pytest.approx(bottom) for line in edge
    )
    assert "triangle on the edge of y: 1e-14 or less" in shown(figure)
    assert "not drawn: 1 missing (NaN)" in shown(figure)
    (line,) = of_kind(axes.lines, "line")
    assert np.isfinite(line.get_ydata()).tolist() == [True, False, False, False]

    figure = plot.convergence(table, "layers", floor=0.0)
    assert [line.get_xdata()[0] for line in of_kind(figure.axes[0].lines, "edge")] == [8]
    assert "triangle on the edge of y: 0" in shown(figure)
    figure = plot.convergence(table, "layers", logy=False)
    assert not of_kind(figure.axes[0].lines, "edge")


def test_infinities_are_at_the_upper_edge() -> None:
    table = pd.DataFrame({"technique": "mlab", "layers": [1, 2, 4], "psnr": [20.0, 30.0, np.inf]})
    figure = plot.convergence(table, "layers", "psnr", logy=False)
    (edge,) = of_kind(figure.axes[0].lines, "edge")
    assert (edge.get_xdata()[0], edge.get_ydata()[0]) == (4, 1.0)
    assert "triangle on the edge of y: inf" in shown(figure)


def test_an_exact_baseline_is_at_the_edge() -> None:
    table = pd.concat([seeds(), pd.DataFrame([{"technique": "a_buffer", "mse": 0.0}])])
    figure = plot.convergence(table.drop(columns="scene"), "samples")
    assert [line.get_label() for line in of_kind(figure.axes[0].lines, "edge")] == [
        "a_buffer (without samples)"
    ]
    assert "a_buffer (without samples)" in legend(figure)


def test_convergence_over_a_param_of_text() -> None:
    table = pd.DataFrame(
        {"weight": ["mb7", "mb8", None], "technique": ["wboit", "wboit", "mlab"], "mse": [0.2, 0.1, 0.3]}
    )
    axes = plot.convergence(table, "weight").axes[0]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["mb7", "mb8"]
    (line,) = of_kind(axes.lines, "line")
    assert line.get_linestyle() == "None"
    assert of_kind(axes.lines, "baseline")[0].get_label() == "mlab (without weight)"


def test_convergence_by_several_columns_or_none() -> None:
    table = seeds().dropna()
    axes = plot.convergence(table, "samples", hue=["technique", "seed"], draw="whiskers").axes[0]
    names = [line.get_label() for line in of_kind(axes.lines, "line")]
    assert names[:2] == ["slab seed=0", "slab seed=1"]
    assert len(names) == 6
    axes = plot.convergence(table[table["technique"] == "slab"], "samples", hue=None).axes[0]
    assert len(of_kind(axes.lines, "line")) == 1


def test_one_point_with_a_spread_is_not_an_invisible_band() -> None:
    table = seeds()
    axes = plot.convergence(table[table["samples"] == 4], "samples").axes[0]
    assert any(
        isinstance(c, LineCollection) and len(c.get_segments()) for c in of_kind(axes.collections, "spread")
    )


def test_linear_axes_and_shifts_of_zero() -> None:
    table = pd.DataFrame({"technique": "wboit", "weight_shift": [0.0, 1.0, 50.0], "mse": [0.3, 0.2, 0.1]})
    axes = plot.convergence(table, "weight_shift").axes[0]
    assert axes.get_xscale() == "linear"
    assert axes.get_xlabel() == "weight_shift (scene units)"
    figure = plot.convergence(table, "weight_shift", logx=True)
    assert "triangle on the edge of x: 0" in shown(figure)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": "bins"}, "no column 'bins'; it has: scene, technique, samples, seed, mse"),
        ({"x": "samples", "y": "rmse"}, "no column 'rmse'"),
        ({"x": "samples", "hue": "weight"}, "no column 'weight'"),
        ({"x": "samples", "y": "technique"}, "column 'technique' must hold numbers, but has 'slab'"),
        ({"x": "samples", "over": ()}, "rows of one point differ in 'seed' .0, 1, 2."),
        ({"x": "samples", "hue": None}, "rows of one point differ in 'technique'"),
        ({"x": "samples", "spread": "all"}, "spread must be"),
        ({"x": "samples", "spread": (0.5, 0.2)}, "spread must be"),
        ({"x": "samples", "draw": "bars"}, "draw must be one of 'band', 'whiskers'"),
        ({"x": "samples", "floor": -1}, "floor must be a finite number >= 0"),
        ({"x": "samples", "logy": "yes"}, "logy must be True or False"),
        ({"x": "samples", "hue": 1}, "hue must be one or several, got 1"),
        ({"x": "samples", "over": 1}, "over must be one or several, got 1"),
        ({"x": "samples", "spread": (0, 0.5, 1)}, "spread must be"),
        ({"x": "samples", "hue": [1]}, "hue must be a column's name or several"),
    ],
)
def test_convergence_refuses(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot.convergence(seeds(), **arguments)


def test_tables_are_checked() -> None:
    with pytest.raises(ValueError, match="data must be a pandas DataFrame, got dict"):
        plot.convergence({"samples": [1]}, "samples")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="data has no rows"):
        plot.convergence(seeds().iloc[:0], "samples")
    with pytest.raises(ValueError, match="data has two columns 'mse'"):
        plot.convergence(pd.concat([seeds(), seeds()[["mse"]]], axis=1), "samples")
    with pytest.raises(ValueError, match="'samples' holds no finite number"):
        plot.convergence(seeds()[seeds()["technique"] == "wboit"], "samples")
    negative = seeds().assign(mse=-1.0)
    with pytest.raises(ValueError, match="'mse' holds -1 in row 0: a logarithmic axis"):
        plot.convergence(negative, "samples")
    two = pd.concat([seeds(), seeds().assign(scene="smoke")])
    with pytest.raises(ValueError, match=r"differ in 'scene' \(blades, smoke\): choose among the rows"):
        plot.convergence(two, "samples")
    many = pd.DataFrame({"technique": [f"t{i}" for i in range(71)], "samples": 1, "mse": 0.1})
    with pytest.raises(ValueError, match="71 lines; more than 70"):
        plot.convergence(many, "samples")


def test_keys_that_a_table_lists_are_not_averaged_over() -> None:
    table = seeds().dropna().assign(strength=[0.1, 0.2, 0.3] * 6)
    plot.convergence(table, "samples")
    table.attrs["keys"] = ["technique", "strength", "seed"]
    with pytest.raises(ValueError, match=r"differ in 'strength' \(0.1, 0.2, 0.3\)"):
        plot.convergence(table, "samples")


def test_names_with_an_underscore_are_in_the_legend() -> None:
    table = seeds().replace({"slab": "_mine", "wboit": "_flat"})
    assert [t.strip() for t in legend(plot.convergence(table, "samples"))] == [
        "_mine",
        "stochastic_transparency",
        "_flat (without samples)",
    ]


def test_nullable_columns_of_a_sweep_are_taken() -> None:
    table = seeds().convert_dtypes()
    table["mse"] = table["mse"].astype(object)
    assert len(of_kind(plot.convergence(table, "samples").axes[0].lines, "line")) == 2


# Pareto ----------------------------------------


def front(figure: Figure) -> list[tuple[float, float]]:
    (line,) = of_kind(figure.axes[0].lines, "front")
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def labels(figure: Figure) -> list[Text]:
    return of_kind(figure.axes[0].texts, "label")


def test_pareto_draws_the_front() -> None:
    figure = plot.pareto(prices())
    assert front(figure) == [(1, 1e-2), (2, 1e-3), (8, 1e-4), (16, 0)]
    assert sorted(t.get_text() for t in labels(figure)) == ["a_buffer", "lwboit", "mlab", "wboit"]
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time in all (ms)", "MSE (linear RGB, squared)")
    beaten, best = of_kind(axes.lines, "points")
    assert beaten.get_xdata().tolist() == [4.0]
    assert best.get_xdata().tolist() == [1, 2, 8]
    (edge,) = of_kind(axes.lines, "edge")
    assert edge.get_xdata()[0] == 16
    assert "triangle on the edge of y: 1e-14 or less" in shown(figure)
    assert front(plot.pareto(prices(), "bytes_per_pixel")) == [
        (20, 1e-2),
        (40, 2e-3),
        (80, 1e-3),
        (160, 1e-4),
        (320, 0),
    ]


def test_pareto_takes_more_psnr_for_better() -> None:
    table = prices().assign(psnr=[20.0, 30.0, 25.0, 40.0, np.inf])
    assert front(plot.pareto(table, y="psnr", logy=False)) == [(1, 20), (2, 30), (8, 40), (16, np.inf)]


def test_pareto_keeps_equals_and_points_alike() -> None:
    table = pd.DataFrame({"technique": ["a", "b", "c"], "total_ms": [1.0, 1.0, 1.0], "mse": [0.1, 0.1, 0.2]})
    figure = plot.pareto(table)
    assert sorted(t.get_text() for t in labels(figure)) == ["a", "b"]


def test_pareto_sums_seeds_up() -> None:
    table = pd.concat([prices().assign(seed=s, mse=prices()["mse"] * (1 + s)) for s in (0, 1, 2)])
    figure = plot.pareto(table)
    assert front(figure)[0] == (1, 2e-2)
    spread = of_kind(figure.axes[0].collections, "spread")[-1].get_segments()[0]
    assert spread[:, 1] == pytest.approx([1e-2, 3e-2])


def test_pareto_names_no_param_that_is_merely_inactive_in_some_rows() -> None:
    table = pd.DataFrame(
        {
            "technique": "wboit",
            "weight": ["one", "mb7", "mb10"],
            "weight_scale": [None, 1.0, 1.0],
            "near": [None, None, 0.1],
            "total_ms": [3.0, 2.0, 1.0],
            "mse": [0.01, 0.1, 0.2],
        }
    )
    assert {t.get_text() for t in labels(plot.pareto(table))} == {
        "wboit weight=one",
        "wboit weight=mb7",
        "wboit weight=mb10",
    }
    alone = table.assign(weight="mb7", near=None)[:2]
    assert {t.get_text() for t in labels(plot.pareto(alone))} == {"wboit", "wboit weight_scale=1"}


def test_pareto_names_variants_by_what_differs() -> None:
    table = pd.DataFrame(
        {
            "technique": ["lwboit", "lwboit", "wboit"],
            "bins": [4, 8, None],
            "weight": ["mb7", "mb7", "mb7"],
            "total_ms": [2.0, 3.0, 1.0],
            "mse": [0.01, 0.001, 0.1],
        }
    )
    assert sorted(t.get_text() for t in labels(plot.pareto(table))) == [
        "lwboit bins=4",
        "lwboit bins=8",
        "wboit",
    ]
    hued = plot.pareto(table, hue="technique", labels="none")
    assert not labels(hued)
    assert legend(hued) == ["Pareto front", "lwboit", "wboit", "hollow: beaten"]
    with pytest.raises(ValueError, match="rows of one point differ in 'bins'"):
        plot.pareto(table, name="technique")


def boxes_of(figure: Figure) -> list[tuple[str, Any]]:
    figure.draw_without_rendering()
    return [(t.get_text(), Text.get_window_extent(t)) for t in labels(figure)]


@pytest.mark.parametrize("width", ["single", "double"])
def test_names_cover_neither_each_other_nor_points_nor_the_edge(width: Any) -> None:
    random = np.random.default_rng(7)
    time = np.exp(random.uniform(0, 2, 40))
    table = pd.DataFrame(
        {
            "technique": [f"technique_{i}" for i in range(40)],
            "total_ms": time,
            "mse": 1e-2 * time**-3 * np.exp(random.uniform(0, 2, 40)),
        }
    )
    figure = plot.pareto(table, labels="all", width=width)
    boxes = boxes_of(figure)
    axes = figure.axes[0]
    window = axes.get_window_extent()
    points = axes.transData.transform(table[["total_ms", "mse"]].to_numpy())
    assert len(boxes) >= 8
    for index, (name, box) in enumerate(boxes):
        assert window.x0 <= box.x0 + 1, name
        assert box.x1 <= window.x1 + 1, name
        assert window.y0 <= box.y0 + 1, name
        assert box.y1 <= window.y1 + 1, name
        for other, its in boxes[index + 1 :]:
            assert not box.overlaps(its), (name, other)
        assert not any(box.contains(*point) for point in points), name
    # what found no room is listed, word for word, or counted where the list ends
    (note,) = [text.get_text() for text in texts(figure) if text.get_gid() == "note"]
    more = re.search(r"(\d+)\smore$", note)
    named = {name for name, _ in boxes} | set(re.findall(r"technique_\d+", note))
    assert len(table) - len(named) == (int(more[1]) if more else 0)
    again = [t.get_position() for t in labels(plot.pareto(table, labels="all", width=width))]
    assert again == [t.get_position() for t in labels(figure)]


def test_the_front_is_named_before_others() -> None:
    table = pd.DataFrame(
        {"technique": [f"a_long_name_{i:02}" for i in range(60)], "total_ms": 1.0 + 1e-4 * np.arange(60)}
    )
    table["mse"] = [0.0101] * 59 + [0.01]
    figure = plot.pareto(table, labels="all", width="single")
    named = [t.get_text() for t in labels(figure)]
    assert {"a_long_name_00", "a_long_name_59"} <= set(named)
    assert len(named) < 60


def test_pareto_counts_what_is_missing_and_refuses_nothing_but_that() -> None:
    table = prices()
    table.loc[2, "mse"] = np.nan
    assert "not drawn: 1 missing (NaN)" in shown(plot.pareto(table))
    with pytest.raises(ValueError, match="no row has numbers in both 'total_ms' and 'mse'"):
        plot.pareto(table.assign(mse=np.nan))
    with pytest.raises(ValueError, match="labels must be one of"):
        plot.pareto(prices(), labels="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no column 'ms'; it has: technique, total_ms"):
        plot.pareto(prices(), x="ms")
    with pytest.raises(ValueError, match="'total_ms' holds -1 in row 0"):
        plot.pareto(prices().assign(total_ms=-1.0))


# Weights ----------------------------------------


def clamped(values: Any) -> Any:
    return np.clip(values, 1e-2, 3e3)


FORMULAS: dict[str, Callable[[Any, float], Any]] = {
    "one": lambda z, a: np.ones_like(z),
    "mb7": lambda z, a: a * clamped(10 / (1e-5 + (z / 5) ** 2 + (z / 200) ** 6)),
    "mb8": lambda z, a: a * clamped(10 / (1e-5 + (z / 10) ** 3 + (z / 200) ** 6)),
    "mb9": lambda z, a: a * clamped(0.03 / (1e-5 + (z / 200) ** 4)),
    "mb10": lambda z, a: a * np.maximum(3e3 * (0.1 * 500 / 499.9 * (1 / z - 1 / 500) / 0.1 * 0.1) ** 3, 1e-2),
    "inv_pow": lambda z, a: z**-4.0,
    "exp": lambda z, a: np.maximum(np.exp(-z), 1e-30),
    "fig1": lambda z, a: (z + 5) ** -2.0,
    "smoke6": lambda z, a: (a / z**3) ** 2,
    "fig10": lambda z, a: 10 / (1 + 10 * (0.01 * z) ** 5),
}
"""MB13's, written once more, with the near plane at 0.1 and the far one at 500."""


@pytest.mark.parametrize("alpha", [1.0, 0.25])
@pytest.mark.parametrize("name", FORMULAS)
def test_weights_are_the_cores_own(name: str, alpha: float) -> None:
    z = np.geomspace(0.11, 490, 50).astype(np.float32)
    found = evaluate({"weight": name}, z, alpha, 0.1, 500.0)
    wanted = FORMULAS[name](z.astype(float), alpha)
    tolerance = (
        2e-4 if name in ("mb10", "exp") else WEIGHT_TOLERANCE
    )  # cancellation at the far plane; z k in f32
    assert found == pytest.approx(wanted, rel=tolerance)


def test_every_published_weight_can_be_drawn() -> None:
    (param,) = [p for p in oitlab.techniques()["wboit"].params if p.name == "weight"]
    known = re.findall(r'"(\w+)"', param.range)
    assert len(known) >= 11
    axes = plot.weight_curves(known, z=[0.5, 5.0, 50.0]).axes[0]
    assert [line.get_label() for line in axes.lines] == known
    assert all((np.asarray(line.get_ydata()) > 0).all() for line in axes.lines)


def test_weight_curves_by_default_are_figure_three() -> None:
    axes = plot.weight_curves().axes[0]
    assert [line.get_label() for line in axes.lines] == ["mb7", "mb8", "mb9", "mb10"]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_xlim() == pytest.approx((0.1, 500))
    assert axes.get_ylabel() == "weight w(z, α = 1)"
    for line in axes.lines[:3]:
        assert line.get_ydata().max() == pytest.approx(3e3, rel=1e-4)
        assert line.get_ydata().min() == pytest.approx(1e-2, rel=1e-4)


def test_weight_curves_with_params_labels_and_alphas() -> None:
    weights = {"steep": ("inv_pow", {"weight_k": 5}), "flat": {"weight": "one"}}
    axes = plot.weight_curves(weights, z=[2.0, 1.0], alpha=[0.5, 1.0]).axes[0]
    names = [line.get_label() for line in axes.lines]
    assert names == ["steep, α = 0.5", "steep, α = 1", "flat, α = 0.5", "flat, α = 1"]
    assert axes.lines[0].get_ydata() == pytest.approx([1, 1 / 32])
    assert axes.lines[0].get_linestyle() != axes.lines[1].get_linestyle()
    assert axes.lines[0].get_color() == axes.lines[1].get_color()
    shifted = plot.weight_curves({"weight": "inv_pow", "weight_k": 2, "weight_shift": 1}, z=[1.0]).axes[0]
    assert shifted.lines[0].get_ydata() == pytest.approx([0.25])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"weights": []}, "weights is empty"),
        ({"weights": ["mb7", "mb7"]}, "weights has 'mb7' twice"),
        ({"weights": ["nothing"]}, "nothing"),
        ({"weights": [3]}, "a weight is a name"),
        ({"weights": 3}, "weights must be one or several, got 3"),
        (
            {"weights": ("inv_pow", {"k": 2})},
            "'inv_pow, k=2' has the param 'k', which is no part of a weight",
        ),
        ({"weights": {"weight": "mb7", "format": "f16"}}, "'mb7, format=f16' has the param 'format'"),
        ({"weights": {"mine": ("mb7", {"layout": "listing4"})}}, "'mine' has the param 'layout'"),
        ({"weights": ("mb7", {"weights_format": "f16"})}, "has the param 'weights_format'"),
        ({"z": [1.0, 0.0]}, r"z\[1\] must be a finite depth > 0, got 0"),
        ({"z": [np.nan]}, r"z\[0\]"),
        ({"z": []}, "z is empty"),
        ({"alpha": 0.0}, r"alpha must be in \(0, 1\], got 0"),
        ({"alpha": []}, "alpha must be a number or several"),
        ({"alpha": [0.1, 0.1]}, "alpha must be a number or several different"),
    ],
)
def test_weight_curves_refuse(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot.weight_curves(**arguments)


@pytest.mark.parametrize(
    ("weight", "formula"),
    [
        (("inv_pow", {"weight_k": 8}), lambda z: z**-8.0),
        (("inv_pow", {"weight_k": 20}), lambda z: z**-20.0),
        ("pow(z, -10.0)", lambda z: z**-10.0),
        ("1e9", lambda z: np.full_like(z, 1e9)),
        ("a * a * a * a * pow(z, -2.0)", lambda z: z**-2.0),
    ],
)
def test_steep_and_large_weights_are_drawn(weight: Any, formula: Any) -> None:
    line = plot.weight_curves(weight).axes[0].lines[0]
    z, w = np.asarray(line.get_data(), float)
    assert len(z) == 600
    assert w == pytest.approx(formula(z), rel=1e-4)


def test_weight_curves_take_all_that_decides_a_weight() -> None:
    params = {"weight.rate": 2.0, "weight_shift": 1.0, "near": 0.5, "far": 9.0}
    axes = plot.weight_curves(("exp(-rate * z)", params), z=[1.0, 2.0]).axes[0]
    assert axes.lines[0].get_ydata() == pytest.approx(np.exp([-4.0, -6.0]), rel=1e-5)


@pytest.mark.parametrize(("weight", "gaps"), [("1.0 - z", [1, 2]), ("0.0", [0, 1, 2]), ("z - 1.5", [0])])
def test_what_is_no_weight_is_a_gap(weight: str, gaps: list[int]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = plot.weight_curves(weight, z=[0.5, 1.75, 4.0])
    axes = figure.axes[0]
    assert np.flatnonzero(np.isnan(axes.lines[0].get_ydata())).tolist() == gaps
    (note,) = [text.get_text() for text in axes.texts if text.get_gid() == "note"]
    assert note.startswith("gaps: no weight (0 or less")
    assert not [t for t in plot.weight_curves("mb7").axes[0].texts if t.get_gid() == "note"]


# Heat maps ----------------------------------------


def test_depth_complexity_shows_the_counts(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> None:
    for source in (fragments, frames[1]):
        figure = plot.depth_complexity(source)
        (image,) = figure.axes[0].get_images()
        data = image.get_array()
        assert (data.filled(0) == fragments.counts).all()
        assert (data.mask == (fragments.counts == 0)).all()
        assert figure.axes[1].get_ylabel() == "fragments per pixel (number)"
        assert f"largest {fragments.counts.max()}" in shown(figure)
        assert f"{(fragments.counts == 0).sum():,} pixels without" in shown(figure)
        assert int(image.norm.vmax) == fragments.counts.max()


def test_depth_complexity_scales(fragments: oitlab.Fragments) -> None:
    few = plot.depth_complexity(fragments, limit=5)
    (image,) = few.axes[0].get_images()
    assert isinstance(image.norm, BoundaryNorm)
    assert image.norm(np.array([1, 5])).tolist() == image.norm(np.array([1, 9])).tolist()
    assert [t.get_text() for t in few.axes[1].get_yticklabels()] == ["1", "2", "3", "4", "5"]
    (image,) = plot.depth_complexity(fragments, log=True, limit=100).axes[0].get_images()
    assert isinstance(image.norm, LogNorm)
    assert (image.norm.vmin, image.norm.vmax) == (1, 100)
    empty = oitlab.Fragments(
        width=3, height=2, offsets=[0] * 7, depth=[], color=[], alpha=[], background=(0, 0, 0)
    )
    assert "largest 0; white: 6 pixels without" in shown(plot.depth_complexity(empty))
    with pytest.raises(ValueError, match="source must be a Frame or Fragments, got list"):
        plot.depth_complexity([1])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="limit must be >= 1"):
        plot.depth_complexity(fragments, limit=0)


def test_a_large_map_keeps_its_largest_number() -> None:
    counts = np.zeros((40, 4000), np.uint32)
    counts[17, 3001] = 99
    figure = plot.depth_complexity(handmade.frame(np.zeros((40, 4000, 3)), fragment_count=counts))
    (image,) = figure.axes[0].get_images()
    assert image.get_array().shape[1] < 4000
    assert image.get_array().max() == 99


def test_error_maps_share_a_stated_scale(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.error_map(others, exact, "absolute")
    assert [axes.get_title() for axes in figure.axes[:3]] == ["wboit", "mlab", "lwboit bins=4"]
    for axes, frame in zip(figure.axes[:3], others, strict=True):
        (image,) = axes.get_images()
        errors = oitlab.error_map(frame, exact, "absolute")
        assert (image.get_array() == np.maximum(errors, 1e-4)).all()
        assert (image.norm.vmin, image.norm.vmax) == (1e-4, 1.0)
        assert image.get_cmap().name == "magma"
        assert f"largest {errors.max():.3g}" in axes.get_xlabel()
    bar = figure.axes[3]
    assert bar.get_ylabel() == "largest error of R, G, B (linear RGB, 1 = white)" or "\n" in bar.get_ylabel()
    assert bar.get_yscale() == "log"


def test_error_map_limits(frames: list[oitlab.Frame]) -> None:
    exact, wboit, *_ = frames
    (image,) = plot.error_map(wboit, exact, limits=(0, 0.1), log=False).axes[0].get_images()
    assert (image.norm.vmin, image.norm.vmax) == (0, 0.1)
    (image,) = plot.error_map({"mine": wboit.color}, exact, "delta_e_2000").axes[0].get_images()
    assert (image.norm.vmin, image.norm.vmax) == (0, 10)
    for wrong in ((0, 1), (1, 0.5), (0.1, math.inf)):
        with pytest.raises(ValueError, match="limits must be finite with 0 < low < high"):
            plot.error_map(wboit, exact, limits=wrong)
    for arguments, message in (
        ({"frames": []}, "frames is empty"),
        ({"metric": "mse"}, "metric must be one of 'squared'"),
        ({"columns": 0}, "columns must be >= 1"),
        ({"limits": 3}, "limits must be two numbers"),
        ({"limits": (1, 2, 3)}, "limits must be two numbers"),
        ({"frames": 3}, "frames must be one or several, got 3"),
        ({"metric": "flip"}, "pixels_per_degree"),
    ):
        given: dict[str, Any] = {"frames": wboit, **arguments}
        with pytest.raises(ValueError, match=message):
            plot.error_map(given.pop("frames"), exact, **given)


# Transmittance ----------------------------------------


def test_transmittance_draws_both_functions(fragments: oitlab.Fragments) -> None:
    y, x = np.unravel_index(np.argmax(fragments.counts), fragments.counts.shape)
    figure = plot.transmittance(fragments, ["avsm", ("fourier_opacity_maps", {"frequencies": 3})])
    exact, avsm, fourier = figure.axes[0].lines
    assert [line.get_label() for line in (exact, avsm, fourier)] == [
        "exact",
        "avsm",
        "fourier_opacity_maps frequencies=3",
    ]
    z = exact.get_xdata()
    assert (np.diff(z) > 0).all()
    curve = oitlab.transmittance(fragments, "avsm", pixel=(int(x), int(y)), depths=z)
    assert (exact.get_ydata() == curve.exact).all()
    assert (avsm.get_ydata() == curve.reconstructed).all()
    assert (curve.exact[0], curve.exact[-1]) == (
        1.0,
        pytest.approx(np.prod(1 - fragments.pixel(x, y)["alpha"].astype(float))),
    )
    ticks = of_kind(figure.axes[0].collections, "fragments")[0].get_segments()
    assert sorted(float(s[0, 0]) for s in ticks) == sorted(fragments.pixel(x, y)["depth"].tolist())
    assert f"pixel (x={x}, y={y}), {fragments.counts.max()} fragments" in shown(figure)


def test_transmittance_logarithmic_and_ringing(fragments: oitlab.Fragments) -> None:
    figure = plot.transmittance(fragments, {"series": ("tfm", {"frequencies": 2})})
    low, high = figure.axes[0].get_ylim()
    values = figure.axes[0].lines[1].get_ydata()
    assert low < min(values.min(), 0)
    assert high > max(values.max(), 1)
    axes = plot.transmittance(fragments, "avsm", logy=True).axes[0]
    assert axes.get_yscale() == "log"
    assert axes.get_ylim()[0] > 0


def test_transmittance_refuses(fragments: oitlab.Fragments) -> None:
    y, x = np.argwhere(fragments.counts == 0)[0]
    for arguments, message in (
        ({"pixel": (48, 0)}, r"pixel \(48, 0\) is outside the 48 x 27 image"),
        ({"pixel": (x, y)}, r"has no fragments; the deepest pixel is \("),
        ({"pixel": 3}, "pixel must be a pair"),
        ({"pixel": (1, 2, 3)}, "pixel must be a pair"),
        ({"pixel": (0.5, 1)}, "pixel must be a pair"),
        ({"techniques": []}, "techniques is empty"),
        ({"techniques": 3}, "techniques must be a technique"),
        ({"techniques": ["avsm", "avsm"]}, "techniques has 'avsm' twice"),
        ({"techniques": "painter"}, "painter"),
        ({"depths": []}, "depths is empty"),
        ({"source": 3}, "source must be a Scene or Fragments, got int"),
    ):
        given: dict[str, Any] = {"source": fragments, "techniques": "avsm", **arguments}
        with pytest.raises(ValueError, match=message):
            plot.transmittance(given.pop("source"), given.pop("techniques"), **given)


# Strips ----------------------------------------

INSETS = [(20, 10, 8, 4), (0, 0, 3, 5), (45, 26, 3, 1)]


def test_insets_show_exactly_their_pixels(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, INSETS, reference=exact, exposure=0.5)
    shown_insets = of_kind(figure.axes, "inset")
    assert len(shown_insets) == 4 * len(INSETS)
    for index, axes in enumerate(shown_insets):
        frame, (x, y, w, h) = frames[index // 3], INSETS[index % 3]
        (image,) = axes.get_images()
        assert (image.get_array() == srgb_bytes(frame.color[y : y + h, x : x + w], 0.5)).all()
        assert image.get_interpolation() == "nearest"
        box = axes.get_position()
        across, down = figure.get_size_inches()
        assert (box.width * across) / (box.height * down) == pytest.approx(w / h)


def test_insets_are_aligned_and_coloured(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, INSETS, reference=exact)
    pictures = [axes for axes in figure.axes if axes.get_title()]
    shown_insets = of_kind(figure.axes, "inset")
    for number in range(3):
        row = shown_insets[number::3]
        offsets = {
            round(a.get_position().x0 - p.get_position().x0, 9) for a, p in zip(row, pictures, strict=True)
        }
        assert len(offsets) == len({round(a.get_position().y0, 9) for a in row}) == 1
        (color,) = {to_hex(a.spines["left"].get_edgecolor()).upper() for a in row}
        assert color in PALETTE
        x, y, w, h = INSETS[number]
        for axes in pictures:
            outline = of_kind(axes.patches, "inset")[number]
            assert (outline.get_xy(), outline.get_width(), outline.get_height()) == ((x - 0.5, y - 0.5), w, h)
            assert to_hex(outline.get_edgecolor()).upper() == color
    assert len({to_hex(a.spines["left"].get_edgecolor()) for a in shown_insets}) == 3


def test_strip_says_what_it_did(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, reference=exact, metrics=["rmse", "psnr"], data_range=1.0, exposure=4)
    text = " ".join(shown(figure).split())
    for frame in others:
        error = oitlab.compare(frame, exact, metrics=["rmse", "psnr"], data_range=1.0)
        assert f"RMSE {error['rmse']:.3g}" in text
        assert f"PSNR {error['psnr']:.3g} dB" in text
    assert "sRGB, exposure +4 stops, clipped to [0, 1] (at most" in text
    assert [a.get_title() for a in figure.axes] == ["a_buffer (reference)", "wboit", "mlab", "lwboit bins=4"]
    bare = plot.strip(others, reference=exact, show_reference=False, labels=["one", "two", "three"])
    assert [a.get_title() for a in bare.axes] == ["one", "two", "three"]
    assert "RMSE" in shown(bare)
    assert "RMSE" not in shown(plot.strip(others))


def test_strip_shows_whole_images_as_write_png_does(frames: list[oitlab.Frame], tmp_path: Path) -> None:
    figure = plot.strip(frames[1].color)
    oitlab.write_png(tmp_path / "a.png", frames[1])
    with Image.open(tmp_path / "a.png") as written:
        assert (figure.axes[0].get_images()[0].get_array() == np.asarray(written)).all()
    assert figure.axes[0].get_title() == "image 0"


def test_strip_breaks_into_rows_and_long_names_into_lines() -> None:
    images = {f"a_rather_long_name_of_a_technique_{i}": handmade.random_image(i) for i in range(7)}
    figure = plot.strip(images, [(0, 0, 2, 2)], columns=3, width="single")
    pictures = [axes for axes in figure.axes if axes.get_title()]
    assert len({round(axes.get_position().y0, 6) for axes in pictures}) == 3
    for axes in pictures:
        room = axes.get_position().width * figure.get_figwidth() * figure.dpi
        assert axes.title.get_window_extent().width <= room + 2
    assert [axes.get_title().replace("\n", "") for axes in pictures] == list(images)


def test_strip_reduces_in_linear_light() -> None:
    image = np.zeros((2, 9000, 3))
    image[:, ::2] = 1.0
    shown_image = plot.strip(image, width=2).axes[0].get_images()[0].get_array()
    assert shown_image.shape[1] < 9000
    assert (
        np.abs(shown_image[0, 5].astype(int) - srgb_bytes(np.array(0.5))).max() <= 12
    )  # 8 or 7 of 15 are white


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"insets": [(0, 0, 0, 4)]},
            r"insets\[0\] is \(0, 0, 0, 4\), which is empty or leaves the 48 x 27 image",
        ),
        ({"insets": [(0, 0, 4, 4), (45, 0, 4, 4)]}, r"insets\[1\]"),
        ({"insets": [(-1, 0, 4, 4)]}, r"insets\[0\]"),
        ({"insets": [(0.5, 0, 4, 4)]}, r"insets\[0\] x must be an integer"),
        ({"insets": 3}, "insets must be one or several, got 3"),
        ({"labels": 3}, "labels must be one or several, got 3"),
        ({"insets": [3]}, r"insets\[0\] must be \(x, y, w, h\)"),
        ({"insets": [(0, 0, 1, 1)] * 7}, "at most 6"),
        ({"labels": ["one"]}, "labels: expected 3"),
        ({"labels": ["one"] * 3}, "labels must differ"),
        ({"columns": 0}, "columns must be >= 1"),
        ({"metrics": "sharpness"}, "sharpness"),
        ({"metrics": "psnr"}, "psnr needs data_range"),
        ({"exposure": 1000}, "exposure"),
        ({"reference": np.zeros((2, 2, 3))}, "shape"),
    ],
)
def test_strip_refuses(frames: list[oitlab.Frame], arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot.strip(frames[1:], **{"reference": frames[0], **arguments})


def test_strip_refuses_images_of_two_sizes_by_name() -> None:
    images = {"first": handmade.random_image(0), "second": handmade.random_image(1, height=6)}
    with pytest.raises(ValueError, match=r"frames\['second'\] is 7 x 6 pixels, the first 7 x 5"):
        plot.strip(images)
    bad = handmade.random_image(0)
    bad[2, 3, 1] = np.nan
    with pytest.raises(ValueError, match=r"frames\['bad'\]: pixel \(x=3, y=2\) is not finite"):
        plot.strip({"bad": bad})


# The table of axes ----------------------------------------


def test_axes_table_holds_every_cell() -> None:
    figure = plot.axes_table()
    table = oitlab.techniques().axes_table()
    words = "".join(t.get_text() for t in figure.texts).replace(" ", "")
    for row in table.rows:
        assert "".join(row[0].split()) in words
    found = sorted("".join(t.get_text().replace(" ", "") for t in figure.texts))
    assert found == sorted(
        "".join(cell for row in (table.columns, *table.rows) for cell in row).replace(" ", "")
    )


def test_axes_table_of_some() -> None:
    figure = plot.axes_table(["mlab", "over"])
    assert [t.get_text() for t in of_kind(figure.texts, "id")] == ["mlab", "a_buffer"]
    for wrong, message in (
        (["nothing"], "unknown technique 'nothing'; known: a_buffer"),
        ([], "techniques is empty"),
        (3, "techniques must be one or several, got 3"),
        (["over", "a_buffer"], "techniques has 'a_buffer' twice"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.axes_table(wrong)
    with pytest.raises(ValueError, match=r"width must be at least \d"):
        plot.axes_table(width="single")


# Frames and figures in notebooks ----------------------------------------


def decoded(data: bytes | None) -> Any:
    assert data is not None
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image)


def test_a_frame_shows_itself_as_write_png_writes_it(frames: list[oitlab.Frame], tmp_path: Path) -> None:
    for frame in (*frames, oitlab.render(oitlab.scenes.squares(width=9, height=5), "wboit", dtype="float64")):
        oitlab.write_png(tmp_path / "a.png", frame)
        assert frame._repr_png_() == (tmp_path / "a.png").read_bytes()


@pytest.mark.parametrize("color", [1e30, -5.0, np.inf, 0.5])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_frame_shows_itself(color: float, dtype: Any) -> None:
    pixel = decoded(handmade.frame(np.full((1, 1, 3), color, dtype))._repr_png_())
    wanted = {1e30: [255] * 3, -5.0: [0] * 3, np.inf: [255, 0, 255], 0.5: [188] * 3}[color]
    assert pixel.tolist() == [[wanted]]


def test_a_huge_frame_is_reduced_by_a_whole_factor() -> None:
    color = np.zeros((3, 4097, 3), np.float32)
    color[:, ::3] = 30.0
    image = decoded(handmade.frame(color)._repr_png_())
    assert image.shape == (1, 1366, 3)
    assert (image[0, :-1] == srgb_bytes(np.array(1 / 3))).all()


def test_a_notebook_shows_figures_and_frames_once() -> None:
    import nbformat
    from nbclient import NotebookClient

    table = "pd.DataFrame({'technique': ['a', 'b'], 'total_ms': [1.0, 2.0], 'mse': [0.1, 0.01]})"
    cells = [
        f"import pandas as pd, oitlab\noitlab.plot.pareto({table})",
        "oitlab.render(oitlab.scenes.squares(width=16, height=9), 'wboit')",
        f"import matplotlib.pyplot as plt\noitlab.plot.pareto({table})",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "", "language": "python"}
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    for cell in notebook.cells:
        images = [output for output in cell.outputs if "image/png" in output.get("data", {})]
        assert len(images) == 1, cell
        assert not [output for output in cell.outputs if output.output_type in ("stream", "error")], cell


def test_names_without_room_are_listed_in_a_few_lines() -> None:
    count = 300
    table = pd.DataFrame(
        {
            "technique": [f"technique_{index}" for index in range(count)],
            "total_ms": 1 + np.arange(count) / count,
            "mse": 1.0,
        }
    )
    figure = plot.pareto(table, labels="all", width="single")
    (note,) = [t.get_text() for t in figure.axes[0].texts if t.get_gid() == "note"]
    assert len(note.splitlines()) <= 4
    flat = note.replace("\n", " ")
    listed = flat.removeprefix("not named, for lack of room: ").split(", ")
    more = re.search(r" and (\d+) more$", flat)
    assert more
    written = sum(t.get_text() in set(table["technique"]) for t in figure.axes[0].texts)
    assert written + len(listed) + int(more[1]) == count


def test_thousands_of_points_take_seconds() -> None:
    count = 20_000
    table = pd.DataFrame(
        {
            "technique": "lwboit",
            "bins": np.repeat(np.arange(1, count // 10 + 1), 10),
            "seed": np.tile(np.arange(10), count // 10),
            "mse": np.tile(np.linspace(1, 2, 10), count // 10),
        }
    )
    begin = time.perf_counter()
    (line,) = (line for line in plot.convergence(table, "bins").axes[0].lines if line.get_gid() == "line")
    assert time.perf_counter() - begin < 10  # 2 s here; 17 s when every point looked through all rows
    assert np.asarray(line.get_xdata()).tolist() == list(range(1, count // 10 + 1))
    assert line.get_ydata() == pytest.approx(1.5)
