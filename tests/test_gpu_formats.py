"""Render targets of a device against the CPU's emulation of formats."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, SCENES, WHY_NOT, scene_of, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

# One unit in the last place of a half, relative.
F16 = 2.0**-10

Rounding = Callable[[Any], Any]


def to_nearest(x: Any) -> Any:
    return np.asarray(x, np.float32).astype(np.float16)


def toward_zero(x: Any) -> Any:
    single = np.asarray(x, np.float32)
    half = single.astype(np.float16)
    beyond = np.abs(half.astype(np.float32)) > np.abs(single)
    return (half.view(np.uint16) - beyond.astype(np.uint16)).view(np.float16)


@pytest.fixture(scope="module")
def device_rounding() -> Rounding:
    """Find out how blend units round to halves: Vulkan leaves it to them, llvmpipe truncates."""
    quarter_from_above = 1 + 0.75 * F16
    pane = oitlab.Mesh(
        [(-9, -9, 0), (9, -9, 0), (0, 9, 0)], [(0, 1, 2)], color=(quarter_from_above, 0.0, 0.0, 1.0)
    )
    frame = oitlab.render(scene_of(pane, width=1, height=1), "weighted_sum", {"format": "f16"}, backend="gpu")
    assert frame.color[0, 0, 0] in (1.0, 1.0 + F16)
    return toward_zero if frame.color[0, 0, 0] == 1.0 else to_nearest


def blended(fragments: oitlab.Fragments, begin: Any, step: Callable[[Any, Any, Any], Any]) -> Any:
    """Blend each pixel's fragments: step(what is there, colours, alphas) of the k-th of all that have one."""
    target = np.array(begin)
    counts = np.diff(fragments.offsets)
    for k in range(counts.max(initial=0)):
        pixels = np.flatnonzero(counts > k)
        index = fragments.offsets[pixels] + k
        there = target[pixels].astype(np.float32)
        target[pixels] = step(there, fragments.color[index], fragments.alpha[index, None])
    return target.astype(np.float64)


def emulated(technique: str, fragments: oitlab.Fragments, rounding: Rounding) -> Any:
    """Compute an image in targets of halves that are rounded after each blend."""
    pixels = fragments.width * fragments.height
    background = np.broadcast_to(fragments.background, (fragments.height, fragments.width, 3)).reshape(-1, 3)
    if technique == "alpha_compositing":
        return blended(fragments, rounding(background), lambda t, c, a: rounding(c + (1 - a) * t))
    sums = blended(
        fragments, np.zeros((pixels, 4), np.float16), lambda t, c, a: rounding(t + np.concatenate([c, a], 1))
    )
    alpha = sums[:, 3:]
    if technique == "weighted_sum":
        return sums[:, :3] + (1 - alpha) * background
    revealage = blended(fragments, np.ones((pixels, 1), np.float16), lambda t, c, a: rounding((1 - a) * t))
    mean = np.divide(sums[:, :3], alpha, out=np.zeros((pixels, 3)), where=alpha > 0)
    return (1 - revealage) * mean + revealage * background


@pytest.mark.parametrize(
    ("technique", "params"),
    [
        ("weighted_sum", {}),
        ("blended_oit", {}),
        ("wboit", {"weight": "one"}),
        ("wboit", {"weight": "one", "layout": "listing4"}),
        ("alpha_compositing", {}),
    ],
)
@pytest.mark.parametrize("name", ["squares", "blades", "soup", "opaque"])
def test_halves_are_rounded_once_per_blend(
    name: str, technique: str, params: dict[str, Any], device_rounding: Rounding
) -> None:
    scene = SCENES[name]
    got = oitlab.render(scene, technique, {"format": "f16"} | params, backend="gpu").color.reshape(-1, 3)
    expected = emulated(technique, oitlab.gpu.capture(scene), device_rounding)
    off = np.abs(got - expected) / (np.maximum(np.abs(expected), 2.0**-3) * F16)
    # a fused product and sum, or one that is not, may fall on the other side of a half
    assert (off <= 1).mean() >= 0.999
    assert (off <= 0.01).mean() >= 0.98


FORMATS: list[tuple[str, dict[str, Any]]] = [
    ("weighted_sum", {"format": "f16"}),
    ("weighted_average", {"format": "f16"}),
    ("blended_oit", {"format": "f16"}),
    *(("wboit", {"format": "f16", "layout": layout}) for layout in ("listing3", "listing4", "monochrome")),
    ("phenomenological", {"format": "f16", "transmission": (0.5, 0.1, 0.9)}),
    ("alpha_compositing", {"format": "f16"}),
    ("painter", {"format": "f16"}),
]


@pytest.mark.parametrize(("technique", "params"), FORMATS)
@pytest.mark.parametrize("name", ["squares", "blades", "soup", "opaque"])
def test_halves_are_near_the_emulation(
    name: str, technique: str, params: dict[str, Any], device_rounding: Rounding
) -> None:
    """The emulation rounds each blend to nearest; one that truncates loses up to a unit more."""
    scene = SCENES[name]
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    off = np.abs(got.color - expected.color)
    layers = np.maximum(expected.fragment_count[..., None], 1.0)
    # each sum is as large as its layers, and so is its unit; weights of 0.01 and small shares of background
    # leave some of the digits that halves have
    assert (off <= 4 * layers**2 * F16).all(), (off / layers**2 / F16).max()
    if device_rounding is to_nearest:
        size = np.maximum(np.abs(expected.color), 2.0**-3)  # a sum of larger terms may have cancelled to less
        assert (off <= size * F16).mean() >= 0.99


@pytest.mark.parametrize(
    ("technique", "params", "limit"),
    [
        # blend units work in eight bits: a step per layer
        ("alpha_compositing", {"format": "unorm8"}, 1 / 255),
        ("alpha_compositing", {"color_format": "srgb8"}, 3 / 255),
        ("wboit", {"format": "f16", "revealage_format": "unorm8"}, 1 / 255),
        ("blended_oit", {"revealage_format": "unorm16"}, 2 / 65535),
        ("phenomenological", {"format": "f16", "modulation_format": "unorm8"}, 1 / 255),
        ("weighted_sum", {"accumulation_format": "unorm8"}, 1 / 255),
    ],
)
def test_targets_of_equal_steps_are_near_the_emulation(
    technique: str, params: dict[str, Any], limit: float
) -> None:
    scene = SCENES["squares"]
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    layers = expected.stats.depth_complexity_max
    assert np.abs(got.color - expected.color).max() <= limit * layers
    assert np.abs(got.color - expected.color).mean() <= limit


WEIGHTS = [
    choice.strip('"')
    for choice in next(param for param in oitlab.techniques()["wboit"].params if param.name == "weight")
    .range.removeprefix("one of ")
    .split("; ")[0]
    .split(", ")
]


@pytest.mark.parametrize("layout", ["listing3", "listing4", "monochrome"])
@pytest.mark.parametrize("weight", WEIGHTS)
def test_every_weight_is_that_of_the_cpu(weight: str, layout: str) -> None:
    scene = SCENES["blades"]
    wanted = [
        ("wboit", {"weight": weight, "layout": layout} | more)
        for more in ({}, {"weight_scale": 3.0, "weight_shift": -4.0}, {"listing3_clamp": True})
    ]
    if weight in ("inv_pow", "exp", "fig10"):
        wanted.append(("wboit", {"weight": weight, "layout": layout, "weight_k": 2.5}))
    for got, expected in zip(
        oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted), strict=True
    ):
        # exp and pow of shaders have some ten roundings more, and weights of the floor's size few digits
        assert np.abs(got.color - expected.color).max() <= 8 * tolerance(scene, expected), got.params
