"""How wide a text is in print, and where it breaks."""

from __future__ import annotations

import re
from functools import lru_cache

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath


@lru_cache(maxsize=4096)
def width_of(text: str, size: float) -> float:
    """Width in points of a line in the figures' font.

    Examples
    --------
    >>> width_of("mm", 7.0) > width_of("ii", 7.0) > 0
    True
    """
    if not text.strip():
        return 0.3 * size * len(text)
    font = FontProperties(family="DejaVu Sans", size=size)
    return float(TextPath((0, 0), text, prop=font).get_extents().x1)


def wrapped(text: str, room: float, size: float) -> list[str]:
    """Break a text into lines of at most `room` points: after spaces, `,`, `_`, `/` or, at need, anywhere.

    Examples
    --------
    >>> wrapped("stochastic_transparency samples=4", 90.0, 7.0)
    ['stochastic_transparency', 'samples=4']
    """
    lines = [""]
    for piece in re.findall(r"[^\s_,;/]*[_,;/]?\s*|\s+", text):
        if not piece:
            continue
        if lines[-1] and width_of((lines[-1] + piece).rstrip(), size) > room:
            lines.append("")
        lines[-1] += piece
        while width_of(lines[-1].rstrip(), size) > room and len(lines[-1]) > 1:
            cut = max(
                1, next((n for n in range(len(lines[-1]), 0, -1) if width_of(lines[-1][:n], size) <= room), 1)
            )
            lines[-1:] = [lines[-1][:cut], lines[-1][cut:]]
    return [line.rstrip() for line in lines]
