"""Error against time: every technique of the registry, default params, on the five scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import SCENES, Run, markdown_table, plot_style, scene, three_digits, timed

import oitlab

SLOW = 20
"""Times the cost of wboit per fragment beyond which a technique owes a reason."""


NOISE = 1e-7
"""Errors of rounding alone: below this none is better than another."""


def front(points: dict[str, tuple[float, float]]) -> list[str]:
    """Names of the points (time, error) that none other beats in one and equals or beats in the other."""
    best, found = float("inf"), []
    seen = {name: (time, max(error, NOISE)) for name, (time, error) in points.items()}
    for name, (_, error) in sorted(seen.items(), key=lambda item: item[1]):
        if error < best:
            best = error
            found.append(name)
    return found


def on_scene(name: str, run: Run) -> dict[str, Any]:
    """Times and errors of all techniques on one scene, and who is on the front."""
    what = scene(name, run)
    exact = oitlab.render(what, "a_buffer", dtype="float64")
    names = [technique.id for technique in oitlab.techniques()]
    times = timed({n: lambda n=n: oitlab.render(what, n) for n in names}, min(run.repeats, 3))
    fragments = exact.stats.fragments
    rows = {}
    for n in names:
        rows[n] = {
            **times[n],
            "ns_per_fragment": 1e6 * times[n]["median_ms"] / fragments,
            "times_wboit": times[n]["median_ms"] / times["wboit"]["median_ms"],
            "rmse": oitlab.compare(oitlab.render(what, n), exact)["rmse"],
        }
    on_front = front({n: (row["median_ms"], row["rmse"]) for n, row in rows.items()})
    return {
        "fragments": fragments,
        "threads": exact.stats.threads,
        "techniques": rows,
        "pareto_front": on_front,
    }


def main(run: Run) -> None:
    """Measure, and write pareto.json, pareto.md and pareto.png."""
    results = {name: on_scene(name, run) for name in SCENES}
    draw(results, run)
    run.save("pareto", {"scenes": results}, tables(results))


def tables(results: dict[str, Any]) -> str:
    """RMSE and milliseconds, then nanoseconds per fragment; bold names a member of the front."""
    names = list(next(iter(results.values()))["techniques"])
    accuracy = [[n, *(_accuracy(row, n) for row in results.values())] for n in names]
    costs = [[n, *(_cost(row["techniques"][n]) for row in results.values())] for n in names]
    return "\n\n".join(
        [
            "RMSE against the float64 exact image, and milliseconds; bold: on the Pareto front.",
            markdown_table(["technique", *results], accuracy),
            f"Nanoseconds per fragment of the whole call, and times wboit; bold: over {SLOW} times wboit.",
            markdown_table(["technique", *results], costs),
        ]
    )


def _accuracy(row: dict[str, Any], name: str) -> str:
    found = row["techniques"][name]
    text = f"{found['rmse']:.1e}, {three_digits(found['median_ms'])}"
    return f"**{text}**" if name in row["pareto_front"] else text


def _cost(found: dict[str, float]) -> str:
    text = f"{three_digits(found['ns_per_fragment'])} ({found['times_wboit']:.1f}x)"
    return f"**{text}**" if found["times_wboit"] > SLOW else text


def draw_front(axes: Any, name: str, row: dict[str, Any]) -> None:
    """All techniques on one scene, the front joined; `name_front` names it."""
    from matplotlib.ticker import LogLocator, NullFormatter

    found = row["techniques"]
    spots = {n: (found[n]["median_ms"], max(found[n]["rmse"], NOISE)) for n in found}
    axes.scatter(*zip(*spots.values(), strict=True), s=12, color="#777777")
    line = [spots[n] for n in row["pareto_front"]]
    axes.step(*zip(*line, strict=True), where="post", color="#0072B2", marker="o", markersize=4)
    axes.set(xscale="log", yscale="log", title=f"{name}, {row['fragments'] / 1e6:.3g} M fragments")
    axes.set(xlabel="milliseconds", ylabel="RMSE")
    axes.margins(0.15)
    times = [time for time, _ in spots.values()]
    few = max(times) < 300 * min(times)  # there is no room for more than a number per decade otherwise
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def name_front(axes: Any, row: dict[str, Any]) -> None:
    """Write the names of the front where they cover nothing, once all panels have their places."""
    from oitlab.plot._labels import place_labels

    found = row["techniques"]
    spots = axes.transData.transform([(t["median_ms"], max(t["rmse"], NOISE)) for t in found.values()])
    radius = 3.0 * axes.get_figure().dpi / 72.0
    places = dict(zip(found, spots, strict=True))
    front = row["pareto_front"]
    points = [(float(places[name][0]), float(places[name][1])) for name in front]
    obstacles = np.hstack([spots - radius, spots + radius])
    place_labels(axes, points, front, (obstacles, np.empty((0, 4))), ["#0072B2"] * len(front))


def draw(results: dict[str, Any], run: Run) -> None:
    """One panel per scene."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    plot_style()
    figure, panels = plt.subplots(2, 3, figsize=(11, 7))
    for axes, (name, row) in zip(panels.flat, results.items(), strict=False):
        draw_front(axes, name, row)
    panels.flat[-1].axis("off")
    panels.flat[-1].text(0, 0.7, "Every technique, default params.\n"
                         "Blue: the Pareto front, named where\nthere is room.\n"
                         "Errors below 1e-7 are drawn at 1e-7.", fontsize=9)  # fmt: skip
    figure.draw_without_rendering()
    for axes, row in zip(panels.flat, results.values(), strict=False):
        name_front(axes, row)
    run.save_figure(figure, "pareto")
    plt.close(figure)
