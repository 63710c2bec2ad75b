"""What a weight of one's own costs: times of whole renders relative to the published weight it repeats."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from harness import Run, markdown_table, scene, three_digits, timed
from numpy.typing import NDArray

import oitlab

CASES = (("smoke", "wboit"), ("soup", "wboit"), ("shells", "wboit"), ("shells", "lwboit"))
"""Scenes and techniques: facing quads with one weight per primitive, triangles of every tilt, and lists."""
MB7 = "a * clamp(10.0 / (1e-5 + pow(z / 5.0, 2.0) + pow(z / 200.0, 6.0)), 1e-2, 3e3)"
"""MB13 eq. 7."""
HOW = {"published": "mb7", "WGSL": MB7, "callable": lambda z, alpha: mb7(z, alpha)}


def mb7(z: NDArray[np.float32], alpha: NDArray[np.float32]) -> NDArray[np.float32]:
    """MB13 eq. 7."""
    far = z * np.float32(1 / 200)
    weight = 10 / (1e-5 + np.square(z * np.float32(0.2)) + np.square(far * far * far))
    return alpha * np.clip(weight, 1e-2, 3e3)


def main(run: Run) -> None:
    """Measure, and write weights.json and weights.md."""
    results: list[dict[str, Any]] = []
    for name, technique in CASES:
        what = scene(name, run)
        calls: dict[str, Callable[[], Any]] = {
            how: lambda t=technique, w=weight, s=what: oitlab.render(s, t, {"weight": w})
            for how, weight in HOW.items()
        }
        times = timed(calls, run.repeats)
        one = times["published"]["median_ms"]
        ratios = {how: times[how]["median_ms"] / one for how in HOW if how != "published"}
        fragments = oitlab.render(what, "wboit").stats.fragments
        row = {
            "scene": name,
            "technique": technique,
            "fragments": fragments,
            "times": times,
            "ratios": ratios,
        }
        results.append(row)
    run.save("weights", {"cases": results}, table(results))


def table(results: list[dict[str, Any]]) -> str:
    """One row per scene and technique."""
    rows = [
        [row["scene"], row["technique"], f"{row['fragments']:,}",
         three_digits(row["times"]["published"]["median_ms"]),
         *(f"{ratio:.2f}" for ratio in row["ratios"].values())]
        for row in results
    ]  # fmt: skip
    about = (
        "Milliseconds of a render with MB13's eq. 7 as the published weight, then the time with the same "
        f"formula of one's own over that: `{MB7}` as text, and as a function of NumPy arrays. Medians of "
        "renders that took turns."
    )
    others = [how for how in HOW if how != "published"]
    return about + "\n\n" + markdown_table(["scene", "technique", "fragments", "published ms", *others], rows)
