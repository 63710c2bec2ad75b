"""A technique's transmittance function and its dependence on order, through the package."""

import numpy as np
import pytest

import oitlab


@pytest.fixture(scope="module")
def fragments() -> oitlab.Fragments:
    return oitlab.capture(oitlab.scenes.blades(seed=3, width=48, height=27, count=80))


def deepest(fragments: oitlab.Fragments) -> tuple[int, int]:
    y, x = np.unravel_index(int(fragments.counts.argmax()), fragments.counts.shape)
    return int(x), int(y)


def test_the_exact_function_is_the_product_over_nearer_fragments(fragments: oitlab.Fragments) -> None:
    pixel = deepest(fragments)
    curve = oitlab.transmittance(fragments, "a_buffer", pixel=pixel)
    inside = fragments.pixel(*pixel)
    for depth, exact in zip(curve.depths, curve.exact, strict=True):
        nearer = inside["depth"] < depth
        assert exact == pytest.approx(np.prod(1 - inside["alpha"][nearer].astype(float)), rel=1e-12)
    np.testing.assert_allclose(curve.reconstructed, curve.exact, rtol=1e-12)


def test_default_depths_show_both_sides_of_every_step(fragments: oitlab.Fragments) -> None:
    pixel = deepest(fragments)
    curve = oitlab.transmittance(fragments, "a_buffer", pixel=pixel)
    steps = len(np.unique(curve.exact))
    assert steps == len(np.unique(fragments.pixel(*pixel)["depth"])) + 1


def test_an_empty_pixel_is_clear() -> None:
    empty = oitlab.Fragments(
        width=1, height=1, offsets=[0, 0], depth=[], alpha=[], color=np.zeros((0, 3)), background=(0, 0, 0)
    )
    curve = oitlab.transmittance(empty, "a_buffer", pixel=(0, 0), depths=[1.0])
    assert curve.exact.tolist() == curve.reconstructed.tolist() == [1.0]


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"pixel": (48, 0)}, "pixel"),
        ({"pixel": (0, -1)}, "pixel"),
        ({"pixel": (0, 0), "depths": [1.0, np.nan]}, "entry 1"),
        ({"pixel": (0, 0), "depths": [-1.0]}, "depths"),
        ({"pixel": (0, 0), "technique": "weighted_sum"}, "weighted_sum"),
        ({"pixel": (0, 0), "params": {"bins": 3}}, "bins"),
    ],
)
def test_bad_arguments_are_named(
    fragments: oitlab.Fragments, arguments: dict[str, object], culprit: str
) -> None:
    technique = str(arguments.pop("technique", "a_buffer"))
    with pytest.raises(ValueError, match=culprit):
        oitlab.transmittance(fragments, technique, **arguments)  # type: ignore[arg-type]


# sums over a few dozen fragments in f32: the square of 2e-6 with room
ROUNDING_VARIANCE = 1e-11
# reconstruction from moments amplifies the rounding of their f32 sums: conformance is 2e-3 (sheet 2.5)
AMPLIFIED = {"mboit_power": 4e-6, "mboit_trig": 4e-6}


@pytest.mark.parametrize("entry", list(oitlab.techniques()), ids=lambda entry: entry.id)
def test_claims_about_order_are_true(entry: oitlab.TechniqueInfo, fragments: oitlab.Fragments) -> None:
    if entry.id == "painter":
        with pytest.raises(ValueError, match="order of its own"):
            oitlab.order_sensitivity(fragments, "painter")
        return
    largest = oitlab.order_sensitivity(fragments, entry.id, n=6).max()
    if entry.properties["order_independent"]:
        assert largest < AMPLIFIED.get(entry.id, ROUNDING_VARIANCE)
    else:
        assert largest > 1e-6


def test_order_sensitivity_refuses_what_it_cannot_do(fragments: oitlab.Fragments) -> None:
    for arguments in ({"n": 1}, {"n": 5000}, {"params": {"submission_order": "sorted"}}):
        with pytest.raises(ValueError, match=r"n: |submission_order"):
            oitlab.order_sensitivity(fragments, "wboit", **arguments)


def test_order_sensitivity_is_reproducible(fragments: oitlab.Fragments) -> None:
    first, second = (oitlab.order_sensitivity(fragments, "alpha_compositing", n=3, seed=5) for _ in "ab")
    assert np.array_equal(first, second)
    other = oitlab.order_sensitivity(fragments, "alpha_compositing", n=3, seed=6)
    assert not np.array_equal(first, other)
