"""Forms over lists: samples, stochastic layers, clusters, polylines and the continuum against the CPU."""

import itertools
import re
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, SCENES, WHY_NOT, scene_of, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

Params = dict[str, Any]

# Scenes of one colour per face: there depths and alphas, and so random masks, are the CPU's to the bit but
# for one depth in thousands.
FACETED = ["squares", "blades", "soup", "opaque", "empty"]


def assert_same(name: str, technique: str, params: Params, share: float = 1.0, factor: float = 1.0) -> None:
    """Compare a share of all pixels, within the rounding of f32 sums times what a form magnifies it by."""
    scene = SCENES[name]
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    limit = factor * tolerance(scene, expected)
    off = np.maximum(
        np.abs(got.color - expected.color).max(axis=-1), np.abs(got.transmittance - expected.transmittance)
    )
    assert np.isfinite(off).all(), params
    assert (off <= limit).mean() >= share, (name, params, off.max(), (off > limit).sum())


@pytest.mark.parametrize("name", FACETED)
def test_masks_are_those_of_the_cpu(name: str) -> None:
    for mode, correction in itertools.product(["color", "depth"], ["none", "alpha"]):
        for stratified, samples in [(True, 1), (True, 8), (False, 33), (True, 64), (False, 64), (True, 131)]:
            params = {"mode": mode, "correction": correction, "stratified": stratified, "samples": samples}
            assert_same(name, "stochastic_transparency", params | {"seed": 2**40 + samples})


def test_wide_masks_are_those_of_the_cpu() -> None:
    for stratified in (True, False):
        assert_same("squares", "stochastic_transparency", {"samples": 4096, "stratified": stratified})


@pytest.mark.parametrize("order", ["reversed", "sorted", "back_to_front", "shuffled", "centroid"])
def test_samples_do_not_know_when_a_fragment_arrives(order: str) -> None:
    scene = SCENES["blades"]
    for technique in ("stochastic_transparency", "screen_door", "alpha_testing", "slab", "deep_shadow_maps"):
        wanted = [(technique, {}), (technique, {"submission_order": order})]
        one, other = oitlab.render_many(scene, wanted, backend="gpu")
        np.testing.assert_array_equal(one.color, other.color)


@pytest.mark.parametrize("samples", [1, 3, 16, 1000, 2**24])
def test_screen_doors_are_those_of_the_cpu(samples: int) -> None:
    for name in FACETED:
        assert_same(name, "screen_door", {"samples": samples})


def pane(alpha: float, z: float) -> oitlab.Mesh:
    corners = [(-9, -9, z), (9, -9, z), (0, 9, z)]
    return oitlab.Mesh(corners, [(0, 1, 2)], color=(0.5, 0.25, 1.0, alpha))


def test_alphas_at_a_threshold_are_decided_as_on_the_cpu() -> None:
    for alpha in (0.0, 0.1, 0.3, 0.5, 1.0):
        scene = scene_of(pane(alpha, 0.0), pane(0.9, -1.0), width=4, height=4)
        # the nearest f32 of 0.1 is more than 0.1, that of 0.3 too, that of 0.9 is less
        for threshold in (0.0, 0.1, 0.3, 0.5, 0.899999, 0.9):
            images = [
                oitlab.render(scene, "alpha_testing", {"threshold": threshold}, backend=backend).color
                for backend in ("cpu", "gpu")
            ]
            np.testing.assert_allclose(images[0], images[1], rtol=0, atol=1e-6)
        for samples in (1, 2, 5, 10):
            images = [
                oitlab.render(scene, "screen_door", {"samples": samples}, backend=backend).color
                for backend in ("cpu", "gpu")
            ]
            np.testing.assert_allclose(images[0], images[1], rtol=0, atol=1e-6)


def coincident() -> oitlab.Scene:
    """Make panes in one plane, in front of an opaque one; some emit alone, some do nothing."""
    alphas = [0.5, 0.0, 1.0, 0.25, 0.75, 0.0, 0.5]
    rng = np.random.default_rng(3)
    panes = [
        oitlab.Mesh(
            [(-9, -9, 0), (9, -9, 0), (0, 9, 0)],
            [(0, 1, 2)],
            color=(*rng.random(3), alpha),
            emission=emission,
        )
        for alpha, emission in zip(
            alphas, [(0, 0, 0), (0.5, 0, 0), *[(0, 0.1, 0)] * 3, (0, 0, 0), (0, 0, 1)], strict=True
        )
    ]
    solid = oitlab.Mesh(
        [(-9, -9, -2), (9, -9, -2), (0, 9, -2)], [(0, 1, 2)], color=(0.1, 0.9, 0.3, 1), alpha_mode="opaque"
    )
    return scene_of(solid, *panes, width=8, height=6)


EVERY_FORM = [
    ("stochastic_transparency", {"mode": "depth"}),
    ("stochastic_transparency", {"correction": "alpha", "samples": 3}),
    ("screen_door", {}),
    ("alpha_testing", {}),
    ("slab", {"layers": 2}),
    ("slab", {"layers": 2, "replay": "as_is", "correction": "tail"}),
    ("slab", {"layers": 3, "variant": "alpha", "bits": 0, "accumulate": "stored"}),
    ("deep_shadow_maps", {"eps": 0.0}),
    ("deep_shadow_maps", {"vertices": 2}),
    ("deep_shadow_maps", {"eps": 0.2, "composite": "normalize"}),
    ("density_clustering", {}),
    ("density_clustering", {"composite": "exact_bg"}),
    ("gs_wsr", {}),
    ("gs_wsr", {"variant": "linear", "background_weight": 0.0}),
    ("continuum", {}),
    ("continuum", {"memory": "bins", "merge": "sum", "accumulate": "all"}),
    ("continuum", {"memory": "bins", "merge": "discard_occupied"}),
]


@pytest.mark.parametrize(("technique", "params"), EVERY_FORM)
def test_coincident_fragments_are_ordered_by_primitive(technique: str, params: Params) -> None:
    scene = coincident()
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    limit = tolerance(scene, expected)
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)
    np.testing.assert_allclose(got.transmittance, expected.transmittance, rtol=0, atol=limit)


ACCUMULATE = [
    {"accumulate": "stored"},
    *({"accumulate": "all", "correction": correction} for correction in ("none", "global", "tail")),
]


@pytest.mark.parametrize("variant", ["mask", "alpha"])
@pytest.mark.parametrize("probability", ["stratified", "random"])
def test_stochastic_layers_are_those_of_the_cpu(variant: str, probability: str) -> None:
    base = {"variant": variant, "probability": probability, "seed": 5}
    for name, more in itertools.product(["squares", "opaque"], ACCUMULATE):
        for layers, bits in [(1, 1), (2, 8), (4, 32), (50, 100)]:
            assert_same(name, "slab", base | more | {"layers": layers, "bits": bits})


@pytest.mark.parametrize("order", ["as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"])
@pytest.mark.parametrize("variant", ["mask", "alpha"])
def test_stochastic_layers_as_submitted_are_those_of_the_cpu(variant: str, order: str) -> None:
    base = {"variant": variant, "replay": "as_is", "submission_order": order}
    for more in ACCUMULATE:
        for layers, bits in [(2, 8), (4, 70)]:
            assert_same("squares", "slab", base | more | {"layers": layers, "bits": bits})


def test_weighted_sums_are_those_of_the_cpu() -> None:
    for name in FACETED:
        for params in (
            {"background_weight": 0.0},
            {"variant": "exp", "sigma": 0.3, "gamma": 2.0},
            {"variant": "exp", "gamma": 0.7, "background_weight": 1e30},
            {"variant": "linear", "sigma": 4.5, "gain": 3.0},
            {"variant": "linear", "background_weight": 0.01},
        ):
            # a power, an exponential and a difference of depths more than a sum has
            assert_same(name, "gs_wsr", params, factor=4)


def test_weighted_sums_in_halves_are_close() -> None:
    params = {"variant": "exp", "sigma": 0.2, "format": "f16"}
    got = oitlab.render(SCENES["blades"], "gs_wsr", params, backend="gpu")
    expected = oitlab.render(SCENES["blades"], "gs_wsr", params)
    # blend units may truncate: a unit in the last place per fragment
    limit = 2.0**-10 * got.stats.depth_complexity_max
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)


# A cluster may be 2 sqrt(3) 1e-4 of the pixel's depths wide, and its edge magnifies the rounding of a
# position as much; of fragments as near to one centre as to another it is rounding that decides.
EDGE = 1 / (2 * 3**0.5 * 1e-4)
CLUSTERED = 0.99


@pytest.mark.parametrize("name", FACETED)
@pytest.mark.parametrize("composite", ["none", "exact_bg", "normalize"])
def test_clusters_are_those_of_the_cpu(name: str, composite: str) -> None:
    for bins, iterations in [(1, 1), (4, 3), (3, 50), (40, 2), (256, 1)]:
        params = {"bins": bins, "iterations": iterations, "composite": composite, "s_max": 8.0}
        assert_same(name, "density_clustering", params, share=CLUSTERED, factor=EDGE)


def test_lone_fragments_do_not_hide_themselves_in_a_cluster() -> None:
    scene = scene_of(pane(0.75, 0.0), pane(0.5, -1.0), pane(0.5, -3.0), width=8, height=8)
    got = oitlab.render(scene, "density_clustering", {"bins": 64}, backend="gpu")
    exact = oitlab.render(scene, "a_buffer")
    np.testing.assert_allclose(got.color, exact.color, rtol=0, atol=1e-6)


# Where a vertex lies on the edge of what eps allows, or two triangles are equal, rounding decides what is
# kept; either is a polyline as good as the other.
COMPRESSED = 0.99


@pytest.mark.parametrize("name", FACETED)
@pytest.mark.parametrize("composite", ["none", "exact_bg", "normalize"])
def test_polylines_are_those_of_the_cpu(name: str, composite: str) -> None:
    for params in ({"eps": 0.0}, {"vertices": 1000}, {"vertices": 2}):
        assert_same(name, "deep_shadow_maps", params | {"composite": composite})
    for params in ({"eps": 0.01}, {"eps": 0.2}, {"eps": 1.0}, {"vertices": 3}, {"vertices": 8}):
        assert_same(name, "deep_shadow_maps", params | {"composite": composite}, share=COMPRESSED)


def test_no_polyline_is_farther_from_the_curve_than_eps() -> None:
    for name, eps in itertools.product(("blades", "smoke"), (0.01, 0.1)):
        scene = SCENES[name]
        got = oitlab.render(scene, "deep_shadow_maps", {"eps": eps}, backend="gpu")
        exact = oitlab.render(scene, "a_buffer")
        assert np.abs(got.transmittance - exact.transmittance).max() <= eps + 1e-5


AXES: dict[str, list[str]] = {
    "memory": ["none", "layers", "unbounded", "samples", "bins"],
    "insertion": ["always", "threshold", "nearest", "stochastic", "never"],
    "merge": [
        "none",
        "discard_furthest",
        "over_furthest",
        "over_nearest",
        "over_closest",
        "smallest_error",
        "over_arrival",
        "discard_occluded",
        "sum",
        "average",
        "discard_occupied",
    ],
    "normalize": ["none", "tail", "global"],
    "opacity": ["alpha", "coverage"],
    "accumulate": ["stored", "all"],
}


def compositions(scene: oitlab.Scene, more: Params) -> list[tuple[Params, oitlab.Frame]]:
    """Render all that have a meaning on the CPU."""
    found = []
    for choices in itertools.product(*AXES.values()):
        params: Params = dict(zip(AXES, choices, strict=True)) | more
        if params["merge"] == "over_arrival":
            params["layers"] = 1
        try:
            found.append((params, oitlab.render(scene, "continuum", params)))
        except ValueError:
            continue
    return found


@pytest.mark.parametrize(
    "more",
    [
        {"layers": 3, "bins": 9, "threshold": 0.3},
        {"layers": 2, "bins": 4, "bits": 5, "samples": 3, "range": "scene", "submission_order": "reversed"},
        {
            "layers": 5,
            "bits": 40,
            "samples": 40,
            "probability": "random",
            "submission_order": "back_to_front",
        },
        {"layers": 2, "weight": "mb7", "range": (4.0, 6.0), "bins": 100, "submission_order": "sorted"},
        {"layers": 3, "bins": 5, "submission_order": "shuffled", "seed": 4},
    ],
    ids=["plain", "few", "random", "weighted", "shuffled"],
)
def test_every_composition_is_that_of_the_cpu(more: Params) -> None:
    scene = SCENES["squares"].replace(width=32, height=24)
    every = compositions(scene, more)
    assert len(every) > 150
    images = oitlab.render_many(scene, [("continuum", params) for params, _ in every], backend="gpu")
    for got, (params, expected) in zip(images, every, strict=True):
        off = np.abs(got.color - expected.color).max(axis=-1)
        # a depth at a bin's edge may be rounded to its other side
        share = 0.99 if params["memory"] == "bins" else 1.0
        assert (off <= tolerance(scene, expected)).mean() >= share, (params, off.max())


def test_compositions_that_order_cannot_change_are_done_in_any_order() -> None:
    scene = SCENES["blades"]
    done = [
        {"merge": "discard_furthest"},
        {"memory": "unbounded", "merge": "none"},
        {"memory": "bins", "merge": "average"},
    ]
    for params in done:
        wanted = [("continuum", params | {"submission_order": order}) for order in ("as_is", "shuffled")]
        one, other = oitlab.render_many(scene, wanted, backend="gpu")
        np.testing.assert_array_equal(one.color, other.color)


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        ("stochastic_transparency", {"samples": 4097}, "there samples is at most 4096"),
        ("stochastic_transparency", {"format": "f16"}, 'node_color_format="f16" has no form'),
        ("screen_door", {"samples": 2**24 + 1}, "there samples is at most 16777216"),
        ("alpha_testing", {"node_depth_format": "d24"}, 'node_depth_format="d24" has no form'),
        ("slab", {"replay": "as_is", "layers": 33}, "there layers is at most 32"),
        ("slab", {"replay": "as_is", "layers": 32, "bits": 300}, "there layers times bits is at most 8192"),
        ("density_clustering", {"bins": 257}, "there bins is at most 256"),
        ("density_clustering", {"summation": "scaled"}, 'summation="scaled" has no form'),
        ("deep_shadow_maps", {"vertices": 1}, "allowed is 0 or an integer >= 2"),
        ("deep_shadow_maps", {"nodes_format": "f16"}, 'nodes_format="f16" has no form'),
        ("gs_wsr", {"format": "bf16"}, 'accumulation_format="bf16"'),
        ("gs_wsr", {"variant": "linear", "format": "f16"}, 'accumulation_format="f16" has no form'),
        ("continuum", {"memory": "bins"}, 'merge="over_furthest" does not go with memory="bins"'),
        ("continuum", {"layers": 33}, "there layers is at most 32"),
        ("continuum", {"opacity": "coverage", "bits": 4000}, "there layers times bits is at most 8192"),
        (
            "continuum",
            {"memory": "bins", "merge": "average", "weight": lambda z, a: z * a},
            "a callable has no form",
        ),
    ],
)
def test_what_has_no_form_is_refused_by_name(technique: str, params: Params, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.render(SCENES["blades"], technique, params, backend="gpu")


@pytest.mark.skipif("llvmpipe" not in str(DEVICE), reason="a driver that does not end loops early")
@pytest.mark.parametrize(
    ("technique", "params"),
    [
        ("deep_shadow_maps", {"vertices": 8}),
        ("continuum", {"memory": "unbounded", "merge": "none", "insertion": "stochastic"}),
    ],
)
def test_what_takes_steps_like_the_square_of_a_list_is_whole_or_an_error(
    technique: str, params: Params
) -> None:
    few, many = (scene_of(*(pane(0.1, -z / 400) for z in range(n)), width=2, height=2) for n in (60, 600))
    got, expected = (oitlab.render(few, technique, params, backend=b) for b in ("gpu", "cpu"))
    np.testing.assert_allclose(got.transmittance, expected.transmittance, rtol=0, atol=1e-6)
    with pytest.raises(RuntimeError, match="ends loops before they are done"):
        oitlab.render(many, technique, params, backend="gpu")
