"""`oitlab.technique`: functions of one's own beside the built-in techniques."""

import functools
import io
import json
import pickle
import re
import subprocess
import sys
import textwrap
import threading
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import _custom_examples as examples
import oitlab
import test_properties as properties
from oitlab import custom
from oitlab.cli import main

OVER = 1e-6
"""`over` in float64 of float32 colours, stored in float32."""
MERGED = 3e-6
"""The built-in nodes merge in float32."""


@pytest.fixture(autouse=True)
def _clean_registry() -> Iterator[None]:
    with custom.temporary():
        yield


@pytest.fixture
def mine() -> list[str]:
    return examples.registered()


@pytest.fixture(scope="module")
def fragments() -> oitlab.Fragments:
    """5 x 4 pixels of random layers, one of them without any, ties in depth, emission, and zero fragments."""
    generator = np.random.default_rng(7)
    counts = generator.integers(1, 12, 20)
    counts[3] = 0
    n = counts.sum()
    alpha = generator.random(n, np.float32)
    alpha[::5] = 0
    alpha[np.cumsum(counts) - 1] = 0.75  # no other pixel is empty
    color = (generator.random((n, 3), np.float32) * alpha[:, np.newaxis]).astype(np.float32)
    color[5] = 0.5
    return oitlab.Fragments(
        width=5,
        height=4,
        offsets=np.cumsum([0, *counts]),
        depth=generator.choice(np.linspace(1, 9, 12), n),
        color=color,
        alpha=alpha,
        background=(0.25, 0.5, 0.75),
    )


def constant(batch: oitlab.Batch, *, level: float = 0.5) -> tuple[Any, Any]:
    return np.full((len(batch), 3), level), np.ones(len(batch))


# what it computes


@pytest.mark.parametrize("name", ["numpy_over", "numba_over"])
@pytest.mark.parametrize("scene", list(oitlab.scenes.SCENES))
def test_over_is_the_a_buffer_on_every_scene(mine: list[str], name: str, scene: str) -> None:
    source = oitlab.scenes.SCENES[scene](width=72, height=41)
    exact, got = oitlab.render_many(source, ["a_buffer", name])
    np.testing.assert_allclose(got.color, exact.color, atol=OVER)
    np.testing.assert_allclose(got.transmittance, exact.transmittance, atol=OVER)
    assert got.stats.fragments == exact.stats.fragments > 0


def test_over_is_the_a_buffer_on_random_fragments(mine: list[str], fragments: oitlab.Fragments) -> None:
    for dtype, tolerance in (("float32", OVER), ("float64", 1e-14)):
        exact, numpy, numba = oitlab.render_many(fragments, ["a_buffer", *mine[:2]], dtype=dtype)
        for got in (numpy, numba):
            assert got.color.dtype == np.dtype(dtype)
            np.testing.assert_allclose(got.color, exact.color, atol=tolerance)
            np.testing.assert_allclose(got.transmittance, exact.transmittance, atol=tolerance)


@pytest.mark.parametrize("order", ["as_is", "reversed", "shuffled", "back_to_front", "centroid"])
def test_lists_in_submission_order(mine: list[str], small_scene: oitlab.Scene, order: str) -> None:
    for layers in (1, 3):
        params = {"layers": layers, "submission_order": order, "seed": 3}
        for source in (small_scene, oitlab.capture(small_scene)):
            built_in, own, exact = oitlab.render_many(
                source, [("mlab", params), ("own_mlab", params), "a_buffer"]
            )
            np.testing.assert_allclose(own.color, built_in.color, atol=MERGED)
            np.testing.assert_allclose(own.transmittance, built_in.transmittance, atol=MERGED)
            if order == "as_is":
                assert np.abs(own.color - exact.color).max() > 0.01


def test_bits_do_not_depend_on_company_skips_threads_or_capture(
    mine: list[str], small_scene: oitlab.Scene
) -> None:
    built_in = ["a_buffer", "wboit", ("mlab", {"layers": 2}), "alpha_compositing", "slab"]
    without = oitlab.render_many(small_scene, built_in)
    together = oitlab.render_many(small_scene, [*mine, *built_in])
    for alone, beside in zip(without, together[len(mine) :], strict=True):
        np.testing.assert_array_equal(alone.color, beside.color)
        np.testing.assert_array_equal(alone.transmittance, beside.transmittance)
    captured = oitlab.capture(small_scene)
    for name, expected in zip(mine, together, strict=False):
        full = oitlab.render(small_scene, name, skip=False)
        # a pixel of one fragment may be composited by the core where `exact_for_one` is promised
        np.testing.assert_allclose(full.color, expected.color, rtol=2.4e-7)
        for threads in (1, 3):
            again = oitlab.render(small_scene, name, threads=threads)
            np.testing.assert_array_equal(again.color, expected.color)
        np.testing.assert_array_equal(oitlab.render(captured, name).color, expected.color)


def test_a_technique_without_promises_is_always_called(small_scene: oitlab.Scene) -> None:
    seen = []

    @oitlab.technique
    def counting(batch: oitlab.Batch) -> tuple[Any, Any]:
        seen.append(len(batch))
        assert (batch.counts > 0).all()
        return batch.background, np.ones(len(batch))

    for skip in (True, False):
        seen.clear()
        frame = oitlab.render(small_scene, "counting", skip=skip)
        assert sum(seen) == (frame.fragment_count > 0).sum()
        assert len(seen) == 1  # 48 x 27 pixels are a tile
    scene = oitlab.Scene([], camera=oitlab.Camera(), width=5, height=3)
    seen.clear()
    np.testing.assert_array_equal(oitlab.render(scene, "counting", skip=False).transmittance, 1)
    assert not seen


def test_batches_are_tiles_and_memory_is_bounded() -> None:
    sizes = []

    @oitlab.technique
    def sizing(batch: oitlab.Batch) -> tuple[Any, Any]:
        sizes.append((len(batch), len(batch.depth)))
        return batch.background, np.ones(len(batch))

    planes = oitlab.scenes.blades(width=128, height=64, count=200)
    frame = oitlab.render(planes, "sizing", threads=1)
    assert len(sizes) == 2
    assert sum(pixels for pixels, _ in sizes) == (frame.fragment_count > 0).sum()
    assert sum(fragments for _, fragments in sizes) == frame.stats.fragments
    deep = 600
    layers = oitlab.Fragments(
        width=1000,
        height=1,
        offsets=np.arange(1001) * deep,
        depth=np.tile(np.linspace(1, 2, deep), 1000),
        color=np.zeros((1000 * deep, 3)),
        alpha=np.full(1000 * deep, 0.01),
        background=(1, 1, 1),
    )
    sizes.clear()
    oitlab.render(layers, "sizing")
    assert sum(fragments for _, fragments in sizes) == 1000 * deep
    assert max(fragments for _, fragments in sizes) <= 2**18


def test_what_a_batch_holds(fragments: oitlab.Fragments) -> None:
    batches: list[oitlab.Batch] = []

    @oitlab.technique(order="submission")
    def keeping(batch: oitlab.Batch) -> tuple[Any, Any]:
        batches.append(batch)
        return batch.background, np.ones(len(batch))

    oitlab.render(fragments, "keeping", threads=1)
    (batch,) = batches
    shapes = {
        "offsets": ((20,), np.int64),
        "depth": ((len(batch.depth),), np.float32),
        "color": ((len(batch.depth), 3), np.float32),
        "alpha": ((len(batch.depth),), np.float32),
        "primitive": ((len(batch.depth),), np.uint32),
        "background": ((19, 3), np.float32),
        "pixel": ((19, 2), np.int32),
    }
    for name, (shape, dtype) in shapes.items():
        array = getattr(batch, name)
        assert (array.shape, array.dtype) == (shape, dtype), name
        assert array.flags.c_contiguous, name
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert (batch.near, batch.far, batch.depth_range) == (
        fragments.near,
        fragments.far,
        fragments.depth_range,
    )
    assert [3, 0] not in batch.pixel.tolist()
    for place, (x, y) in enumerate(batch.pixel.tolist()):
        pixel = fragments.pixel(x, y)
        covers = (pixel["alpha"] > 0) | (pixel["color"] > 0).any(axis=1)
        row = slice(batch.offsets[place], batch.offsets[place + 1])
        for name in ("depth", "color", "alpha", "primitive"):
            np.testing.assert_array_equal(getattr(batch, name)[row], pixel[name][covers])
        assert batch.counts[place] == covers.sum()
        assert (batch.rows[row] == place).all()


def test_the_background_of_a_pixel_is_its_own() -> None:
    wall = oitlab.Mesh([(-9, -9, -1), (0, -9, -1), (0, 9, -1), (-9, 9, -1)], [(0, 1, 2), (0, 2, 3)],
                       color=(1, 0, 0, 1), alpha_mode="opaque")  # fmt: skip
    pane = oitlab.Mesh([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2), (0, 2, 3)],
                       color=(0, 1, 0, 0.5))  # fmt: skip
    scene = oitlab.Scene([wall, pane], camera=oitlab.Camera(), width=16, height=9, background=(0, 0, 1))
    oitlab.technique(lambda batch: (batch.background, np.ones(len(batch))), id="behind")
    image = oitlab.render(scene, "behind").color
    np.testing.assert_array_equal(image[:, 0], np.broadcast_to((1, 0, 0), (9, 3)))
    np.testing.assert_array_equal(image[:, 15], np.broadcast_to((0, 0, 1), (9, 3)))


def test_colored_transmittance_and_dropped(small_scene: oitlab.Scene) -> None:
    @oitlab.technique(colored_transmittance=True)
    def tinted(batch: oitlab.Batch, *, same: bool = False) -> tuple[Any, Any, Any]:
        share = np.full(len(batch), 0.5) if same else np.tile([0.25, 0.5, 1.0], (len(batch), 1))
        return batch.background, share, np.minimum(batch.counts, 2)

    frame = oitlab.render(small_scene, "tinted", skip=False)
    hit = frame.fragment_count > 0
    np.testing.assert_array_equal(frame.transmittance[hit], np.tile([0.25, 0.5, 1.0], (hit.sum(), 1)))
    np.testing.assert_array_equal(frame.transmittance[~hit], 1)
    assert frame.stats.dropped == np.minimum(frame.fragment_count, 2).sum() > hit.sum()
    same = oitlab.render(small_scene, "tinted", {"same": True})
    assert same.transmittance.shape == (27, 48, 3)
    np.testing.assert_array_equal(same.transmittance[hit], 0.5)


def test_rounding_beyond_the_unit_interval_is_clipped(fragments: oitlab.Fragments) -> None:
    share = {"of": 1 + 4e-7}
    oitlab.technique(lambda batch: (batch.background, np.full(len(batch), share["of"])), id="rounded")
    assert oitlab.render(fragments, "rounded", dtype="float64").transmittance.max() == 1
    share["of"] = -4e-7
    assert oitlab.render(fragments, "rounded", dtype="float64").transmittance.min() == 0


# the generic suite


@properties.quick
@given(properties.pixels)
def test_promises_hold_on_lists_that_hypothesis_makes(scene: list[list[Any]]) -> None:
    names = examples.registered()
    made = properties.made_of(scene)
    properties.check_finite(made, names)
    properties.check_hull(
        scene, [name for name in names if oitlab.techniques()[name].properties["exact_for_one_color"]]
    )
    exact = oitlab.render(made, "a_buffer", dtype="float64")
    counts = exact.fragment_count
    for name in names:
        promised = oitlab.techniques()[name].properties
        got = oitlab.render(made, name, dtype="float64")
        if promised["exact_coverage"]:
            np.testing.assert_allclose(got.transmittance, exact.transmittance, atol=1e-12)
        if promised["exact_for_one"]:
            one = counts <= 1
            np.testing.assert_allclose(got.color[one], exact.color[one], rtol=1e-12, atol=1e-12)


def test_order_sensitivity(mine: list[str], small_scene: oitlab.Scene) -> None:
    assert oitlab.order_sensitivity(small_scene, "numba_over", n=3).max() < 1e-12
    own = oitlab.order_sensitivity(small_scene, "own_mlab", {"layers": 1}, n=3, seed=5)
    built_in = oitlab.order_sensitivity(small_scene, "mlab", {"layers": 1}, n=3, seed=5)
    assert own.max() > 1e-3
    np.testing.assert_allclose(own, built_in, atol=1e-5)
    with pytest.raises(ValueError, match="submission_order is what order_sensitivity varies"):
        oitlab.order_sensitivity(small_scene, "own_mlab", {"submission_order": "reversed"})


def test_transmittance(mine: list[str], fragments: oitlab.Fragments) -> None:
    for x, y in ((0, 0), (3, 0), (4, 3)):
        curve = oitlab.transmittance(fragments, "numpy_over", pixel=(x, y))
        np.testing.assert_allclose(curve.reconstructed, curve.exact, rtol=1e-12)
    with pytest.raises(ValueError, match="own_mlab has no transmittance function"):
        oitlab.transmittance(fragments, "own_mlab", pixel=(0, 0))


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        (lambda batch, depths: depths[:1], r"returned shape \(1,\) for 2 depths"),
        (
            lambda batch, depths: depths + 1,
            r"the transmittance at depth 1 of pixel \(x=1, y=2\) is .*2.0.* not in",
        ),
        (lambda batch, depths: depths * np.nan, r"pixel \(x=1, y=2\) is .*nan"),
        (lambda batch, depths: np.ones(2, int), "has dtype int64"),
    ],
)
def test_bad_transmittance_functions(fragments: oitlab.Fragments, curve: Any, message: str) -> None:
    oitlab.technique(transmittance=lambda batch, depths, *, level: curve(batch, depths))(constant)
    with pytest.raises(ValueError, match="constant: .*" + message):
        oitlab.transmittance(fragments, "constant", pixel=(1, 2), depths=[1, 2])


def test_error_split_and_stress(fragments: oitlab.Fragments, mine: list[str]) -> None:
    with pytest.raises(ValueError, match="'numpy_over' has no storage formats"):
        oitlab.error_split(fragments, "numpy_over")
    rows = oitlab.stress("numba_over", formats=["f32", "f16"], cases=["mb13_overflow"])
    assert rows["format"].tolist() == ["f32"]
    assert rows["error_exact"].max() < OVER

    @oitlab.technique
    def rounding(batch: oitlab.Batch, *, format: oitlab.Param | str = stored) -> tuple[Any, Any]:
        color, share = examples.numpy_over(batch)
        dtype = {"f64": np.float64, "f16": np.float16}[str(format)]
        return color.astype(dtype), share

    split = oitlab.error_split(fragments, "rounding", format="f16")
    assert split.algorithmic.max < 1e-12
    assert 1e-5 < split.storage.max < 1e-3


stored: Any = oitlab.Param("f64", choices=("f64", "f16"))


# params


DECLARED = {
    "on": True,
    "count": 3,
    "factor": 1.0,
    "mode": "a",
    "bounds": (0.0, 1.0),
    "layers": oitlab.Param(4, min=1, max=64, doc="kept per pixel"),
    "weight": oitlab.Param("one", choices=("one", "two")),
}


def declared() -> oitlab.TechniqueInfo:
    def with_params(batch: oitlab.Batch, *, factor: float, **others: Any) -> tuple[Any, Any]:
        assert {*others, "factor"} == set(DECLARED)
        return np.full((len(batch), 3), factor), np.ones(len(batch))

    oitlab.technique(params=DECLARED)(with_params)
    return oitlab.techniques()["with_params"]


def test_the_entry_says_what_it_takes() -> None:
    entry = declared()
    assert (entry.custom, entry.backends, entry.name) == (True, ("cpu",), "with params")
    table = {param.name: (param.type, param.range, param.default) for param in entry.params}
    orders = oitlab.techniques()["wboit"].params[-2]
    assert table == {
        "on": ("bool", "True or False", True),
        "count": ("int", "an integer of 64 bits", 3),
        "factor": ("float", "a finite number", 1.0),
        "mode": ("str", "text", "a"),
        "bounds": ("tuple", "a tuple (float, float)", (0.0, 1.0)),
        "layers": ("int", "an integer in [1, 64]", 4),
        "weight": ("str", 'one of "one", "two"', "one"),
        "submission_order": (orders.type, orders.range, orders.default),
        "seed": ("int", "an integer >= 0", 0),
    }
    assert entry.params[5].doc == "kept per pixel"
    assert entry.fingerprint is not None
    assert oitlab.techniques()["wboit"].fingerprint is None
    assert not oitlab.techniques()["wboit"].custom
    assert set(entry.axes) == set(oitlab.techniques()["wboit"].axes)
    assert set(entry.properties) == set(oitlab.techniques()["wboit"].properties)
    for text in (str(entry), str(oitlab.techniques()), str(oitlab.techniques().axes_table())):
        assert "with_params" in text


def test_params_are_read_as_their_defaults_are(fragments: oitlab.Fragments) -> None:
    declared()
    given = {
        "on": np.bool_(False),
        "count": np.int64(7),
        "factor": 2,
        "mode": "b",
        "bounds": np.array([2, 3]),
        "layers": 64,
        "weight": "two",
        "seed": 9,
    }
    frame = oitlab.render(fragments, "with_params", given)
    assert frame.technique == "with_params"
    assert frame.params == {
        "on": False,
        "count": 7,
        "factor": 2.0,
        "mode": "b",
        "bounds": (2.0, 3.0),
        "layers": 64,
        "weight": "two",
        "submission_order": "as_is",
        "seed": 9,
    }
    assert type(frame.params["factor"]) is float
    assert oitlab.render(fragments, "with_params", {"count": None}).params["count"] == 3


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"cuont": 3}, r'unknown parameter "cuont"; its parameters are on \(True or False\), count'),
        ({"on": 1}, 'parameter "on" is 1; allowed is True or False; its parameters are on, count'),
        ({"count": 2.5}, '"count" is 2.5; allowed is an integer'),
        ({"count": True}, '"count" is True'),
        ({"count": 2**63}, '"count" is 9223372036854775808; allowed is an integer of 64 bits'),
        ({"count": -(2**63) - 1}, '"count" is -9223372036854775809; allowed is an integer of 64 bits'),
        ({"factor": "big"}, "\"factor\" is 'big'; allowed is a finite number"),
        ({"factor": np.inf}, '"factor" is inf'),
        ({"factor": np.nan}, '"factor" is nan'),
        ({"mode": 3}, '"mode" is 3; allowed is text'),
        ({"bounds": 1.0}, r'"bounds" is 1.0; allowed is a tuple \(float, float\)'),
        ({"bounds": (1.0, 2.0, 3.0)}, '"bounds"'),
        ({"bounds": (1.0, "x")}, '"bounds"'),
        ({"layers": 0}, r'"layers" is 0; allowed is an integer in \[1, 64\]'),
        ({"layers": 65}, '"layers" is 65'),
        ({"weight": "three"}, '"weight" is \'three\'; allowed is one of "one", "two"'),
        ({"seed": -1}, '"seed" is -1; allowed is an integer in'),
        ({"submission_order": "sideways"}, '"submission_order" is \'sideways\'; allowed is one of "as_is"'),
    ],
)
def test_bad_params_are_refused_by_name(fragments: oitlab.Fragments, params: Any, message: str) -> None:
    declared()
    with pytest.raises(ValueError, match="^with_params: .*" + message):
        oitlab.render_many(fragments, ["a_buffer", ("with_params", params)])


def test_seed_reaches_a_function_that_takes_it(fragments: oitlab.Fragments) -> None:
    calls = []

    @oitlab.technique
    def noisy(batch: oitlab.Batch, *, seed: int = 0) -> tuple[Any, Any]:
        calls.append(seed)
        return constant(batch, level=seed / 100)

    frames = oitlab.render_many(
        fragments, [("noisy", {"seed": 5}), ("noisy", {"seed": 6}), ("noisy", {"seed": 5})]
    )
    assert sorted(calls) == [5, 6]
    assert [frame.params["seed"] for frame in frames] == [5, 6, 5]
    assert frames[0].color[0, 0, 0] == np.float32(0.05)
    assert [param.name for param in oitlab.techniques()["noisy"].params] == ["submission_order", "seed"]


def test_equal_requests_are_rendered_once(fragments: oitlab.Fragments) -> None:
    calls = []

    @oitlab.technique
    def called(batch: oitlab.Batch, *, level: float = 0.5) -> tuple[Any, Any]:
        calls.append(level)
        return constant(batch, level=level)

    variants: list[Any] = [
        "called",
        ("called", {"level": 0.5}),
        ("called", {"level": 1}),
        ("called", {"seed": 4}),
    ]
    frames = oitlab.render_many(fragments, variants)
    assert sorted(calls) == [0.5, 1.0]
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames] == [1, 1, 0, 0]
    assert [frame.color[0, 0, 0] for frame in frames] == [0.5, 0.5, 1, 0.5]
    frames[0].color[:] = 7
    assert frames[1].color[0, 0, 0] == 0.5
    calls.clear()
    oitlab.render_many(fragments, variants, skip=False)
    assert len(calls) == 4


# cost


def test_costs(mine: list[str], small_scene: oitlab.Scene) -> None:
    frame = oitlab.render(small_scene, "numba_over")
    assert frame.stats.geometry_passes == 1
    assert frame.stats.bytes_per_pixel == 28 * frame.stats.depth_complexity_mean + 4
    assert frame.stats.resolve_ms > 0
    assert frame.stats.total_ms >= frame.stats.raster_ms
    entry = oitlab.techniques()["numba_over"]
    cost = entry.cost(depth_complexity_mean=2.0, depth_complexity_max=5)
    assert cost == oitlab.Cost(1.0, 60.0)
    assert (entry.geometry_passes, entry.bytes_per_pixel) == ("1", "by params")
    with pytest.raises(ValueError, match="depth_complexity_mean: 6"):
        entry.cost(depth_complexity_mean=6.0, depth_complexity_max=5)
    unsaid = oitlab.render(small_scene, "own_mlab").stats
    assert np.isnan([unsaid.geometry_passes, unsaid.bytes_per_pixel]).all()
    oitlab.technique(bytes_per_pixel=lambda params, mean, largest: -params["level"])(constant)
    with pytest.raises(ValueError, match=r"constant: bytes_per_pixel is -0.5, not a finite number >= 0"):
        oitlab.render(small_scene, "constant")


def test_costs_that_fail_name_the_technique(fragments: oitlab.Fragments) -> None:
    wrong: list[Any] = [
        lambda params, mean, largest: params["levle"],
        lambda params: 3,
        lambda params, mean, largest: 1 / 0,
    ]
    for function, error in zip(wrong, ("KeyError: 'levle'", "TypeError: ", "ZeroDivisionError"), strict=True):
        oitlab.technique(bytes_per_pixel=function)(constant)
        message = f"^constant: bytes_per_pixel, called with params of the names level, .* raised {error}"
        with pytest.raises(ValueError, match=message):
            oitlab.render(fragments, "constant")


# what goes wrong


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda n: None, "returned None, not"),
        (lambda n: np.ones((n, 3)), "returned an array of shape .* not"),
        (lambda n: (np.ones((n, 3)),), "returned a tuple of 1"),
        (lambda n: (np.ones((n, 4)), np.ones(n)), r"color has shape \(19, 4\) for 19 pixels, not \(19, 3\)"),
        (lambda n: (np.ones((n, 3), int), np.ones(n)), "color has dtype int64, not a float's"),
        (lambda n: (np.ones((n, 3)), np.ones(n - 1)), r"transmittance has shape \(18,\) .* not \(19,\)"),
        (lambda n: (np.ones((n, 3)), np.ones((n, 3))), "three channels need colored_transmittance=True"),
        (lambda n: (np.ones((n, 3)), 1.0), r"transmittance has shape \(\)"),
        (lambda n: (np.ones((n, 3)), ["a"] * n), "transmittance has dtype <U1"),
        (lambda n: (np.ones((n, 3)), [[1.0], 2.0]), "transmittance is not a regular array"),
        (
            lambda n: (spoiled((n, 3), np.nan), np.ones(n)),
            r"color of pixel \(x=3, y=1\) is \[nan, .* not finite",
        ),
        (lambda n: (spoiled((n, 3), np.inf), np.ones(n)), r"color of pixel \(x=3, y=1\) is \[inf,"),
        (
            lambda n: (np.ones((n, 3)), spoiled(n, np.nan)),
            r"transmittance of pixel \(x=3, y=1\) is nan, not in",
        ),
        (lambda n: (np.ones((n, 3)), spoiled(n, 1.5)), r"transmittance of pixel \(x=3, y=1\) is 1.5"),
        (lambda n: (np.ones((n, 3)), spoiled(n, -0.1)), r"transmittance of pixel \(x=3, y=1\) is -0.1"),
        (lambda n: (np.ma.masked_equal(spoiled((n, 3), 0), 0), np.ones(n)), "color has masked values"),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), np.ones(n)),
            "dropped is an array of .* float64, not 19 integers",
        ),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), -np.ones(n, int)),
            r"pixel \(x=0, y=0\) dropped -1 fragments",
        ),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), np.full(n, 99, np.uint64)),
            r"pixel \(x=0, y=0\) dropped 99 fragments, but has only \d+",
        ),
    ],
)
def test_what_comes_back_is_checked(fragments: oitlab.Fragments, result: Any, message: str) -> None:
    oitlab.technique(lambda batch: result(len(batch)), id="wrong")
    with pytest.raises(ValueError, match="wrong: .*" + message):
        oitlab.render(fragments, "wrong", threads=1)


def spoiled(shape: Any, value: float) -> Any:
    """Ones, but for the place of pixel (3, 1) in a batch that lacks (3, 0)."""
    array = np.ones(shape)
    array[7] = value
    return array


@pytest.mark.parametrize("threads", [1, 4])
def test_exceptions_reach_the_caller_as_they_are(small_scene: oitlab.Scene, threads: int) -> None:
    raised = KeyError("mine")

    @oitlab.technique
    def failing(batch: oitlab.Batch) -> tuple[Any, Any]:
        helper = raised
        raise helper

    for source in (small_scene, oitlab.capture(small_scene)):
        with pytest.raises(KeyError) as caught:
            oitlab.render_many(source, ["a_buffer", "failing"], threads=threads)
        assert caught.value is raised
        text = "".join(traceback.format_exception(caught.value))
        assert "raise helper" in text
        assert "in render_many" in text
        raised.__traceback__ = None
    with pytest.raises(KeyError, match="mine"):
        oitlab.order_sensitivity(small_scene, "failing", n=2)
    assert np.isfinite(oitlab.render(small_scene, "a_buffer").color).all()


def test_rendering_from_within_a_technique_is_refused(small_scene: oitlab.Scene) -> None:
    fragments = oitlab.capture(small_scene)

    @oitlab.technique
    def nested(batch: oitlab.Batch) -> tuple[Any, Any]:
        oitlab.render(fragments, "a_buffer")
        return batch.background, np.ones(len(batch))

    with pytest.raises(RuntimeError, match="from within a technique or a function that a render calls"):
        oitlab.render(small_scene, "nested")


def test_renders_of_several_threads_do_not_lock_each_other_out(
    mine: list[str], small_scene: oitlab.Scene
) -> None:
    images: list[Any] = []
    work = [
        threading.Thread(target=lambda: images.append(oitlab.render(small_scene, "numpy_over").color))
        for _ in range(4)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join(60)
    assert len(images) == 4
    for image in images:
        np.testing.assert_array_equal(image, images[0])


INTERRUPTED = """
import os, signal, threading, time
import numpy as np, oitlab

@oitlab.technique
def slow(batch):
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        np.ones(100).sum()
    print("left")
    return batch.background, np.ones(len(batch))

scene = oitlab.scenes.blades(width=48, height=27, count=60)
try:
    oitlab.render(scene, "slow")
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent the POSIX way")
def test_ctrl_c_works_while_the_function_runs() -> None:
    result = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    # the function is left alone at once, and waited for before the interpreter goes
    assert (result.returncode, result.stdout) == (0, "interrupted\nleft\n"), result.stderr


# the registry


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"id": "wboit"}, "id: 'wboit' is taken by the built-in technique 'wboit'"),
        ({"id": "over"}, "id: 'over' is taken by the built-in technique 'a_buffer'"),
        ({"id": "no name"}, "id must be a name of letters"),
        ({"id": ""}, "id must be a name"),
        ({"id": 3}, "id must be a name"),
        ({"order": "random"}, "constant: order must be 'sorted' or 'submission', got 'random'"),
        ({"params": ["level"]}, "constant: params must be a mapping"),
        ({"params": {"level": 0.5, "levle": 1}}, "takes no keyword-only argument 'levle'"),
        ({"params": {"submission_order": "as_is"}}, "the name 'submission_order' is taken"),
        ({"params": {"mse": 1}}, "constant: params: the name 'mse' is taken by a column of the tables"),
        ({"params": {"total_ms": 1}}, "the name 'total_ms' is taken by a column"),
        ({"params": {"width": 1}}, "the name 'width' is taken by a column"),
        ({"params": {"level": 2**63}}, "level: default: 9223372036854775808 is not an integer of 64 bits"),
        ({"params": {"level": [1]}}, "level: default must be a bool, int, float, str or tuple, got"),
        ({"params": {"level": ()}}, "level: default must hold"),
        ({"params": {"level": np.nan}}, "level: default: nan is not a finite number"),
        ({"params": {3: 1}}, "3 is not a name"),
        ({"transmittance": 3}, "transmittance must be a function, got 3"),
        ({"transmittance": lambda batch: 1}, "cannot be called as"),
        ({"name": 3}, "name must be text"),
        ({"doc": 3}, "doc must be text"),
        ({"citation": "Porter1984"}, "citation must be a sequence of keys"),
        ({"citation": [3]}, "citation must be a sequence of keys"),
        ({"unbiased": 1}, "unbiased must be True or False, got 1"),
        ({"colored_transmittance": "yes"}, "colored_transmittance must be True or False"),
        ({"geometry_passes": -1}, "geometry_passes must be a finite number >= 0 or a function, got -1"),
        ({"bytes_per_pixel": "many"}, "bytes_per_pixel must be a finite number"),
        ({"axes": {"colour": "red"}}, "unknown axis 'colour'; the axes are memory"),
        ({"axes": {"memory": 3}}, "must be text"),
        ({"axes": "none"}, "axes must be a mapping"),
    ],
)
def test_bad_registrations_are_refused(keywords: Any, message: str) -> None:
    before = oitlab.techniques()
    with pytest.raises(ValueError, match=message):
        oitlab.technique(**keywords)(constant)
    assert oitlab.techniques() is before


def test_functions_that_cannot_be_called_are_refused() -> None:
    def nothing() -> None: ...
    def needs(batch: Any, *, must: int) -> None: ...

    with pytest.raises(ValueError, match=r"nothing: the function\(\).* cannot be called as \(batch\)"):
        oitlab.technique(nothing)
    with pytest.raises(ValueError, match="needs: params: the function's argument 'must' has no default"):
        oitlab.technique(needs)
    oitlab.technique(params={"must": 3})(needs)
    assert oitlab.techniques()["needs"].params[0].default == 3
    with pytest.raises(ValueError, match="a technique is a function, got 3"):
        oitlab.technique(3)  # type: ignore[call-overload]


def test_arguments_that_would_never_be_params_are_refused() -> None:
    def positional(batch: Any, k: int = 4) -> None: ...
    def only(batch: Any, k: int = 4, /) -> None: ...

    for function in (positional, only):
        message = rf"{function.__name__}: params: .* 'k' .*: make k keyword-only, as in \(batch, \*, k=4\)"
        for params in (None, {"k": 4}):
            with pytest.raises(ValueError, match=message):
                oitlab.technique(params=params)(function)


def test_a_large_integer_is_as_large_as_a_table_takes(fragments: oitlab.Fragments) -> None:
    declared()
    for count in (2**63 - 1, -(2**63)):
        assert oitlab.render(fragments, "with_params", {"count": count}).params["count"] == count


def test_any_callable_will_do(fragments: oitlab.Fragments) -> None:
    class Level:
        """Not the technique's docstring."""

        def __call__(self, batch: oitlab.Batch, *, level: float = 0.25) -> tuple[Any, Any]:
            return constant(batch, level=level)

    oitlab.technique(id="by_partial")(functools.partial(constant, level=0.75))
    oitlab.technique(id="by_object")(Level())
    one, two = oitlab.render_many(fragments, ["by_partial", ("by_object", {"level": 0.5})])
    assert (one.color[0, 0, 0], two.color[0, 0, 0]) == (0.75, 0.5)
    assert one.params["level"] == 0.75
    for name in ("by_partial", "by_object"):
        assert oitlab.techniques()[name].doc == ""
        assert custom.receive(custom.shippable(name)) == name
    with pytest.raises(ValueError, match="id must be a name of letters"):
        oitlab.technique(Level())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"default": None}, "default must be"),
        ({"default": 3, "min": 5}, "default: 3 is not an integer >= 5"),
        ({"default": 3, "max": 2}, "default: 3 is not an integer <= 2"),
        ({"default": 3, "min": 4, "max": 2}, "min: 4 is greater than max = 2"),
        ({"default": 3, "min": "a"}, "min must be a number"),
        ({"default": "a", "max": 2}, "max is for numbers, and the default is 'a'"),
        ({"default": "a", "choices": "abc"}, "choices must be a sequence"),
        ({"default": "a", "choices": ()}, "choices must be a sequence"),
        ({"default": "a", "choices": ("a", 3)}, "choices: 3 is not of the type"),
        ({"default": "c", "choices": ("a", "b")}, "default: 'c' is not one of"),
        (
            {"default": (1.0, 2.0), "max": 1},
            r"default: \(1.0, 2.0\) is not a tuple \(float, float\), each <= 1",
        ),
        ({"default": (1, 2**64)}, r"default: \(1, 18446744073709551616\) is not a tuple \(int, int\)"),
        ({"default": 1, "doc": 3}, "doc must be text"),
    ],
)
def test_bad_declarations_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.Param(**arguments)


def test_a_second_function_takes_the_place_of_the_first(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    oitlab.technique(lambda batch: constant(batch, level=1.0), id="other")
    levels, ids = [], []
    for level in (0.25, 0.75):
        oitlab.technique(lambda batch, *, k=level: constant(batch, level=k), id="constant")
        levels.append(oitlab.render(fragments, "constant").color[0, 0, 0])
        ids.append(oitlab.techniques().ids[-2:])
    assert levels == [0.25, 0.75]
    assert ids == [("constant", "other")] * 2
    oitlab.unregister("constant")
    assert oitlab.techniques().ids[-1] == "other"
    with pytest.raises(ValueError, match="technique 'constant' is not registered; custom techniques: other"):
        oitlab.unregister("constant")
    with pytest.raises(ValueError, match="technique 'wboit' is built in"):
        oitlab.unregister("wboit")
    with pytest.raises(
        ValueError, match=r'unknown technique "constant"; the techniques are a_buffer, .*, other'
    ):
        oitlab.render(fragments, "constant")


def test_temporary_restores_what_was_there() -> None:
    oitlab.technique(constant)
    before = oitlab.techniques()
    with custom.temporary():
        oitlab.technique(lambda batch: None, id="constant")
        oitlab.technique(id="more")(constant)
        assert oitlab.techniques()["constant"].definition is not before["constant"].definition
    assert oitlab.techniques() == before
    assert oitlab.techniques()["constant"].definition is before["constant"].definition


def test_it_has_no_gpu_form(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    with pytest.raises(ValueError, match="'constant' has no GPU form"):
        oitlab.render(fragments, "constant", backend="gpu")


def test_diagnostics_look_for_nothing(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    frame = oitlab.render(fragments, "constant", diagnostics=True)
    assert dict(frame.diagnostics) == {}
    assert frame.stats.diagnostics == {}


def test_frames_can_be_pickled_and_written(fragments: oitlab.Fragments, tmp_path: Path) -> None:
    oitlab.technique(constant)
    frame = oitlab.render(fragments, "constant", {"level": 0.25})
    again = pickle.loads(pickle.dumps(frame))
    assert again.params == frame.params
    oitlab.write_exr(tmp_path / "mine.exr", frame)
    np.testing.assert_array_equal(oitlab.read_exr(tmp_path / "mine.exr").color, frame.color)
    json.dumps(frame.params)


# fingerprints and other processes

LEVEL = 0.5


def test_a_fingerprint_follows_what_the_function_computes() -> None:
    def of(source: str, **names: Any) -> str | None:
        scope = {"np": np, "__name__": "__main__", **names}
        exec(textwrap.dedent(source), scope)
        with custom.temporary():
            oitlab.technique(scope["mine"])
            return oitlab.techniques()["mine"].fingerprint

    base = "def mine(batch, *, k=1):\n    return np.full((len(batch), 3), 0.5 * k), half(batch)\n"
    helper = "def half(batch):\n    return np.full(len(batch), 0.5)\n"
    same = of(base + helper)
    assert same == of(helper + "\n\n" + base.replace(":\n", ":\n    # a comment\n", 1))
    assert isinstance(same, str)
    changes = {
        same,
        of(base.replace("0.5", "0.25") + helper),
        of(base.replace("k=1", "k=2") + helper),
        of(base.replace("full", "empty", 1) + helper),
        of(base + helper.replace("0.5", "0.25")),
        of(base.replace("0.5", "LEVEL") + helper, LEVEL=0.5),
        of(base.replace("0.5", "LEVEL") + helper, LEVEL=0.25),
        of(base.replace("0.5", "LEVEL[0]") + helper, LEVEL=np.array([0.5])),
        of(base.replace("0.5", "LEVEL[0]") + helper, LEVEL=np.array([0.25])),
        of(base.replace("0.5", "LEVEL['a']") + helper, LEVEL={"a": 0.5}),
        of(base.replace("0.5", "LEVEL['a']") + helper, LEVEL={"a": 0.25}),
        of(base + "class Half:\n  k = 0.5\n  def __call__(self, batch): return self.k\nhalf = Half()\n"),
        of(base + "class Half:\n  k = 0.25\n  def __call__(self, batch): return self.k\nhalf = Half()\n"),
        of(base + "class Half:\n  k = 0.5\n  def __call__(self, batch): return -self.k\nhalf = Half()\n"),
    }
    assert len(changes) == 14


def test_a_fingerprint_follows_numba_and_options() -> None:
    prints = set()
    for options in (
        {},
        {"order": "submission"},
        {"exact_for_one": True},
        {"transmittance": examples.over_curve},
    ):
        oitlab.technique(**options)(examples.numba_over)
        prints.add(oitlab.techniques()["numba_over"].fingerprint)
    oitlab.technique(examples.numpy_over)
    oitlab.technique(id="numba_over")(examples.numpy_over)
    prints.add(oitlab.techniques()["numba_over"].fingerprint)
    assert len(prints) == 5


def rendered_elsewhere(shipment: Any, fragments: oitlab.Fragments, params: Any) -> tuple[Any, Any]:
    first = custom.receive(pickle.loads(shipment))
    definition = oitlab.techniques()[first].definition
    assert custom.receive(pickle.loads(shipment)) == first
    assert oitlab.techniques()[first].definition is definition
    frame = oitlab.render(fragments, first, params)
    return frame.color, oitlab.techniques()[first].fingerprint


def test_other_processes_render_the_same(mine: list[str], fragments: oitlab.Fragments) -> None:
    table = np.linspace(0, 1, 5)

    @oitlab.technique
    def closure(batch: oitlab.Batch, *, k: int = 2) -> tuple[Any, Any]:
        color, share = examples.numba_over(batch)
        return color + table[k] * LEVEL, share

    @oitlab.technique(params={"k": oitlab.Param(1, min=0, max=4)})
    def closure_too(batch: oitlab.Batch, *, k: int) -> tuple[Any, Any]:
        return closure(batch, k=k)

    jobs: list[tuple[str, Any]] = [*((name, {}) for name in mine), ("closure", {"k": 4}), ("closure_too", {})]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for name, params in jobs:
            box = pickle.dumps(custom.shippable(name))
            color, fingerprint = pool.submit(rendered_elsewhere, box, fragments, params).result(120)
            np.testing.assert_array_equal(color, oitlab.render(fragments, name, params).color)
            assert fingerprint == oitlab.techniques()[name].fingerprint, name


def test_what_cannot_be_shipped_is_refused() -> None:
    with pytest.raises(ValueError, match="technique 'wboit' is built in"):
        custom.shippable("wboit")
    with pytest.raises(ValueError, match="technique 'nothing' is not registered"):
        custom.shippable("nothing")
    with pytest.raises(ValueError, match="shipment must come from"):
        custom.receive(b"")  # type: ignore[arg-type]
    lock = threading.Lock()
    oitlab.technique(lambda batch: (lock, None), id="locked")
    with pytest.raises(ValueError, match="technique 'locked' cannot be sent to another process"):
        custom.shippable("locked")
    assert oitlab.techniques()["locked"].fingerprint


# the command line and documents

PLUGIN = """
import numpy as np, oitlab

@oitlab.technique(citation=["Porter1984"])
def gray(batch, *, level=0.5):
    "The same gray everywhere."
    return np.full((len(batch), 3), level), np.ones(len(batch))
"""


def test_the_command_line_imports_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plugin = tmp_path / "plugin.py"
    plugin.write_text(PLUGIN)
    scene = ["scene:squares", "--width", "24", "--height", "16"]
    variants = ["--techniques", "gray:level=0.25,wboit", "-o", str(tmp_path)]
    assert main(["--import", str(plugin), "compare", *scene, *variants]) == 0
    assert "gray level=0.25" in capsys.readouterr().out
    assert (tmp_path / "squares.csv").read_text().count("gray level=0.25") == 1
    picture = ["--technique", "gray", "--param", "level=0.25", "-o", str(tmp_path / "a.exr")]
    assert main(["--import", str(plugin), "render", *scene, *picture]) == 0
    assert oitlab.read_exr(tmp_path / "a.exr").technique == "gray"
    capsys.readouterr()
    assert main(["--import", str(plugin), "techniques", "gray"]) == 0
    assert "The same gray everywhere." in capsys.readouterr().out
    for wrong, message in ((str(tmp_path / "none.py"), "none.py"), ("no_such_module", "no_such_module")):
        assert main(["--import", wrong, "techniques", "--ids"]) == 2
        assert re.search(message, capsys.readouterr().err)


def test_the_readme_example_runs() -> None:
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    section = text.split("## A technique of your own")[1].split("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.S)
    output = io.StringIO()
    exec(code, {"print": lambda *values: print(*values, file=output), "__name__": "__main__"})
    assert "nearest" in oitlab.techniques()
    errors = [float(value) for value in re.findall(r"RMSE ([-\d.e]+)", output.getvalue())]
    assert len(errors) == 3
    assert errors[0] < 1e-6 < errors[1] < errors[2]
