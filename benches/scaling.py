"""How time grows with fragments, with triangles and with threads, the cost of an empty scene taken off."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from harness import Run, markdown_table, plot_style, pooled, scene, three_digits, timed
from pacing import paced

import oitlab

TECHNIQUES = ("wboit", "lwboit", "mlab", "a_buffer", "painter")
FRAGMENTS = (1e5, 3e5, 1e6, 3e6, 1e7, 3e7)
TRIANGLES = (1e3, 1e4, 1e5, 1e6)
HUGE_FRAGMENTS, HUGE_TRIANGLES = (1e8, 3e8), (1e7,)
HALF_SIDE = 0.0042
"""Standard deviation of a tiny triangle's corners: some two fragments each at 720 rows."""


def smoke_of(fragments: float, run: Run) -> oitlab.Scene:
    """Smoke with about that many fragments: first one with few quads tells how many there are per quad."""
    trial = oitlab.scenes.smoke(**run.size, count=100)
    per_quad = oitlab.render(trial, "wboit").stats.fragments / 100
    return oitlab.scenes.smoke(**run.size, count=max(1, round(fragments / per_quad)))


def dust_of(triangles: float, run: Run) -> oitlab.Scene:
    """Triangles of a few pixels in random order: their set-up matters more than their fragments."""
    rng, count = np.random.default_rng(0), int(triangles)
    corners = rng.uniform(-0.5, 0.5, (count, 1, 3)) + rng.normal(0, HALF_SIDE, (count, 3, 3))
    colors = np.column_stack([rng.random((count, 3)), np.full(count, 0.3)])
    vertices = corners.reshape(-1, 3)
    mesh = oitlab.Mesh(vertices, np.arange(3 * count).reshape(-1, 3), face_colors=colors)
    camera = oitlab.Camera(eye=(0.78, 0.61, 1.22), fov_y=40.0).tightened(vertices)
    return oitlab.Scene([mesh], camera=camera, **run.size)


def exponent(sizes: list[float], times: list[float]) -> float | None:
    """Slope of log time over log size, by least squares, over the points whose time is positive."""
    points = [(s, t) for s, t in zip(sizes, times, strict=True) if t > 0]
    if len({s for s, _ in points}) < 2:
        return None
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0])


def curve(scenes: list[oitlab.Scene], run: Run) -> dict[str, Any]:
    """Times of every technique on scenes of growing size."""
    empty_scene = oitlab.Scene([], camera=scenes[0].camera, **run.size)
    points = [
        {
            "triangles": sum(len(mesh.faces) for mesh in what.meshes),
            "fragments": oitlab.render(what, "wboit").stats.fragments,
            "times": each(what, run),
        }
        for what in scenes
    ]
    return {"empty": each(empty_scene, run), "points": points}


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
    return {
        t: exponent(sizes, [p["times"][t]["median_ms"] - found["empty"][t]["median_ms"] for p in points])
        for t in TECHNIQUES
    }


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
    fragments = FRAGMENTS + (HUGE_FRAGMENTS if run.huge else ())
    triangles = TRIANGLES + (HUGE_TRIANGLES if run.huge else ())
    if run.quick:
        fragments, triangles = (1e4, 1e5), (1e2, 1e3)
    results = {
        "fragments": curve([smoke_of(count, run) for count in fragments], run),
        "triangles": curve([dust_of(count, run) for count in triangles], run),
    }
    for size, found in results.items():
        found["exponents"] = fitted(found, size)
        found["exponents_of_the_larger_half"] = fitted(found, size, len(found["points"]) // 2)
    results["threads"] = threads(run)
    draw(results, run)
    run.save("scaling", results, tables(results))


def tables(results: dict[str, Any]) -> str:
    """Milliseconds over size, with the exponents, then the gain of threads."""
    parts = []
    for size in ("fragments", "triangles"):
        found = results[size]
        rows = [[f"{point[size]:,}", *(three_digits(point["times"][t]["median_ms"]) for t in TECHNIQUES)]
                for point in found["points"]]  # fmt: skip
        empty = ["empty scene", *(three_digits(found["empty"][t]["median_ms"]) for t in TECHNIQUES)]
        half = found["points"][len(found["points"]) // 2][size]
        slopes = [
            [name, *("-" if e is None else f"{e:.2f}" for e in found[which].values())]
            for name, which in (
                ("**exponent**", "exponents"),
                (f"**from {half:,} on**", "exponents_of_the_larger_half"),
            )
        ]
        parts += [f"Milliseconds over {size}.", markdown_table([size, *TECHNIQUES], [empty, *rows, *slopes])]
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


def draw(results: dict[str, Any], run: Run) -> None:
    """Both curves on logarithmic axes, with a line of slope 1 to compare with."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    plot_style()
    colors = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7")
    figure, panels = plt.subplots(1, 2, figsize=(9, 4))
    for axes, size in zip(panels, ("fragments", "triangles"), strict=True):
        found = results[size]
        sizes = np.array([point[size] for point in found["points"]], float)
        for technique, color in zip(TECHNIQUES, colors, strict=True):
            times = [p["times"][technique]["median_ms"] for p in found["points"]]
            slope = found["exponents"][technique]
            label = technique if slope is None else f"{technique}, exponent {slope:.2f}"
            net = np.array(times) - found["empty"][technique]["median_ms"]
            axes.plot(sizes, np.where(net > 0, net, np.nan), "o-", color=color, markersize=3, label=label)
        last = found["points"][-1]["times"]["wboit"]["median_ms"]
        axes.plot(sizes, last * sizes / sizes[-1], ":", color="#777777", label="linear")
        axes.set(xscale="log", yscale="log", xlabel=size, ylabel="milliseconds beyond the empty scene")
        axes.legend()
    run.save_figure(figure, "scaling")
    plt.close(figure)
