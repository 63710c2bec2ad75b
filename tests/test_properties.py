"""What holds for every technique, every backend and every valid fragment list, on lists of hypothesis."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import oitlab
from backends import render
from oitlab import Fragments

TECHNIQUES = oitlab.techniques()
MEANS = [entry.id for entry in TECHNIQUES if entry.properties["exact_for_one_color"]]
BACKGROUND = (0.25, 0.5, 0.75)
SIZE = {"width": 2, "height": 1, "background": BACKGROUND, "depth_range": (1.0, 9.0)}
HULL = 1e-5
"""How far a mean of float32 sums may leave its colours' hull, relative to the largest of them."""
SEES_ZERO_FRAGMENTS = {"weighted_average"}

quick = settings(max_examples=40, derandomize=True, deadline=None, database=None)
EXAMPLES = {"cpu": quick.max_examples, "gpu": 8}
"""For each example a device gets a job per technique, however few pixels there are."""
unit = st.floats(0, 1, width=32)
depths = st.one_of(st.sampled_from([0.0, 1.0, 2.5, 2.5000002, 9.0]), st.floats(0, 100, width=32))
alphas = st.one_of(st.sampled_from([0.0, 1e-7, 1.0]), unit)
channels = st.one_of(st.sampled_from([0.0, 1.0, 6e4]), unit)
# depth, unmultiplied colour, alpha, primitive, whether it emits if it covers nothing
layers = st.tuples(depths, st.tuples(channels, channels, channels), alphas, st.integers(0, 9), st.booleans())
pixels = st.lists(st.lists(layers, max_size=12), min_size=2, max_size=2)


def for_all(backend: str, *strategies: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], None]:
    """Check what follows on examples of the strategies."""

    def run(check: Callable[..., None]) -> None:
        settings(quick, max_examples=EXAMPLES[backend])(given(*strategies)(check))()

    return run


def made_of(scene: list[list[Any]]) -> Fragments:
    """Fragments of the two pixels of layers."""
    every = [layer for pixel in scene for layer in pixel]
    share = [alpha if alpha else float(emits) for _, _, alpha, _, emits in every]
    color = [np.float32(rgb) * np.float32(s) for (_, rgb, *_), s in zip(every, share, strict=True)]
    return Fragments(
        offsets=np.cumsum([0, *map(len, scene)]),
        depth=np.array([layer[0] for layer in every], np.float32),
        color=np.array(color, np.float32).reshape(-1, 3),
        alpha=np.array([layer[2] for layer in every], np.float32),
        primitive=np.array([layer[3] for layer in every], np.uint32),
        **SIZE,
    )


def images(fragments: Fragments, names: list[str], backend: Any = "cpu") -> list[tuple[str, oitlab.Frame]]:
    return list(zip(names, oitlab.render_many(fragments, names, backend=backend), strict=True))


def check_finite(fragments: Fragments, names: list[str], backend: Any = "cpu") -> None:
    for name, frame in images(fragments, names, backend):
        assert np.isfinite(frame.color).all(), name
        assert np.isfinite(frame.transmittance).all(), name


def check_hull(scene: list[list[Any]], names: list[str], backend: Any = "cpu") -> None:
    """Means stay inside the hull of the colours."""
    # no emission without coverage, and a primitive of its own for each fragment
    plain = [
        [(z, rgb, alpha, place, False) for place, (z, rgb, alpha, *_) in enumerate(pixel)] for pixel in scene
    ]
    fragments = made_of(plain)
    for name, frame in images(fragments, names, backend):
        for x in range(2):
            pixel = fragments.pixel(x, 0)
            covers = pixel["alpha"] > 0
            colors = pixel["color"][covers] / pixel["alpha"][covers, np.newaxis]
            every = np.vstack([colors, np.float32([BACKGROUND])])
            slack = HULL * max(1.0, every.max())
            assert (every.min(0) - slack <= frame.color[0, x]).all(), name
            assert (frame.color[0, x] <= every.max(0) + slack).all(), name


def test_every_image_is_finite(backend: str) -> None:
    @for_all(backend, pixels)
    def check(scene: list[list[Any]]) -> None:
        check_finite(made_of(scene), list(TECHNIQUES.ids), backend)


def test_means_stay_inside_the_hull_of_the_colors(backend: str) -> None:
    @for_all(backend, pixels)
    def check(scene: list[list[Any]]) -> None:
        check_hull(scene, MEANS, backend)


def test_zero_fragments_do_nothing(backend: str) -> None:
    names = [name for name in TECHNIQUES.ids if name not in SEES_ZERO_FRAGMENTS]

    @for_all(backend, pixels, st.integers(0, 1), st.integers(0, 12), depths)
    def check(scene: list[list[Any]], x: int, place: int, depth: float) -> None:
        more = [list(pixel) for pixel in scene]
        more[x].insert(place, (depth, (0.0, 0.0, 0.0), 0.0, 99, False))
        pairs = zip(
            images(made_of(scene), names, backend), images(made_of(more), names, backend), strict=True
        )
        for (name, without), (_, with_zero) in pairs:
            np.testing.assert_array_equal(without.color, with_zero.color, name)
            np.testing.assert_array_equal(without.transmittance, with_zero.transmittance, name)


@pytest.mark.parametrize(
    ("technique", "params"),
    [("weighted_average", {}), ("hybrid_transparency", {"layers": 1, "tail": "count"})],
)
def test_two_techniques_count_zero_fragments(backend: str, technique: str, params: dict[str, Any]) -> None:
    layer = (2.0, (1.0, 0.5, 0.0), 0.5, 0, False)
    zero = (1.0, (0.0, 0.0, 0.0), 0.0, 1, False)
    behind = (3.0, (0.0, 0.5, 1.0), 0.25, 2, False)
    without = render(made_of([[layer, behind], []]), technique, params, backend=backend)
    with_zero = render(made_of([[zero, layer, behind], []]), technique, params, backend=backend)
    assert not np.array_equal(without.color, with_zero.color)
