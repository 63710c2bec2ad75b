"""Captured fragments: arrays in, the same arrays and the same bits out."""

import pickle
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab import Fragments

TWO_PIXELS: dict[str, Any] = {
    "width": 2,
    "height": 1,
    "offsets": [0, 2, 3],
    "depth": [2.0, 1.0, 3.0],
    "color": [(0.5, 0, 0), (0, 0.25, 0), (0, 0, 0.75)],
    "alpha": [0.5, 0.25, 0.75],
    "primitive": [4, 0, 2],
    "background": (1.0, 0.5, 0.25),
    "near": 0.5,
    "far": 8.0,
}
ARRAYS = ("offsets", "depth", "color", "alpha", "primitive", "background")


def same(one: Fragments, two: Fragments) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one == two
    assert hash(one) == hash(two)


def test_arrays_come_back_in_their_dtypes() -> None:
    fragments = Fragments(**TWO_PIXELS)
    dtypes = {name: str(getattr(fragments, name).dtype) for name in ARRAYS}
    assert dtypes == {
        "offsets": "int64",
        "depth": "float32",
        "color": "float32",
        "alpha": "float32",
        "primitive": "uint32",
        "background": "float32",
    }
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(fragments, name), TWO_PIXELS[name])
    assert (fragments.width, fragments.height, fragments.near, fragments.far) == (2, 1, 0.5, 8.0)
    assert len(fragments) == 3
    np.testing.assert_array_equal(fragments.counts, [[2, 1]])


def test_defaults_follow_from_the_fragments() -> None:
    fragments = Fragments(**{key: value for key, value in TWO_PIXELS.items() if key != "primitive"})
    assert fragments.depth_range == (1.0, 3.0)
    assert fragments.primitive_depth is None
    assert fragments.primitive.dtype == np.uint32
    assert Fragments(**TWO_PIXELS, depth_range=(0.5, 9.0)).depth_range == (0.5, 9.0)


def test_a_pixel_is_its_slice() -> None:
    fragments = Fragments(**TWO_PIXELS)
    pixel = fragments.pixel(0, 0)
    np.testing.assert_array_equal(pixel["depth"], [2, 1])
    np.testing.assert_array_equal(pixel["color"], [(0.5, 0, 0), (0, 0.25, 0)])
    np.testing.assert_array_equal(fragments.pixel(1, 0)["primitive"], [2])
    for x, y in ((2, 0), (0, 1), (-1, 0)):
        with pytest.raises(IndexError, match="outside"):
            fragments.pixel(x, y)


def test_pickles_hold_everything() -> None:
    image = np.random.default_rng(0).random((1, 2, 3))
    given = Fragments(**{**TWO_PIXELS, "background": image, "primitive_depth": np.arange(5.0) + 1})
    copy = pickle.loads(pickle.dumps(given))
    same(copy, given)
    np.testing.assert_array_equal(copy.primitive_depth, np.arange(5.0) + 1)


def test_a_capture_survives_its_arrays(small_scene: oitlab.Scene) -> None:
    fragments = oitlab.capture(small_scene)
    assert len(fragments) > 500
    again = Fragments(
        **{name: getattr(fragments, name) for name in ARRAYS},
        width=fragments.width,
        height=fragments.height,
        near=fragments.near,
        far=fragments.far,
        depth_range=fragments.depth_range,
        primitive_depth=fragments.primitive_depth,
    )
    same(again, fragments)
    same(pickle.loads(pickle.dumps(fragments)), fragments)


@pytest.mark.parametrize("technique", oitlab.techniques().ids)
def test_a_capture_gives_its_scenes_bits(small_scene: oitlab.Scene, technique: str, backend: Any) -> None:
    # on a device, depths that are only weighed may be a unit in the last place off; a capture's are exact
    off = 2e-6 if (technique, backend) == ("wboit", "gpu") else 0.0
    direct = oitlab.render(small_scene, technique, backend=backend)
    fragments = oitlab.capture(small_scene) if backend == "cpu" else oitlab.gpu.capture(small_scene)
    for source in (fragments, pickle.loads(pickle.dumps(fragments))):
        captured = oitlab.render(source, technique, backend=backend)
        np.testing.assert_allclose(captured.color, direct.color, rtol=0, atol=off)
        np.testing.assert_array_equal(captured.transmittance, direct.transmittance)
        np.testing.assert_array_equal(captured.first_depth, direct.first_depth)
        np.testing.assert_array_equal(captured.fragment_count, direct.fragment_count)


def _quads(rng: np.random.Generator, count: int, size: float, alphas: tuple[float, ...]) -> list[oitlab.Mesh]:
    """Squares that face the camera of `_facing`, each with a depth and a colour of its own."""
    at = np.column_stack([rng.uniform(-1.8, 1.8, (count, 2)), rng.uniform(-1, 1, count)])
    corners = at[:, None] + size * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    faces = (np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    colors = np.column_stack([rng.random((count, 3)), rng.choice(alphas, count)]).repeat(2, axis=0)
    return [oitlab.Mesh(corners.reshape(-1, 3), faces, face_colors=colors)]


def _facing(kind: str) -> oitlab.Scene:
    """What makes the raster keep sums of cells, of a few rows at a time, or of the whole tile."""
    rng = np.random.default_rng(3)
    large = _quads(rng, 1, 3.0, (0.5,))
    tilted = oitlab.Mesh([(-2, -2, -1), (2, -2, 1), (0, 2, 0)], [(0, 1, 2)], color=(0.2, 0.9, 0.4, 0.3))
    turns = [(_quads(rng, 1, 3.0, (0.1, 1e-4)), _quads(rng, 40, 0.05, (0.3,))) for _ in range(12)]
    meshes = {
        "cells": large,
        "faint cells": _quads(rng, 6, 0.9, (1e-4, 3e-5)),
        "in turns": _quads(rng, 2000, 0.06, (0.02,))
        + [mesh for turn in turns for part in turn for mesh in part],
        "rows": _quads(rng, 60, 0.7, (0.3, 0.9, 1e-4, 0.0, 1.0)),
        "faint rows": _quads(rng, 60, 0.7, (1e-4, 3e-5)),
        "few small ones": large + _quads(rng, 200, 0.04, (0.3, 1e-4)) + _quads(rng, 20, 0.7, (0.4,)),
        "many small ones": large + _quads(rng, 9000, 0.06, (0.3, 1e-4)) + _quads(rng, 20, 0.7, (0.4,)),
        "deep": _quads(rng, 1500, 0.9, (0.02, 1e-4)),
        "pixels": [*_quads(rng, 60, 0.7, (0.3, 1e-4)), tilted, *_quads(rng, 60, 0.7, (0.3, 1e-4))],
    }
    return oitlab.Scene(meshes[kind], camera=oitlab.Camera(ortho_height=4), width=150, height=100)


@pytest.mark.parametrize("skip", [True, False])
@pytest.mark.parametrize(
    "kind",
    [
        "cells",
        "faint cells",
        "in turns",
        "rows",
        "faint rows",
        "few small ones",
        "many small ones",
        "deep",
        "pixels",
    ],
)
def test_sums_have_the_bits_of_lists_however_they_are_kept(kind: str, skip: bool) -> None:
    variants: list[Any] = ["wboit", ("wboit", {"weight": "inv_pow"}), "weighted_sum", "weighted_average"]
    scene = _facing(kind)
    lists = oitlab.capture(scene)
    for one, other in zip(
        oitlab.render_many(scene, variants, skip=skip), oitlab.render_many(lists, variants), strict=True
    ):
        np.testing.assert_array_equal(one.color, other.color)
        np.testing.assert_array_equal(one.transmittance, other.transmittance)
        assert one.stats.fragments == other.stats.fragments > 1000
        assert one.stats.depth_complexity_max == other.stats.depth_complexity_max
    for params in ({}, {"weight": "1.0 / (z * z)"}):
        alone = oitlab.render(scene, "wboit", params, skip=skip)
        np.testing.assert_array_equal(alone.color, oitlab.render(lists, "wboit", params).color)


def test_weights_see_the_sign_of_a_zero_alpha() -> None:
    corners, faces = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)]

    def emitter(alpha: float) -> oitlab.Mesh:
        return oitlab.Mesh(corners, faces, color=(0.5, 0.5, 0.5, alpha), emission=(0.3, 0.2, 0.1))

    meshes = [emitter(0.0), emitter(-0.0), oitlab.Mesh(corners, faces, color=(1, 1, 1, 0.5))]
    scene = oitlab.Scene(meshes, camera=oitlab.Camera(ortho_height=2), width=20, height=20)
    weight = {"weight": "select(1.0, 7.0, 1.0 / a > 0.0)"}
    direct = oitlab.render(scene, "wboit", weight)
    np.testing.assert_array_equal(direct.color, oitlab.render(oitlab.capture(scene), "wboit", weight).color)


def test_capture_agrees_with_the_frame(small_scene: oitlab.Scene) -> None:
    fragments = oitlab.capture(small_scene, threads=1)
    frame = oitlab.render(small_scene, "a_buffer")
    np.testing.assert_array_equal(fragments.counts, frame.fragment_count)
    y, x = np.unravel_index(fragments.counts.argmax(), fragments.counts.shape)
    assert fragments.pixel(int(x), int(y))["depth"].min() == frame.first_depth[y, x]
    assert (fragments.near, fragments.far) == (small_scene.camera.near, small_scene.camera.far)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, "width"),
        ({"width": -2}, "width"),
        ({"offsets": [0, 2]}, "offsets"),
        ({"offsets": [0, 2, 4]}, "offsets"),
        ({"offsets": [0, 3, 2]}, "offsets"),
        ({"offsets": [1, 2, 3]}, "offsets"),
        ({"offsets": [0.0, 2.0, 3.0]}, "offsets must hold integers"),
        ({"depth": [2.0, 1.0]}, "depth"),
        ({"depth": [2.0, 1.0, np.nan]}, r"depth.*2"),
        ({"depth": [2.0, -1.0, 1.0]}, r"depth.*1"),
        ({"color": [(0.5, 0, 0)]}, "color"),
        ({"color": [(0.5, 0)] * 3}, "color must have shape"),
        ({"color": [(0.5, 0, np.inf)] * 3}, r"color.*0"),
        ({"alpha": [0.5, 1.5, 0.5]}, r"alpha.*1"),
        ({"alpha": [0.5, 0.5]}, "alpha"),
        ({"alpha": ["a", "b", "c"]}, "alpha must hold real numbers"),
        ({"primitive": [0, 1]}, "primitive"),
        ({"primitive": [0, 1, -1]}, r"primitive.*-1"),
        ({"primitive": [0, 1, 2**32]}, "primitive.*4294967296"),
        ({"background": (0, 0)}, "background must have shape"),
        ({"background": np.zeros((2, 2, 3))}, "background must have shape"),
        ({"background": (0, np.nan, 0)}, "background"),
        ({"near": 0.0}, "near"),
        ({"far": 0.25}, "near|far"),
        ({"depth_range": (2.0, 1.0)}, "depth_range"),
        ({"depth_range": (2.0,)}, "depth_range must have shape"),
        ({"primitive_depth": [1.0, 2.0]}, "primitive"),
        ({"primitive_depth": [1.0, 2.0, 3.0, 4.0, np.nan]}, r"primitive_depth.*4"),
    ],
)
def test_bad_fragments_are_refused_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Fragments(**{**TWO_PIXELS, **changes})
