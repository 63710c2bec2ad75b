"""Sweeps: grids of techniques and params over scenes, as tidy tables.

`grid` multiplies values out, `bind` checks and resolves them, `plan` makes tasks of what is not stored yet,
`work` runs a task, `shipping` sends tasks to executors, `study` stores rows, `table` shows them, and `run` is
the one place that names all of these.
"""

from .run import SweepFailed, SweepInterrupted, sweep
from .study import read_study
from .table import to_xarray

__all__ = ["SweepFailed", "SweepInterrupted", "read_study", "sweep", "to_xarray"]
