"""What distinguishes the lines of every plot here, in colour and without."""

from typing import Any

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""Okabe and Ito's palette: told apart by colour-blind readers, and by lightness in greyscale print."""
GREY = "#777777"
LIGHT_GREY = "#DDDDDD"

SERIES = (BLUE, RED, GREEN, PINK, SKY, ORANGE, BLACK)
"""Colours of lines, in order; yellow is left out, since it vanishes on white paper."""
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")


def series(index: int) -> tuple[str, Any, str]:
    """Colour, dash and marker of the line with this index: no two of the first 70 agree in colour and marker.

    Examples
    --------
    >>> series(0), series(1)[0]
    (('#0072B2', '-', 'o'), '#D55E00')
    >>> len({series(index)[::2] for index in range(70)})
    70
    """
    return SERIES[index % 7], DASHES[index % 6], MARKERS[index % 10]
