"""Weights and bin functions of one's own: in WGSL and as functions of arrays."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import oitlab

Floats = NDArray[np.float32]

FEW_ULPS = 4e-6
"""Of an average of weighted colours, for weights that are a few ulps of float32 apart."""
WEIGHING = [t.id for t in oitlab.techniques() if any(p.name == "weight" for p in t.params)]

MB7 = "a * clamp(10.0 / (1e-5 + pow(z / 5.0, 2.0) + pow(z / 200.0, 6.0)), 1e-2, 3e3)"
WRITTEN = {
    "one": "1.0 + 0.0 * z",
    "mb7": MB7,
    "mb8": "a * clamp(10.0 / (1e-5 + pow(z / 10, 3) + pow(z / 200, 6)), 1e-2, 3e3)",
    "mb9": "a * clamp(0.03 / (1e-5 + pow(z / 200.0, 4.0)), 1e-2, 3e3)",
    "mb10": "a * max(1e-2, 3e3 * pow(1.0 - d, 3.0))",
    "inv_pow": "pow(z, -4.0)",
    "exp": "exp(-z)",
    "fig1": "pow(z + 5.0, -2.0)",
    "smoke6": "pow(a / pow(z, 3.0), 2.0)",
    "fig10": "10.0 / (1.0 + 10.0 * pow(0.01 * z, 5.0))",
    "i3d16": "clamp(1e3 * a * pow(1.0 - 0.99 * d, 3.0), 1e-2, 30.0)",
}


def one_per_pixel(depth: Floats) -> oitlab.Fragments:
    """Two layers per pixel: a red one at `depth`, a green one at 1 whose weight is known."""
    n = len(depth)
    color = np.tile(np.float32([(0.5, 0, 0), (0, 0.5, 0)]), (n, 1))
    return oitlab.Fragments(
        width=n,
        height=1,
        offsets=np.arange(0, 2 * n + 1, 2),
        depth=np.column_stack([depth, np.full(n, 0.0)]).ravel().astype(np.float32),
        color=color,
        alpha=np.full(2 * n, 0.5, np.float32),
        background=(0, 0, 0),
    )


def values(text: str, z: NDArray[Any], **uniforms: float) -> NDArray[Any]:
    """What an expression is at depths of at least 1, from the colours of a render: w_red / w_green is one."""
    named = {f"weight.{name}": value for name, value in uniforms.items()}
    # where z is the least depth there is the weight is 1
    weight = f"fn own(z: f32{''.join(f', {name}: f32' for name in uniforms)}) -> f32 {{ return {text}; }} "
    arguments = "".join(f", {name}: f32" for name in uniforms)
    call = f"own(z{''.join(f', {name}' for name in uniforms)})"
    weight += f"fn weight(z: f32{arguments}) -> f32 {{ if z < 0.5 {{ return 1.0; }} return {call}; }}"
    params = {"weight": weight, **named}
    color = oitlab.render(one_per_pixel(np.float32(z)), "wboit", params, dtype="float64").color[0]
    return color[:, 0] / color[:, 1]


@pytest.mark.parametrize("technique", WEIGHING)
def test_techniques_that_weigh_take_ones_own(technique: str, fragments: oitlab.Fragments) -> None:
    params = {"continuum": {"layers": 1, "normalize": "tail", "merge": "discard_furthest"}}.get(technique, {})
    named = oitlab.render(fragments, technique, {**params, "weight": "mb7"})
    written = oitlab.render(fragments, technique, {**params, "weight": MB7})
    called = oitlab.render(fragments, technique, {**params, "weight": mb7})
    other = oitlab.render(fragments, technique, {**params, "weight": "pow(z, -4.0)"})
    assert abs(written.color - named.color).max() < FEW_ULPS
    assert abs(called.color - named.color).max() < FEW_ULPS
    assert abs(other.color - named.color).max() > 1e-3
    assert written.params["weight"] == MB7
    assert called.params["weight"] is mb7
    assert written.stats.invalid_weights == called.stats.invalid_weights == 0


def mb7(z: Floats, alpha: Floats) -> Floats:
    """MB13 eq. 7 as a function of arrays."""
    assert z.dtype == alpha.dtype == np.float32
    assert z.shape == alpha.shape
    return alpha * np.clip(10 / (1e-5 + (z / 5) ** 2 + (z / 200) ** 6), 1e-2, 3e3)


@pytest.mark.parametrize("name", WRITTEN)
def test_published_weights_can_be_written(name: str, fragments: oitlab.Fragments) -> None:
    entry = oitlab.techniques()["wboit"]
    weight = next(param for param in entry.params if param.name == "weight")
    assert set(WRITTEN) == set(
        weight.range.split(";")[0].removeprefix("one of ").replace('"', "").split(", ")
    )
    planes = {"near": 2.0, "far": 60.0} if name in ("mb10", "i3d16") else {}
    named, written = (
        oitlab.render(fragments, "wboit", {"weight": w, **planes}) for w in (name, WRITTEN[name])
    )
    # 1 - d is known to an ulp of 1, and mb10 takes its third power
    tolerance = 2e-4 if planes else FEW_ULPS
    assert abs(written.color - named.color).max() < tolerance
    assert written.params["near"] == named.params["near"]


FUNCTIONS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "2.0 + sin(z)": lambda z: 2 + np.sin(z),
    "2.0 + cos(z)": lambda z: 2 + np.cos(z),
    "1.0 + abs(tan(z))": lambda z: 1 + abs(np.tan(z)),
    "asin(1.0 / z) + 1.0": lambda z: np.arcsin(1 / z) + 1,
    "acos(1.0 / z) + 1.0": lambda z: np.arccos(1 / z) + 1,
    "atan(z)": np.arctan,
    "atan2(z, -3.0)": lambda z: np.arctan2(z, -3),
    "sinh(z * 0.1)": lambda z: np.sinh(z * 0.1),
    "cosh(z * 0.1)": lambda z: np.cosh(z * 0.1),
    "tanh(z * 0.1)": lambda z: np.tanh(z * 0.1),
    "asinh(z)": np.arcsinh,
    "acosh(z + 0.5)": lambda z: np.arccosh(z + 0.5),
    "atanh(0.5 / z)": lambda z: np.arctanh(0.5 / z),
    "exp(z * 0.1)": lambda z: np.exp(z * 0.1),
    "exp2(-z * 0.1)": lambda z: np.exp2(-z * 0.1),
    "log(z + 1.0)": lambda z: np.log(z + 1),
    "log2(z + 1.0)": lambda z: np.log2(z + 1),
    "pow(z, 1.7)": lambda z: z**1.7,
    "pow(z, 0.1 * z)": lambda z: z ** (0.1 * z),
    "sqrt(z)": np.sqrt,
    "inverseSqrt(z)": lambda z: 1 / np.sqrt(z),
    "floor(z) + ceil(z) + trunc(z)": lambda z: np.floor(z) + np.ceil(z) + np.trunc(z),
    "round(z * 2.0)": lambda z: np.rint(z * 2),
    "fract(z) + 1.0": lambda z: z - np.floor(z) + 1,
    "sign(z - 5.0) + 2.0": lambda z: np.sign(z - 5) + 2,
    "min(z, 7.0) + max(z, 9.0) + clamp(z, 2.0, 3.0)": lambda z: (
        np.minimum(z, 7) + np.maximum(z, 9) + np.clip(z, 2, 3)
    ),
    "mix(z, 3.0, 0.25)": lambda z: z * 0.75 + 0.75,
    "step(6.0, z) + 1.0": lambda z: (z >= 6) + 1.0,
    "smoothstep(2.0, 12.0, z) + 1.0": lambda z: (
        np.clip((z - 2) / 10, 0, 1) ** 2 * (3 - 2 * np.clip((z - 2) / 10, 0, 1)) + 1
    ),
    "degrees(z) + radians(z)": lambda z: np.degrees(z) + np.radians(z),
    "length(vec3(z, 2.0, 1.0)) + dot(vec2(z), vec2(1.0, 2.0))": lambda z: np.sqrt(z * z + 5) + 3 * z,
    "f32(u32(z) % 3u + 1u)": lambda z: z.astype(int) % 3 + 1.0,
    "quantizeToF16(z)": lambda z: z.astype(np.float16).astype(float),
    "ldexp(z, 3)": lambda z: 8 * z,
}


@pytest.mark.parametrize("text", FUNCTIONS)
def test_functions_are_numpys(text: str) -> None:
    z = np.linspace(1, 20, 301, dtype=np.float32).astype(float)
    assert values(text, z) == pytest.approx(FUNCTIONS[text](z), rel=3e-5)


def test_statements_and_helpers() -> None:
    z = np.linspace(1, 20, 301, dtype=np.float32).astype(float)
    module = """
        const knee = 6.0;
        fn falloff(x: f32, n: i32) -> f32 {
            var product = 1.0;
            for (var i = 0; i < n; i++) { product *= x; }
            return product;
        }
        fn weight(z: f32) -> f32 {
            if z < 0.5 { return 1.0; }
            switch i32(z) {
                case 1, 2: { return 2.0; }
                case 3: { return falloff(z, 2); }
                default: {}
            }
            let far = select(1.0, 0.25, z > knee);
            return far * falloff(z, 1);
        }
    """
    color = oitlab.render(one_per_pixel(np.float32(z)), "wboit", {"weight": module}, dtype="float64").color[0]
    whole = z.astype(int)
    expected = np.where(whole <= 2, 2, np.where(whole == 3, z * z, np.where(z > 6, 0.25, 1) * z))
    assert color[:, 0] / color[:, 1] == pytest.approx(expected, rel=1e-5)


def test_window_depth(fragments: oitlab.Fragments) -> None:
    near, far = 2.0, 60.0
    own = "fn weight(d: f32, z: f32) -> f32 { return 1.5 - d; }"

    def window(z: Floats, alpha: Floats) -> Floats:
        return 1.5 - np.clip(far * (z - near) / (z * (far - near)), 0, 1)

    written = oitlab.render(fragments, "wboit", {"weight": own, "near": near, "far": far})
    called = oitlab.render(fragments, "wboit", {"weight": window})
    assert abs(written.color - called.color).max() < FEW_ULPS
    texts = [{"weight": own, "near": near}, {"weight": own, "near": 3.0}, {"weight": "1.0 / z", "near": 3.0}]
    frames = oitlab.render_many(fragments, [("wboit", params) for params in [*texts, {"weight": "1.0 / z"}]])
    skipped = [frame.stats.skipped["duplicate_variants"] for frame in frames]
    assert skipped == [0, 0, 1, 0]  # planes only matter where window depth is read


def test_weights_see_scaled_and_shifted_depths(fragments: oitlab.Fragments) -> None:
    params = {"weight_scale": 2.0, "weight_shift": -3.0}
    named = oitlab.render(fragments, "wboit", {"weight": "inv_pow", **params})
    written = oitlab.render(fragments, "wboit", {"weight": "1.0 / (z * z * z * z)", **params})
    called = oitlab.render(fragments, "wboit", {"weight": lambda z, a: z**-4.0, **params})
    assert abs(written.color - named.color).max() < FEW_ULPS
    assert abs(called.color - named.color).max() < FEW_ULPS


def test_uniforms(fragments: oitlab.Fragments) -> None:
    text = "gain * exp(-k * z)"
    given = {"weight": text, "weight.k": 0.25, "weight.gain": np.float64(2)}
    frame = oitlab.render(fragments, "wboit", given)
    assert frame.params == {**frame.params, **given}
    assert (
        abs(frame.color - oitlab.render(fragments, "wboit", {"weight": "exp", "weight_k": 0.25}).color).max()
        < 1e-5
    )
    module = "fn weight(k: f32, z: f32, gain: f32) -> f32 { return gain * exp(-k * z); }"
    assert np.array_equal(frame.color, oitlab.render(fragments, "wboit", {**given, "weight": module}).color)
    variants = [("wboit", {**given, "weight.k": k}) for k in (0.1, 0.2, 0.1, 0.2)]
    frames = oitlab.render_many(fragments, variants)
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames] == [1, 1, 0, 0]
    assert not np.array_equal(frames[0].color, frames[1].color)
    assert np.array_equal(frames[0].color, frames[2].color)


def test_callables_are_told_apart_by_object(fragments: oitlab.Fragments) -> None:
    def one(z: Floats, alpha: Floats) -> Floats:
        return np.ones_like(z)

    def same(z: Floats, alpha: Floats) -> Floats:
        return np.ones_like(z)

    frames = oitlab.render_many(fragments, [("wboit", {"weight": f}) for f in (one, same, one)])
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames] == [1, 0, 0]


@pytest.mark.parametrize("kind", ["float64", "int", "bool", "list", "strided"])
def test_callables_may_return_any_numbers(kind: str, fragments: oitlab.Fragments) -> None:
    returned: dict[str, Callable[[Floats], Any]] = {
        "float64": lambda z: np.full(len(z), 1e300),
        "int": lambda z: np.full(len(z), 3),
        "bool": lambda z: np.full(len(z), True),
        "list": lambda z: [2.5] * len(z),
        "strided": lambda z: np.full((len(z), 2), 4, np.float32)[:, 0],
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", oitlab.WeightWarning)
        frame = oitlab.render(fragments, "wboit", {"weight": lambda z, a: returned[kind](z)})
    assert abs(frame.color - oitlab.render(fragments, "wboit", {"weight": "one"}).color).max() < FEW_ULPS
    assert frame.stats.invalid_weights == (len(fragments) if kind == "float64" else 0)


def test_callables_are_called_for_many_fragments(
    small_scene: oitlab.Scene, fragments: oitlab.Fragments
) -> None:
    sizes: list[int] = []

    def weight(z: Floats, alpha: Floats) -> Floats:
        sizes.append(len(z))
        return 1 / (1 + z)

    for source in (small_scene, fragments):
        for technique in ("wboit", "lwboit"):
            sizes.clear()
            oitlab.render(source, technique, {"weight": weight}, threads=1, skip=False)
            assert sum(sizes) == len(fragments)
            assert np.mean(sizes) > 500


@pytest.mark.parametrize("weight", [MB7, mb7, "exp(-k * z) * (1.5 - d)"])
@pytest.mark.parametrize("technique", ["wboit", "lwboit"])
def test_captures_and_threads_have_the_same_bits(
    technique: str, weight: Any, small_scene: oitlab.Scene, fragments: oitlab.Fragments
) -> None:
    params = {"weight": weight} | ({"weight.k": 0.2} if weight not in (MB7, mb7) else {})
    frames = [
        oitlab.render(source, technique, params, threads=threads, skip=skip)
        for source in (small_scene, fragments)
        for threads, skip in ((1, True), (3, True), (None, False))
    ]
    for frame in frames:
        assert frame.color == pytest.approx(frames[0].color, rel=3e-7)  # pixels of one fragment are cut short
    for frame in (frames[1], frames[3], frames[4]):
        assert np.array_equal(frame.color, frames[0].color)
    assert np.array_equal(frames[2].color, frames[5].color)


def test_many_weights_at_once_are_those_alone() -> None:
    scene = oitlab.scenes.smoke(width=48, height=27, count=30)
    tilted = oitlab.scenes.soup(width=48, height=27, count=400)
    both = scene.replace(meshes=[*scene.meshes, *tilted.meshes])
    weights: list[Any] = ["mb7", MB7, mb7, "1.0 / z", "one", "mb9"]
    variants = [("wboit", {"weight": weight}) for weight in weights]
    variants += [("weighted_average", {}), ("lwboit", {"weight": "1.0 / z"})]
    for source in (scene, tilted, both):
        for variant, frame in zip(variants, oitlab.render_many(source, variants), strict=True):
            assert np.array_equal(frame.color, oitlab.render(source, *variant).color), variant


@pytest.mark.parametrize("summation", ["plain", "compensated", "scaled"])
@pytest.mark.parametrize("format", ["f16", "f64"])
def test_storage_formats_take_ones_own(format: str, summation: str, fragments: oitlab.Fragments) -> None:
    params = {"format": format, "summation": summation}
    named, written, called = (
        oitlab.render(fragments, "wboit", {"weight": w, **params}) for w in ("mb7", MB7, mb7)
    )
    tolerance = 1e-2 if format == "f16" else FEW_ULPS
    assert abs(written.color - named.color).max() < tolerance
    assert abs(called.color - named.color).max() < tolerance
    checked = oitlab.render(fragments, "wboit", {"weight": mb7, **params}, diagnostics=True)
    assert checked.diagnostics is not None


# what is counted


def counted(source: Any, technique: str, params: dict[str, Any], *, skip: bool = True) -> oitlab.Frame:
    """Render with exactly one warning, from this file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frame = oitlab.render(source, technique, params, skip=skip)
    assert [w.category for w in caught] == [oitlab.WeightWarning]
    assert caught[0].filename == __file__
    assert f"{frame.stats.invalid_weights} of {technique}" in str(caught[0].message)
    return frame


@pytest.mark.parametrize("bad", ["0.0", "-1.0", "log(-z)", "1.0 / (z - z)"])
def test_what_is_no_weight_is_counted_exactly(bad: str) -> None:
    depth = np.linspace(1, 20, 301, dtype=np.float32)
    fragments = one_per_pixel(depth)
    frame = counted(fragments, "wboit", {"weight": f"select(1.0, {bad}, z > 7.0)"})
    assert frame.stats.invalid_weights == (depth > 7).sum()
    # next to a weight of 1 the least one is nothing
    beyond = depth > 7
    assert frame.color[0, beyond, 0] == pytest.approx(0, abs=1e-20)
    assert frame.color[0, beyond, 1] == pytest.approx(0.75)


def in_tails(fragments: oitlab.Fragments) -> Floats:
    """Depths of all fragments but the nearest of each pixel."""
    pixels = np.split(fragments.depth, fragments.offsets[1:-1])
    return np.concatenate([np.sort(depth)[1:] for depth in pixels])


@pytest.mark.parametrize("technique", WEIGHING)
def test_counts_are_those_of_fragments(technique: str) -> None:
    params: dict[str, Any] = {
        "continuum": {"layers": 1, "normalize": "tail", "merge": "discard_furthest"},
        "lwboit": {"shape": False},
    }.get(technique, {})

    for scene in (
        oitlab.scenes.soup(width=48, height=27, count=40_000),
        oitlab.scenes.smoke(width=48, height=27, count=30),
        oitlab.scenes.shells(width=48, height=27, subdivisions=2),
    ):
        fragments = oitlab.capture(scene)
        middle = np.float32(np.median(fragments.depth))
        weight = f"select(1.0, -1.0, z > {middle})"

        def function(z: Floats, alpha: Floats, middle: np.float32 = middle) -> Floats:
            return np.where(z > middle, -1, 1)

        # pixels of one fragment need not be weighed; weights see the depths that nodes hold
        for stored in ({}, {"format": "f16"} if technique != "continuum" else {"format": "f64"}):
            counts = {
                counted(
                    source, technique, {**params, "weight": own, **stored}, skip=False
                ).stats.invalid_weights
                for source in (scene, fragments)
                for own in (weight, function)
            }
            weighed = in_tails(fragments) if technique == "continuum" else fragments.depth
            assert counts == {int((weighed > middle).sum())}


def test_one_warning_tells_of_all_variants(fragments: oitlab.Fragments) -> None:
    variants = [("wboit", {"weight": "-z"}), ("wboit", {"weight": "mb7"}), ("lwboit", {"weight": "0.0 - z"})]
    with pytest.warns(oitlab.WeightWarning) as caught:
        frames = oitlab.render_many(fragments, variants, skip=False)
    assert len(caught) == 1
    n = len(fragments)
    assert [frame.stats.invalid_weights for frame in frames] == [n, 0, n]
    assert f"{n} of wboit, {n} of lwboit" in str(caught[0].message)
    # all weights alike, as where all underflow
    assert abs(frames[0].color - oitlab.render(fragments, "wboit", {"weight": "one"}).color).max() < FEW_ULPS


def test_shared_weights_count_for_each_technique(small_scene: oitlab.Scene) -> None:
    own = {"weight": "select(1.0, 0.0, z > 5.0)"}
    with pytest.warns(oitlab.WeightWarning):
        one, two = oitlab.render_many(
            small_scene, [("wboit", own), ("wboit", {**own, "listing3_clamp": True})]
        )
    assert one.stats.invalid_weights == two.stats.invalid_weights > 0


# bin functions

BELL = "exp2(-4.0 * x * x)"


def tent(x: Floats) -> Floats:
    """Fade linearly."""
    return np.maximum(0, 1 - abs(x))


@pytest.mark.parametrize("partition", ["none", "absorbance"])
@pytest.mark.parametrize("format", [{}, {"format": "f16"}, {"storage": "ll"}])
def test_bin_functions(partition: str, format: dict[str, str], fragments: oitlab.Fragments) -> None:
    params = {"partition": partition, **format}
    tolerance = 1e-2 if "format" in format else 2e-5

    def close(name: str, own: Any) -> None:
        named, mine = (oitlab.render(fragments, "lwboit", {**params, "bin_function": f}) for f in (name, own))
        assert abs(named.color - mine.color).max() < tolerance
        assert mine.stats.invalid_weights == 0

    close("bell", BELL)
    close("bell", "fn bin(x: f32) -> f32 { return pow(0.5, 4.0 * x * x); }")
    close("tent", "max(0.0, 1.0 - abs(x))")
    close("tent", tent)
    bell, tents = (
        oitlab.render(fragments, "lwboit", {**params, "bin_function": f}) for f in ("bell", "tent")
    )
    assert abs(bell.color - tents.color).max() > 1e-3


def test_bin_functions_have_uniforms_and_counts(fragments: oitlab.Fragments) -> None:
    params = {"bin_function": "exp2(-s * x * x)", "bin_function.s": 4.0}
    frame = oitlab.render(fragments, "lwboit", params)
    assert frame.params == {**frame.params, **params}
    assert abs(frame.color - oitlab.render(fragments, "lwboit").color).max() < 2e-5
    bad = counted(fragments, "lwboit", {"bin_function": "select(1.0, -1.0, abs(x) > 0.5)"}, skip=False)
    assert bad.stats.invalid_weights == len(fragments)
    naive = oitlab.render(fragments, "lwboit", {"smooth": False})
    assert abs(bad.color - naive.color).max() < 1e-5
    only = oitlab.render(fragments, "lwboit", {"smooth": False, **params})
    assert np.array_equal(only.color, naive.color)


def test_fragments_without_a_share_are_counted(fragments: oitlab.Fragments) -> None:
    """A bin function so narrow that it is 0 between the centres loses what lies there."""
    for nothing in ("0.0 * x", lambda x: 0.0 * x):
        lost = counted(fragments, "lwboit", {"bin_function": nothing}, skip=False)
        assert lost.stats.invalid_weights == len(fragments)
    narrow = counted(fragments, "lwboit", {"bin_function": "max(0.0, 1.0 - 4.0 * abs(x))"}, skip=False)
    assert 0 < narrow.stats.invalid_weights < len(fragments)


def test_an_argument_alone_is_a_function(fragments: oitlab.Fragments) -> None:
    for name in ("z", "a", "d"):
        alone, in_brackets = oitlab.render_many(
            fragments, [("wboit", {"weight": w}) for w in (name, f"({name})")]
        )
        assert np.array_equal(alone.color, in_brackets.color)
    with pytest.raises(ValueError, match='"x"'):
        oitlab.render(fragments, "wboit", {"weight": "x"})


def test_callables_for_both(small_scene: oitlab.Scene) -> None:
    named = oitlab.render(small_scene, "lwboit", {"weight": "mb7", "bin_function": "tent"})
    called = oitlab.render(small_scene, "lwboit", {"weight": mb7, "bin_function": tent})
    assert abs(named.color - called.color).max() < 2e-5
