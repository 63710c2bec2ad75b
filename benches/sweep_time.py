"""A thousand weights on one scene: how long `oitlab.sweep` takes, beside a loop over render and compare."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import Run, markdown_table, scene, three_digits

import oitlab

POINTS, QUICK_POINTS = 1000, 30
ALONE, QUICK_ALONE = 20, 3
"""Variants that are also rendered and compared one by one."""
LIMIT_SECONDS = 60.0
SWEEPS = {
    "inv_pow, weight_k": ({"weight": "inv_pow"}, "weight_k", (0.5, 10.0)),
    "mb7, weight_shift": ({"weight": "mb7"}, "weight_shift", (-0.5, 2.0)),
}


def measured(what: oitlab.Scene, name: str, points: int) -> dict[str, Any]:
    """One sweep of wboit with what comes by default, into a store; then once more from the store."""
    fixed, param, (low, high) = SWEEPS[name]
    grid = {"wboit": {**fixed, param: np.linspace(low, high, points)}}
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder, "study.sqlite")
        start = time.perf_counter()
        table = oitlab.sweep(what, grid, store=store, progress=False)
        seconds = time.perf_counter() - start
        start = time.perf_counter()
        oitlab.sweep(what, grid, store=store, progress=False)
        again = time.perf_counter() - start
        stored = len(oitlab.read_study(store))
    order = table["mse"].sort_values().index
    ends = [{param: float(table[param][i]), "mse": float(table["mse"][i])} for i in (order[0], order[-1])]
    return {
        "points": len(table),
        "seconds": seconds,
        "again_seconds": again,
        "stored_rows": stored,
        "shared_with": int(table["shared_with"].max()),
        "threads": int(table["threads"].max()),
        "best": ends[0],
        "worst": ends[1],
        "param": param,
    }


def one_by_one(what: oitlab.Scene, count: int) -> dict[str, Any]:
    """The same by a loop over render and compare; the image it is compared with is rendered before."""
    fixed, param, (low, high) = SWEEPS["mb7, weight_shift"]
    values = np.linspace(low, high, count)
    exact = oitlab.render(what, "a_buffer")
    start = time.perf_counter()
    errors = []
    for value in values:
        frame = oitlab.render(what, "wboit", {**fixed, param: value})
        errors.append(oitlab.compare(frame, exact, metrics=["mse", "max_error"])["mse"])
    seconds = time.perf_counter() - start
    table = oitlab.sweep(what, {"wboit": {**fixed, param: values}}, progress=False)
    return {"points": count, "seconds": seconds, "same_mse": table["mse"].tolist() == errors}


def main(run: Run) -> None:
    """Measure, and write sweep.json and sweep.md."""
    what = scene("soup", run)
    points = QUICK_POINTS if run.quick else POINTS
    results: dict[str, Any] = {
        "points": points,
        "limit_seconds": LIMIT_SECONDS,
        "sweeps": {name: measured(what, name, points) for name in SWEEPS},
        "one_by_one": one_by_one(what, QUICK_ALONE if run.quick else ALONE),
    }
    for row in results["sweeps"].values():
        row["within_limit"] = row["seconds"] < LIMIT_SECONDS
    run.save("sweep", results, tables(results))


def tables(results: dict[str, Any]) -> str:
    """Seconds of each sweep, what one point takes, and where the smallest error is."""
    rows = []
    for name, row in results["sweeps"].items():
        best = f"{row['best'][row['param']]:.3g} (MSE {row['best']['mse']:.3g})"
        rows.append([name, f"{row['points']:,}", three_digits(row["seconds"]),
                     three_digits(1e3 * row["seconds"] / row["points"]), three_digits(row["again_seconds"]),
                     best, "yes" if row["within_limit"] else "**no**"])  # fmt: skip
    alone = results["one_by_one"]
    each = three_digits(1e3 * alone["seconds"] / alone["points"])
    header = ["wboit with", "points", "seconds", "ms a point", "from the store, s", "best",
              f"under {results['limit_seconds']:.0f} s"]  # fmt: skip
    return "\n\n".join(
        [
            "`oitlab.sweep` of soup with default metrics, the reference's rendering and a store included.",
            markdown_table(header, rows),
            f"A loop over `render` and `compare` takes {each} ms a point (mb7, {alone['points']} points).",
        ]
    )
