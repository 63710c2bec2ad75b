"""Linked lists in one pass over the geometry, against lists that are counted first."""

import re
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, SCENES, WHY_NOT
from test_gpu import with_environment

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

Params = dict[str, Any]

LISTED: list[tuple[str, Params]] = [
    ("a_buffer", {}),
    ("a_buffer", {"overflow": "drop", "capacity": 3}),
    ("a_buffer", {"overflow": "tail_blend", "capacity": 3, "submission_order": "shuffled"}),
    ("lwboit", {"storage": "ll"}),
    ("mlab", {"layers": 2}),
    ("mlab", {"layers": 2, "submission_order": "reversed"}),
    ("mlab", {"layers": 2, "submission_order": "shuffled", "seed": 5}),
    ("k_buffer", {"layers": 2, "submission_order": "centroid"}),
    ("deep_shadow_maps", {"vertices": 5}),
    ("density_clustering", {}),
    ("stochastic_transparency", {}),
    ("continuum", {"memory": "unbounded", "merge": "none", "submission_order": "back_to_front"}),
]


def linked(scene: oitlab.Scene, technique: str, params: Params | None = None) -> oitlab.Frame:
    return oitlab.gpu.render(scene, technique, params, path="linked_lists")


@pytest.mark.parametrize(("technique", "params"), LISTED)
def test_the_same_lists_are_looked_at(technique: str, params: Params) -> None:
    """Lists are sorted before anybody looks at them, so that images agree to the bit."""
    for name in ("squares", "smoke", "soup", "near plane", "opaque", "masked", "empty"):
        got = linked(SCENES[name], technique, params)
        expected = oitlab.gpu.render(SCENES[name], technique, params)
        np.testing.assert_array_equal(got.color, expected.color, err_msg=name)
        np.testing.assert_array_equal(got.transmittance, expected.transmittance, err_msg=name)
        for stat in ("fragments", "depth_complexity_max", "dropped"):
            assert getattr(got.stats, stat) == getattr(expected.stats, stat), (name, stat)


def test_every_technique_of_lists_has_them_and_others_say_what_does() -> None:
    scene, refused = SCENES["squares"], {}
    for entry in oitlab.techniques():
        try:
            got = linked(scene, entry.id)
        except ValueError as problem:
            refused[entry.id] = str(problem)
        else:
            expected = oitlab.gpu.render(scene, entry.id)
            np.testing.assert_array_equal(got.color, expected.color, err_msg=entry.id)
    assert all('no form for "linked_lists"; path="hardware" has one' in why for why in refused.values())
    assert {"wboit", "alpha_compositing", "depth_peeling", "mboit_power"} <= refused.keys()
    assert not refused.keys() & {"a_buffer", "mlab", "mlcb", "slab", "z3", "avsm", "continuum", "screen_door"}


GROWING = """
import numpy as np, oitlab
def panes(count, width, height):
    pane = np.array([(-9.0, -9, 0), (9, -9, 0), (0, 9, 0)])
    corners = pane + np.linspace(-1, 1, count)[:, None, None] * (0, 0, 1)
    faces = np.arange(3 * count).reshape(-1, 3)
    colors = np.random.default_rng(1).random((count, 4))
    mesh = oitlab.Mesh(corners.reshape(-1, 3), faces, face_colors=colors)
    return oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=width, height=height)
# a pool begins with two nodes per pixel; wider images want more heads; a buffer holds 4096 nodes
for scene in (panes(1, 20, 20), panes(9, 20, 20), panes(2, 60, 40), panes(60, 30, 50), panes(1, 9, 9)):
    for technique in ("a_buffer", "mlab"):
        got = oitlab.gpu.render(scene, technique, path="linked_lists")
        expected = oitlab.gpu.render(scene, technique)
        np.testing.assert_array_equal(got.color, expected.color)
        assert got.stats.fragments == expected.stats.fragments > 0
"""


@pytest.mark.parametrize("buffer_bytes", ["65536", "1000000000"])
def test_a_pool_grows_and_nothing_is_lost(buffer_bytes: str) -> None:
    done = with_environment(GROWING, OITLAB_GPU_BUFFER_BYTES=buffer_bytes)
    assert done.returncode == 0, done.stderr


def test_what_is_no_list_is_refused_by_name() -> None:
    message = 'what keeps no lists of fragments has no form for "linked_lists"; path="hardware" has one'
    with pytest.raises(ValueError, match=re.escape(message)):
        linked(SCENES["blades"], "wboit")
