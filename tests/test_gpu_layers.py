"""Order-dependent lists of layers on the GPU: every param that has a form, every order, what decides ties."""

import itertools
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, ORTHOGRAPHIC, SCENES, WHY_NOT, scene_of, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

ORDERS = ("as_is", "reversed", "sorted", "back_to_front")

Params = dict[str, Any]


def combinations(**choices: Iterable[Any]) -> list[Params]:
    return [
        dict(zip(choices, values, strict=True)) for values in itertools.product(*map(list, choices.values()))
    ]


def compared(
    scene: oitlab.Scene, technique: str, variants: list[Params]
) -> list[tuple[Params, oitlab.Frame, oitlab.Frame]]:
    """Render on both backends, from the same fragments: the device's own."""
    wanted = [(technique, params) for params in variants]
    got = oitlab.render_many(scene, wanted, backend="gpu")
    expected = oitlab.render_many(oitlab.gpu.capture(scene), wanted)
    return list(zip(variants, got, expected, strict=True))


def off_by(got: oitlab.Frame, expected: oitlab.Frame) -> Any:
    """Return how far off each pixel is."""
    color = np.abs(got.color - expected.color).max(axis=-1)
    share = np.abs(got.transmittance - expected.transmittance).reshape(color.shape)
    return np.maximum(color, share)


def assert_agree(scene: oitlab.Scene, technique: str, variants: list[Params]) -> None:
    for params, got, expected in compared(scene, technique, variants):
        assert off_by(got, expected).max() <= tolerance(scene, expected), params


def stack(*layers: tuple[float, tuple[float, ...]], emission: Any = (0, 0, 0)) -> oitlab.Scene:
    """Cover the image with panes at depths, each of a colour; one with emission besides, at depth 2."""
    corners = [[(-30.0, -30, 5 - z), (30, -30, 5 - z), (0, 60, 5 - z)] for z, _ in layers]
    faces = np.arange(3 * len(layers)).reshape(-1, 3)
    colors = [color for _, color in layers]
    panes = oitlab.Mesh(np.reshape(corners, (-1, 3)), faces, face_colors=colors)
    meshes = [panes]
    if any(emission):
        glow = [(-30.0, -30, 3), (30, -30, 3), (0, 60, 3)]
        meshes.append(oitlab.Mesh(glow, [(0, 1, 2)], color=(1, 1, 1, 0), emission=emission))
    return scene_of(*meshes, camera=ORTHOGRAPHIC, width=9, height=7)


RED, GREEN, BLUE = (1.0, 0.1, 0.0), (0.0, 1.0, 0.2), (0.1, 0.0, 1.0)

STACKS = {
    "one": stack((3.0, (*RED, 0.4))),
    "nothing but opaque": stack((3.0, (*RED, 1.0)), (2.0, (*GREEN, 1.0)), (4.0, (*BLUE, 1.0))),
    # equal depths are told apart by primitive, equal gaps by place
    "coincident": stack(
        *((3.0, (*color, 0.5)) for color in (RED, GREEN, BLUE, RED, GREEN)), (2.0, (*BLUE, 0.3))
    ),
    "equal gaps": stack(
        *((1.0 + i, (*color, 0.5)) for i, color in enumerate((RED, GREEN, BLUE) * 3) if i != 4),
        (5.0, (*GREEN, 0.7)),
    ),
    "invisible": stack(*((1.0 + i * 3 % 7, (*BLUE, 0.0 if i % 2 else 0.6)) for i in range(7))),
    "glow": stack(
        *((1.0 + i * 3 % 7, (*RED, 0.25)) for i in range(7)), (1.5, (*BLUE, 1.0)), emission=(3, 2, 1)
    ),
    "glow alone": stack((9.0, (*RED, 0.0)), emission=(3, 2, 1)),
    "faint": stack(*((1.0 + i * 5 % 11, (*GREEN, 10.0 ** -(i % 6))) for i in range(11))),
    "bright": stack(*((1.0 + i * 5 % 11, (1e30, 1e-30, 3e38, 0.5 if i % 3 else 1.0)) for i in range(11))),
    "deep": stack(*((1.0 + i * 37 % 101 * 0.1, (*(RED, GREEN, BLUE)[i % 3], 0.9)) for i in range(101))),
}

BUCKETS: list[Params] = [
    *combinations(
        layers=(1, 2, 4, 32), front_threshold=(0.2, -1.0, 0.5, 1e300), opaque_threshold=(0.98, 2.0)
    ),
    *combinations(mode=("depth",), layers=(1, 3), buckets=(1, 4, 512), range=("pixel", "scene", (2.0, 4.5))),
    *combinations(
        mode=("transmittance",),
        layers=(1, 4),
        buckets=(1, 3, 8),
        transmittance_threshold=(0.1, 0.5, 1.0, 0.0),
    ),
]
MASKS: list[Params] = [
    *combinations(layers=(1, 4), bits=(1, 32, 200), seed=(2**40 + 3,)),
    *combinations(store=("hybrid",), layers=(1, 4), alpha_bits=(1, 4, 16), seed=(1,)),
    {"layers": 2, "bits": 33},
    {"layers": 32, "bits": 64},
]
STEPS = combinations(
    layers=(1, 2, 3, 8, 32), protect_front=(True, False), composite=("none", "exact_bg", "normalize")
)
CORES = combinations(layers=(0, 1, 3, 32), tail=("exact", "count"), correction=("tail", "global"))
LISTS: dict[str, list[Params]] = {
    "z3": combinations(layers=(1, 2, 5, 32), merge_depth=("front", "mean")),
    "mlab_buckets": BUCKETS,
    "mlcb": MASKS,
    "adaptive_transparency": STEPS,
    "hybrid_transparency": CORES,
}


@pytest.mark.parametrize("technique", LISTS)
@pytest.mark.parametrize("name", ["squares", "blades", "opaque"])
def test_every_param_is_that_of_the_cpu(name: str, technique: str) -> None:
    assert_agree(SCENES[name], technique, LISTS[technique])


@pytest.mark.parametrize("technique", LISTS)
@pytest.mark.parametrize("name", STACKS)
def test_extreme_stacks_are_those_of_the_cpu(name: str, technique: str) -> None:
    for _, got, _ in compared(STACKS[name], technique, LISTS[technique]):
        assert np.isfinite(got.color).all()
    assert_agree(STACKS[name], technique, LISTS[technique])


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("technique", [*LISTS, "avsm"])
def test_every_order_is_that_of_the_cpu(technique: str, order: str) -> None:
    variants: list[Params] = [{"layers": k, "submission_order": order} for k in (2, 3, 8)]
    assert_agree(SCENES["random"], technique, variants)
    assert_agree(STACKS["coincident"], technique, variants)


def test_the_core_and_its_tail_know_no_order() -> None:
    scene = SCENES["random"]
    plain = oitlab.render(scene, "hybrid_transparency", {"layers": 3}, backend="gpu")
    for order in ("shuffled", "centroid", "reversed"):
        params = {"layers": 3, "submission_order": order}
        got = oitlab.render(scene, "hybrid_transparency", params, backend="gpu")
        assert off_by(got, plain).max() <= tolerance(scene, plain)


# Nodes of a polyline are rounded to f32 after every fragment, as the CPU does with this format.
SINGLE: Params = {"nodes_format": "f32"}
POLYLINES = combinations(layers=(2, 3, 8, 32), composite=("none", "exact_bg", "normalize"))
THICK = combinations(layers=(2, 8, 32), thickness=(0.3, 1.7, 1e-8, 1e300))


@pytest.mark.parametrize("name", ["squares", "blades", "smoke", "opaque", *STACKS])
def test_polylines_are_those_of_the_cpu(name: str) -> None:
    scene = SCENES[name] if name in SCENES else STACKS[name]
    assert_agree(scene, "avsm", [params | SINGLE for params in POLYLINES])


@pytest.mark.parametrize("name", ["squares", "blades", "opaque", *STACKS])
def test_thick_fragments_are_those_of_the_cpu(name: str) -> None:
    scene = SCENES[name] if name in SCENES else STACKS[name]
    assert_agree(scene, "avsm", [params | SINGLE for params in THICK])


# The panes of smoke have equal distances and alphas, and so areas of some triangles differ by less than the
# rounding of transmittance: it decides which node goes, one being as good as the other.
SHARE_OF_EQUAL_DECISIONS = 0.99
EQUAL_ERRORS = 1e-2


@pytest.mark.parametrize("params", [{}, {"layers": 12}, {"layers": 32, "thickness": 0.3}])
def test_where_nodes_are_as_good_as_each_other_so_are_the_images(params: Params) -> None:
    scene = SCENES["smoke"]
    exact = oitlab.render(scene, "a_buffer")
    ((_, got, expected),) = compared(scene, "avsm", [params])
    agrees = off_by(got, expected) <= tolerance(scene, expected)
    assert agrees.mean() >= SHARE_OF_EQUAL_DECISIONS
    errors = [float(np.sqrt(np.mean((frame.color - exact.color) ** 2))) for frame in (got, expected)]
    assert errors[0] == pytest.approx(errors[1], rel=EQUAL_ERRORS)


def test_zero_fragments_take_slots_where_they_count() -> None:
    scene = STACKS["invisible"]
    variants = combinations(layers=(1, 2, 4), tail=("count", "exact"))
    frames = compared(scene, "hybrid_transparency", variants)
    assert_agree(scene, "hybrid_transparency", variants)
    colors = {(p["layers"], p["tail"]): got.color[3, 4] for p, got, _ in frames}
    assert np.abs(colors[2, "count"] - colors[2, "exact"]).max() > 1e-2


def test_thresholds_that_are_no_f32_are_those_of_the_cpu() -> None:
    """An alpha of 0.2 is more than 0.2 in f32, and one of 0.9 less than 0.9."""
    panes = (
        (2.0, (*RED, 0.2)),
        (1.0, (*GREEN, 0.1)),
        (3.0, (*BLUE, 0.9)),
        (4.0, (*RED, 0.8)),
        (1.5, (*BLUE, 0.1)),
    )
    scene = stack(*panes)
    front, opaque = ((x, float(np.float32(x))) for x in (0.2, 0.9))
    variants = combinations(layers=(3,), front_threshold=front, opaque_threshold=opaque)
    assert_agree(scene, "mlab_buckets", variants)
    colors = {tuple(got.color[3, 4]) for _, got, _ in compared(scene, "mlab_buckets", variants)}
    assert len(colors) == 4


@pytest.mark.parametrize("bits", [7, 32, 64])
def test_masks_of_many_seeds_have_the_mean_that_alphas_have(bits: int) -> None:
    scene = STACKS["coincident"]
    wanted = [("mlcb", {"bits": bits, "layers": 2, "seed": seed}) for seed in range(64)]
    mean = np.mean(
        [f.color.mean(axis=(0, 1)) for f in oitlab.render_many(scene, wanted, backend="gpu")], axis=0
    )
    expected = oitlab.render(scene, "mlab", {"layers": 2}, backend="gpu").color.mean(axis=(0, 1))
    # 64 seeds of 63 pixels, whose samples deviate by 1/2 at most
    np.testing.assert_allclose(mean, expected, rtol=0, atol=4 * 0.5 / np.sqrt(64 * 63 * bits))


def test_formats_that_a_device_has_are_the_same_form() -> None:
    for technique, name in (
        ("adaptive_transparency", "node_share_format"),
        ("avsm", "nodes_format"),
        ("hybrid_transparency", "revealage_format"),
    ):
        scene = SCENES["blades"]
        given = oitlab.render(scene, technique, {name: "f32"}, backend="gpu")
        plain = oitlab.render(scene, technique, backend="gpu")
        np.testing.assert_array_equal(given.color, plain.color)


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        ("z3", {"layers": 33}, "layers is at most 32"),
        ("z3", {"format": "f16"}, "nodes of other formats than f32"),
        ("mlab_buckets", {"mode": "transmittance", "layers": 4, "buckets": 9}, "buckets is at most 8"),
        ("mlab_buckets", {"mode": "depth", "buckets": 513}, "buckets is at most 512"),
        ("mlab_buckets", {"layers": 1000}, "layers=1000 has no form"),
        ("mlcb", {"bits": 2049}, "bits is at most 2048"),
        ("mlcb", {"bits": 257, "layers": 32}, "fewer layers have room for more"),
        ("mlcb", {"node_color_format": "f16"}, "nodes of other formats"),
        ("adaptive_transparency", {"format": "f16"}, 'node_share_format="f16" has no form'),
        ("adaptive_transparency", {"revealage_format": "unorm8"}, 'revealage_format="unorm8" has no form'),
        ("avsm", {"summation": "scaled"}, 'summation="scaled" has no form'),
        ("avsm", {"node_depth_format": "f16"}, 'node_depth_format="f16" has no form'),
        ("avsm", {"format": "f64"}, 'nodes_format="f64" has no form'),
        ("hybrid_transparency", {"tail": "count", "count_format": "f16"}, 'count_format="f16" has no form'),
        ("hybrid_transparency", {"layers": 40}, "layers is at most 32"),
    ],
)
def test_what_lists_do_not_do_is_refused_by_name(technique: str, params: Params, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.render(SCENES["blades"], technique, params, backend="gpu")


@pytest.mark.skipif("llvmpipe" not in str(DEVICE), reason="a driver that does not end loops early")
@pytest.mark.parametrize(
    ("technique", "params", "layers"),
    [
        ("a_buffer", {}, 20_000),
        ("avsm", {"layers": 32}, 2000),
        ("mlab_buckets", {"mode": "depth", "buckets": 512}, 500),
    ],
)
def test_loops_that_a_driver_ends_early_are_an_error(technique: str, params: Params, layers: int) -> None:
    depth = np.random.default_rng(5).permutation(np.linspace(1, 9, layers))
    scene = stack(*((float(z), (*GREEN, 0.5)) for z in depth)).replace(width=2, height=2)
    with pytest.raises(RuntimeError, match="ends loops before they are done"):
        oitlab.render(scene, technique, params, backend="gpu")
