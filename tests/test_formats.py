"""Storage formats as params."""

from typing import Any

import numpy as np
import pytest

import oitlab
from backends import refusal

ENTRIES = list(oitlab.techniques())


def names_of(entry: oitlab.TechniqueInfo) -> set[str]:
    """Name a technique's params."""
    return {param.name for param in entry.params}


def test_every_technique_has_formats_and_those_that_sum_ways_to_sum() -> None:
    for entry in ENTRIES:
        assert "format" in names_of(entry), entry.id
        # maps and weights end in weighted sums; the composer has those of its parts, which are plain
        if names_of(entry) & {"self_correct", "bias", "weight"} and entry.id != "continuum":
            assert "summation" in names_of(entry), entry.id


def looks_through_a_map(entry: oitlab.TechniqueInfo) -> bool:
    """Tell whether a technique sees each fragment through a map whose numbers have formats."""
    return {"composite", "summation"} <= names_of(entry)


def depth_of(entry: oitlab.TechniqueInfo) -> str:
    """Name the param for the format of stored depths, if there is one."""
    names = [param.name for param in entry.params if param.name.endswith("depth_format")]
    return names[0] if names else ""


@pytest.mark.parametrize("entry", ENTRIES, ids=[entry.id for entry in ENTRIES])
def test_every_format_of_every_target_gives_a_finite_image(
    entry: oitlab.TechniqueInfo, small_scene: oitlab.Scene, backend: Any
) -> None:
    plain = oitlab.render(small_scene, entry.id, backend=backend)
    names = [param for param in entry.params if param.name == "format" or param.name.endswith("_format")]
    assert len(names) >= 2
    if backend == "gpu":  # a pipeline each: those of single targets are in test_gpu_formats.py
        names = [param for param in names if param.name == "format"]
    for param in names:
        for chosen in param.range.removeprefix("one of ").replace('"', "").split(", "):
            if refusal(small_scene, entry.id, {param.name: chosen}, backend):
                continue  # what the device has no targets for
            frame = oitlab.render(small_scene, entry.id, {param.name: chosen}, backend=backend)
            assert frame.params[param.name] == chosen
            assert np.isfinite(frame.color).all()
            # even 8 bits are near on a handful of layers, unless weights are beyond them; where a map
            # just misses something, a pixel is another
            if chosen in {"f64", "f32", "f16"}:
                off = np.abs(frame.color - plain.color).max(axis=-1) > 0.01
                # where blades cross, depths in halves put some layers in another order
                reordered = chosen == "f16" and frame.params.get(depth_of(entry), "f32") == "f16"
                looks = looks_through_a_map(entry)
                assert off.mean() <= (0.02 if reordered or looks else 0.0)
                assert np.abs(frame.color - plain.color).max() < 0.1 or not looks


def test_an_override_that_changes_nothing_is_the_same_variant(
    small_scene: oitlab.Scene, backend: Any
) -> None:
    same = [{}, {"format": "f32"}, {"accumulation_format": "f32"}, {"revealage_format": "f64"}]
    same = [params for params in same if not refusal(small_scene, "wboit", params, backend)]
    assert len(same) >= 3
    frames = oitlab.render_many(small_scene, [("wboit", params) for params in same], backend=backend)
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames].count(1) == len(same) - 1
    half, stated, other = oitlab.render_many(
        small_scene,
        [
            ("wboit", {"format": "f16"}),
            ("wboit", {"format": "f16", "revealage_format": "f16"}),
            ("wboit", {"format": "f16", "revealage_format": "unorm8"}),
        ],
        backend=backend,
    )
    np.testing.assert_array_equal(half.color, stated.color)
    assert (half.stats.bytes_per_pixel, other.stats.bytes_per_pixel) == (10.0, 9.0)


def test_nodes_can_be_packed(small_scene: oitlab.Scene) -> None:
    packed = {"node_color_format": "rgb9e5", "node_depth_format": "d24"}
    frames = oitlab.render_many(
        small_scene, [("mlab", {}), ("mlab", {"node_color_format": "unorm8"}), ("mlab", packed)]
    )
    assert [frame.stats.bytes_per_pixel for frame in frames] == [80.0, 32.0, 32.0]
    for frame in frames[1:]:
        assert 0.0 < np.abs(frame.color - frames[0].color).max() < 0.05


def test_the_bias_of_moments_follows_their_format(small_scene: oitlab.Scene) -> None:
    def bias(**params: object) -> object:
        return oitlab.render(small_scene, "mboit_power", params).params["bias"]

    assert [bias(), bias(format="f16"), bias(moments_format="unorm16")] == [5e-7, 6e-5, 6e-5]
    assert bias(format="f16", bias=0.01) == 0.01
    with pytest.raises(
        ValueError, match=r'mboit_power: .*"unorm16" with 6 moments; allowed is unorm16 for 4'
    ):
        bias(moments=6, moments_format="unorm16")


def test_formats_that_make_no_sense_are_refused_by_name(small_scene: oitlab.Scene, backend: Any) -> None:
    with pytest.raises(ValueError, match=r'wboit.*"accumulation_format" is "d24".*"r11g11b10f"'):
        oitlab.render(small_scene, "wboit", {"accumulation_format": "d24"}, backend=backend)
    with pytest.raises(ValueError, match=r'wboit: parameter "format" is 16; .*"f64", "f32", "f16", "bf16"'):
        oitlab.render(small_scene, "wboit", {"format": 16}, backend=backend)
