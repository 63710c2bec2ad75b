"""Orders of submission on the GPU, and lists with room for so many fragments, on both rasters."""

import re
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, PARAMS, SCENES, WHY_NOT, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

Params = dict[str, Any]

ORDERS = ("as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid")
PATHS = ("hardware", "compute")

ORDERED: list[tuple[str, Params]] = [
    ("mlab", {"layers": 2}),
    ("k_buffer", {"layers": 2}),
    ("z3", {"layers": 3}),
    ("mlcb", {"layers": 3}),
    ("mlcb", {"layers": 2, "store": "hybrid"}),
    ("mlab_buckets", {"layers": 2}),
    ("mlab_buckets", {"layers": 2, "mode": "depth", "buckets": 3, "range": "pixel"}),
    ("mlab_buckets", {"layers": 2, "mode": "transmittance", "buckets": 3}),
    ("adaptive_transparency", {"layers": 3}),
    ("avsm", {"layers": 6}),
]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("technique", "params"), ORDERED)
def test_what_depends_on_the_order_gets_that_of_the_cpu(technique: str, params: Params, order: str) -> None:
    # depths agree to the bit here, so that nothing changes places
    scene = SCENES["squares"]
    params = PARAMS.get(technique, {}) | params | {"submission_order": order, "seed": 5}
    expected = oitlab.render(scene, technique, params)
    for path in PATHS:
        got = oitlab.gpu.render(scene, technique, params, path=path)  # type: ignore[arg-type]
        off = np.abs(got.color - expected.color).max()
        assert off <= tolerance(scene, expected), (path, off)


def test_these_techniques_do_depend_on_it() -> None:
    scene = SCENES["squares"]
    for technique, params in ORDERED:
        wanted = [
            (technique, PARAMS.get(technique, {}) | params | {"submission_order": order})
            for order in ("as_is", "shuffled", "centroid")
        ]
        one, other, third = (frame.color for frame in oitlab.render_many(scene, wanted, backend="gpu"))
        assert np.abs(one - other).max() > 1e-3, technique
        assert np.abs(one - third).max() > 1e-3, technique


@pytest.mark.parametrize("order", ["shuffled", "centroid"])
def test_fragments_that_are_there_already_come_in_these_orders_too(order: str) -> None:
    fragments = oitlab.capture(SCENES["squares"])
    params = {"layers": 2, "submission_order": order, "seed": 9}
    got = oitlab.render(fragments, "mlab", params, backend="gpu")
    expected = oitlab.render(fragments, "mlab", params)
    assert np.abs(got.color - expected.color).max() <= tolerance(SCENES["squares"], expected)


@pytest.mark.parametrize("order", ["sorted", "back_to_front"])
@pytest.mark.parametrize("technique", ["alpha_compositing", "wboit"])
def test_tiles_hand_fragments_over_by_depth(technique: str, order: str) -> None:
    scene = SCENES["blades"]
    params = {"submission_order": order}
    got = oitlab.gpu.render(scene, technique, params, path="compute")
    expected = oitlab.render(scene, technique, params)
    assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected)


LIMITED: list[tuple[str, Params]] = [
    ("a_buffer", {"overflow": "drop"}),
    ("a_buffer", {"overflow": "tail_blend"}),
    ("lwboit", {"storage": "ll"}),
    ("lwboit", {"storage": "ll", "range": "pixel", "partition": "absorbance", "normalize": False}),
]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("technique", "params"), LIMITED)
def test_fragments_beyond_the_capacity_are_dropped_as_on_the_cpu(
    technique: str, params: Params, order: str
) -> None:
    scene = SCENES["squares"]
    for capacity in (1, 3, 20):
        given = params | {"capacity": capacity, "submission_order": order, "seed": 2}
        expected = oitlab.render(scene, technique, given)
        got = oitlab.render(scene, technique, given, backend="gpu")
        limit = (8 if technique == "lwboit" else 1) * tolerance(scene, expected)
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)
        assert got.stats.dropped == expected.stats.dropped
        assert (got.stats.dropped > 0) == (params.get("overflow") != "tail_blend" and capacity < 20)
        if order not in ("sorted", "back_to_front") or params.get("overflow") == "tail_blend":
            tiles = oitlab.gpu.render(scene, technique, given, path="compute")
            np.testing.assert_allclose(tiles.color, expected.color, rtol=0, atol=limit)
            assert tiles.stats.dropped == expected.stats.dropped


def test_what_does_nothing_takes_no_room() -> None:
    rng = np.random.default_rng(2)
    pane = [(-9.0, -9, 0), (9, -9, 0), (0, 9, 0)]
    corners = np.array(pane) + rng.uniform(-2, 2, (12, 1, 1)) * (0, 0, 1)
    colors = rng.random((12, 4))
    colors[::3, 3] = 0
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), face_colors=colors)
    scene = oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=9, height=7)
    params = {"overflow": "drop", "capacity": 5}
    expected = oitlab.render(scene, "a_buffer", params)
    assert expected.stats.dropped == 3 * 63
    for path in PATHS:
        got = oitlab.gpu.render(scene, "a_buffer", params, path=path)  # type: ignore[arg-type]
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=1e-6)
        assert got.stats.dropped == expected.stats.dropped


def test_capacities_without_a_form_are_refused_by_name() -> None:
    fragments = oitlab.capture(SCENES["squares"])
    with pytest.raises(ValueError, match=r"capacity has no form .* for fragments that are there already"):
        oitlab.render(fragments, "a_buffer", {"overflow": "drop", "capacity": 3}, backend="gpu")
    params = {"overflow": "drop", "capacity": 3, "submission_order": "sorted"}
    with pytest.raises(ValueError, match=re.escape('submission_order="sorted" sorts fragments')):
        oitlab.gpu.render(SCENES["squares"], "a_buffer", params, path="compute")


def test_an_order_beyond_the_device_is_an_error_that_says_so() -> None:
    fragments = oitlab.Fragments(
        width=1,
        height=1,
        offsets=[0, 2],
        depth=np.array([1, 2], np.float32),
        color=np.full((2, 3), 0.25, np.float32),
        alpha=np.full(2, 0.5, np.float32),
        primitive=np.array([0, 2**32 - 1], np.uint32),
        background=(0.1, 0.2, 0.3),
        near=0.5,
        far=4.0,
    )
    with pytest.raises(MemoryError, match="the order of 4294967296 primitives"):
        oitlab.render(fragments, "painter", backend="gpu")
