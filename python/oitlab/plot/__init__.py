"""Plots for papers and notebooks, as matplotlib figures.

Every function gives a `matplotlib.figure.Figure` of a column's or a page's width, with type of 7 points or
more at that size, colours that colour-blind readers can tell apart, dashes and markers for greyscale print,
and units on every axis. The figure is yours alone: nothing is registered with pyplot, no global setting
changes, and a notebook shows it when it is a cell's last value. `oitlab` imports this module, and with it
matplotlib, when it is first used.
"""

from ._axes_table import axes_table
from ._convergence import convergence
from ._heat import depth_complexity, error_map
from ._pareto import pareto
from ._strip import strip
from ._transmittance import transmittance
from ._weights import weight_curves

__all__ = [
    "axes_table",
    "convergence",
    "depth_complexity",
    "error_map",
    "pareto",
    "strip",
    "transmittance",
    "weight_curves",
]
