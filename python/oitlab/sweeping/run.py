"""`oitlab.sweep`: every combination of params on every scene, one row each."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, closing
from functools import partial
from importlib import import_module
from itertools import groupby
from typing import TYPE_CHECKING, Any

from .._callers import outside
from .._convert import count, flag
from ..fragments import Fragments
from ..frame import Frame
from ..rendering import WeightWarning
from ..scene import Scene
from . import plan, told
from .bind import Backend
from .devices import checked_backends, device_of
from .grid import Grid, checked_seeds, expanded
from .memory import can_measure
from .metrics import Metrics, measure_of
from .plan import Wanted
from .shipping import completed
from .study import Study, named_row
from .table import from_rows
from .work import Package, Row, Task, VariantFailed

if TYPE_CHECKING:
    import pandas as pd


_FUNCTIONS = ("weight", "bin_function")
"""Params that may be functions of one's own."""
_NAMED = 5
"""Functions that a warning names."""


class SweepInterrupted(UserWarning):
    """Ctrl-C stopped a sweep, whose table has only what was finished before."""


class SweepFailed(RuntimeError):
    """A sweep broke off: a worker died for good, a metric raised, memory ran out.

    The message names scene, technique and params where one variant is to blame, whose error is the cause.

    Attributes
    ----------
    table : pandas.DataFrame
        The rows that were finished before.
    """

    def __init__(self, message: str, table: pd.DataFrame) -> None:
        super().__init__(message)
        self.table = table

    def __reduce__(self) -> tuple[Any, ...]:
        return SweepFailed, (str(self), self.table)


def sweep(
    scenes: Scene | Fragments | Mapping[str, Scene | Fragments] | Iterable[Scene | Fragments],
    grid: Grid,
    reference: str
    | tuple[str, Mapping[str, Any] | None]
    | Frame
    | Mapping[str, Any]
    | Any
    | None = "a_buffer",
    *,
    metrics: Metrics | None = None,
    metric_options: Mapping[str, Any] | None = None,
    seeds: Iterable[int] | None = None,
    repeats: int = 1,
    store: str | os.PathLike[str] | None = None,
    executor: Executor | None = None,
    threads: int | None = None,
    group: int | None = None,
    measure_memory: bool = False,
    progress: bool = True,
    backend: Backend | Iterable[Backend] = "cpu",
) -> pd.DataFrame:
    """Render every combination of params on every scene and measure it: one tidy row per variant.

    Everything is checked before anything is rendered. Variants that differ only in params without effect are
    one row and are run once; the others share rasterisations in groups. Ctrl-C stops cleanly: the table then
    has what is finished, and a `SweepInterrupted` warning says so.

    Parameters
    ----------
    scenes : Scene, Fragments, mapping of names to them, or iterable of them
        The `scene` column has the names; without names they are scene0, scene1, ...
    grid : mapping of technique ids to params, or iterable of ids and (id, params)
        A param's list, range or 1-D array is swept; anything else, a tuple included, is one value. All
        combinations are rendered, the last param running fastest. Params of None mean the defaults.
    reference : str, (str, params), Frame, (H, W, 3) array, mapping of scenes' names to such, or None
        What images are measured against; rendered once per scene (and worker). None: no error metrics.
    metrics : str, iterable of str, or mapping of names to functions, optional
        Names of `oitlab.compare`, or "all"; `mse` and `max_error` when absent. In a mapping, a function of
        (frame, reference) gives a float, None stands for the metric of that name.
    metric_options : mapping, optional
        `data_range`, `threshold`, `luminance` and `pixels_per_degree` of `oitlab.compare`.
    seeds : iterable of int >= 0, optional
        Seeds of every variant that draws random numbers; the others run once. Scenes keep their seeds.
    repeats : int >= 1
        Renders of each group, for times. Nothing warms up: with three or more, the median is of warm ones.
    store : path, optional
        An SQLite file that gets every row as soon as it is finished and outlives `kill -9`. What it has
        already is not computed again; see Notes. `oitlab.read_study` reads it at any time. It must lie
        on a local disk (not NFS); several sweeps may share it.
    executor : concurrent.futures.Executor, optional
        Where groups are rendered instead of here: a thread or process pool, Dask's
        `Client(...).get_executor()`, `mpi4py.futures.MPIPoolExecutor`. It is not shut down.
    threads : int >= 1, optional
        Of each render; all cores when absent, or 1 under an executor, whose workers are many.
    group : int >= 1, optional
        Most variants that share a rasterisation. 1 gives every variant times of its own; when absent, as
        many as 256 MiB of images hold, at most 64, or 8 under an executor.
    measure_memory : bool
        Fill `bytes_per_pixel_measured` by rendering each variant once more, alone in a fresh process,
        which takes a second or so each. Linux only.
    progress : bool
        Show a progress bar.
    backend : {"cpu", "gpu"} or iterable of them
        Where variants are rendered, as in `oitlab.render`; several are an axis of the grid that runs fastest.
        References are always rendered on the CPU. With an executor, its workers have the device: start
        processes by "spawn", since a fork of a process that has used the GPU cannot use it.

    Returns
    -------
    pandas.DataFrame
        In the order of scenes and grid, with these columns:

        - `scene`, `technique`; every param of the techniques, <NA> where a technique has no such param or the
          param has no effect beside the others; `seed` (<NA> likewise). Functions of a module show their
          qualified names, lambdas, closures, methods and objects a hash of what they compute as well. A param
          named like another column is called `param.<name>`.
        - The metrics.
        - `resolve_ms`, `raster_ms`, `total_ms`: medians over `repeats` of what `Frame.stats` has, with
          `..._spread`, the largest minus the smallest (NaN for one). `raster_ms` is the rasterisation that
          the group shares, `raster_share_ms` that divided by the number of variants; `total_ms` is about
          what the variant would have taken alone. `shared_with` counts the others of the group: where it is
          not 0, times are attributions of one pass.
        - `executor`: its class where there was one, whose neighbours disturb times; <NA> otherwise.
        - `geometry_passes`, `bytes_per_pixel`: of a streaming GPU implementation, with this scene's depth
          complexity. `bytes_per_pixel_measured`: this renderer's peak, see `measure_memory`; NaN without.
        - `dropped` fragments, `invalid_weights` as in `Stats`, and `skipped.<shortcut>`: work avoided.
        - `fragments`, `depth_complexity_mean`, `depth_complexity_max`, `repeats`, `threads`, `backend`,
          `width`, `height`, `scene_hash`, versions, commit, CPU, cores, host and, for rows of the GPU, `gpu`:
          the device and its driver.

    Raises
    ------
    ValueError
        Wrong scenes, techniques, params, metrics, reference or options; a `store` that is something else;
        with `store` or `executor`, functions whose code cannot be seen or that cannot be pickled; params that
        have no form on the GPU, or that the device lacks something for.
    RuntimeError
        `backend="gpu"` without a device, here or in the executor's workers.
    OSError
        A `store` that cannot be written.
    SweepFailed
        An error after the start; its `table` has what was finished, and so has `store`. The others of its
        group are finished first.

    Warns
    -----
    SweepInterrupted
        After Ctrl-C.
    WeightWarning
        Functions of one's own gave what is no weight; once for all rows, from wherever they come.

    Notes
    -----
    A stored row is taken for the one that is wanted if these agree: scene, technique (its code, where it is
    your own) and params with effect; reference; metrics and their options; `repeats` and `measure_memory`;
    oitlab's version and compiled core; backend and, on the GPU, the device with its driver. A scene's name,
    `threads`, `group` and `executor` may differ. A function counts by its bytecode, constants, defaults,
    attributes, closure and what it uses of its own package and of modules without a version; what it calls
    elsewhere counts by name and version.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=20)
    >>> grid = {"wboit": {"weight": ["mb7", "mb9"]}, "lwboit": {"bins": [4, 16]}, "a_buffer": None}
    >>> table = oitlab.sweep({"blades": scene}, grid, progress=False)
    >>> print(table[["scene", "technique", "weight", "bins"]].to_string(index=False))
     scene technique weight  bins
    blades     wboit    mb7  <NA>
    blades     wboit    mb9  <NA>
    blades    lwboit    mb7     4
    blades    lwboit    mb7    16
    blades  a_buffer   <NA>  <NA>
    >>> float(table["mse"].iloc[-1])
    0.0
    """
    named = plan.named_scenes(scenes)
    requests = expanded(grid)
    checked = checked_seeds(seeds)
    times = count(repeats, "repeats")
    if times < 1:
        raise ValueError("repeats must be at least 1, got 0")
    group = None if group is None else _positive(group, "group")
    threads = None if threads is None else _positive(threads, "threads")
    remembers = flag(measure_memory, "measure_memory")
    if remembers and not can_measure():
        raise ValueError("measure_memory: this system does not tell the peak of a process's memory")
    show = flag(progress, "progress")
    backends = checked_backends(backend)
    if remembers and "gpu" in backends:
        raise ValueError("measure_memory: a process's memory is not the device's; it is for backend=\"cpu\"")
    _check_executor(executor)
    packages = plan.packages_of(named, reference)
    measure = measure_of(metrics, metric_options, has_reference=reference is not None)
    conditions = (measure.identity, str(times), str(remembers))
    wanted = plan.wanted_rows(named, packages, requests, checked, conditions, backends)
    by_key = dict(packages.values())
    if store is not None or executor is not None:
        told.check(requests, by_key.values(), measure, travels=executor is not None)
    device = None
    if "gpu" in backends:
        drawn = {row.variant.identity: row.variant for row in wanted if row.variant.backend == "gpu"}
        device = device_of(executor, list(named.values()), list(drawn.values()))
        wanted = plan.on_device(wanted, device)

    largest = plan.LARGEST_GROUP if executor is None else plan.LARGEST_TASK
    cores = threads or (None if executor is None else 1)
    make = partial(Task, measure=measure, repeats=times, threads=cores, measure_memory=remembers)
    with ExitStack() as stack:
        study = None if store is None else stack.enter_context(closing(Study(store)))
        sheet = _Sheet(wanted, study, stack, show=show)
        try:
            sheet.take_from_store()
            tasks = list(plan.tasks_of(sheet.missing(), by_key, make, group, largest, device))
            _run(tasks, by_key, executor, sheet)
        except KeyboardInterrupt:
            warnings.warn(SweepInterrupted(f"stopped by Ctrl-C: {sheet.summary()}"), stacklevel=2)
        except VariantFailed as error:
            what = f"{sheet.scenes_of(error.key)}: {error.what}: {_said(error.__cause__)}"
            raise SweepFailed(f"{what} ({sheet.summary()})", sheet.table()) from error.__cause__
        except Exception as error:
            raise SweepFailed(f"{_said(error)} ({sheet.summary()})", sheet.table()) from error
        table = sheet.table()
        _warn_of_weights(sheet.invalid())
        return table


def _said(error: BaseException | None) -> str:
    return str(error) or type(error).__name__


def _warn_of_weights(rows: Sequence[Row]) -> None:
    if not rows:
        return
    which = list(dict.fromkeys(_function_of(row) for row in rows))
    others = f" and {len(which) - _NAMED} more" if len(which) > _NAMED else ""
    message = (
        f"{len(rows)} rows have fragments for which a function of one's own gave what is no weight or share; "
        f"the least there is took its place, and column invalid_weights counts them: "
        f"{', '.join(which[:_NAMED])}{others}"
    )
    warnings.warn(message, WeightWarning, stacklevel=outside())


def _function_of(row: Row) -> str:
    given = [f"{name}={row['params'][name]!r}" for name in _FUNCTIONS if row["params"].get(name) is not None]
    return f"{row['technique']} ({', '.join(given)})"


def _positive(value: Any, name: str) -> int:
    number = count(value, name)
    if number < 1:
        raise ValueError(f"{name} must be at least 1, got {number}")
    return number


def _check_executor(executor: Any) -> None:
    if executor is None or isinstance(executor, Executor):
        return
    hint = "; a Dask client's is client.get_executor()" if hasattr(executor, "get_executor") else ""
    raise ValueError(f"executor must be a concurrent.futures.Executor, got {type(executor).__name__}{hint}")


def _run(
    tasks: Sequence[Task], packages: Mapping[str, Package], executor: Executor | None, sheet: _Sheet
) -> None:
    if executor is None:
        for package, some in groupby(tasks, lambda task: task.package):
            for task in some:
                if not sheet.has_all(task.keys):  # another sweep may have been here meanwhile
                    for finished in task.rows(packages[package]):
                        sheet.add([finished])
            packages[package].forget()
        return
    used = {task.package: packages[task.package] for task in tasks}
    with closing(completed(executor, list(tasks), used)) as results:
        for rows in results:
            sheet.add([(key, {**row, "executor": type(executor).__name__}) for key, row in rows])


class _Sheet:
    """The rows of a sweep as they are filled in."""

    def __init__(
        self, wanted: Sequence[Wanted], study: Study | None, stack: ExitStack, *, show: bool
    ) -> None:
        # tqdm.auto warns in notebooks without widgets, which a silent sweep does not need
        tqdm: Any = import_module("tqdm.auto" if show else "tqdm").tqdm

        self._wanted = wanted
        self._study = study
        self._rows: dict[tuple[str, str], Row] = {}
        self._scenes: dict[str, list[str]] = {}
        for row in wanted:
            self._scenes.setdefault(row.key, []).append(row.scene)
        bar = tqdm(total=len(wanted), unit="variant", desc="sweep", disable=not show)
        self._bar = stack.enter_context(closing(bar))

    def take_from_store(self) -> None:
        """Fill in what the study has."""
        for key in self._scenes:
            self._take(key)

    def _take(self, key: str) -> bool:
        """Fill in one key from the study; False where it has none."""
        found = self._study.find(key) if self._study else []
        if not found:
            return False
        by_scene = {row["scene"]: row for row in found}
        new = [named_row(found[0], scene) for scene in self._scenes[key] if scene not in by_scene]
        if new and self._study:  # the same scene under another name
            self._study.add((key, row) for row in new)
        self._keep(key, {**by_scene, **{row["scene"]: row for row in new}})
        return True

    def has_all(self, keys: Iterable[str]) -> bool:
        """Whether a study has got all these meanwhile; False without a study."""
        return self._study is not None and all([self._take(key) for key in keys])

    def add(self, rows: Sequence[tuple[str, Row]]) -> None:
        """Store finished rows, then show them."""
        named = [(key, named_row(row, scene)) for key, row in rows for scene in self._scenes[key]]
        if self._study:
            self._study.add(named)
        for key, row in named:
            self._keep(key, {row["scene"]: row})

    def _keep(self, key: str, rows: Mapping[str, Row]) -> None:
        before = len(self._rows)
        for scene in self._scenes[key]:
            if scene in rows:
                self._rows.setdefault((key, scene), rows[scene])
        self._bar.update(len(self._rows) - before)

    def missing(self) -> list[Wanted]:
        """Give what is still to be made."""
        return [row for row in self._wanted if (row.key, row.scene) not in self._rows]

    def table(self) -> pd.DataFrame:
        """Finished rows, in the order in which they were asked for."""
        places = ((row.key, row.scene) for row in self._wanted)
        return from_rows([self._rows[place] for place in places if place in self._rows])

    def invalid(self) -> list[Row]:
        """Give the finished rows with fragments that got no weight of their function."""
        places = ((row.key, row.scene) for row in self._wanted)
        rows = (self._rows[place] for place in places if place in self._rows)
        return [row for row in rows if row["invalid_weights"]]

    def scenes_of(self, key: str) -> str:
        """Name the scenes of a content key."""
        return ", ".join(self._scenes[key])

    def summary(self) -> str:
        """How far it is."""
        kept = f"; {self._study.path} keeps them" if self._study else ""
        return f"{len(self._rows)} of {len(self._wanted)} rows are finished{kept}"
