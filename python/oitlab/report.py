"""Techniques side by side: the comparison, its table and its contact sheet."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ._atomic import replacing
from .metrics import compare

if TYPE_CHECKING:
    from rich.table import Table

    from .frame import Frame
    from .scene import Scene

__all__ = ["Comparison", "Row", "compare_techniques", "table", "write_csv"]

_BASELINE = "wboit"
_CAPTURE_LIMIT = 24_000_000
"""Fragments that may be kept in memory (24 bytes each) so that each technique is timed by itself."""


@dataclass(frozen=True, slots=True)
class Row:
    """One technique's line of the table.

    Attributes
    ----------
    label : str
        Technique id, followed by the parameters that were set.
    mse : float
        Mean squared error of linear RGB against the reference.
    rmse : float
        Its square root.
    max_error : float
        Largest absolute channel error, linear.
    mse_255 : float
        MSE on the 0..255 scale.
    factor : float
        MSE of default wboit divided by this MSE: 2 means half of wboit's error, inf means exact,
        NaN that the registry has no wboit.
    resolve_ms : float
        Milliseconds that the technique itself took on the fragments.
    total_ms : float
        Milliseconds of all that this image needed, such as `painter`'s sort of the primitives: from the
        kept fragments on or, where they are too many to keep, with the shared rasterisation.
    bytes_per_pixel : float
        Memory of a streaming GPU implementation; NaN where a technique of one's own does not say.
    geometry_passes : float
        Times such an implementation draws the geometry, or NaN.
    dropped : int
        Fragments that the technique's capacity lost.

    Examples
    --------
    >>> Row("wboit", 0.01, 0.1, 0.5, 650.25, 1.0, 2.0, 2.5, 12, 1, 0).label
    'wboit'
    """

    label: str
    mse: float
    rmse: float
    max_error: float
    mse_255: float
    factor: float
    resolve_ms: float
    total_ms: float
    bytes_per_pixel: float
    geometry_passes: float
    dropped: int


@dataclass(frozen=True, slots=True)
class Comparison:
    """What `compare_techniques` found.

    Attributes
    ----------
    reference : str
        The exact image.
    frames : tuple of Frame
        One per variant, in the order asked for.
    rows : tuple of Row
        The table's lines, in the same order.

    Examples
    --------
    >>> Comparison.__slots__
    ('reference', 'frames', 'rows')
    """

    reference: Frame
    frames: tuple[Frame, ...]
    rows: tuple[Row, ...]


def compare_techniques(
    scene: Scene,
    variants: Sequence[tuple[str, Mapping[str, Any]]],
    *,
    reference: str = "a_buffer",
    backend: Literal["cpu", "gpu"] = "cpu",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Render a scene with several techniques and measure each against the exact image.

    The scene is rasterised once for the statistics and once more to keep its fragments, on which each
    technique is then timed alone. A scene with too many fragments to keep (more than 24 million) is
    rasterised once for all techniques instead.

    Parameters
    ----------
    scene : Scene
        Any `Scene`.
    variants : sequence of (str, mapping)
        Pairs of technique id and parameters.
    reference : str
        Technique id of the exact image, which the CPU renders.
    backend : {"cpu", "gpu"}
        Of the variants. The GPU draws each twice, so that no time is that of compiling its shaders.
    threads : int, optional
        CPU threads, None for all.
    progress : callable, optional
        Called with the label of each variant when it is done.

    Returns
    -------
    Comparison
        Frames and rows in the order of `variants`.

    Raises
    ------
    ValueError, RuntimeError
        Unknown technique or parameter, or what the backend does not do, as in `render`; before anything is
        rendered.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> result = compare_techniques(scene, [("a_buffer", {}), ("lwboit", {"bins": 16})])
    >>> [row.label for row in result.rows], result.rows[0].mse
    (['a_buffer', 'lwboit bins=16'], 0.0)
    """
    from .rendering import check_variants, render

    wanted = [(technique, dict(params)) for technique, params in variants]
    check_variants(scene, [reference])
    check_variants(scene, wanted, backend)
    exact = render(scene, reference, threads=threads)
    jobs = [*wanted, *_baseline(wanted)]
    frames: list[Frame] = []
    rendered = _rendered(scene, jobs, len(wanted), exact.stats.fragments, backend, threads)
    for job, frame in zip(jobs, rendered, strict=True):
        frames.append(frame)
        if progress is not None:
            progress(label(*job))
    baseline = _baseline_mse(jobs, frames, exact)
    shown = frames[: len(wanted)]
    rows = tuple(_row(label(*job), frame, exact, baseline) for job, frame in zip(wanted, shown, strict=True))
    return Comparison(exact, tuple(shown), rows)


def label(technique: str, params: Mapping[str, Any]) -> str:
    """Name a variant: its technique and the parameters that were set.

    Examples
    --------
    >>> label("lwboit", {"bins": 64, "smooth": False})
    'lwboit bins=64 smooth=false'
    """
    texts = [f"{key}={str(v).lower() if isinstance(v, bool) else v}" for key, v in params.items()]
    return " ".join([technique, *texts])


def _baseline(wanted: Sequence[tuple[str, dict[str, Any]]]) -> list[tuple[str, dict[str, Any]]]:
    """Give the extra job that the error factors need, when it is not among those asked for."""
    from .registry import techniques

    known = any(info.id == _BASELINE for info in techniques())
    return [(_BASELINE, {})] if known and (_BASELINE, {}) not in wanted else []


def _rendered(
    scene: Scene,
    jobs: list[tuple[str, dict[str, Any]]],
    shown: int,
    fragments: int,
    backend: Literal["cpu", "gpu"],
    threads: int | None,
) -> Iterator[Frame]:
    from .rendering import capture, render, render_many

    if backend == "gpu":
        for technique, params in jobs[:shown]:
            for _ in range(2):
                frame = render(scene, technique, params, backend=backend, threads=threads)
            yield frame
        # nobody asked for the others, which a device may lack something for
        yield from render_many(scene, jobs[shown:], threads=threads)
        return
    if fragments > _CAPTURE_LIMIT:
        yield from render_many(scene, jobs, threads=threads)
        return
    kept = capture(scene, threads=threads)
    for technique, params in jobs:
        frame = render(kept, technique, params, threads=threads)
        yield frame.replace(scene_hash=lambda: scene.content_hash)


def _baseline_mse(
    jobs: Sequence[tuple[str, Mapping[str, Any]]], frames: Sequence[Frame], exact: Frame
) -> float:
    for job, frame in zip(jobs, frames, strict=True):
        if job == (_BASELINE, {}):
            return compare(frame, exact, metrics="mse")["mse"]
    return math.nan


def _row(name: str, frame: Frame, exact: Frame, baseline: float) -> Row:
    error = compare(frame, exact)
    exactness = math.nan if math.isnan(baseline) else math.inf
    return Row(
        label=name,
        mse=error["mse"],
        rmse=error["rmse"],
        max_error=error["max_error"],
        mse_255=error["mse_255"],
        factor=baseline / error["mse"] if error["mse"] > 0.0 else exactness,
        resolve_ms=frame.stats.resolve_ms,
        total_ms=frame.stats.total_ms,
        bytes_per_pixel=frame.stats.bytes_per_pixel,
        geometry_passes=frame.stats.geometry_passes,
        dropped=frame.stats.dropped,
    )


_COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("technique", lambda row: row.label),
    ("RMSE", lambda row: f"{row.rmse:.3g}"),
    ("MSE", lambda row: f"{row.mse:.3g}"),
    ("MSE 0-255", lambda row: f"{row.mse_255:.3g}"),
    ("max error", lambda row: f"{row.max_error:.3g}"),
    ("wboit MSE / MSE", lambda row: _factor_text(row.factor)),
    ("resolve ms", lambda row: f"{row.resolve_ms:.1f}"),
    ("total ms", lambda row: f"{row.total_ms:.1f}"),
    ("bytes/pixel", lambda row: _count_text(row.bytes_per_pixel)),
    ("passes", lambda row: _count_text(row.geometry_passes)),
    ("dropped", lambda row: f"{row.dropped:,}"),
)


def table(comparison: Comparison) -> Table:
    """Lay the rows out as a rich table; `headline` belongs above it.

    Parameters
    ----------
    comparison : Comparison
        What `compare_techniques` gave.

    Returns
    -------
    rich.table.Table
        Print it with a `rich.console.Console`.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> table(compare_techniques(scene, [("wboit", {})])).row_count
    1
    """
    from rich import box
    from rich.table import Table

    view = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, (name, _) in enumerate(_COLUMNS):
        view.add_column(name, justify="right" if index else "left", no_wrap=True)
    for row in comparison.rows:
        view.add_row(*(text(row) for _, text in _COLUMNS))
    return view


def headline(comparison: Comparison, title: str) -> str:
    """Say what was drawn: size, fragments, depth complexity, rasterisation time, threads.

    Examples
    --------
    >>> import oitlab
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> headline(compare_techniques(scene, []), "squares")
    'squares, 32 x 18: ... fragments, ... per pixel (at most ...), raster ... ms, ... threads, cpu'
    """
    stats = comparison.reference.stats
    height, width = comparison.reference.color.shape[:2]
    others = {frame.stats.backend for frame in comparison.frames} - {stats.backend}
    return (
        f"{title}, {width} x {height}: {stats.fragments:,} fragments, "
        f"{stats.depth_complexity_mean:.2f} per pixel (at most {stats.depth_complexity_max:,}), "
        f"raster {stats.raster_ms:.1f} ms, {stats.threads} threads, {stats.backend}"
        + "".join(f"; techniques on the {backend}" for backend in sorted(others))
    )


def write_csv(path: str | os.PathLike[str], comparison: Comparison) -> None:
    """Write the rows as CSV, numbers in full precision, atomically.

    Parameters
    ----------
    path : path-like
        The file to write; its folder must exist.
    comparison : Comparison
        What `compare_techniques` gave.

    Raises
    ------
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import oitlab
    >>> result = compare_techniques(oitlab.scenes.squares(width=32, height=18), [("wboit", {})])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_csv(pathlib.Path(folder, "a.csv"), result)
    ...     pathlib.Path(folder, "a.csv").read_text().split(",")[:3]
    ['technique', 'mse', 'rmse']
    """
    names = ["technique", *Row.__slots__[1:]]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([getattr(row, slot) for slot in Row.__slots__] for row in comparison.rows)
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _factor_text(factor: float) -> str:
    if math.isnan(factor):
        return "-"
    if math.isinf(factor):
        return "exact"
    return f"{factor:.3g}" if factor < 1e6 else "> 1e6"


def _count_text(count: float) -> str:
    if math.isnan(count):
        return "-"
    return f"{count:,.0f}" if float(count).is_integer() else f"{count:,.1f}"
