"""A clean registry for every test, and fragments of every sort."""

from collections.abc import Iterator

import numpy as np
import pytest

import _custom_examples as examples
import oitlab
from oitlab import custom


@pytest.fixture(autouse=True)
def _clean_registry() -> Iterator[None]:
    with custom.temporary():
        yield


@pytest.fixture
def mine() -> list[str]:
    return examples.registered()


@pytest.fixture(scope="module")
def fragments() -> oitlab.Fragments:
    """5 x 4 pixels of random layers, one of them without any, ties in depth, emission, and zero fragments."""
    generator = np.random.default_rng(7)
    counts = generator.integers(1, 12, 20)
    counts[3] = 0
    n = counts.sum()
    alpha = generator.random(n, np.float32)
    alpha[::5] = 0
    alpha[np.cumsum(counts) - 1] = 0.75  # no other pixel is empty
    color = (generator.random((n, 3), np.float32) * alpha[:, np.newaxis]).astype(np.float32)
    color[5] = 0.5
    return oitlab.Fragments(
        width=5,
        height=4,
        offsets=np.cumsum([0, *counts]),
        depth=generator.choice(np.linspace(1, 9, 12), n),
        color=color,
        alpha=alpha,
        background=(0.25, 0.5, 0.75),
    )
