"""Combinations of Wyman's axes that nobody has published, beside their nearest published neighbours.

Table 1 of W16 [Wyman2016] has holes; the technique `continuum` runs them. Every group below has techniques of
the literature and holes that differ from them in one or two axes, all with room for four layers (four bins,
eight samples). The error is the RMSE of linear RGB against the exact image; that of random techniques is the
root of the mean over seeds.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _study import BLACK, BLUE, GREEN, GREY, ORANGE, RED, SKY, Study, markdown_table, plot_style, three_digits

import oitlab

SCENES = ("squares", "soup", "shells", "smoke", "blades")
SCENE_COLORS = dict(zip(SCENES, (GREY, BLUE, GREEN, RED, ORANGE), strict=True))
LAYERS = 4
BINS = 4
TINY = 1e-4
"""An RMSE from here on down is not worth a ratio."""


@dataclass(frozen=True)
class Entry:
    """One technique with params, and whether draws change its image."""

    label: str
    technique: str
    params: Mapping[str, Any]
    random: bool = False


def published(label: str, technique: str, *, random: bool = False, **params: Any) -> Entry:
    """Name a technique of the literature."""
    return Entry(label, technique, params, random)


def hole(merge: str, *, memory: str = "layers", **params: Any) -> Entry:
    """Name a combination of axes: where not given, layers / always / none / alpha / stored."""
    room = {"layers": {"layers": LAYERS}, "bins": {"bins": BINS}}.get(memory, {})
    random = "coverage" in params.values() or "stochastic" in params.values()
    named = [
        f"{n}={v}" if n == "weight" else "second pass" if n == "accumulate" else v for n, v in params.items()
    ]
    axes = {"memory": memory, "merge": merge, **params, **room}
    return Entry(", ".join([merge, *named]), "continuum", axes, random)


MLAB = published("mlab", "mlab", layers=LAYERS)
Z3 = published("z3", "z3", layers=LAYERS)
K_BUFFER = published("k_buffer", "k_buffer", layers=LAYERS)
MLCB = published("mlcb", "mlcb", layers=LAYERS, random=True)
HYBRID = published("hybrid_transparency", "hybrid_transparency", layers=LAYERS)
ADAPTIVE = published(
    "adaptive_transparency, normalised", "adaptive_transparency", layers=LAYERS, composite="normalize"
)
SLAB = published("slab, stored", "slab", layers=LAYERS, accumulate="stored", correction="none", random=True)
SECOND_PASS = {"accumulate": "all", "normalize": "global"}
SMALLEST_ERROR = hole("smallest_error")
WEIGHTED_TAIL = hole("discard_furthest", normalize="tail", weight="smoke6")

GROUPS: dict[str, tuple[list[Entry], list[Entry]]] = {
    "A tail with a depth weight": (
        [HYBRID, published("wboit", "wboit")],
        [
            *(
                hole("discard_furthest", normalize="tail", weight=w)
                for w in ("mb7", "mb9", "mb10", "inv_pow", "i3d16")
            ),
            WEIGHTED_TAIL,
        ],
    ),
    "Adaptive transparency's merge in one pass": ([MLAB, Z3, ADAPTIVE], [SMALLEST_ERROR]),
    "Other merges of masks": (
        [MLCB, Z3, K_BUFFER],
        [
            *(
                hole(merge, opacity="coverage")
                for merge in ("over_closest", "over_nearest", "smallest_error")
            ),
            hole("discard_furthest", normalize="tail", opacity="coverage"),
        ],
    ),
    "Stochastic insertion that merges": (
        [MLAB, Z3, SLAB],
        [
            hole(merge, insertion="stochastic")
            for merge in ("over_furthest", "over_closest", "smallest_error")
        ],
    ),
    "A second pass through merged layers": (
        [MLAB, Z3, ADAPTIVE],
        [hole("over_furthest", **SECOND_PASS), hole("over_closest", **SECOND_PASS)],
    ),
    "Buckets that make good what they discard": (
        [
            published(
                "multilayer_depth_peeling, bucket", "multilayer_depth_peeling", mode="bucket", layers=BINS
            ),
            published("lwboit", "lwboit", bins=BINS),
        ],
        [
            hole("discard_occupied", memory="bins", normalize="tail"),
            hole("discard_occupied", memory="bins", normalize="global"),
            hole("discard_occupied", memory="bins", **SECOND_PASS),
        ],
    ),
    "A screen door that is normalised": (
        [
            published("screen_door", "screen_door"),
            published("stochastic_transparency", "stochastic_transparency", random=True),
        ],
        [
            hole("discard_occluded", memory="samples", normalize="global", opacity="coverage"),
            hole("discard_occluded", memory="samples", **SECOND_PASS, opacity="coverage"),
        ],
    ),
}
SIZES = (1, 2, 4, 8, 16)
SWEPT = ((MLAB, BLACK, "-"), (SMALLEST_ERROR, BLUE, "-"), (HYBRID, GREY, "--"), (WEIGHTED_TAIL, ORANGE, "--"),
         (ADAPTIVE, SKY, ":"))  # fmt: skip


def main() -> None:
    """Measure, plot, write the table."""
    study = Study.from_command_line("continuum_holes", __doc__)
    size, seeds = ((96, 54), 2) if study.quick else ((480, 270), 4)
    bench = Bench(*size, seeds)
    groups = []
    for title, (known, holes) in GROUPS.items():
        neighbours, found = [list(map(bench.measure, entries)) for entries in (known, holes)]
        best = {name: min(row["rmse"][name] for row in neighbours) for name in SCENES}
        for row in [*neighbours, *found]:
            row["ratio"] = {n: row["rmse"][n] / best[n] for n in SCENES if best[n] > TINY}
        groups.append({"group": title, "published": neighbours, "holes": found})
        print(title, file=sys.stderr)
    sweeps = [bench.sweep(entry) for entry, *_ in SWEPT]
    plot_style()
    study.save_figure(_ratios(groups), "ratios.png")
    study.save_figure(_sweeps(sweeps), "layers.png")
    results = {
        "size": size,
        "seeds": seeds,
        "layers": LAYERS,
        "bins": BINS,
        "groups": groups,
        "sweeps": sweeps,
    }
    study.save(results, _markdown(groups))


class Bench:
    """The scenes' fragments with their exact images."""

    def __init__(self, width: int, height: int, seeds: int) -> None:
        make = oitlab.scenes.SCENES
        self.seeds = seeds
        self.fragments = {name: oitlab.capture(make[name](width=width, height=height)) for name in SCENES}
        self.exact = {name: oitlab.render(kept, "a_buffer") for name, kept in self.fragments.items()}

    def measure(self, entry: Entry, **changes: Any) -> dict[str, Any]:
        """Give the RMSE on every scene, and the cost on soup."""
        params = {**entry.params, **changes}
        costs = oitlab.techniques()[entry.technique].cost(
            params,
            depth_complexity_mean=self.exact["soup"].stats.depth_complexity_mean,
            depth_complexity_max=self.exact["soup"].stats.depth_complexity_max,
        )
        return {
            "label": entry.label,
            "technique": entry.technique,
            "params": params,
            "rmse": {name: self._rmse(name, entry, params) for name in SCENES},
            "bytes_per_pixel": costs.bytes_per_pixel,
            "geometry_passes": costs.geometry_passes,
        }

    def sweep(self, entry: Entry) -> dict[str, Any]:
        """Give the RMSE on every scene for growing k."""
        rows = [self.measure(entry, layers=layers)["rmse"] for layers in SIZES]
        return {"label": entry.label, "layers": SIZES, "rmse": {n: [row[n] for row in rows] for n in SCENES}}

    def _rmse(self, name: str, entry: Entry, params: dict[str, Any]) -> float:
        squares = [
            oitlab.compare(
                oitlab.render(self.fragments[name], entry.technique, {**params, "seed": seed}),
                self.exact[name],
                metrics="mse",
            )["mse"]
            for seed in range(self.seeds if entry.random else 1)
        ]
        return math.sqrt(float(np.mean(squares)))


def _markdown(groups: list[dict[str, Any]]) -> str:
    header = ["RMSE", *SCENES, "to the best published", "bytes/pixel", "passes"]
    rows: list[list[str]] = []
    for group in groups:
        rows.append([f"*{group['group']}*", *[""] * (len(header) - 1)])
        rows += [_line(row, f"`{row['label']}`") for row in group["published"]]
        rows += [_line(row, f"**{row['label']}**") for row in group["holes"]]
    note = (
        'Bold: holes. "To the best published": geometric mean over the scenes of the RMSE divided by the '
        f"smallest of the group's published ones; scenes where that is {TINY:g} or less left out."
    )
    return f"{markdown_table(header, rows)}\n\n{note}"


def _line(row: dict[str, Any], name: str) -> list[str]:
    errors = ["< 0.0001" if row["rmse"][n] <= TINY else f"{row['rmse'][n]:.4f}" for n in SCENES]
    memory = three_digits(row["bytes_per_pixel"]).removesuffix(".00").removesuffix(".0")
    return [name, *errors, f"{_mean(row['ratio']):.2f}", memory, f"{row['geometry_passes']:g}"]


def _mean(ratio: dict[str, float]) -> float:
    return math.exp(float(np.mean(np.log(list(ratio.values())))))


def _ratios(groups: list[dict[str, Any]]) -> Any:
    """Draw each hole's error over that of its best published neighbour, a dot per scene."""
    lines = [(group["group"], row) for group in groups for row in group["holes"]]
    figure, place = plt.subplots(figsize=(7.2, 0.6 + 0.22 * (len(lines) + len(groups))))
    y, ticks, last = 0.0, [], ""
    for title, row in lines:
        if title != last:
            y, last = y - 1.0, title
            place.text(
                0.0, y, title, transform=place.get_yaxis_transform(), weight="bold", va="center", fontsize=7
            )
        y -= 1.0
        ticks.append((y, row["label"]))
        for name, ratio in row["ratio"].items():
            place.plot(ratio, y, "o", ms=4, color=SCENE_COLORS[name])
        place.plot(_mean(row["ratio"]), y, "|", ms=11, mew=1.6, color=BLACK)
    for name, color in SCENE_COLORS.items():
        place.plot([], [], "o", ms=4, color=color, label=name)
    place.plot([], [], "|", ms=11, mew=1.6, color=BLACK, label="geometric mean")
    place.axvline(1.0, color=BLACK, lw=0.8)
    place.set_yticks([y for y, _ in ticks], [label for _, label in ticks], fontsize=7)
    place.set(xscale="log", xlabel="RMSE / RMSE of the best published neighbour (left of the line: better)")
    figure.legend(loc="outside lower center", ncols=6)
    return figure


def _sweeps(sweeps: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(1, len(SCENES), figsize=(11, 2.7))
    for place, name in zip(axes, SCENES, strict=True):
        for sweep, (_, color, style) in zip(sweeps, SWEPT, strict=True):
            errors = np.maximum(sweep["rmse"][name], TINY)
            place.plot(sweep["layers"], errors, style, color=color, marker="o", ms=3, label=sweep["label"])
        place.set(title=name, xscale="log", yscale="log", xlabel="layers")
        place.set_xticks(SIZES, [str(k) for k in SIZES])
        place.minorticks_off()
    axes[0].set_ylabel("RMSE, linear RGB (1 = white)")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(SWEPT))
    return figure


if __name__ == "__main__":
    main()
