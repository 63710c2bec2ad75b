"""Peeling on the GPU: ties, limits, formats, and what has no form there."""

import re
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, ORTHOGRAPHIC, SCENES, SIZE, WHY_NOT, around, mesh_of, scene_of, tolerance
from test_gpu import with_environment

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

PEELING = ("depth_peeling", "dual_depth_peeling")


def agree(scene: oitlab.Scene, technique: str, params: dict[str, Any], limit: float = 0.0) -> oitlab.Frame:
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    limit = max(limit, tolerance(scene, expected))
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit, err_msg=str(params))
    np.testing.assert_allclose(got.transmittance, expected.transmittance, rtol=0, atol=limit)
    assert got.stats.geometry_passes == expected.stats.geometry_passes
    return got


def coincident(copies: int, layers: int, camera: oitlab.Camera = ORTHOGRAPHIC) -> oitlab.Scene:
    """Stack panes that face the camera, at each depth several: their depths are equal to the bit."""
    rng = np.random.default_rng(11)
    depths = rng.permutation(np.repeat(np.arange(layers) * 0.5 - 1, copies))
    pane = np.array([(-3.0, -2, 0), (3, -2, 0), (0, 4, 0)])
    return scene_of(mesh_of(pane + depths[:, None, None] * (0, 0, 1), rng), camera=camera)


@pytest.mark.parametrize("technique", PEELING)
@pytest.mark.parametrize(("copies", "layers"), [(1, 1), (2, 1), (5, 1), (3, 4), (2, 5), (40, 1)])
def test_coincident_fragments_are_all_peeled_in_the_order_of_their_ids(
    technique: str, copies: int, layers: int
) -> None:
    scene = coincident(copies, layers)
    fragments = oitlab.gpu.capture(scene)
    assert len(np.unique(fragments.depth)) == layers
    for passes in (0, 1, 2, copies, copies + 1, copies * layers, 1000):
        agree(scene, technique, {"passes": passes})


@pytest.mark.parametrize("technique", PEELING)
@pytest.mark.parametrize("order", ["as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"])
def test_the_order_of_submission_is_nothing_to_peeling(technique: str, order: str) -> None:
    scene = coincident(3, 3)
    usual = oitlab.render(scene, technique, backend="gpu")
    got = agree(scene, technique, {"submission_order": order, "seed": 4})
    np.testing.assert_array_equal(got.color, usual.color)


@pytest.mark.parametrize("technique", PEELING)
@pytest.mark.parametrize("name", ["squares", "opaque", "empty"])
def test_limited_passes_are_those_of_the_cpu(technique: str, name: str) -> None:
    for passes in (1, 2, 3, 7, 8, 10**12):
        agree(SCENES[name], technique, {"passes": passes})


@pytest.mark.parametrize("name", ["squares", "opaque", "blades"])
def test_peeling_stops_where_hardly_anything_shows_through(name: str) -> None:
    agree(SCENES[name], "depth_peeling", {"early_out": True}, limit=2e-6)


def test_early_out_leaves_less_than_a_thousandth() -> None:
    pane = np.array([(-3.0, -2, 0), (3, -2, 0), (0, 4, 0)])
    corners = pane + np.linspace(-1, 1, 20)[:, None, None] * (0, 0, 1)
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(60).reshape(-1, 3), color=(1.0, 1.0, 1.0, 0.5))
    frame = agree(scene_of(mesh), "depth_peeling", {"early_out": True})
    assert frame.transmittance.min() == 0.5**11
    # twenty layers are more than one submission's passes
    assert agree(scene_of(mesh), "depth_peeling", {}).transmittance.min() == 0.5**20


@pytest.mark.parametrize("technique", PEELING)
def test_what_is_opaque_or_not_there_is_no_exception(technique: str) -> None:
    rng = np.random.default_rng(2)
    corners = around(rng, 60, 1.5, 1.5)
    colors = rng.random((60, 4))
    colors[::3, 3], colors[1::3, 3] = 0, 1
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3), face_colors=colors)
    glow = oitlab.Mesh(
        [(-2, -2, 1), (2, -2, 1), (0, 2, 1)], [(0, 1, 2)], color=(1, 1, 1, 0), emission=(0.5, 2, 1)
    )
    for passes in (0, 2, 5):
        agree(scene_of(mesh, glow), technique, {"passes": passes})


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e25])
def test_depths_of_any_size_are_told_apart(scale: float) -> None:
    """Window depths are depths over a power of two: no digit is lost."""
    rng = np.random.default_rng(3)
    camera = oitlab.Camera(
        eye=(0, 0, 5 * scale), target=(0, 0, 0), up=(0, 1, 0), fov_y=50.0, near=0.5 * scale, far=12.0 * scale
    )
    scene = scene_of(mesh_of(scale * around(rng, 60, 1.5, 1.0), rng), camera=camera)
    for technique in PEELING:
        agree(scene, technique, {})


@pytest.mark.parametrize("format_", ["f16", "unorm8", "unorm16"])
def test_layers_are_composited_in_other_formats(format_: str) -> None:
    steps = {"f16": 2.0**-10, "unorm8": 1 / 255, "unorm16": 1 / 65535}
    scene = SCENES["squares"]
    params = {"color_format": format_}
    got = oitlab.render(scene, "depth_peeling", params, backend="gpu")
    expected = oitlab.render(scene, "depth_peeling", params)
    off = np.abs(got.color - expected.color)
    # one unit per layer: blend units may truncate, and those of eight bits work in eight bits
    layers = expected.stats.depth_complexity_max
    assert off.max() <= 2 * layers * steps[format_]
    plain = oitlab.render(scene, "depth_peeling", backend="gpu")
    assert np.abs(got.color - plain.color).max() > 0


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        ("depth_peeling", {"depth_format": "f16"}, 'depth_format="f16" has no form on the backend "gpu"'),
        ("depth_peeling", {"format": "f64"}, 'color_format="f64" has no form'),
        ("depth_peeling", {"color_format": "rgb9e5"}, 'is one of "f32", "f16", "unorm8", "unorm16"'),
        ("dual_depth_peeling", {"format": "f16"}, "nodes of other formats than f32"),
    ],
)
def test_what_has_no_form_is_refused_by_name(technique: str, params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.render(SCENES["blades"], technique, params, backend="gpu")


SMALL_BUFFERS = """
import numpy as np, oitlab
faces = np.arange(1200).reshape(-1, 3)
colors = np.random.default_rng(0).random((400, 4)) * (1, 1, 1, 0.05)
pane = [(-9, -9, 0), (9, -9, 0), (0, 9, 0)]
mesh = oitlab.Mesh(pane * 400, faces, face_colors=colors)
ties = oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=6, height=4)
assert 112 * 400 > 2 * 16384
for technique, passes in (("depth_peeling", 0), ("depth_peeling", 150), ("dual_depth_peeling", 0)):
    pair = [oitlab.render(ties, technique, {"passes": passes}, backend=backend) for backend in ("cpu", "gpu")]
    np.testing.assert_allclose(pair[0].color, pair[1].color, rtol=0, atol=2e-5)
"""


def test_ties_between_draw_calls_are_ties() -> None:
    done = with_environment(SMALL_BUFFERS, OITLAB_GPU_BUFFER_BYTES="16384")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("technique", PEELING)
def test_many_layers_and_sizes(technique: str) -> None:
    rng = np.random.default_rng(5)
    pane = np.array([(-2.0, -2, 0), (2, -2, 0), (0, 3, 0)])
    corners = pane + rng.permutation(np.linspace(-2, 2, 200))[:, None, None] * (0, 0, 1)
    colors = np.column_stack([rng.random((200, 3)), np.full(200, 0.05)])
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(600).reshape(-1, 3), face_colors=colors)
    for size in ({"width": 1, "height": 1}, {"width": 7, "height": 33}):
        agree(scene_of(mesh, **size), technique, {})
    assert agree(scene_of(mesh, **SIZE), technique, {}).stats.depth_complexity_max == 200
