"""What went wrong with each pixel's numbers."""

import pickle
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab._storage import accepted
from oitlab.diagnostics import MEANING

ENTRIES = oitlab.techniques()
WATCHED = [
    "alpha_compositing",
    "painter",
    "weighted_sum",
    "weighted_average",
    "blended_oit",
    "wboit",
    "phenomenological",
    "gs_wsr",
    "lwboit",
]
SERIES = ["fourier_opacity_maps", "tfm", "wavelet", "mboit_power", "mboit_trig"]


def row(layers: list[int], depth: float, alpha: float) -> oitlab.Fragments:
    """One pixel for each number of equal white layers."""
    n = sum(layers)
    return oitlab.Fragments(
        width=len(layers),
        height=1,
        offsets=np.concatenate([[0], np.cumsum(layers)]),
        depth=np.full(n, depth),
        alpha=np.full(n, alpha),
        color=np.full((n, 3), alpha),
        background=(0, 0, 0),
    )


@pytest.mark.parametrize("name", ENTRIES.ids)
def test_every_technique_has_images_of_what_can_befall_it(small_scene: oitlab.Scene, name: str) -> None:
    frame = oitlab.render(small_scene, name, diagnostics=True)
    assert set(frame.diagnostics) <= set(MEANING)
    assert frame.stats.diagnostics == frame.diagnostics.pixels
    for kind, image in frame.diagnostics.items():
        assert image.shape == (small_scene.height, small_scene.width)
        assert image.dtype == (np.float32 if kind == "cancellation" else np.uint32)
        assert frame.stats.diagnostics[kind] == np.count_nonzero(image >= 1)
    np.testing.assert_array_equal(frame.color, oitlab.render(small_scene, name).color)
    assert bool(frame.diagnostics) or name not in {*WATCHED, *SERIES}


@pytest.mark.parametrize("name", [*WATCHED, *SERIES])
@pytest.mark.parametrize("order", ["as_is", "shuffled", "sorted", "centroid"])
def test_a_capture_is_diagnosed_as_its_scene(small_scene: oitlab.Scene, name: str, order: str) -> None:
    params = accepted(ENTRIES[name], {"submission_order": order})  # the painter has one of its own
    if "format" in {param.name for param in ENTRIES[name].params}:
        params["format"] = "f16"
    scene = oitlab.render(small_scene, name, params, diagnostics=True, threads=1)
    captured = oitlab.render(oitlab.capture(small_scene), name, params, diagnostics=True)
    assert list(scene.diagnostics) == list(captured.diagnostics)
    for kind, image in scene.diagnostics.items():
        np.testing.assert_array_equal(image, captured.diagnostics[kind])


def test_overflow_and_what_is_read_by_hand() -> None:
    # MB13: weights of 3000 fill a half with 21 opaque layers
    frame = oitlab.render(row([0, 21, 22, 40], 0.1, 1.0), "wboit", {"format": "f16"}, diagnostics=True)
    assert frame.diagnostics["overflow"].tolist() == [[0, 0, 1, 1]]
    assert frame.diagnostics["non_finite"].tolist() == [[0, 0, 4, 4]]
    assert frame.stats.diagnostics["overflow"] == 2


def test_cancellation_by_hand() -> None:
    frame = oitlab.render(row([0, 1, 3, 4], 1.0, 0.25), "weighted_sum", diagnostics=True)
    np.testing.assert_allclose(
        frame.diagnostics["cancellation"], [[0, np.log2(5 / 3), np.log2(7), 24]], rtol=1e-6
    )


def test_stagnation_and_saturation_by_hand() -> None:
    faint = oitlab.render(row([7], 1.0, 1 / 511), "wboit", {"revealage_format": "unorm8"}, diagnostics=True)
    assert faint.diagnostics["stagnation"].tolist() == [[7]]
    assert faint.transmittance.tolist() == [[1.0]]
    full = oitlab.render(row([2, 4], 1.0, 0.4), "weighted_sum", {"format": "unorm8"}, diagnostics=True)
    assert full.diagnostics["saturation"].tolist() == [[0, 2]]


def test_kinds_that_are_not_there_are_named(small_scene: oitlab.Scene) -> None:
    frame = oitlab.render(small_scene, "weighted_sum", {"format": "unorm8"}, diagnostics=True)
    with pytest.raises(KeyError, match="'weighted_sum' has no diagnostic 'overflow'; it has: underflow"):
        frame.diagnostics["overflow"]
    exact = oitlab.render(small_scene, "a_buffer", diagnostics=True)
    with pytest.raises(KeyError, match="'a_buffer' has no diagnostic 'overflow'; it has: none"):
        exact.diagnostics["overflow"]
    plain = oitlab.render(small_scene, "weighted_sum")
    assert (len(plain.diagnostics), plain.stats.diagnostics) == (0, {})
    with pytest.raises(KeyError, match="without diagnostics=True"):
        plain.diagnostics["overflow"]
    assert "not asked for" in repr(plain.diagnostics)
    assert "underflow" in repr(frame.diagnostics)


def test_several_variants_are_diagnosed_each_for_itself(small_scene: oitlab.Scene) -> None:
    variants = [("wboit", {"format": "f16"}), ("a_buffer", {}), ("wboit", {})]
    half, exact, single = oitlab.render_many(small_scene, variants, diagnostics=True)
    assert "cancellation" in half.diagnostics
    assert "cancellation" not in single.diagnostics
    assert not exact.diagnostics


def test_diagnostics_survive_pickling_and_files(small_scene: oitlab.Scene, tmp_path: Any) -> None:
    frame = oitlab.render(small_scene, "wboit", {"format": "f16"}, diagnostics=True)
    copy = pickle.loads(pickle.dumps(frame))
    for kind, image in frame.diagnostics.items():
        np.testing.assert_array_equal(image, copy.diagnostics[kind])
    oitlab.write_exr(tmp_path / "a.exr", frame)
    back = oitlab.read_exr(tmp_path / "a.exr")
    assert back.stats == frame.stats  # the counts; images of faults are not written
    assert "not asked for" in repr(back.diagnostics)


def test_bad_requests_are_refused_before_anything_is_drawn(small_scene: oitlab.Scene) -> None:
    with pytest.raises(ValueError, match="diagnostics must be True or False, got 'yes'"):
        oitlab.render(small_scene, "wboit", diagnostics="yes")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="wieght"):
        oitlab.render(small_scene, "wboit", {"wieght": "mb7"}, diagnostics=True)
