"""What every technique promises in the registry holds on every backend, and does so under its params, too.

The core's own tests check promises under params on the CPU; a device is compared with it, param by param.
"""

import functools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import oitlab
from backends import DEVICE, F32, WHY_NOT, refusal
from gpu_scenes import CONFORMS, DECIDING, ROUNDINGS

ENTRIES = list(oitlab.techniques())
BACKGROUND = (0.25, 0.5, 0.75)
VIEW: dict[str, Any] = {"background": BACKGROUND, "near": 0.1, "far": 100.0, "depth_range": (1.0, 9.0)}
SUMS = 1e-5
"""Of sums of up to 64 terms in f32, in any order, and quotients of them; relative to the brightest colour."""
MOMENTS = 2e-3
"""Moments amplify the rounding of their sums: what their paper's implementations may differ by."""
COVERAGE = {"cpu": 0.0, "gpu": F32}
"""Of what is covered, 1 - R, times the colour: R is a double on the CPU, and an f32 on a device."""
PRODUCT = {"cpu": F32, "gpu": 64 * 2 * F32}
"""Of a product of 64 factors: the CPU rounds the image alone, a device every factor and every product."""

Pixel = list[tuple[float, tuple[float, float, float], float, int]]
"""Depth, unmultiplied colour, alpha and primitive of each fragment."""


def fragments_of(pixels: list[Pixel]) -> oitlab.Fragments:
    every = [layer for pixel in pixels for layer in pixel]
    alpha = np.array([a for _, _, a, _ in every], np.float32)
    color = np.array([rgb for _, rgb, _, _ in every], np.float32).reshape(-1, 3)
    return oitlab.Fragments(
        width=len(pixels),
        height=1,
        offsets=np.cumsum([0, *map(len, pixels)]),
        depth=np.array([z for z, _, _, _ in every], np.float32),
        color=color * alpha[:, None],
        alpha=alpha,
        primitive=np.array([key for _, _, _, key in every], np.uint32),
        **VIEW,
    )


def random_pixel(n: int, seed: int, color: tuple[float, float, float] | None = None) -> Pixel:
    """Layers in any order, some of them at one depth, some invisible, none of them of one primitive."""
    rng = np.random.default_rng(seed)
    depths = np.where(rng.random(n) < 0.2, 4.0, rng.uniform(1.0, 9.0, n))
    alphas = np.where(rng.random(n) < 0.1, 0.0, rng.random(n) ** 2)
    keys = rng.permutation(n)
    return [
        (float(z), color or tuple(rng.random(3)), float(a), int(key))  # type: ignore[misc]
        for z, a, key in zip(depths, alphas, keys, strict=True)
    ]


SIZES = (0, 1, 2, 3, 5, 8, 13, 31, 64)
LAYERS = [random_pixel(n, 100 + n) for n in SIZES]


def exact(fragments: oitlab.Fragments) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colour and background share of sorted OVER in float64."""
    frame = oitlab.render(fragments, "a_buffer", dtype="float64")
    return np.float64(frame.color), np.float64(frame.transmittance)


def off(frame: oitlab.Frame, color: Any, share: Any) -> NDArray[np.float64]:
    """Per pixel how far a frame is from colour and share, relative to colours above 1."""
    of_color = np.abs(frame.color - color).max(axis=-1) / np.maximum(1.0, np.abs(color).max(axis=-1))
    shape = *of_color.shape, -1  # a share may be one per channel
    of_share = np.abs(frame.transmittance.reshape(shape) - share.reshape(shape)).max(axis=-1)
    result: NDArray[np.float64] = np.maximum(of_color, of_share)
    return result


def those(promise: str) -> pytest.MarkDecorator:
    """Give the techniques that promise something."""
    chosen = [entry for entry in ENTRIES if entry.properties[promise]]
    assert chosen
    return pytest.mark.parametrize("technique", [entry.id for entry in chosen])


every_technique = pytest.mark.parametrize("technique", [entry.id for entry in ENTRIES])


@every_technique
def test_without_fragments_the_background_is_left(technique: str, backend: Any) -> None:
    invisible: Pixel = [(2.0, (0.0, 0.0, 0.0), 0.0, 0)]
    frame = oitlab.render(fragments_of([[], invisible, []]), technique, backend=backend)
    np.testing.assert_array_equal(frame.color, np.broadcast_to(np.float32(BACKGROUND), (1, 3, 3)))
    np.testing.assert_array_equal(frame.transmittance, 1)


@those("exact_for_one")
def test_one_fragment_is_exact_where_promised(technique: str, backend: Any) -> None:
    rgbs = [(0.9, 0.2, 0.5), (6e4, 0.2, 0.5)]
    alphas, depths = [1e-6, 0.01, 0.35, 0.999, 1.0], [0.0, 1.0, 4.7, 9.0, 300.0]
    fragments = fragments_of([[(z, rgb, a, 3)] for rgb in rgbs for a in alphas for z in depths])
    frame = oitlab.render(fragments, technique, backend=backend)
    brightest = np.repeat([max(rgb) for rgb in rgbs], len(alphas) * len(depths))
    assert (off(frame, *exact(fragments)) <= SUMS + COVERAGE[backend] * brightest).all()


@those("exact_for_one_color")
def test_one_color_is_exact_where_promised(technique: str, backend: Any) -> None:
    fragments = fragments_of([random_pixel(n, 100 + n, (0.2, 0.6, 0.9)) for n in SIZES])
    frame = oitlab.render(fragments, technique, backend=backend)
    assert off(frame, *exact(fragments)).max() <= SUMS


@those("exact_coverage")
def test_coverage_is_exact_where_promised(technique: str, backend: Any) -> None:
    fragments = fragments_of(LAYERS)
    share = oitlab.render(fragments, technique, backend=backend).transmittance.reshape(len(SIZES), -1)
    assert np.abs(share - exact(fragments)[1].reshape(-1, 1)).max() <= PRODUCT[backend]


@those("order_independent")
def test_order_makes_no_difference_where_promised(technique: str, backend: Any) -> None:
    rng = np.random.default_rng(9)
    first, *others = (
        oitlab.render(fragments_of(pixels), technique, backend=backend)
        for pixels in (
            LAYERS,
            [pixel[::-1] for pixel in LAYERS],
            [[pixel[i] for i in rng.permutation(len(pixel))] for pixel in LAYERS],
        )
    )
    for other in others:
        moved = off(other, first.color, first.transmittance)
        assert moved.max() <= (MOMENTS if technique in CONFORMS else SUMS)


@every_technique
def test_a_thousand_layers_of_one_color(technique: str, backend: Any) -> None:
    rgb = (0.7, 0.5, 0.3)
    pixel: Pixel = [(1 + i % 97 * 0.08, rgb, (1e-3, 0.0, 5e-3)[i % 3], i) for i in range(1000)]
    fragments = fragments_of([pixel])
    frame = oitlab.render(fragments, technique, backend=backend)
    assert np.isfinite(frame.color).all()
    if oitlab.techniques()[technique].properties["exact_for_one_color"]:
        assert off(frame, *exact(fragments)).max() <= 1000 * 2 * F32


@every_technique
def test_numbers_at_the_ends_of_single_precision_stay_numbers(technique: str, backend: Any) -> None:
    tiny, largest = 2.0**-128, float(np.finfo(np.float32).max)
    depths, shades = [0.0, tiny, 1.0, largest], [0.0, tiny, 1.0, largest]
    alphas = [0.0, tiny, 0.5, 1 - 2.0**-24, 1.0]
    last = 2**32 - 1
    pixels: list[Pixel] = []
    for i in range(4):
        for j in range(5):
            shade = [tuple(shades[(i + j * n + c) % 4] for c in range(3)) for n in range(3)]
            pixels.append(
                [
                    (depths[i], shade[0], alphas[j], 0),  # type: ignore[list-item]
                    (depths[(i + j) % 4], shade[1], alphas[(i + 1) % 5], last),  # type: ignore[list-item]
                    (depths[(i + 2 * j) % 4], shade[2], alphas[(i + 2) % 5], 7),  # type: ignore[list-item]
                ]
            )
    frame = oitlab.render(fragments_of(pixels), technique, backend=backend)
    assert np.isfinite(frame.color).all()
    assert np.isfinite(frame.transmittance).all()


def values_of(param: oitlab.ParamInfo) -> list[Any]:
    """Give values worth trying, some of which it may refuse; test_gpu_formats.py has narrow formats."""
    words: list[Any] = re.findall(r'"([^"]+)"', param.range)
    if "format" in param.name:
        return ["f32", "f64"]
    if "bool" in param.type:
        return [False, True]
    if "callable" in param.type:
        words = words[:2]  # a pipeline each; all published weights are in test_gpu_formats.py
        words.append(f"1.0 / (1.0 + {0} * {0})".format("z" if param.name == "weight" else "x"))
    if "z_lo" in param.type:
        words += [(2.0, 6.0), (0.5, 20.0)]
    if "float" in param.type:
        words += [-5.0, 0.0, 1e-3, 0.25, 2.5, 60.0]
    if "int" in param.type:
        listed = re.findall(r"\d+", param.range) if param.range.startswith("one of") else [0, 1, 3, 8, 33]
        words += map(int, listed)
    return words


NEARLY_ALL = 0.95
"""Pixels of a crowd in which rounding decides nothing, or that have no moments to solve for that are hard."""
CROWD = fragments_of([random_pixel(n, 100 * n + seed) for n in (1, 3, 8, 24) for seed in range(12)])


@functools.cache
def variants_of(technique: str) -> list[dict[str, Any]]:
    """Change one param at a time, as far as the CPU takes it and it changes anything."""
    found: list[dict[str, Any]] = []
    for param in oitlab.techniques()[technique].params:
        for value in values_of(param):
            try:
                refusal(CROWD, technique, {param.name: value}, "cpu")
            except (ValueError, MemoryError):
                continue
            found.append({param.name: value})
    assert len(found) >= 2
    return found


def taken(technique: str) -> Iterator[dict[str, Any]]:
    """Give those that the device has a form of."""
    for params in variants_of(technique):
        reason = refusal(CROWD, technique, params, "gpu")
        if not reason:
            yield params
            continue
        (name,) = params
        # refusals name the param and say where the value would do
        assert name in reason or (name.endswith("_format") and "format" in reason), reason


@pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)
@every_technique
def test_under_every_param_a_device_does_what_the_cpu_does(technique: str) -> None:
    wanted = [(technique, params) for params in taken(technique)]
    got, expected = (oitlab.render_many(CROWD, wanted, backend=backend) for backend in ("gpu", "cpu"))
    for (_, params), ours, theirs in zip(wanted, got, expected, strict=True):
        distance = off(ours, theirs.color, theirs.transmittance)
        most, worst, share = bounds(technique, params)
        assert distance.max() <= worst, (params, distance.max())
        assert (distance <= most).mean() >= share, (params, np.sort(distance.ravel()))


def bounds(technique: str, params: dict[str, Any]) -> tuple[float, float, float]:
    """Give what nearly all pixels are within, what all are within, and how many nearly all are."""
    rounding = (24 + ROUNDINGS) * 2 * F32
    if params.get("wrapping_zone", 1.0) <= 0.01:
        return CONFORMS[technique][1], 1.0, NEARLY_ALL  # the range's far end is on the step at its near end
    if technique in CONFORMS:
        return *CONFORMS[technique], NEARLY_ALL
    return (rounding, 1.0, NEARLY_ALL) if technique in DECIDING else (rounding, rounding, 1.0)
