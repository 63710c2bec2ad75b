"""`plot.weight_curves`: weights as the core has them."""

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab import plot
from oitlab.plot._weights import evaluate
from plotting import WEIGHT_TOLERANCE


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
