"""Techniques of two passes over the geometry, and bins of layered rendering, against the CPU backend."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import DEVICE, F32, ROUNDINGS, SCENES, WHY_NOT, scene_of, tolerance

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

Params = dict[str, Any]

MAPS = (
    "opacity_shadow_maps",
    "deep_opacity_maps",
    "occupancy_maps",
    "fourier_opacity_maps",
    "tfm",
    "wavelet",
)
MOMENTS = ("mboit_power", "mboit_trig")
# What implementations of M18 differ by for 95 % of pixels, and at worst: eight moments, and no bias,
# leave little of single precision.
CONFORMS, CONFORMS_AT_WORST = 2e-3, 0.1
# A device rounds T and each coefficient as often as it adds to them, relative to all absorbance of the pixel;
# the series, products and functions of a term take some eight roundings more.
TERMS = 8


def absorbances(scene: oitlab.Scene, s_max: float) -> Any:
    """Sum the absorbance of each pixel."""
    fragments = oitlab.capture(scene)
    with np.errstate(divide="ignore"):
        s = np.minimum(-np.log1p(-fragments.alpha.astype(np.float64)), s_max)
    ends = np.concatenate([[0.0], np.cumsum(s)])[fragments.offsets]
    return np.diff(ends).reshape(scene.height, scene.width)


def limits(scene: oitlab.Scene, expected: oitlab.Frame, params: Params) -> Any:
    """Bound the difference of each pixel: absorbance is rounded relative to all of it, and T by as much.

    What is normalised is so by a coverage that is 1 - R: where that is faint, few digits are left of it.
    """
    layers = expected.fragment_count + ROUNDINGS
    scale = max(1.0, float(np.abs(expected.color).max()))
    tau = F32 * (layers + TERMS) * absorbances(scene, params.get("s_max", 10.0))
    covered = np.maximum(1.0 - expected.transmittance, F32)
    return (
        tolerance(scene, expected) + tau * scale + 2 * F32 * layers * np.abs(expected.color).max(-1) / covered
    )


def pairs(scene: oitlab.Scene, wanted: list[tuple[str, Params]]) -> Iterator[tuple[Any, Any, Params]]:
    frames = [oitlab.render_many(scene, wanted, backend=backend) for backend in ("gpu", "cpu")]
    for got, expected, (_, params) in zip(*frames, wanted, strict=True):
        yield got, expected, params


def check(scene: oitlab.Scene, technique: str, variants: list[Params], share: float = 1.0) -> None:
    for got, expected, params in pairs(scene, [(technique, params) for params in variants]):
        limit = limits(scene, expected, params)
        off = np.abs(got.color - expected.color).max(axis=-1)
        assert np.isfinite(got.color).all()
        assert (off <= limit).mean() >= share, (technique, params, (off / limit).max())
        gone = np.abs(got.transmittance - expected.transmittance)
        assert (gone <= limit).mean() >= share, (technique, params, (gone / limit).max())


OWN: list[tuple[str, Params]] = [
    # more bins than a pass has attachments for, and fewer than a texel has channels
    *(("opacity_shadow_maps", {"bins": bins}) for bins in (1, 2, 5, 33, 300)),
    *(("opacity_shadow_maps", {"bins": 7, "interp": interp}) for interp in ("floor", "linear")),
    ("opacity_shadow_maps", {"bins": 7, "self_correct": False}),
    *(("deep_opacity_maps", {"bins": bins}) for bins in (1, 2, 9, 120, 4000)),
    *(("deep_opacity_maps", {"bins": bins, "spacing": "uniform"}) for bins in (1, 30, 200)),
    ("deep_opacity_maps", {"self_correct": False}),
    *(("occupancy_maps", {"bits": bits}) for bits in (1, 31, 33, 1000)),
    *(("occupancy_maps", {"bits": 96, "slabs": slabs}) for slabs in (3, 32, 96)),
    *(("fourier_opacity_maps", {"frequencies": k}) for k in (1, 2, 16, 40)),
    ("fourier_opacity_maps", {"lanczos": True, "margin": 0.13}),
    ("fourier_opacity_maps", {"self_correct": False, "margin": 0.25}),
    *(("tfm", {"frequencies": k}) for k in (1, 3, 40)),
    ("tfm", {"self_correct": False}),
    *(("tfm", {"frequencies": k, "project": "transmittance"}) for k in (1, 8, 50)),
    ("tfm", {"project": "transmittance", "submission_order": "back_to_front"}),
    *(("wavelet", {"rank": rank}) for rank in (0, 1, 2, 6, 10)),
    ("wavelet", {"self_correct": False}),
]


@pytest.mark.parametrize(("technique", "params"), OWN)
@pytest.mark.parametrize("name", ["blades", "opaque"])
def test_params_of_maps_are_those_of_the_cpu(name: str, technique: str, params: Params) -> None:
    check(SCENES[name], technique, [params])


SHARED: list[Params] = [
    *({"composite": composite} for composite in ("none", "exact_bg", "normalize")),
    *({"range": bounds} for bounds in ("pixel", "scene", (4.0, 5.5), (0.0, 1e300), (7.0, 7.0001))),
    *({"s_max": s_max} for s_max in (1.0, 60.0)),
    *({"submission_order": order} for order in ("reversed", "shuffled", "centroid")),
]


@pytest.mark.parametrize("technique", MAPS)
@pytest.mark.parametrize("name", ["squares", "smoke", "orthographic"])
def test_what_maps_have_in_common_is_that_of_the_cpu(name: str, technique: str) -> None:
    check(SCENES[name], technique, SHARED)


MOMENT_PARAMS: list[tuple[str, Params]] = [
    *(("mboit_power", {"moments": m}) for m in (4, 6, 8)),
    *(("mboit_trig", {"moments": m}) for m in (2, 3, 4)),
    *((technique, {"overestimation": beta}) for technique in MOMENTS for beta in (0.0, 1.0)),
    *((technique, {"bias": bias}) for technique in MOMENTS for bias in (0.0, 1e-3, 1.0, 5.0)),
    *((technique, more) for technique in MOMENTS for more in SHARED if "submission_order" not in more),
    *(("mboit_trig", {"wrapping_zone": zone}) for zone in (0.0, 1.0, np.pi)),
]


@pytest.mark.parametrize(("technique", "params"), MOMENT_PARAMS)
@pytest.mark.parametrize("name", ["smoke", "random", "opaque"])
def test_moments_conform(name: str, technique: str, params: Params) -> None:
    ((got, expected, _),) = pairs(SCENES[name], [(technique, params)])
    off = np.abs(got.color - expected.color).max(axis=-1)
    assert np.isfinite(got.color).all()
    # without a zone the far end is the near one, and what is there is on either side of a step
    assert np.quantile(off, 0.95) <= CONFORMS
    assert off.max() <= (1.0 if params.get("wrapping_zone") == 0.0 else CONFORMS_AT_WORST)
    assert np.abs(got.transmittance - expected.transmittance).max() <= tolerance(SCENES[name], expected)


def panes(depths: Any, alphas: Any, *, emission: float = 0.0) -> oitlab.Scene:
    """Look through panes at these distances."""
    rng = np.random.default_rng(3)
    glow = (emission, 0.0, 2 * emission)
    meshes = [
        oitlab.Mesh(
            [(-9, -9, 5 - z), (9, -9, 5 - z), (0, 18, 5 - z)],
            [(0, 1, 2)],
            color=(*rng.random(3), alpha),
            emission=glow,
        )
        for z, alpha in zip(depths, alphas, strict=True)
    ]
    return scene_of(*meshes, width=3, height=2)


STACKS: dict[str, tuple[Any, Any]] = {
    "one": ([4.0], [0.3]),
    "one that is opaque": ([4.0], [1.0]),
    "one that is not there": ([4.0], [0.0]),
    "two at one depth": ([4.0, 4.0], [0.5, 0.8]),
    "many at one depth": ([4.0] * 30, [0.1] * 30),
    "opaque ones": (np.linspace(3, 9, 60), [1.0] * 60),
    "faint ones": (np.linspace(3, 9, 40), [1e-5] * 40),
    "of all kinds": (np.linspace(3, 9, 25), [0.0, 1.0, 0.5, 1e-3, 0.97] * 5),
    "on the edges of bins": (3 + np.arange(9) / 8, [0.4] * 9),
    "all but at one depth": (4 + 1e-6 * np.arange(12), [0.3] * 12),
}


@pytest.mark.parametrize("composite", ["none", "exact_bg", "normalize"])
@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("technique", MAPS)
def test_stacks_are_those_of_the_cpu(technique: str, name: str, composite: str) -> None:
    for emission in (0.0, 0.7):
        scene = panes(*STACKS[name], emission=emission)
        check(scene, technique, [{"composite": composite}])


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("technique", MOMENTS)
def test_stacks_of_moments_conform(technique: str, name: str) -> None:
    for composite in ("none", "normalize"):
        ((got, expected, _),) = pairs(panes(*STACKS[name]), [(technique, {"composite": composite})])
        assert np.abs(got.color - expected.color).max() <= CONFORMS_AT_WORST, composite


HALVES = 2.0**-10


@pytest.mark.parametrize("technique", [*MAPS, "mboit_power", "lwboit"])
@pytest.mark.parametrize("name", ["squares", "blades", "opaque"])
def test_maps_of_halves_are_near_the_emulation(name: str, technique: str) -> None:
    """Blend units may truncate: each sum is a unit per layer off, and T by all of them."""
    biased: Params = (
        {"bias": 1e-2} if technique in MOMENTS else {}
    )  # what sums of moments in halves take to be safe
    got, expected, _ = next(pairs(SCENES[name], [(technique, {"format": "f16"} | biased)]))
    layers = np.maximum(expected.fragment_count[..., None], 1.0)
    off = np.abs(got.color - expected.color)
    assert (off <= 4 * layers**2 * HALVES).all(), (off / layers**2 / HALVES).max()
    assert off.max() > 0.0  # and not the same numbers


@pytest.mark.parametrize(
    ("technique", "params", "limit"),
    [
        ("wavelet", {"revealage_format": "unorm8"}, 1 / 255),
        ("opacity_shadow_maps", {"composite": "exact_bg", "revealage_format": "unorm16"}, 2 / 65535),
        ("lwboit", {"revealage_format": "unorm8", "normalize": False}, 1 / 255),
        ("fourier_opacity_maps", {"accumulation_format": "f16"}, HALVES),
    ],
)
def test_targets_of_other_formats_are_near_the_emulation(
    technique: str, params: Params, limit: float
) -> None:
    got, expected, _ = next(pairs(SCENES["squares"], [(technique, params)]))
    assert np.abs(got.color - expected.color).max() <= limit * expected.stats.depth_complexity_max


BINS: list[Params] = [
    {"bins": 1},
    {"bins": 3, "smooth": False},
    {"bins": 40},
    {"bins": 512, "range": "pixel"},
    {"bins": 9, "range": (4.0, 4.000001)},
    {"shape": False, "bin_function": "tent"},
    {"shape_anchor": "edge", "weight": "one"},
    {"normalize": False, "weight": "inv_pow"},
]


@pytest.mark.parametrize("partition", ["none", "absorbance"])
@pytest.mark.parametrize("name", ["squares", "smoke", "opaque", "orthographic"])
def test_layers_of_bins_are_those_of_the_cpu(name: str, partition: str) -> None:
    # shares of a fragment are exponentials, weights powers
    scene = SCENES[name]
    for got, expected, params in pairs(scene, [("lwboit", {"partition": partition} | more) for more in BINS]):
        off = np.abs(got.color - expected.color).max()
        assert off <= 8 * tolerance(scene, expected), (params, off)


@pytest.mark.parametrize("name", STACKS)
def test_stacks_of_bins_are_those_of_the_cpu(name: str) -> None:
    scene = panes(*STACKS[name])
    wanted = [
        ("lwboit", {"partition": p, "smooth": s}) for p in ("none", "absorbance") for s in (False, True)
    ]
    for got, expected, params in pairs(scene, wanted):
        off = np.abs(got.color - expected.color).max()
        assert off <= 8 * tolerance(scene, expected), (params, off)


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        ("opacity_shadow_maps", {"bins": 20_000}, "bins: 5000 layers of a target"),
        ("fourier_opacity_maps", {"frequencies": 10_000}, "frequencies: 5001 layers"),
        ("occupancy_maps", {"bits": 1 << 17}, "occupancy_maps: bits=131072 has no form"),
        ("occupancy_maps", {"bits": 10, "slabs": 4}, "10 bits do not divide into 4 slabs"),
        ("tfm", {"project": "transmittance", "frequencies": 5000}, "frequencies is at most 4096"),
        ("tfm", {"project": "transmittance", "format": "f16"}, 'coefficients_format="f16" has no form'),
        ("wavelet", {"summation": "compensated"}, 'summation="compensated" has no form'),
        ("wavelet", {"coefficients_format": "bf16"}, 'coefficients_format="bf16" has no form'),
        ("mboit_power", {"moments_format": "unorm16"}, 'there it is one of "f32", "f16"'),
        ("mboit_trig", {"absorbance_format": "f64"}, 'absorbance_format="f64" has no form'),
        ("lwboit", {"summation": "fixed"}, 'lwboit: summation="fixed" has no form'),
        ("wavelet", {"submission_order": "sorted"}, 'submission_order="sorted" sorts fragments'),
    ],
)
def test_what_no_device_does_is_refused_by_name(technique: str, params: Params, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.render(SCENES["blades"], technique, params, backend="gpu")
