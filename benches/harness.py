"""What the parts of `make bench` share: timing, results with provenance, the studies' tables and plots."""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import oitlab
from oitlab._provenance import provenance

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path.append(str(CHECKOUT / "experiments"))

from _study import markdown_table, plot_style, three_digits  # noqa: E402

__all__ = ["SCENES", "Run", "markdown_table", "plot_style", "pooled", "scene", "three_digits", "timed"]

SCENES = ("squares", "soup", "smoke", "shells", "blades")
SMALL = {"squares": {}, "soup": {"count": 3000}, "smoke": {"count": 60}, "shells": {"subdivisions": 2},
         "blades": {"count": 60}}  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One invocation: how large it is, and where its files go."""

    folder: Path
    quick: bool = False
    huge: bool = False
    repeats: int = 7
    peer_python: str = sys.executable
    peers: tuple[str, ...] = ()
    budget: float = 20.0
    """Seconds of timed frames that one mode of one peer may take."""
    timeout: float = 120.0

    @property
    def size(self) -> dict[str, int]:
        """Of the image."""
        return {"width": 160, "height": 90} if self.quick else {"width": 1280, "height": 720}

    def save(self, name: str, results: dict[str, Any], tables: str) -> None:
        """Write NAME.json and NAME.md, both with machine, versions, threads, commit and load."""
        self.folder.mkdir(parents=True, exist_ok=True)
        about = {"command": " ".join(["python", "benches/bench.py", *sys.argv[1:]]), **provenance()}
        text = json.dumps({"about": about, **results}, indent=1, allow_nan=False)
        (self.folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        page = f"{tables}\n\n{footer(about)}\n"
        (self.folder / f"{name}.md").write_text(page, encoding="utf-8")
        print(page)

    def save_figure(self, figure: Any, name: str) -> None:
        """Write NAME.png."""
        self.folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(self.folder / f"{name}.png", dpi=60 if self.quick else 160)


def footer(about: dict[str, Any]) -> str:
    """Say in a sentence where numbers come from."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    return (
        f"`{about['command']}`, {about['date']}, commit {about['commit'] or 'unknown'}, {about['cpu']}, "
        f"{about['cores']} cores, load average {about['load_average']} at the end, {about['system']}; "
        f"{versions}."
    )


def scene(name: str, run: Run) -> oitlab.Scene:
    """One of the five scenes; small in a quick run."""
    return oitlab.scenes.SCENES[name](**run.size, **(SMALL[name] if run.quick else {}))


def timed(calls: dict[str, Callable[[], Any]], repeats: int) -> dict[str, dict[str, float]]:
    """Times of calls that take turns, so that a busy moment hits them all; one turn before warms up."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            if turn:
                times[name].append(1e3 * (time.perf_counter() - start))
    return {name: pooled(values) for name, values in times.items()}


def pooled(times_ms: Iterable[float]) -> dict[str, float]:
    """Median and spread."""
    times: Sequence[float] = sorted(times_ms)
    return {
        "median_ms": statistics.median(times),
        "min_ms": times[0],
        "max_ms": times[-1],
        "repeats": len(times),
    }
