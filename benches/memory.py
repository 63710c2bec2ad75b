"""Memory stays bounded however many fragments there are: the peak of rendering some 3e8 of them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from harness import Run, markdown_table, three_digits
from memory_worker import LAYOUTS, STACK

TECHNIQUES = ("a_buffer", "lwboit", "mlab")
QUADS, QUICK_QUADS = 5650, 60
"""Of the smoke: some 3e8 fragments at 1280 x 720."""
LIMIT_BYTES = 1 << 30
FRAGMENT_BYTES = 24
"""Of one fragment in arrays: depth, colour, alpha, primitive."""


def measured(technique: str, layout: str, run: Run) -> dict[str, Any]:
    """What one technique took, in a process of its own."""
    worker = Path(__file__).with_name("memory_worker.py")
    size = [f"--{name}={value}" for name, value in run.size.items()]
    quads = f"--quads={QUICK_QUADS if run.quick else QUADS}"
    command = [sys.executable, str(worker), technique, layout, *size, quads]
    finished = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(finished.stdout)
    return {**found, "within_limit": found["peak_bytes"] < LIMIT_BYTES}


def main(run: Run) -> None:
    """Measure, and write memory.json and memory.md."""
    layouts: dict[str, Any] = {}
    if Path("/proc/self/clear_refs").exists():
        layouts = {layout: {t: measured(t, layout, run) for t in TECHNIQUES} for layout in LAYOUTS}
    results = {"stack": STACK, "limit_bytes": LIMIT_BYTES, "layouts": layouts}
    run.save("memory", results, tables(results) if layouts else "Skipped: no /proc, where Linux has peaks.")


def tables(results: dict[str, Any]) -> str:
    """Peaks beside what the fragments would take if they were kept."""
    rows = []
    for layout, techniques in results["layouts"].items():
        for technique, row in techniques.items():
            kept = FRAGMENT_BYTES * row["fragments"]
            mebibytes = (
                three_digits(size / 2**20) for size in (row["peak_bytes"], row["before_bytes"], kept)
            )
            rows.append([f"{layout} {technique}", f"{row['fragments']:,}", f"{row['depth_complexity_max']:,}",
                         three_digits(row["seconds"]), *mebibytes,
                         "yes" if row["within_limit"] else "**no**"])  # fmt: skip
    header = ["quads and technique", "fragments", "most in a pixel", "seconds", "peak MiB", "before MiB",
              "kept MiB", "under 1 GiB"]  # fmt: skip
    return "\n\n".join(
        [
            f"Grey smoke and a stack of {results['stack']:,} quads; each row in a process of its own. Peak: "
            "resident memory while rendering, beyond that of interpreter, imports and scene (before). Kept: "
            f"the fragments as arrays, {FRAGMENT_BYTES} bytes each, which nobody keeps.",
            markdown_table(header, rows),
        ]
    )
