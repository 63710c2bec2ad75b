"""What rendering one variant takes of this machine's memory, measured in a process that does nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ..fragments import Fragments
from ..scene import Scene

_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")


def can_measure() -> bool:
    """Whether the system tells the peak of a process's memory (Linux)."""
    return _STATUS.exists() and _RESET.exists()


def peak_bytes_per_pixel(
    source: Scene | Fragments, request: tuple[str, dict[str, Any]], threads: int | None
) -> float | None:
    """Peak growth of resident memory while a fresh process renders this once, per pixel; None if unknown.

    Output images are part of it (16 bytes per pixel in float32), and so is the scene's set-up, its tiles
    and their lists; interpreter, libraries and the scene itself are not.
    """
    if not can_measure():
        return None
    import cloudpickle

    from .custom import shippable

    job = cloudpickle.dumps((shippable([request[0]]), source, request, threads))
    command = [sys.executable, "-c", "from oitlab.sweeping.memory import child; child()"]
    finished = subprocess.run(command, input=job, stdout=subprocess.PIPE, check=True)
    grown = json.loads(finished.stdout)["grown_bytes"]
    return float(grown) / (source.width * source.height)


def child() -> None:
    """Render what comes on stdin and print by how much memory grew."""
    import pickle

    from ..rendering import render, silent_weights
    from .bind import _empty_pixel
    from .custom import receive

    own, source, (technique, params), threads = pickle.loads(sys.stdin.buffer.read())
    receive(own)
    render(_empty_pixel(source), technique, params, threads=threads)  # code and threads are there before
    _RESET.write_text("5")  # the peak starts from what is resident now
    before = _resident("VmRSS")
    with silent_weights():  # told already
        render(source, technique, params, threads=threads)
    print(json.dumps({"grown_bytes": max(0, _resident("VmHWM") - before)}))


def _resident(field: str) -> int:
    lines = _STATUS.read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith(f"{field}:"))
    return 1024 * int(kibibytes)
