"""What techniques of one's own compute, beside built-in ones."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given

import _custom_examples as examples
import oitlab
import test_properties as properties

OVER = 1e-6
"""`over` in float64 of float32 colours, stored in float32."""
MERGED = 3e-6
"""The built-in nodes merge in float32."""


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
