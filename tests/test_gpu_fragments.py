"""Fragments as the source: lists that no scene made, on the GPU as on the CPU."""

from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import CONFORMS, DECIDING, DEVICE, F32, PARAMS, ROUNDINGS, SCENES, WHY_NOT

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

IDS = [entry.id for entry in oitlab.techniques() if "gpu" in entry.backends]


def random_fragments(
    seed: int, *, deepest: int = 24, image: bool = False, opaque: bool = False
) -> oitlab.Fragments:
    """Make unordered lists of up to `deepest` fragments, a sixth of them of one depth, one in twenty zero."""
    rng = np.random.default_rng(seed)
    width, height = 37, 11
    counts = rng.integers(0, deepest + 1, width * height)
    n = int(counts.sum())
    alpha = rng.random(n) ** 2
    if opaque:
        alpha[rng.random(n) < 0.1] = 1.0
    color = rng.random((n, 3)) * alpha[:, None]
    nothing = rng.random(n) < 0.05
    alpha[nothing], color[nothing] = 0.0, 0.0
    depth = rng.uniform(1.0, 20.0, n)
    depth[rng.random(n) < 1 / 6] = 5.0
    return oitlab.Fragments(
        width=width,
        height=height,
        offsets=np.concatenate([[0], np.cumsum(counts)]),
        depth=depth.astype(np.float32),
        color=color.astype(np.float32),
        alpha=alpha.astype(np.float32),
        primitive=rng.permutation(n).astype(np.uint32),
        background=rng.random((height, width, 3)).astype(np.float32) if image else (0.2, 0.4, 0.1),
    )


FRAGMENTS = {
    "few": random_fragments(1, deepest=4),
    "many": random_fragments(2, deepest=40),
    "over an image": random_fragments(3, image=True),
    "opaque ones": random_fragments(4, opaque=True, image=True),
    "none": random_fragments(5, deepest=0, image=True),
}


def limit_of(expected: oitlab.Frame) -> float:
    scale = max(1.0, float(np.abs(expected.color).max()))
    return float((expected.stats.depth_complexity_max + ROUNDINGS) * 2 * F32 * scale)


@pytest.mark.parametrize("name", FRAGMENTS)
@pytest.mark.parametrize("technique", IDS)
def test_images_of_fragments_are_those_of_the_cpu(technique: str, name: str) -> None:
    fragments = FRAGMENTS[name]
    params = PARAMS.get(technique, {})
    got = oitlab.render(fragments, technique, params, backend="gpu")
    expected = oitlab.render(fragments, technique, params)
    most, worst = CONFORMS.get(technique, (limit_of(expected),) * 2)
    share = DECIDING.get(technique, 0.95 if technique in CONFORMS else 1.0)
    off = np.abs(got.color - expected.color).max(axis=-1)
    assert (off <= most).mean() >= share
    assert technique in DECIDING or off.max() <= worst
    assert np.abs(got.transmittance - expected.transmittance).max() <= worst
    assert (got.params, got.scene_hash) == (expected.params, expected.scene_hash)
    for field in ("fragments", "depth_complexity_max", "bytes_per_pixel"):
        assert getattr(got.stats, field) == getattr(expected.stats, field), field


@pytest.mark.parametrize("order", ["as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"])
def test_every_order_of_fragments_can_be_blended(order: str) -> None:
    fragments = FRAGMENTS["many"]
    wanted = [("alpha_compositing", {"submission_order": order, "seed": 5})]
    (got,), (expected,) = (oitlab.render_many(fragments, wanted, backend=b) for b in ("gpu", "cpu"))
    assert np.abs(got.color - expected.color).max() <= limit_of(expected)


@pytest.mark.parametrize("order", ["as_is", "reversed", "sorted", "back_to_front"])
@pytest.mark.parametrize("technique", ["mlab", "k_buffer"])
def test_lists_come_as_they_were_submitted(technique: str, order: str) -> None:
    fragments = FRAGMENTS["many"]
    wanted = [(technique, {"submission_order": order, "layers": k}) for k in (1, 4)]
    for got, expected in zip(
        *(oitlab.render_many(fragments, wanted, backend=b) for b in ("gpu", "cpu")), strict=True
    ):
        assert np.abs(got.color - expected.color).max() <= limit_of(expected)


def test_captured_fragments_are_the_scene() -> None:
    scene = SCENES["opaque"]
    for technique in ("wboit", "a_buffer", "mlab"):
        from_scene, from_fragments = (
            oitlab.render(source, technique, backend="gpu") for source in (scene, oitlab.capture(scene))
        )
        assert np.abs(from_scene.color - from_fragments.color).max() <= limit_of(from_scene)


def test_lists_longer_than_a_buffer_come_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    import subprocess
    import sys

    code = """
import numpy as np, oitlab, sys
sys.path.insert(0, "tests")
from test_gpu_fragments import FRAGMENTS, limit_of
for technique in ("a_buffer", "wboit", "mlab"):
    got = oitlab.render(FRAGMENTS["over an image"], technique, backend="gpu")
    expected = oitlab.render(FRAGMENTS["over an image"], technique)
    assert np.abs(got.color - expected.color).max() <= limit_of(expected), technique
"""
    monkeypatch.setenv("OITLAB_GPU_BUFFER_BYTES", "16384")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_two_orders_of_the_same_fragments_stay_apart() -> None:
    fragments = FRAGMENTS["few"]
    wanted: list[tuple[str, dict[str, Any]]] = [
        ("alpha_compositing", {"submission_order": order}) for order in ("as_is", "reversed", "as_is")
    ]
    first, second, third = oitlab.render_many(fragments, wanted, backend="gpu", skip=False)
    assert (first.color == third.color).all()
    assert (first.color != second.color).any()


def stack(depth: Any, primitive: Any, far: float = 100.0) -> oitlab.Fragments:
    """Make one pixel of half-covering fragments, each of a colour of its own."""
    n = len(depth)
    return oitlab.Fragments(
        width=1,
        height=1,
        offsets=[0, n],
        depth=np.asarray(depth, np.float32),
        color=(np.random.default_rng(3).random((n, 3)) / 2).astype(np.float32),
        alpha=np.full(n, 0.5, np.float32),
        primitive=np.asarray(primitive, np.uint32),
        background=(1.0, 1.0, 1.0),
        far=far,
    )


HARD = {
    "beyond the far plane": stack([150.0, 1e6, 3.0], [0, 1, 2]),
    "the last ids": stack([3.0, 3.0, 2.0], [2**32 - 1, 2**32 - 2, 2**32 - 1]),
    "one primitive twice": stack([3.0, 3.0, 3.0], [7, 7, 7]),
    "many of one depth and primitive": stack([3.0] * 40, [0] * 40),
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("technique", ["a_buffer", "depth_peeling", "dual_depth_peeling", "screen_door"])
def test_coincident_and_distant_fragments_are_those_of_the_cpu(technique: str, name: str) -> None:
    got, expected = (oitlab.render(HARD[name], technique, backend=b) for b in ("gpu", "cpu"))
    assert np.abs(got.color - expected.color).max() <= limit_of(expected)
    assert np.abs(got.transmittance - expected.transmittance).max() <= limit_of(expected)
