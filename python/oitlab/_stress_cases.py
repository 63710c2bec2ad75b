"""The stress lab's battery: named stacks of layers, each of which is hard on one kind of number.

A case is one row of pixels; each pixel has the first so many layers of one endless stack, so that errors can
be followed as the stack grows.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .fragments import Fragments

_Floats: TypeAlias = NDArray[np.float64]
_Stack: TypeAlias = tuple[_Floats, _Floats, _Floats]
"""Depths (n,), unmultiplied colours (n, 3) and alphas (n,), in order of submission."""

BACKGROUND = (0.25, 0.5, 0.75)
SHALLOW = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
DEEP = (*SHALLOW, 2000, 5000, 10_000, 20_000, 50_000, 100_000)


@dataclass(frozen=True)
class Case:
    """A stack of layers under a name."""

    name: str
    doc: str
    stack: Callable[[np.random.Generator, int], _Stack]
    layers: tuple[int, ...] = SHALLOW
    near: float = 0.1
    far: float = 100.0
    params: Mapping[str, Any] = field(default_factory=dict)
    """What it asks for where a technique has such a parameter; the caller's own win."""
    needs: tuple[str, ...] = ()
    """Parameters without which the case says nothing about a technique."""
    emits: bool = False
    """Whether colours are those of emission, not multiplied by alpha."""

    def fragments(self, seed: int) -> Fragments:
        """Make the row of pixels; the same for the same seed."""
        draw = np.random.default_rng([seed, zlib.crc32(self.name.encode())])
        depth, rgb, alpha = self.stack(draw, max(self.layers))
        color = rgb if self.emits else rgb * alpha[:, None]
        prefix = np.concatenate([np.arange(n) for n in self.layers])
        return Fragments(
            width=len(self.layers),
            height=1,
            offsets=np.concatenate([[0], np.cumsum(self.layers)]),
            depth=depth[prefix].astype(np.float32),
            color=color[prefix].astype(np.float32),
            alpha=alpha[prefix].astype(np.float32),
            primitive=prefix,
            background=BACKGROUND,
            near=self.near,
            far=self.far,
        )


def _colors(draw: np.random.Generator, n: int) -> _Floats:
    return draw.random((n, 3))


def _uniform(alpha: float, *, near: float = 1.0, far: float = 50.0) -> Callable[..., _Stack]:
    """Layers of one alpha, of random colours and depths."""

    def stack(draw: np.random.Generator, n: int) -> _Stack:
        return draw.uniform(near, far, n), _colors(draw, n), np.full(n, alpha)

    return stack


def _mixed_alphas(draw: np.random.Generator, n: int) -> _Stack:
    cycle = np.array([0.0, 1e-7, 0.5, 1e-3, 0.25])
    return draw.uniform(1.0, 50.0, n), _colors(draw, n), cycle[np.arange(n) % len(cycle)]


def _emission(draw: np.random.Generator, n: int) -> _Stack:
    alpha = np.where(np.arange(n) % 2 == 0, 0.25, 0.0)
    return draw.uniform(1.0, 50.0, n), 0.01 * _colors(draw, n), alpha


def _log_depths(low: float, high: float, alpha: float = 0.1) -> Callable[..., _Stack]:
    def stack(draw: np.random.Generator, n: int) -> _Stack:
        depth = np.exp(draw.uniform(np.log(low), np.log(high), n))
        depth[:2] = [high, low][: min(n, 2)]
        return np.clip(depth, low, high), _colors(draw, n), np.full(n, alpha)

    return stack


def _clusters(draw: np.random.Generator, n: int) -> _Stack:
    """Three clusters as tight as float32 can tell apart, with gaps of a thousand times their distance."""
    center = np.array([1.0, 1e3, 1e6])[np.arange(n) % 3]
    return center * (1.0 + 1e-6 * draw.integers(0, 8, n)), _colors(draw, n), np.full(n, 0.2)


def _equal_depths(draw: np.random.Generator, n: int) -> _Stack:
    return np.full(n, 5.0), _colors(draw, n), np.full(n, 0.1)


def _hdr(brightness: float) -> Callable[..., _Stack]:
    def stack(draw: np.random.Generator, n: int) -> _Stack:
        return draw.uniform(1.0, 50.0, n), brightness * (0.5 + 0.5 * _colors(draw, n)), np.full(n, 0.2)

    return stack


def _firefly(draw: np.random.Generator, n: int) -> _Stack:
    """One layer in a hundred, the first among them, is a million times as bright as the others."""
    depth, color, alpha = draw.uniform(1.0, 50.0, n), _colors(draw, n), np.full(n, 0.1)
    color[::100] *= 6e4
    color[1::2] *= 0.06
    return depth, color, alpha


def _at(*depths: float, alpha: float = 0.5) -> Callable[..., _Stack]:
    """Layers at these depths in turn."""

    def stack(draw: np.random.Generator, n: int) -> _Stack:
        return np.array(depths)[np.arange(n) % len(depths)], _colors(draw, n), np.full(n, alpha)

    return stack


def _plain(depth: float, color: tuple[float, float, float], alpha: float) -> Callable[..., _Stack]:
    """Equal layers."""

    def stack(_: np.random.Generator, n: int) -> _Stack:
        return np.full(n, depth), np.tile(color, (n, 1)), np.full(n, alpha)

    return stack


def _large_first(draw: np.random.Generator, n: int) -> _Stack:
    """Fifty dense layers, then faint ones: what a sum is large for when they come."""
    alpha = np.where(np.arange(n) < 50, 0.9, 1e-3)
    return draw.uniform(1.0, 50.0, n), _colors(draw, n), alpha


def _ramp(draw: np.random.Generator, n: int) -> _Stack:
    """Front to back, colours from dark to bright: order matters as much as it can."""
    place = np.arange(n) / max(n - 1, 1)
    color = place[:, None] * np.ones(3)
    return 1.0 + 49.0 * place, color, draw.uniform(0.05, 0.3, n)


def _order(order: str) -> Case:
    return Case(
        f"order_{order}",
        f'a ramp of colours, handed over with submission_order="{order}"',
        _ramp,
        params={"submission_order": order},
        needs=("submission_order",),
    )


CASES: tuple[Case, ...] = (
    Case("layers_faint", "alpha 0.002, up to 100,000 layers", _uniform(0.002), DEEP),
    Case("layers_thin", "alpha 0.1, up to 100,000 layers", _uniform(0.1), DEEP),
    Case("layers_dense", "alpha 0.9, up to 100,000 layers", _uniform(0.9), DEEP),
    Case("alpha_1e-7", "alpha 1e-7", _uniform(1e-7), (1, 10, 100, 1000, 10_000)),
    Case("alpha_1-1e-7", "alpha 1 - 1e-7 (as float32: 1 - 2^-23)", _uniform(1.0 - 2.0**-23)),
    Case("alpha_0_emits", "every other layer emits without covering", _emission, emits=True),
    Case("alpha_1", "opaque layers", _uniform(1.0)),
    Case("alpha_mixed", "alpha 0, 1e-7, 0.5, 1e-3, 0.25 in turn", _mixed_alphas),
    Case("depth_wide", "depths 1e-3 to 1e7", _log_depths(1e-3, 1e7), near=1e-3, far=1e7),
    Case("depth_clusters", "three clusters 1e-6 wide at 1, 1e3 and 1e6", _clusters, near=0.5, far=2e6),
    Case("depth_equal", "all layers at one depth", _equal_depths),
    Case("near_far_1e8", "near 1e-3, far 1e5, depths between", _log_depths(1e-3, 1e5), near=1e-3, far=1e5),
    Case("hdr_6e4", "colours up to 6e4", _hdr(6e4)),
    Case("hdr_1e6", "colours up to 1e6, beyond every half", _hdr(1e6)),
    Case("hdr_firefly", "one layer of 6e4 among a hundred of 0.06", _firefly),
    Case("weight_upper", "depth 0.1, where MB13's weights are clamped to 3e3", _at(0.1)),
    Case("weight_lower", "depth 500, where MB13's weights are clamped to 1e-2", _at(500.0), far=1000.0),
    Case("weight_both", "depths 0.1 and 500 in turn", _at(0.1, 500.0), far=1000.0),
    Case("order_large_first", "fifty dense layers, then faint ones", _large_first),
    *map(_order, ("reversed", "back_to_front", "sorted", "shuffled")),
    Case(
        "mb13_overflow",
        "MB13 section 3.2: 16-bit sums overflow after about 20 opaque layers at the upper clamp (21.8)",
        _plain(0.1, (0.9, 0.5, 0.1), 1.0),
        (1, 5, 10, 20, 21, 22, 23, 30, 50, 100),
    ),
    Case(
        "mb13_underflow",
        "MB13 section 3.2: without range clamping what is faint and far turns dark",
        _plain(60.0, (0.1, 0.5, 0.1), 0.9),
        (1, 2, 5, 10, 20, 50),
        params={"weight": "inv_pow"},
    ),
    Case(
        "mb13_revealage",
        "alpha 1/511: 8 bits of revealage round it away, however many layers there are",
        _plain(1.0, (0.9, 0.5, 0.1), 1.0 / 511.0),
        (1, 10, 100, 1000, 10_000),
    ),
    Case(
        "mb13_listing3",
        "MB13 Listing 3 as printed divides by no less than 1e-4: faint layers at the lower clamp turn dark",
        _plain(200.0, (0.9, 0.5, 0.1), 0.001),
        (1, 2, 5, 10, 20, 50, 100),
        far=1000.0,
        params={"listing3_clamp": True},
        needs=("listing3_clamp",),
    ),
)
"""The battery, in the table's order."""
