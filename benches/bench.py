"""`make bench`: whole calls from Python to NumPy array, on the five procedural scenes.

Every number of a run comes from the same minutes on the same machine: compare ratios, not milliseconds of
different days. The techniques of a scene take turns within each repetition, so that a busy moment hits all.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import oitlab
from oitlab._provenance import provenance

SCENES = ("squares", "soup", "smoke", "shells", "blades")
TECHNIQUES = ("wboit", "painter", "lwboit", "a_buffer")


def milliseconds(scene: oitlab.Scene, technique: str) -> float:
    """Time one whole call."""
    start = time.perf_counter()
    oitlab.render(scene, technique)
    return (time.perf_counter() - start) * 1e3


def bench(scene: oitlab.Scene, repeats: int) -> dict[str, Any]:
    """Measure all techniques on one scene."""
    frames = {name: oitlab.render(scene, name) for name in TECHNIQUES}  # warms up, too
    times: dict[str, list[float]] = {name: [] for name in TECHNIQUES}
    for _ in range(repeats):
        for name in TECHNIQUES:
            times[name].append(milliseconds(scene, name))
    exact = frames["a_buffer"]
    return {
        "fragments": exact.stats.fragments,
        "depth_complexity_mean": exact.stats.depth_complexity_mean,
        "depth_complexity_max": exact.stats.depth_complexity_max,
        "threads": exact.stats.threads,
        "techniques": {
            name: {
                "median_ms": statistics.median(times[name]),
                "min_ms": min(times[name]),
                "max_ms": max(times[name]),
                "rmse": oitlab.compare(frames[name], exact)["rmse"],
            }
            for name in TECHNIQUES
        },
    }


def report(results: dict[str, Any]) -> str:
    """Lay out the table: milliseconds, and how many times the time of wboit that is."""
    lines = [f"{'scene':8} {'fragments':>11}  " + "".join(f"{name:>22}" for name in TECHNIQUES)]
    for scene, row in results.items():
        times = {name: row["techniques"][name]["median_ms"] for name in TECHNIQUES}
        cells = (f"{times[name]:11.1f} ms ({times[name] / times['wboit']:4.1f}x)" for name in TECHNIQUES)
        lines.append(f"{scene:8} {row['fragments']:11,}  " + "".join(f"{cell:>22}" for cell in cells))
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small images, one repetition")
    parser.add_argument("--output", type=Path, default=Path("out/bench.json"))
    options = parser.parse_args()
    size = {"width": 160, "height": 90} if options.quick else {}
    results = {name: bench(oitlab.scenes.SCENES[name](**size), 1 if options.quick else 7) for name in SCENES}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    about = {"command": "make bench", **provenance()}
    options.output.write_text(json.dumps({"about": about, "scenes": results}, indent=1) + "\n")
    print(report(results))
    print(
        "medians of whole calls; the bracket is the ratio to wboit in the same run; "
        f"written: {options.output}"
    )


if __name__ == "__main__":
    main()
