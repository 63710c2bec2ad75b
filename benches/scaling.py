"""How time grows with fragments, with triangles and with threads, the cost of an empty scene taken off.

In one image small scenes are mostly the pixels that they cover: twice the fragments take less than twice the
time. Where the image grows with the scene every pixel costs the same, and time should be linear.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
from growing import dust_of, fog_of, haze_of, smoke_of
from harness import Run, markdown_table, plot_style, pooled, scene, three_digits, timed
from pacing import paced

import oitlab

TECHNIQUES = ("wboit", "lwboit", "mlab", "a_buffer", "painter")
FRAGMENTS = (1e5, 3e5, 1e6, 3e6, 1e7, 3e7)
TRIANGLES = (1e3, 1e4, 1e5, 1e6)
HUGE_FRAGMENTS, HUGE_TRIANGLES = (1e8, 3e8), (1e7,)
SERIES = {
    "fragments": (smoke_of, "fragments", "fragments, in one image"),
    "fragments_in_growing_images": (fog_of, "fragments", "fragments, in an image that grows with them"),
    "triangles": (dust_of, "triangles", "triangles, in one image"),
    "triangles_in_growing_images": (haze_of, "triangles", "triangles, in an image that grows with them"),
}
"""What grows how: its scenes, what is counted, and what it is called."""


def exponent(sizes: list[float], times: list[float]) -> float | None:
    """Slope of log time over log size, by least squares, over the points whose time is positive."""
    points = [(s, t) for s, t in zip(sizes, times, strict=True) if t > 0]
    if len({s for s, _ in points}) < 2:
        return None
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0])


def curve(scenes: Iterable[oitlab.Scene], run: Run) -> dict[str, Any]:
    """Times of every technique on scenes of growing size, and on empty ones of the same images."""
    points: list[dict[str, Any]] = []
    for what in scenes:
        size = {"width": what.width, "height": what.height}
        known = [point["empty"] for point in points if size.items() <= point.items()]
        points.append(
            {
                **size,
                "triangles": sum(len(mesh.faces) for mesh in what.meshes),
                "fragments": oitlab.render(what, "wboit").stats.fragments,
                "empty": known[0] if known else each(oitlab.Scene([], camera=what.camera, **size), run),
                "times": each(what, run),
            }
        )
    return {"points": points}


def each(what: oitlab.Scene, run: Run) -> dict[str, dict[str, float]]:
    """Times of every technique, one after the other: short frames tell of themselves only when warm."""

    def of(technique: str) -> dict[str, float]:
        frames = paced(lambda: oitlab.render(what, technique), min(run.repeats, 3), run.budget)
        return pooled(1e3 * seconds for seconds, _ in frames)

    return {technique: of(technique) for technique in TECHNIQUES}


def fitted(found: dict[str, Any], size: str, first: int = 0) -> dict[str, float | None]:
    """Exponents per technique from a point on; the empty scene's time is the one of the same technique."""
    points = found["points"][first:]
    sizes = [point[size] for point in points]
    return {t: exponent(sizes, [beyond_empty(point, t) for point in points]) for t in TECHNIQUES}


def beyond_empty(point: dict[str, Any], technique: str) -> float:
    """Milliseconds that the scene takes longer than an empty one."""
    return float(point["times"][technique]["median_ms"] - point["empty"][technique]["median_ms"])


def threads(run: Run) -> dict[str, Any]:
    """One thread's time over that of all cores."""
    cores = os.cpu_count() or 1
    found = {}
    for name in ("soup", "smoke", "shells"):
        what = scene(name, run)
        for technique in TECHNIQUES:
            calls = {n: lambda n=n, w=what, t=technique: oitlab.render(w, t, threads=n) for n in {1, cores}}
            # a few milliseconds each: many, or whoever else uses the machine decides
            times = timed({str(n): call for n, call in calls.items()}, 3 * run.repeats)
            one, all_of_them = times["1"], times[str(cores)]
            found[f"{name} {technique}"] = {
                kind: one[kind] / all_of_them[kind] for kind in ("median_ms", "min_ms")
            }
    return {"cores": cores, "speedup": found}


def main(run: Run) -> None:
    """Measure, and write scaling.json, scaling.md and scaling.png."""
    counts = {"fragments": FRAGMENTS, "triangles": TRIANGLES}
    if run.huge:
        counts = {"fragments": FRAGMENTS + HUGE_FRAGMENTS, "triangles": TRIANGLES + HUGE_TRIANGLES}
    if run.quick:
        counts = {"fragments": (1e4, 1e5), "triangles": (1e2, 1e3)}
    # the first second of a process is slower than what comes after it
    each(smoke_of(counts["fragments"][0], run), run)
    results: dict[str, Any] = {}
    for name, (scene_of, size, _) in SERIES.items():
        found = curve((scene_of(count, run) for count in counts[size]), run)
        found["exponents"] = fitted(found, size)
        found["exponents_of_the_larger_half"] = fitted(found, size, len(found["points"]) // 2)
        results[name] = found
    results["threads"] = threads(run)
    draw(results, run)
    run.save("scaling", results, tables(results))


def tables(results: dict[str, Any]) -> str:
    """Milliseconds over size, with the exponents, then the gain of threads."""
    parts = []
    for name, (_, size, title) in SERIES.items():
        found = results[name]
        rows = []
        for point in found["points"]:
            image = f"{point['width']} x {point['height']}"
            times = [milliseconds(point["times"], point["empty"], technique) for technique in TECHNIQUES]
            rows.append([f"{point[size]:,}", image, *times])
        half = found["points"][len(found["points"]) // 2][size]
        slopes = [
            [label, "", *("-" if e is None else f"{e:.2f}" for e in found[which].values())]
            for label, which in (
                ("**exponent**", "exponents"),
                (f"**from {half:,} on**", "exponents_of_the_larger_half"),
            )
        ]
        parts.append(
            f"Milliseconds over {title}; in brackets those of an empty scene, which exponents leave out."
        )
        parts.append(markdown_table([size, "image", *TECHNIQUES], [*rows, *slopes]))
    speedup = results["threads"]["speedup"]
    names = dict.fromkeys(key.split()[0] for key in speedup)

    def cell(name: str, technique: str) -> str:
        ratio = speedup[f"{name} {technique}"]
        return f"{ratio['median_ms']:.2f} ({ratio['min_ms']:.2f})"

    rows = [[t, *(cell(name, t) for name in names)] for t in TECHNIQUES]
    cores = results["threads"]["cores"]
    parts.append(f"Time on one thread over time on {cores}: medians, and in brackets the least times.")
    parts.append(markdown_table(["technique", *names], rows))
    return "\n\n".join(parts)


def milliseconds(times: dict[str, Any], empty: dict[str, Any], technique: str) -> str:
    """Of a scene, and of an empty one in brackets."""
    return f"{three_digits(times[technique]['median_ms'])} ({three_digits(empty[technique]['median_ms'])})"


def draw(results: dict[str, Any], run: Run) -> None:
    """All curves on logarithmic axes, with a line of slope 1 to compare with."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    plot_style()
    colors = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7")
    figure, panels = plt.subplots(2, 2, figsize=(9, 8))
    for axes, (name, (_, size, title)) in zip(panels.flat, SERIES.items(), strict=True):
        found = results[name]
        sizes = np.array([point[size] for point in found["points"]], float)
        for technique, color in zip(TECHNIQUES, colors, strict=True):
            net = np.array([beyond_empty(point, technique) for point in found["points"]])
            slope = found["exponents"][technique]
            label = technique if slope is None else f"{technique}, exponent {slope:.2f}"
            axes.plot(sizes, np.where(net > 0, net, np.nan), "o-", color=color, markersize=3, label=label)
        last = beyond_empty(found["points"][-1], "wboit")
        axes.plot(sizes, last * sizes / sizes[-1], ":", color="#777777", label="linear")
        axes.set(xscale="log", yscale="log", xlabel=title, ylabel="milliseconds beyond the empty scene")
        axes.legend()
    run.save_figure(figure, "scaling")
    plt.close(figure)
