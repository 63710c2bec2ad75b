"""Time one adapter on one scene file, in a process of its own; the last line printed is a JSON object.

python benches/worker.py numba a_buffer scene.npz --repeats 7 --image image.npy
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")  # first frames are measured as first frames

import numpy as np
from arrays import Arrays
from pacing import paced


def busy_seconds() -> tuple[float, float]:
    """CPU time so far: the machine's, and this process's."""
    try:
        ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return 0.0, time.process_time()
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK"), time.process_time()


def share_of_others(before: tuple[float, float], seconds: float) -> float:
    """Share of all cores that other processes used since `before`."""
    machine, mine = (now - then for now, then in zip(busy_seconds(), before, strict=True))
    return max(0.0, machine - mine) / (seconds * (os.cpu_count() or 1))


def measure(
    adapter: Any, arrays: Arrays, mode: str, repeats: int, budget: float
) -> tuple[dict[str, Any], Any]:
    """Set up, then render as often as `paced` says."""
    before, start = busy_seconds(), time.perf_counter()
    frame: Callable[[], Any] = adapter.setup(arrays, mode)
    image = frame()
    first = time.perf_counter() - start
    times: list[float] = []
    for seconds, latest in paced(frame, repeats, budget):
        times.append(seconds)
        image = latest
    others = share_of_others(before, time.perf_counter() - start)
    image = getattr(frame, "decode", lambda pixels: pixels)(image)[..., :3]
    linear = image / np.float32(255) if image.dtype == np.uint8 else image.astype(np.float32)
    result = {
        "first_ms": 1e3 * first,
        "times_ms": [1e3 * seconds for seconds in times],
        "others_cpu": others,
        "info": getattr(frame, "info", {}),
    }
    return result, linear


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peer")
    parser.add_argument("mode")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--budget", type=float, default=20.0, help="seconds of timed frames")
    parser.add_argument("--image", type=Path, help="write the last image, linear RGB float32")
    options = parser.parse_args()
    try:
        adapter = importlib.import_module(f"peers.{options.peer}")
    except ImportError as error:
        print(json.dumps({"skipped": str(error)}))
        return
    arrays = Arrays.load(options.scene)
    result, image = measure(adapter, arrays, options.mode, options.repeats, options.budget)
    if options.image:
        np.save(options.image, image)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
