"""Techniques for the tests of custom ones that other processes can import, and what they are made of."""

from typing import Any

import numba
import numpy as np

import oitlab

OVER_PROMISES = {
    "unbiased": True,
    "consistent": True,
    "exact_for_one": True,
    "exact_for_one_color": True,
    "exact_coverage": True,
}


def numpy_over(batch: oitlab.Batch) -> tuple[Any, Any]:
    """`over`, one layer of all pixels at a time."""
    color, share = np.zeros((len(batch), 3)), np.ones(len(batch))
    for k in range(batch.counts.max()):
        pixels = np.flatnonzero(batch.counts > k)
        place = batch.offsets[pixels] + k
        color[pixels] += share[pixels, np.newaxis] * batch.color[place]
        share[pixels] *= 1 - batch.alpha[place].astype(float)
    return color + share[:, np.newaxis] * batch.background, share


@numba.njit(nogil=True)
def over_kernel(offsets: Any, depth: Any, color: Any, alpha: Any, background: Any, out: Any) -> None:
    for p in range(len(offsets) - 1):
        share = 1.0
        for i in range(offsets[p], offsets[p + 1]):
            for c in range(3):
                out[p, c] += share * color[i, c]
            share *= 1.0 - alpha[i]
        for c in range(3):
            out[p, c] += share * background[p, c]
        out[p, 3] = share


def numba_over(batch: oitlab.Batch) -> tuple[Any, Any]:
    """`over`, one pixel after the other."""
    out = np.zeros((len(batch), 4))
    over_kernel(batch.offsets, batch.depth, batch.color, batch.alpha, batch.background, out)
    return out[:, :3], out[:, 3]


@numba.njit
def mlab_kernel(
    offsets: Any, depth: Any, color: Any, alpha: Any, background: Any, layers: int, out: Any
) -> None:
    nodes = np.empty((layers + 1, 5))  # depth, premultiplied colour, transmittance
    for p in range(len(offsets) - 1):
        held = 0
        for i in range(offsets[p], offsets[p + 1]):
            place = held
            while place > 0 and nodes[place - 1, 0] > depth[i]:
                nodes[place] = nodes[place - 1]
                place -= 1
            nodes[place, 0] = depth[i]
            nodes[place, 1:4] = color[i]
            nodes[place, 4] = 1.0 - alpha[i]
            held += 1
            if held > layers:
                held = layers
                nodes[held - 1, 1:4] += nodes[held - 1, 4] * nodes[held, 1:4]
                nodes[held - 1, 4] *= nodes[held, 4]
        share = 1.0
        for n in range(held):
            out[p, :3] += share * nodes[n, 1:4]
            share *= nodes[n, 4]
        out[p, :3] += share * background[p]
        out[p, 3] = share


def own_mlab(batch: oitlab.Batch, *, layers: int = 4) -> tuple[Any, Any]:
    """Multi-layer alpha blending: k layers, the furthest two of which merge."""
    out = np.zeros((len(batch), 4))
    lists = batch.offsets, batch.depth, batch.color, batch.alpha
    mlab_kernel(*lists, batch.background, layers, out)
    return out[:, :3], out[:, 3]


def over_curve(batch: oitlab.Batch, depths: Any) -> Any:
    """The product of 1 - alpha in front of each depth."""
    in_front = batch.depth < depths[:, np.newaxis]
    return np.where(in_front, 1 - batch.alpha.astype(float), 1.0).prod(axis=1)


def registered() -> list[str]:
    """Register all of them."""
    over = {**OVER_PROMISES, "transmittance": over_curve, "geometry_passes": 1}
    oitlab.technique(**over)(numpy_over)
    oitlab.technique(**over, bytes_per_pixel=lambda params, mean, largest: 28 * mean + 4)(numba_over)
    oitlab.technique(order="submission", consistent=True, exact_for_one=True, exact_coverage=True)(own_mlab)
    return ["numpy_over", "numba_over", "own_mlab"]
