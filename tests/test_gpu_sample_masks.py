"""Stochastic transparency by the device's sample masks, which are those of the CPU."""

import itertools
import re
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import CLIPPED, DEVICE, SCENES, VARYING_COLOR, WHY_NOT, scene_of, tolerance
from test_gpu_samples import coincident, pane

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

Params = dict[str, Any]
TECHNIQUE = "stochastic_transparency"


def masked(scene: oitlab.Scene, params: Params) -> oitlab.Frame:
    return oitlab.gpu.render(scene, TECHNIQUE, params, path="samples")


@pytest.mark.parametrize("name", SCENES)
def test_masks_of_samples_are_those_of_the_cpu(name: str) -> None:
    scene = SCENES[name]
    varies = 4 * VARYING_COLOR if name in (*CLIPPED, "smooth", "masked") else 0.0
    # an alpha that is interpolated may cover another number of samples
    share = 0.999 if varies else 1.0
    for mode, correction, stratified in itertools.product(
        ["color", "depth"], ["none", "alpha"], [True, False]
    ):
        params = {"mode": mode, "correction": correction, "stratified": stratified, "seed": 2**33 + 1}
        got, expected = masked(scene, params), oitlab.render(scene, TECHNIQUE, params)
        off = np.abs(got.color - expected.color).max(axis=-1)
        off = np.maximum(off, np.abs(got.transmittance - expected.transmittance).reshape(off.shape))
        assert (off <= tolerance(scene, expected) + varies).mean() >= share, (params, off.max())
        assert got.stats.fragments == expected.stats.fragments


@pytest.mark.parametrize("samples", [1, 3, 4, 5, 16, 33, 100])
def test_samples_come_in_as_many_parts_as_they_take(samples: int) -> None:
    scene = SCENES["opaque"]
    for mode, stratified in itertools.product(["color", "depth"], [True, False]):
        params = {"mode": mode, "samples": samples, "stratified": stratified}
        got, expected = masked(scene, params), oitlab.render(scene, TECHNIQUE, params)
        assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected), params


def test_all_samples_that_masks_have_are_drawn() -> None:
    scene = scene_of(pane(0.3, 0.0), pane(0.5, -1.0), width=5, height=3)
    params = {"samples": 4096}
    got, expected = masked(scene, params), oitlab.render(scene, TECHNIQUE, params)
    assert np.abs(got.color - expected.color).max() <= 1e-6


@pytest.mark.parametrize("mode", ["color", "depth"])
@pytest.mark.parametrize("correction", ["none", "alpha"])
def test_coincident_fragments_hide_those_of_larger_ids(mode: str, correction: str) -> None:
    scene = coincident()
    for samples in (2, 8, 19):
        params = {"mode": mode, "correction": correction, "samples": samples}
        got, expected = masked(scene, params), oitlab.render(scene, TECHNIQUE, params)
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=tolerance(scene, expected))


@pytest.mark.parametrize("alpha", [0.0, 1e-6, 0.5, 1.0])
def test_alphas_at_their_ends(alpha: float) -> None:
    scene = scene_of(pane(alpha, 0.0), pane(0.5, -1.0), width=8, height=6)
    for mode, correction in itertools.product(["color", "depth"], ["none", "alpha"]):
        params = {"mode": mode, "correction": correction}
        got, expected = masked(scene, params), oitlab.render(scene, TECHNIQUE, params)
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=1e-6)


def test_all_three_paths_show_the_same_samples() -> None:
    scene = SCENES["smoke"]
    images = [
        oitlab.gpu.render(scene, TECHNIQUE, {"samples": 12}, path=path).color
        for path in ("hardware", "compute", "samples")
    ]
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], rtol=0, atol=1e-5)


def test_order_makes_no_difference_and_calls_repeat_to_the_bit() -> None:
    scene = SCENES["blades"]
    one, again = masked(scene, {}), masked(scene, {"submission_order": "shuffled"})
    np.testing.assert_array_equal(one.color, again.color)
    assert one.stats.raster_ms > 0


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        ("wboit", {}, 'what has no masks of samples has no form for "samples"; path="hardware" has one'),
        ("a_buffer", {}, 'has no form for "samples"'),
        (TECHNIQUE, {"samples": 4097}, "there samples is at most 4096"),
        (TECHNIQUE, {"format": "f16"}, 'node_color_format="f16" has no form'),
    ],
)
def test_what_has_no_masks_is_refused(technique: str, params: Params, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.gpu.render(SCENES["blades"], technique, params, path="samples")
