"""Orders of submission on the GPU, and lists with room for so many fragments, on both rasters."""

import os
import subprocess
import sys
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
        assert (expected.stats.dropped > 0) == (params.get("overflow") != "tail_blend" and capacity < 20)
        limit = (8 if technique == "lwboit" else 1) * tolerance(scene, expected)
        for path in PATHS:
            got = oitlab.gpu.render(scene, technique, given, path=path)  # type: ignore[arg-type]
            np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit, err_msg=path)
            assert got.stats.dropped == expected.stats.dropped, path


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


HUGE = 2**32 - 1


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("technique", "params"), [*ORDERED, ("alpha_compositing", {}), ("a_buffer", {})])
def test_fragments_of_any_primitives_come_in_any_order(technique: str, params: Params, order: str) -> None:
    rng = np.random.default_rng(4)
    ids = np.array([0, 1, 2**20, 2**31 - 1, 2**31, 2**32 - 2, HUGE], np.uint32)
    fragments = oitlab.Fragments(
        width=3,
        height=2,
        offsets=np.arange(7) * 7,
        depth=rng.choice([1.0, 1.5, 2.0, 3.0], 42).astype(np.float32),
        color=rng.random((42, 3)).astype(np.float32) / 4,
        alpha=rng.uniform(0.25, 0.75, 42).astype(np.float32),
        primitive=np.concatenate([rng.permutation(ids) for _ in range(6)]),
        background=(0.1, 0.2, 0.3),
        near=0.5,
        far=4.0,
    )
    given = PARAMS.get(technique, {}) | params
    given |= {"submission_order": order, "seed": 6}
    expected = oitlab.render(fragments, technique, given)
    got = oitlab.render(fragments, technique, given, backend="gpu")
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=1e-5)


def test_the_painter_takes_fragments_of_any_primitives() -> None:
    ids = np.array([HUGE, 0, 2**31], np.uint32)
    fragments = oitlab.Fragments(
        width=1,
        height=1,
        offsets=[0, 3],
        depth=np.array([3, 1, 2], np.float32),
        color=np.eye(3, dtype=np.float32) / 2,
        alpha=np.full(3, 0.5, np.float32),
        primitive=ids,
        background=(0.1, 0.2, 0.3),
    )
    got, expected = (oitlab.render(fragments, "painter", backend=backend).color for backend in ("gpu", "cpu"))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)


BEYOND = """
import sys
import numpy as np, oitlab
x, y = np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50))
centers = np.stack([x, y, np.sin(9 * x * y)], -1).reshape(-1, 1, 3)
corners = centers + 0.05 * np.array([(-1, -1, 0), (1, -1, 0), (0, 1, 0)])
colors = np.random.default_rng(1).random((2500, 4))
mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(7500).reshape(-1, 3), face_colors=colors)
scene = oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=48, height=48)
# all of them are in sight, and a rank takes 8 bytes
for order in ("as_is", "reversed", "sorted", "shuffled", "centroid"):
    params = {"layers": 2, "submission_order": order}
    expected = oitlab.render(scene, "mlab", params)
    try:
        got = oitlab.render(scene, "mlab", params, backend="gpu")
    except MemoryError as error:
        assert order in ("shuffled", "centroid"), order
        assert "primitives in sight" in str(error) and "keeps that of 2048" in str(error), error
    else:
        assert order not in ("shuffled", "centroid"), order
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=1e-5)
# those that are drawn in their order need no ranks
pair = [oitlab.render(scene, "painter", backend=backend).color for backend in ("cpu", "gpu")]
np.testing.assert_allclose(pair[0], pair[1], rtol=0, atol=1e-5)
"""


def test_more_ranks_than_a_buffer_holds_are_an_error_that_says_so() -> None:
    environment = os.environ | {"OITLAB_GPU_BUFFER_BYTES": "16384"}
    arguments = [sys.executable, "-c", BEYOND]
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
