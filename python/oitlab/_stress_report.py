"""What the stress lab found, for people: tables in Markdown, CSV, and errors against layers as a plot."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._atomic import replacing
from ._palette import GREY, series
from ._provenance import provenance
from ._stress_cases import CASES
from .registry import techniques
from .stress_lab import stress

if TYPE_CHECKING:
    import pandas as pd

PLOTTED = "layers_thin"
"""The case whose errors are drawn against the number of layers."""
_GROWING = ("layers_faint", "layers_thin", "layers_dense")
_DRAWN = (1e-9, 10.0)
"""Errors are drawn within these: two images that agree to the bit have none to put on a logarithmic axis."""

_ERRORS = "Errors are the largest of a channel, relative to the reference where that exceeds 1."
_COLUMNS = """\
Storage error: against the technique in float64. Error: against `a_buffer`. Layers: first number of layers, of
alpha 0.002, 0.1 and 0.9, at which the storage error has left the tolerance. Rescued: cases in which stored
numbers were infinite and read as the largest one. Rings: cases in which T(z) rises or is no share. Coverage:
cases in which the background's share is not the product of 1 - alpha to 2^-24."""

_STYLES = tuple(map(series, range(6)))
_EXACT_COLOR = GREY


def run(
    names: Sequence[str],
    formats: Sequence[str],
    seed: int,
    tolerance: float,
    threads: int | None,
    progress: Callable[[str], None],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Run the battery on every technique; give the table and, for the plot, errors by number of layers."""
    import pandas as pd

    tables, curves = [], []
    for name in names:
        progress(name)
        keywords: dict[str, Any] = {
            "formats": formats,
            "seed": seed,
            "tolerance": tolerance,
            "threads": threads,
        }
        tables.append(stress(name, **keywords))
        curves.append(stress(name, cases=[PLOTTED], per_layers=True, **keywords))
    table = pd.concat(tables, ignore_index=True)
    if table.empty:
        raise ValueError(f"formats: none of {', '.join(names)} can store anything in {', '.join(formats)}")
    return table, pd.concat(curves, ignore_index=True)


def write(
    folder: Path, table: pd.DataFrame, curves: pd.DataFrame, command: str, tolerance: float
) -> list[Path]:
    """Write table.md, table.csv and error_against_layers.png into a folder that exists; give their paths."""
    about = {"command": command, **provenance()}
    image = io.BytesIO()
    figure(curves, tolerance).savefig(image, format="png", dpi=150)
    files = {
        "table.md": (markdown(table, tolerance) + footer(about)).encode(),
        "table.csv": table.to_csv(index=False, float_format="%.4g").encode(),
        "error_against_layers.png": image.getvalue(),
    }
    for name, content in files.items():
        with replacing(folder / name) as path:
            path.write_bytes(content)
    return [folder / name for name in files]


def footer(about: Mapping[str, Any]) -> str:
    """Say what made the table, when and where."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    machine = f"{about['cpu']}, {about['cores']} cores, {about['system']}"
    return f"\n`{about['command']}`, {about['date']}, commit {about['commit']}, {machine}; {versions}.\n"


def markdown(table: pd.DataFrame, tolerance: float) -> str:
    """Lay the findings out: one row per technique and format, MB13's statements, and what the cases are."""
    cases = [(case.name, f"{max(case.layers):,}", case.doc) for case in CASES]
    parts = [
        "# The stress lab",
        f"{_ERRORS} A result has left the tolerance where its error exceeds {tolerance:.3g}. All rows are in "
        "table.csv; `oitlab.stress` says what its columns mean.",
        "## By technique and format",
        _COLUMNS,
        _summary(table),
        "## What McGuire and Bavoil say of 16-bit targets",
        "First number of layers at which the storage error has left the tolerance, and the largest error.",
        _statements(table),
        "## The cases",
        _lines(("case", "layers", "what it is"), cases),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _summary(table: pd.DataFrame) -> str:
    rows = []
    for (technique, name), group in table.groupby(["technique", "format"], sort=False):
        by_case = group.set_index("case")
        layers = [_layers(by_case, case) for case in _GROWING]
        rows.append(
            (
                f"`{technique}`",
                str(name) if group["stored_as"].iloc[0] == name else str(group["stored_as"].iloc[0]),
                _worst(group, "error_f64"),
                " / ".join(layers),
                _worst(group, "error_exact"),
                _tally(group["rescued"] > 0),
                _tally(~group["monotone"]),
                _tally(~group["exact_coverage"]),
                _tally(~group["finite"]),
            )
        )
    header = ("technique", "stored as", "largest storage error", "layers", "largest error")
    return _lines((*header, "rescued", "rings", "coverage", "not finite"), rows)


def _statements(table: pd.DataFrame) -> str:
    names = [case.name for case in CASES if case.name.startswith("mb13_")]
    summed = {entry.id for entry in techniques() if any(param.name == "summation" for param in entry.params)}
    rows = []
    found = table[table["technique"].isin(summed) & table["case"].isin(names)]
    for (technique, name), group in found.groupby(["technique", "format"], sort=False):
        by_case = group.set_index("case")
        rows.append((f"`{technique}`", str(name), *(_statement(by_case, case) for case in names)))
    return (
        _lines(("technique", "format", *names), rows)
        if rows
        else "None of these techniques sums weighted colours."
    )


def _statement(by_case: pd.DataFrame, case: str) -> str:
    if case not in by_case.index:
        return "–"
    return f"{_layers(by_case, case)} ({_numbers(by_case, 'error_f64')[case]:.1g})"


def _layers(by_case: pd.DataFrame, case: str) -> str:
    if case not in by_case.index or math.isnan(_numbers(by_case, "error_f64")[case]):
        return "–"
    first = _numbers(by_case, "layers_storage")[case]
    return "never" if math.isnan(first) else f"{int(first):,}"


def _worst(group: pd.DataFrame, column: str) -> str:
    errors = _numbers(group.set_index("case"), column)
    known = {case: error for case, error in errors.items() if not math.isnan(error)}
    if not known:
        return "–"
    case = max(known, key=known.__getitem__)
    return f"{known[case]:.2g} ({case})"


def _numbers(by_case: pd.DataFrame, column: str) -> dict[str, float]:
    """Give a column by case, NaN where something is missing."""
    values = by_case[column].to_numpy(dtype=float, na_value=math.nan)
    return dict(zip(map(str, by_case.index), map(float, values), strict=True))


def _tally(marks: Any) -> str:
    known = marks.dropna()
    return f"{int(known.sum())} of {len(known)}" if len(known) else "–"


def _lines(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, [":--"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def figure(curves: pd.DataFrame, tolerance: float) -> Any:
    """Draw errors against the number of layers, a panel per technique and a line per format."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(curves["technique"]))
    formats = list(dict.fromkeys(curves["format"]))
    columns = min(6, len(names))
    rows = math.ceil(len(names) / columns)
    drawing = Figure(figsize=(2.6 * columns + 1.4, 2.1 * rows + 1.2), layout="constrained")
    panels = drawing.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, name in zip(panels.flat, names, strict=False):
        _panel(panel, curves[curves["technique"] == name], formats, tolerance)
        panel.set_title(name, fontsize=10)
    for panel in list(panels.flat)[len(names) :]:
        panel.set_axis_off()
    handles, labels = _legend(formats, tolerance)
    drawing.legend(
        handles, labels, loc="outside upper center", ncols=min(len(labels), 1 + columns // 2), fontsize=11
    )
    drawing.supxlabel("layers of alpha 0.1 in a pixel (number)", fontsize=11)
    drawing.supylabel(
        f"largest error of a channel (linear RGB, 1 = white; less than {_DRAWN[0]:.0e} at the bottom)",
        fontsize=11,
    )
    return drawing


def _panel(panel: Any, curves: pd.DataFrame, formats: Sequence[str], tolerance: float) -> None:
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(*_DRAWN)
    panel.axhline(tolerance, color="black", linewidth=0.8, linestyle=":")
    for name, (color, dash, marker) in zip(formats, _STYLES, strict=False):
        line = curves[curves["format"] == name]
        stored = line[line["error_f64"].notna()]
        errors = stored["error_f64"].clip(*_DRAWN)
        panel.plot(
            stored["layers"],
            errors,
            color=color,
            linestyle=dash,
            marker=marker,
            markersize=3.5,
            linewidth=1.3,
        )
    widest = curves[curves["format"] == curves["format"].iloc[0]]
    errors = widest["error_exact"].clip(*_DRAWN)
    panel.plot(widest["layers"], errors, color=_EXACT_COLOR, linewidth=2.2, alpha=0.6)
    panel.grid(color="#dddddd", linewidth=0.5)
    panel.tick_params(labelsize=9)


def _legend(formats: Sequence[str], tolerance: float) -> tuple[list[Any], list[str]]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=color, linestyle=dash, marker=marker, markersize=5)
        for _, (color, dash, marker) in zip(formats, _STYLES, strict=False)
    ]
    labels = [f"{name}, against the technique in float64" for name in formats[: len(handles)]]
    handles.append(Line2D([], [], color=_EXACT_COLOR, linewidth=2.2, alpha=0.6))
    handles.append(Line2D([], [], color="black", linewidth=0.8, linestyle=":"))
    first = formats[0] if formats else ""
    return handles, [*labels, f"{first}, against a_buffer", f"tolerance {tolerance:.2g}"]
