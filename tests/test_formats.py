"""Storage formats as params."""

import numpy as np
import pytest

import oitlab

STORED = [entry for entry in oitlab.techniques() if any(param.name == "format" for param in entry.params)]
LISTED = [
    "a_buffer",
    "mlab",
    "mlab_buckets",
    "k_buffer",
    "z3",
    "mlcb",
    "slab",
    "hybrid_transparency",
    "continuum",
]
BLENDED = ["weighted_sum", "weighted_average", "blended_oit", "wboit", "phenomenological", "lwboit", "gs_wsr"]
LOOKING = [
    "opacity_shadow_maps",
    "deep_opacity_maps",
    "density_clustering",
    "occupancy_maps",
    "fourier_opacity_maps",
    "tfm",
    "wavelet",
    "avsm",
    "deep_shadow_maps",
    "mboit_power",
    "mboit_trig",
]
"""Those that see each fragment through a map."""
SUMMED = [*BLENDED, *LOOKING]


def test_techniques_that_sum_have_formats_and_summation() -> None:
    assert {entry.id for entry in STORED} >= {*SUMMED, *LISTED, "alpha_compositing", "painter"}
    for name in SUMMED:
        assert "summation" in {param.name for param in oitlab.techniques()[name].params}


def depth_of(entry: oitlab.TechniqueInfo) -> str:
    """Name the param for the format of stored depths, if there is one."""
    names = [param.name for param in entry.params if param.name.endswith("depth_format")]
    return names[0] if names else ""


@pytest.mark.parametrize("entry", STORED, ids=[entry.id for entry in STORED])
def test_every_format_of_every_target_gives_a_finite_image(
    entry: oitlab.TechniqueInfo, small_scene: oitlab.Scene
) -> None:
    plain = oitlab.render(small_scene, entry.id)
    names = [param for param in entry.params if param.name == "format" or param.name.endswith("_format")]
    assert len(names) >= 2
    for param in names:
        for chosen in param.range.removeprefix("one of ").replace('"', "").split(", "):
            frame = oitlab.render(small_scene, entry.id, {param.name: chosen})
            assert frame.params[param.name] == chosen
            assert np.isfinite(frame.color).all()
            # even 8 bits are near on a handful of layers, unless weights are beyond them; where a map
            # just misses something, a pixel is another
            if chosen in {"f64", "f32", "f16"}:
                off = np.abs(frame.color - plain.color).max(axis=-1) > 0.01
                # where blades cross, depths in halves put some layers in another order
                reordered = chosen == "f16" and frame.params.get(depth_of(entry), "f32") == "f16"
                assert off.mean() <= (0.02 if reordered or entry.id in LOOKING else 0.0)
                assert np.abs(frame.color - plain.color).max() < 0.1 or entry.id not in LOOKING


def test_an_override_that_changes_nothing_is_the_same_variant(small_scene: oitlab.Scene) -> None:
    same = [{}, {"format": "f32"}, {"accumulation_format": "f32"}, {"revealage_format": "f64"}]
    frames = oitlab.render_many(small_scene, [("wboit", params) for params in same])
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames].count(1) == len(same) - 1
    half, stated, other = oitlab.render_many(
        small_scene,
        [
            ("wboit", {"format": "f16"}),
            ("wboit", {"format": "f16", "revealage_format": "f16"}),
            ("wboit", {"format": "f16", "revealage_format": "unorm8"}),
        ],
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


def test_formats_that_make_no_sense_are_refused_by_name(small_scene: oitlab.Scene) -> None:
    with pytest.raises(ValueError, match=r'wboit.*"accumulation_format" is "d24".*"r11g11b10f"'):
        oitlab.render(small_scene, "wboit", {"accumulation_format": "d24"})
    with pytest.raises(ValueError, match=r'wboit: parameter "format" is 16; .*"f64", "f32", "f16", "bf16"'):
        oitlab.render(small_scene, "wboit", {"format": 16})
