"""`plot.convergence`: an error against a param."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection

from oitlab import plot
from plotting import legend, of_kind, seeds, shown


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


def test_thousands_of_points() -> None:
    count = 20_000
    table = pd.DataFrame(
        {
            "technique": "lwboit",
            "bins": np.repeat(np.arange(1, count // 10 + 1), 10),
            "seed": np.tile(np.arange(10), count // 10),
            "mse": np.tile(np.linspace(1, 2, 10), count // 10),
        }
    )
    (line,) = (line for line in plot.convergence(table, "bins").axes[0].lines if line.get_gid() == "line")
    assert np.asarray(line.get_xdata()).tolist() == list(range(1, count // 10 + 1))
    assert line.get_ydata() == pytest.approx(1.5)
