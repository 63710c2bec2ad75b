"""How far FEE21's depth weights should be shifted: both signs, every weight, stacks of nearly opaque squares.

FEE21 [Friederichs2021], section 3.4 and Figure 8, moves the origin of the weight function in front of the
first surface and reports an MSE of 602.44 without and 12.49 with the shift, on the 0-255 scale, without
saying how far, with which weight, or where the squares stand. Here weights see max(z + weight_shift, 1e-4).
z is the view depth in `wboit`; in shaped `lwboit` it is counted from half a bin before the first surface, so
there a positive shift moves the origin towards the camera, as the paper says.

The scene imitates the paper's: 64 squares in eight stacks of eight, the front one red, two clusters of four
close squares with a wide gap between. Sizes and depths are ours, so the spacing is varied as well.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _study import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    RED,
    SKY,
    Study,
    markdown_table,
    plot_style,
    show_image,
    srgb,
    three_digits,
)

import oitlab

PAPER = {"without": 602.44, "with": 12.49}
FRONT = 5.0
"""View depth of the front squares."""
SPACING, GAP = 0.05, 6.0
"""Distance of squares within a cluster, and between the clusters, in scene units."""
ALPHAS = (0.5, 0.9, 0.99)
OPAQUE = ALPHAS[1:]
"""The stacks of the issue; 0.5 is what FEE21 calls fairly transparent."""
EXPONENTS = {"mb7": 2, "mb8": 3, "inv_pow": 4, "smoke6": 6}
"""Weights that fall as z^-k between their clamps."""
WEIGHTS = ("mb7", "mb8", "mb9", "mb10", "inv_pow", "smoke6")
COLORS = dict(zip(WEIGHTS, (BLUE, ORANGE, GREEN, SKY, RED, PINK), strict=True))
TECHNIQUES: dict[str, tuple[str, dict[str, Any]]] = {
    "wboit": ("wboit", {}),
    **{f"lwboit {bins}": ("lwboit", {"bins": bins}) for bins in (8, 16, 32, 64)},
    "lwboit 32 edge": ("lwboit", {"bins": 32, "shape_anchor": "edge"}),
    "lwboit 32 absorbance": ("lwboit", {"bins": 32, "partition": "absorbance"}),
}
SHOWN = ("wboit", "lwboit 8", "lwboit 64")
HUES = (
    (0.02, 0.45, 0.05), (0.05, 0.1, 0.8), (0.9, 0.75, 0.05), (0.05, 0.6, 0.7), (0.6, 0.1, 0.6),
    (0.85, 0.85, 0.85), (0.05, 0.05, 0.05),
)  # fmt: skip
RED_FRONT = (0.8, 0.03, 0.03)


def main() -> None:
    """Sweep, plot, and print the tables."""
    study = Study.from_command_line("fee21_figure8", __doc__)
    size = (64, 36) if study.quick else (320, 180)
    steps = 6 if study.quick else 40
    sweeps = _main_sweep(size, steps)
    spacings = _spacing_sweep(
        (size[0] // 2, size[1] // 2), steps, (0.05, 1.0) if study.quick else (0.01, 0.03, 0.1, 0.3, 1.0)
    )
    plot_style()
    study.save_figure(_curves(sweeps), "mse_shift.png")
    study.save_figure(_first_depth_plot(sweeps), "mse_first_depth.png")
    study.save_figure(_spacing_plot(spacings), "spacing.png")
    study.save_figure(_images(sweeps, (960, 540) if not study.quick else size), "images.png")
    results = {"paper": PAPER, "front": FRONT, "spacing": SPACING, "gap": GAP, "size": size}
    study.save({**results, "sweeps": sweeps, "spacings": spacings}, _markdown(sweeps, spacings))


def stacks(alpha: float, spacing: float, size: tuple[int, int]) -> oitlab.Scene:
    """Eight stacks of eight squares seen along z, orthographic; red in front at depth `FRONT`."""
    rng = np.random.default_rng(8)
    cluster = spacing * np.arange(4)
    places = np.concatenate([cluster, cluster[-1] + GAP + cluster])
    corner = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    vertices, colors = [], []
    for column, row in product(range(4), range(2)):
        middle = np.array([-1.23 + 0.8 * column, -0.52 + 0.92 * row])
        hues = [RED_FRONT, *(HUES[i] for i in rng.permutation(len(HUES)))]
        for layer, (z, hue) in enumerate(zip(places, hues, strict=True)):
            drift = np.array([0.022, 0.03]) * (layer - 3.5)
            flat = middle + drift + 0.24 * corner
            vertices.append(np.column_stack([flat, np.full(4, -z)]))
            colors.append((*hue, alpha))
    faces = np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(len(colors))[:, None, None]
    order = rng.permutation(2 * len(colors))
    corners = np.concatenate(vertices)
    mesh = oitlab.Mesh(corners, faces.reshape(-1, 3)[order], face_colors=np.repeat(colors, 2, axis=0)[order])
    camera = oitlab.Camera(eye=(0, 0, FRONT), ortho_height=2.1).tightened(corners)
    return oitlab.Scene([mesh], camera=camera, width=size[0], height=size[1])


def _shifts(first: float, steps: int) -> list[float]:
    """Shifts of both signs, dense where the weights' origin meets the first surface at depth `first`."""
    sizes = np.geomspace(0.01, 100.0, steps)
    around = np.concatenate([-first + np.geomspace(1e-3, 30.0, steps), -first - sizes])
    return sorted({0.0, *np.concatenate([sizes, -sizes, around]).round(6).tolist()})


def _sweep(
    alpha: float, spacing: float, size: tuple[int, int], jobs: Iterable[tuple[str, str]], steps: int
) -> list[dict[str, Any]]:
    kept = oitlab.capture(stacks(alpha, spacing, size))
    exact = oitlab.render(kept, "a_buffer")
    return [
        {
            "alpha": alpha,
            "spacing": spacing,
            "predicted_first": _predicted(weight, alpha, spacing),
            **_shift_sweep(kept, exact, label, weight, steps),
        }
        for label, weight in jobs
    ]


def _shift_sweep(
    kept: oitlab.Fragments, exact: oitlab.Frame, label: str, weight: str, steps: int
) -> dict[str, Any]:
    technique, params = TECHNIQUES[label]
    low, high = kept.depth_range
    first = FRONT if technique == "wboit" else 0.0 if "edge" in label else (high - low) / params["bins"] / 2
    shifts = _shifts(first, steps)
    jobs = [(technique, {**params, "weight": weight, "weight_shift": shift}) for shift in shifts]
    frames = oitlab.render_many(kept, jobs)
    errors = [oitlab.compare(frame, exact, metrics="mse_255")["mse_255"] for frame in frames]
    best = int(np.argmin(errors))
    zero = shifts.index(0.0)
    positive = min(error for shift, error in zip(shifts, errors, strict=True) if shift >= 0)
    negative = min(error for shift, error in zip(shifts, errors, strict=True) if shift <= 0)
    return {
        "technique": label,
        "weight": weight,
        "first_depth": first,
        "shift": shifts,
        "mse_255": errors,
        "unshifted": errors[zero],
        "best": errors[best],
        "best_shift": shifts[best],
        "best_positive": positive,
        "best_negative": negative,
        "factor": errors[zero] / errors[best],
        "red_unshifted": _redness(frames[zero], exact),
        "red_best": _redness(frames[best], exact),
    }


def _predicted(weight: str, alpha: float, spacing: float) -> float | None:
    """Depth z at which z^-k falls by the factor 1 - alpha over one spacing.

    `over` weighs a layer 1 / (1 - alpha) times as much as the next one of the same alpha, so two layers of
    one bin are composited exactly where w(z) / w(z + spacing) is that ratio.
    """
    if weight not in EXPONENTS:
        return None
    return spacing / ((1 - alpha) ** (-1 / EXPONENTS[weight]) - 1)


def _redness(frame: oitlab.Frame, exact: oitlab.Frame) -> float:
    """Mean excess of red over green and blue, 0-255, over the pixels that a square covers."""
    wrong = (frame.color - exact.color)[exact.fragment_count > 0].mean(axis=0)
    return float(255 * (wrong[0] - wrong[1:].mean()))


def _main_sweep(size: tuple[int, int], steps: int) -> list[dict[str, Any]]:
    jobs = list(product(TECHNIQUES, WEIGHTS))
    return [sweep for alpha in ALPHAS for sweep in _sweep(alpha, SPACING, size, jobs, steps)]


def _spacing_sweep(size: tuple[int, int], steps: int, spacings: tuple[float, ...]) -> list[dict[str, Any]]:
    jobs = list(product(SHOWN, WEIGHTS))
    keys = ("alpha", "spacing", "technique", "weight", "unshifted", "best", "best_shift", "factor")
    return [
        {key: sweep[key] for key in keys}
        for alpha, spacing in product(OPAQUE, spacings)
        for sweep in _sweep(alpha, spacing, size, jobs, steps)
    ]


def _curves(sweeps: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(len(ALPHAS), len(SHOWN), figsize=(8.2, 6.2), sharey=True)
    for (row, alpha), (column, label) in product(enumerate(ALPHAS), enumerate(SHOWN)):
        place = axes[row, column]
        for sweep in sweeps:
            if sweep["alpha"] == alpha and sweep["technique"] == label:
                place.plot(
                    sweep["shift"], sweep["mse_255"], color=COLORS[sweep["weight"]], label=sweep["weight"]
                )
        for name, mse in PAPER.items():
            place.axhline(mse, color=GREY, lw=0.8, ls=":")
            if row == column == 0:
                place.annotate(f"FEE21 {name}", (100, mse), (0, 1), textcoords="offset points", ha="right",
                               fontsize=6.5, color=GREY)  # fmt: skip
        place.axvline(0, color=BLACK, lw=0.6)
        place.set(yscale="log", title=f"{label}, alpha {alpha}")
        place.set_xscale("symlog", linthresh=0.1, linscale=0.5)
        place.set_xticks([-100, -10, -1, 0, 1, 10, 100])
        if row == len(ALPHAS) - 1:
            place.set_xlabel("weight_shift (scene units)")
    for row in axes:
        row[0].set_ylabel("MSE (0-255)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(WEIGHTS))
    return figure


def _first_depth_plot(sweeps: list[dict[str, Any]]) -> Any:
    """Draw the shaped sweeps over what the weights see instead of over the shift: the minima line up."""
    weights, bins = ("mb7", "inv_pow", "smoke6"), (8, 16, 32, 64)
    figure, axes = plt.subplots(len(ALPHAS), len(weights), figsize=(8.2, 6.2), sharey=True, sharex=True)
    for (row, alpha), (column, weight) in product(enumerate(ALPHAS), enumerate(weights)):
        place = axes[row, column]
        for count, color in zip(bins, (SKY, ORANGE, GREEN, BLUE), strict=True):
            sweep = _find(sweeps, alpha, f"lwboit {count}", weight)
            seen = np.add(sweep["shift"], sweep["first_depth"])
            place.plot(
                seen[seen > 0], np.array(sweep["mse_255"])[seen > 0], color=color, label=f"{count} bins"
            )
        place.axvline(sweep["predicted_first"], color=BLACK, lw=0.8, ls="--")
        place.set(xscale="log", yscale="log", xlim=(3e-3, 30), title=f"{weight}, alpha {alpha}")
        if weight == "mb7":
            place.axvspan(3e-3, 0.288, color=GREY, alpha=0.15, lw=0)
        if row == len(ALPHAS) - 1:
            place.set_xlabel("depth at which the weights\nsee the first surface (scene units)")
    for row in axes:
        row[0].set_ylabel("MSE (0-255)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(bins))
    return figure


def _find(sweeps: list[dict[str, Any]], alpha: float, technique: str, weight: str) -> dict[str, Any]:
    wanted = (alpha, technique, weight)
    return next(s for s in sweeps if (s["alpha"], s["technique"], s["weight"]) == wanted)


def _spacing_plot(spacings: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(len(OPAQUE), len(SHOWN), figsize=(8.2, 4.6), sharey=True, sharex=True)
    for (row, alpha), (column, label) in product(enumerate(OPAQUE), enumerate(SHOWN)):
        place = axes[row, column]
        for weight in WEIGHTS:
            line = [
                (found["spacing"], found["factor"])
                for found in spacings
                if (found["alpha"], found["technique"], found["weight"]) == (alpha, label, weight)
            ]
            place.plot(*zip(*line, strict=True), "o-", ms=3, color=COLORS[weight], label=weight)
        place.axhline(PAPER["without"] / PAPER["with"], color=GREY, lw=0.8, ls=":")
        place.set(xscale="log", yscale="log", title=f"{label}, alpha {alpha}")
        if row == len(OPAQUE) - 1:
            place.set_xlabel("spacing in a cluster (scene units)")
    for row in axes:
        row[0].set_ylabel("MSE unshifted / at best shift")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(WEIGHTS))
    return figure


def _images(sweeps: list[dict[str, Any]], size: tuple[int, int]) -> Any:
    """Show the paper's triple, (a) exact, (b) without shift, (c) with, for wboit and for shaped lwboit."""
    shown = [(0.9, "wboit", "mb7"), (0.9, "lwboit 8", "inv_pow"), (0.5, "lwboit 64", "inv_pow")]
    figure, axes = plt.subplots(len(shown), 3, figsize=(7.2, 4.5))
    for row, (alpha, label, weight) in zip(axes, shown, strict=True):
        kept = oitlab.capture(stacks(alpha, SPACING, size))
        exact = oitlab.render(kept, "a_buffer")
        sweep = _find(sweeps, alpha, label, weight)
        technique, params = TECHNIQUES[label]
        show_image(row[0], srgb(exact.color), f"exact, alpha {alpha}")
        row[0].set_ylabel(f"{label}, {weight}")
        for place, shift in zip(row[1:], (0.0, sweep["best_shift"]), strict=True):
            frame = oitlab.render(kept, technique, {**params, "weight": weight, "weight_shift": shift})
            mse = oitlab.compare(frame, exact, metrics="mse_255")["mse_255"]
            title = f"shift {shift:+.3g}" if shift else "no shift"
            show_image(place, srgb(frame.color), f"{title}: MSE {three_digits(mse)}")
    return figure


def _markdown(sweeps: list[dict[str, Any]], spacings: list[dict[str, Any]]) -> str:
    rows = [
        [
            f"{sweep['technique']}, {sweep['weight']}",
            f"{sweep['alpha']}",
            three_digits(sweep["unshifted"]),
            three_digits(sweep["best_negative"]),
            three_digits(sweep["best_positive"]),
            f"{sweep['best_shift']:+.3g}",
            f"{sweep['best_shift'] + sweep['first_depth']:.3g}",
            "-" if sweep["predicted_first"] is None else f"{sweep['predicted_first']:.3g}",
            f"{three_digits(sweep['factor'])} x",
            f"{sweep['red_unshifted']:+.1f}",
            f"{sweep['red_best']:+.1f}",
        ]
        for sweep in sweeps
    ]
    header = ["technique, weight", "alpha", "MSE at 0", "best s <= 0", "best s >= 0", "best s",
              "seen at", "predicted", "factor", "red excess at 0", "at best s"]  # fmt: skip
    best = [
        [f"{alpha}", f"{spacing:g}", *(_best_cell(spacings, alpha, spacing, t) for t in SHOWN)]
        for alpha, spacing in sorted({(found["alpha"], found["spacing"]) for found in spacings})
    ]
    return "\n\n".join(
        [
            markdown_table(header, rows),
            "Largest factor that a shift brings, over the weights, by spacing within a cluster:",
            markdown_table(["alpha", "spacing", *SHOWN], best),
        ]
    )


def _best_cell(spacings: list[dict[str, Any]], alpha: float, spacing: float, technique: str) -> str:
    found = [s for s in spacings if (s["alpha"], s["spacing"], s["technique"]) == (alpha, spacing, technique)]
    best = max(found, key=lambda s: s["factor"])
    return (
        f"{three_digits(best['factor'])} x ({best['weight']}, s = {best['best_shift']:+.3g}: "
        f"{three_digits(best['unshifted'])} to {three_digits(best['best'])})"
    )


if __name__ == "__main__":
    main()
