"""How many frames are timed, and for how long: the same for peers and for what is compared with them.

Imports nothing of oitlab: peers have environments of their own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

WARM_UP = 0.25
LEAST = 1.0
"""Seconds of frames that are not timed, after the first, and of timed ones where frames are short: the first
tens of milliseconds of a process tell more about the machine than about the renderer."""


def paced(frame: Callable[[], Any], repeats: int, budget: float) -> Iterator[tuple[float, Any]]:
    """Warm up, then give seconds and result of `repeats` frames and for `LEAST` seconds, within `budget`.

    A single repetition is a test and not a measurement: it takes no longer than it must.
    """
    warm_up, least = (WARM_UP, LEAST) if repeats > 1 else (0.0, 0.0)
    warm = time.perf_counter() + warm_up
    while time.perf_counter() < warm:
        frame()
    count, spent = 0, 0.0
    while (count < repeats or spent < least) and (not count or spent < budget):
        begin = time.perf_counter()
        result = frame()
        seconds = time.perf_counter() - begin
        count, spent = count + 1, spent + seconds
        yield seconds, result
