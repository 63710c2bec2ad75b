"""Weights of one's own, written in WGSL, on the GPU as they are."""

import warnings
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, SCENES, WHY_NOT, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

TECHNIQUES: list[tuple[str, dict[str, Any]]] = [
    ("wboit", {}),
    ("wboit", {"layout": "listing4"}),
    ("wboit", {"layout": "monochrome"}),
    ("lwboit", {"storage": "ll"}),
    ("lwboit", {"storage": "lr"}),
]

WEIGHTS: dict[str, dict[str, Any]] = {
    "an argument": {"weight": "a"},
    "an expression": {"weight": "a / (z * z + 0.1)"},
    "window depth": {"weight": "a * pow(1.0 - d, 3.0) + 0.01", "near": 0.5, "far": 20.0},
    "seen depth": {"weight": "1.0 / z", "weight_scale": 2.0, "weight_shift": -1.0},
    "uniforms": {
        "weight": "p + q * a + r / z + s * d + t",
        "weight.p": 0.5,
        "weight.q": 2.0,
        "weight.r": 3.0,
        "weight.s": 0.25,
        "weight.t": 0.125,
    },
    "a module": {
        "weight": """
            struct Params { k: f32, l: f32 }
            const one_minus = 1.0;
            fn fragment_of(p: Params, z: f32) -> f32 { return p.l + one_minus / pow(z, p.k); }
            fn weight(k: f32, z: f32) -> f32 { return fragment_of(Params(k, 0.5), z); }
        """,
        "weight.k": 2.0,
    },
    "the shader's own names": {
        "weight": """
            struct value { turns: f32, own_turns: f32 }
            const is_lost = 2.0;
            fn weight_(own_weight: f32) -> f32 { return own_weight * is_lost; }
            fn turns(v: value) -> f32 { var own_value = v.turns; own_value += v.own_turns; return own_value; }
            fn weight(own_turns: f32, a: f32, own_u: f32) -> f32 {
                let store = weight_(a);
                return turns(value(store, own_turns)) + own_u;
            }
        """,
        "weight.own_turns": 0.5,
        "weight.own_u": 0.25,
    },
    "a uniform of the shader's own name": {"weight": "a * own_turns", "weight.own_turns": 2.0},
    "loops and branches": {
        "weight": """
            fn weight(z: f32, a: f32) -> f32 {
                var sum = 0.0;
                for (var i = 1; i <= 8; i++) {
                    if i == 3 { continue; }
                    switch i { case 1, 5: { sum += a; } default: { sum += z / f32(i * i); } }
                }
                return sum;
            }
        """
    },
}


@pytest.mark.parametrize(("technique", "more"), TECHNIQUES)
@pytest.mark.parametrize("name", WEIGHTS)
def test_a_weight_of_ones_own_is_that_of_the_cpu(name: str, technique: str, more: dict[str, Any]) -> None:
    scene = SCENES["blades"]
    got, expected = (
        oitlab.render(scene, technique, WEIGHTS[name] | more, backend=backend) for backend in ("gpu", "cpu")
    )
    assert np.abs(got.color - expected.color).max() <= 2 * tolerance(scene, expected)
    assert got.params == expected.params
    assert got.stats.invalid_weights == expected.stats.invalid_weights == 0


def test_the_same_formula_is_the_same_weight() -> None:
    scene = SCENES["soup"]
    text = "a * clamp(10.0 / (1e-5 + (z / 5.0) * (z / 5.0) + pow(z / 200.0, 6.0)), 1e-2, 3e3)"
    own, published = oitlab.render_many(
        scene, [("wboit", {"weight": text}), ("wboit", {"weight": "mb7"})], backend="gpu"
    )
    assert np.abs(own.color - published.color).max() <= 2 * tolerance(scene, published)


@pytest.mark.parametrize(("technique", "more"), TECHNIQUES)
@pytest.mark.parametrize(
    "text",
    [
        "select(1.0, -1.0, a > 0.5)",
        "select(1.0, 0.0, a > 0.5)",
        "sqrt(0.5 - a)",
        "1.0 / max(0.5 - a, 0.0)",
        "fn weight(a: f32) -> f32 { var x = 1.0; while a > 0.5 { x += 1.0; } return x; }",
        "fn weight(a: f32) -> f32 { var i = 0; loop { if a <= 0.5 { break; } i++; } return 2.0; }",
        "fn weight(a: f32) -> f32 { var i = 0; loop { continuing { i++; break if a <= 0.5; } } return 2.0; }",
    ],
)
def test_what_is_no_weight_is_counted_and_replaced(text: str, technique: str, more: dict[str, Any]) -> None:
    scene = SCENES["random"]
    with pytest.warns(oitlab.WeightWarning):
        got = oitlab.render(scene, technique, {"weight": text} | more, backend="gpu")
    with pytest.warns(oitlab.WeightWarning):
        # lists of one fragment are answered without their weight otherwise
        expected = oitlab.render(scene, technique, {"weight": text} | more, skip=False)
    assert got.stats.invalid_weights == expected.stats.invalid_weights > 0
    assert np.abs(got.color - expected.color).max() <= 2 * tolerance(scene, expected)


def test_counts_do_not_go_on_from_one_frame_to_the_next() -> None:
    scene = SCENES["random"]
    wanted = [("wboit", {"weight": text}) for text in ("a - 0.5", "a", "a - 0.5")]
    with pytest.warns(oitlab.WeightWarning):
        first, second, third = oitlab.render_many(scene, wanted, backend="gpu", skip=False)
    assert first.stats.invalid_weights == third.stats.invalid_weights > 0
    assert second.stats.invalid_weights == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        oitlab.render(scene, "wboit", {"weight": "a"}, backend="gpu")


def test_a_value_of_a_uniform_is_not_that_of_another_frame() -> None:
    scene = SCENES["blades"]
    wanted = [("wboit", {"weight": "pow(z, -k)", "weight.k": k}) for k in (0.5, 4.0)]
    for got, expected in zip(
        oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted), strict=True
    ):
        assert np.abs(got.color - expected.color).max() <= 8 * tolerance(scene, expected)


@pytest.mark.parametrize(("technique", "more"), TECHNIQUES)
def test_callables_are_refused(technique: str, more: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"a callable has no form on the backend .*written in WGSL"):
        oitlab.render(SCENES["squares"], technique, {"weight": lambda z, a: z} | more, backend="gpu")


BIN_FUNCTIONS: dict[str, dict[str, Any]] = {
    "the tent": {"bin_function": "max(0.0, 1.0 - abs(x))"},
    "a uniform": {"bin_function": "exp(-k * x * x)", "bin_function.k": 1.5},
    "more than all": {"bin_function": "3.0 - abs(x)"},
    "less than nothing": {"bin_function": "0.75 - abs(x)"},
    "numbers that are none": {"bin_function": "sqrt(1.5 - abs(x))"},
    "nothing": {"bin_function": "0.0 * x"},
    "beside a weight": {"bin_function": "1.0 / (1.0 + x * x)", "weight": "a * k / z", "weight.k": 2.0},
    "huge": {"bin_function": "1e38 * (3.0 - abs(x))"},
}


@pytest.mark.parametrize("function", BIN_FUNCTIONS)
@pytest.mark.parametrize("partition", ["none", "absorbance"])
@pytest.mark.parametrize("storage", ["ll", "lr", "tiles"])
def test_bin_functions_are_those_of_the_cpu(storage: str, partition: str, function: str) -> None:
    scene = SCENES["squares"]
    base = {"storage": "ll" if storage == "ll" else "lr", "partition": partition, "bins": 12}
    params = base | BIN_FUNCTIONS[function]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # the CPU need not ask for the shares of lone fragments
        expected = oitlab.render(scene, "lwboit", params, skip=False)
        path = "compute" if storage == "tiles" else "hardware"
        got = oitlab.gpu.render(scene, "lwboit", params, path=path)
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=8 * tolerance(scene, expected))
    assert got.stats.invalid_weights == expected.stats.invalid_weights
    wrong = function in ("less than nothing", "numbers that are none", "nothing")
    assert (got.stats.invalid_weights > 0) == wrong


def test_bin_functions_that_are_callables_are_refused() -> None:
    with pytest.raises(ValueError, match=r"a callable has no form on the backend .*written in WGSL"):
        oitlab.render(SCENES["squares"], "lwboit", {"bin_function": lambda x: 1 - abs(x)}, backend="gpu")
