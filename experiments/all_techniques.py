"""Every technique of the registry, with its defaults, on five procedural scenes and three known meshes.

The meshes have opacity 0.35 and the framing of `oitlab.load`. What is measured is what `oitlab compare`
prints: RMSE and largest error of linear RGB against the exact image, by what factor the MSE is smaller than
wboit's [Friederichs2021], milliseconds that the technique itself took on the fragments, and the bytes per
pixel and geometry passes of a streaming GPU implementation. Techniques whose image depends on the order of
submission are measured in the order of the file and in a random one: a file may be sorted by luck.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from _study import CHECKOUT, ORANGE, Study, markdown_table, plot_style, three_digits
from matplotlib.colors import TwoSlopeNorm
from matplotlib.lines import Line2D

import oitlab
from oitlab.report import Comparison, Row, compare_techniques, headline
from oitlab.sheet import write_contact_sheet

SCENES = ("squares", "soup", "shells", "smoke", "blades")
MESHES = {
    "dragon": "scans/stanford_dragon_res2.ply",
    "engine": "cad/2CylinderEngine.glb",
    "Sponza": "architecture/dabrovic_sponza.obj",
}
OPACITY = 0.35
SHEETS = ("blades", "engine")
"""Scenes whose pictures and error maps are kept."""
AS_EXACT = 1e-6
"""An RMSE from here on down is float32's rounding."""
NOT_DRAWN = ("a_buffer", "painter", "depth_peeling", "dual_depth_peeling", "deep_shadow_maps", "continuum")
"""What sorts, stores everything, takes a pass per layer, or is another technique by default."""


def main() -> None:
    """Measure, plot, write the tables."""
    study = Study.from_command_line("all_techniques", __doc__)
    size = (160, 90) if study.quick else (640, 360)
    defaults = [(name, {}) for name in oitlab.techniques().ids]
    ordered = [name for name, _ in defaults if not oitlab.techniques()[name].properties["order_independent"]]
    variants = [*defaults, *((name, {"submission_order": "shuffled"}) for name in ordered)]
    measured = []
    for name, command, scene in _scenes(*size):
        comparison = compare_techniques(scene, variants)
        title = headline(comparison, name)
        measured.append({"scene": name, "command": command, "headline": title, "rows": _rows(comparison)})
        if name in SHEETS:
            path = study.folder / f"{name.lower()}.png"
            n = len(defaults)
            first = replace(comparison, rows=comparison.rows[:n], frames=comparison.frames[:n])
            write_contact_sheet(path, first, title, columns=6, cell_width=320)
        print(title, file=sys.stderr)
    plot_style()
    study.save_figure(_factors(measured), "factors.png")
    study.save_figure(_error_against_memory(measured), "memory.png")
    study.save({"opacity": OPACITY, "size": size, "scenes": measured}, _markdown(measured))


def _scenes(width: int, height: int) -> Iterator[tuple[str, str, oitlab.Scene]]:
    """Give name, equivalent command, and scene; say which meshes are missing."""
    size = f"--width {width} --height {height}"
    for name in SCENES:
        scene = oitlab.scenes.SCENES[name](width=width, height=height)
        yield name, f"oitlab compare scene:{name} {size}", scene
    folder = Path(os.environ.get("OITLAB_DATA", CHECKOUT.parent / "shared" / "data"))
    for name, file in MESHES.items():
        if (folder / file).is_file():
            scene = oitlab.load(folder / file, opacity=OPACITY, width=width, height=height)
            yield name, f"oitlab compare $OITLAB_DATA/{file} --opacity {OPACITY} {size}", scene
        else:
            print(
                f"left out: {name}, because {folder / file} is not there. The meshes are not part of the "
                "repository (see docs/real_meshes.md); let OITLAB_DATA name the folder that holds them.",
                file=sys.stderr,
            )


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    return [
        {
            "technique": row.label.replace(" submission_order=", ", "),
            "rmse": row.rmse,
            "max_error": row.max_error,
            "factor": None if _is_exact(row) else row.factor,
            "resolve_ms": row.resolve_ms,
            "bytes_per_pixel": row.bytes_per_pixel,
            "geometry_passes": row.geometry_passes,
            "dropped": row.dropped,
        }
        for row in comparison.rows
    ]


def _is_exact(row: Row) -> bool:
    return row.rmse <= AS_EXACT


def _markdown(measured: list[dict[str, Any]]) -> str:
    names = [row["technique"] for row in measured[0]["rows"]]
    table = _factor_table(measured)
    overview = [[f"`{name}`", *map(_factor, line)] for name, line in zip(names, table, strict=True)]
    parts = [
        markdown_table(["wboit's MSE / MSE", *(entry["scene"] for entry in measured)], overview),
        "",
        f'"exact": RMSE of {AS_EXACT:g} or less.',
    ]
    header = ["technique", "RMSE", "max error", "wboit MSE / MSE", "resolve ms", "bytes/pixel", "passes"]
    for entry in measured:
        rows = [
            [
                f"`{row['technique']}`",
                f"{row['rmse']:.3g}",
                f"{row['max_error']:.3g}",
                _factor(row["factor"]),
                f"{row['resolve_ms']:.1f}",
                three_digits(row["bytes_per_pixel"]).removesuffix(".0"),
                f"{row['geometry_passes']:g}",
            ]
            for row in entry["rows"]
        ]
        title = f"## {entry['scene']}\n\n{entry['headline'].partition(': ')[2]}\n\n    {entry['command']}\n"
        parts += ["", title, markdown_table(header, rows)]
    return "\n".join(parts)


def _factor_table(measured: list[dict[str, Any]]) -> list[tuple[float | None, ...]]:
    """Give one line per technique, one column per scene."""
    columns = [[row["factor"] for row in entry["rows"]] for entry in measured]
    return list(zip(*columns, strict=True))


def _factor(factor: float | None) -> str:
    return "exact" if factor is None else three_digits(factor)


def _factors(measured: list[dict[str, Any]]) -> Any:
    """Draw the overview as a map: blue is better than wboit, red worse."""
    table = _factor_table(measured)
    power = np.array([[5.0 if f is None else math.log10(f) for f in line] for line in table])
    figure, place = plt.subplots(figsize=(1.0 + 0.72 * len(measured), 0.5 + 0.19 * len(table)))
    norm = TwoSlopeNorm(0.0, -2.0, 5.0)
    place.imshow(np.clip(power, -2.0, 5.0), cmap="RdBu", norm=norm, aspect="auto")
    for y, line in enumerate(table):
        for x, factor in enumerate(line):
            dark = norm(np.clip(power[y, x], -2, 5)) > 0.8 or norm(np.clip(power[y, x], -2, 5)) < 0.2
            color = "white" if dark else "black"
            place.text(x, y, _factor(factor), ha="center", va="center", fontsize=6.5, color=color)
    place.set_xticks(range(len(measured)), [entry["scene"] for entry in measured])
    place.set_yticks(range(len(table)), [row["technique"] for row in measured[0]["rows"]])
    place.xaxis.tick_top()
    place.tick_params(length=0, labelsize=7)
    place.grid(visible=False)
    place.spines[:].set(visible=False)
    figure.supxlabel("by what factor the MSE is smaller than wboit's", fontsize=7.5)
    return figure


def _error_against_memory(measured: list[dict[str, Any]]) -> Any:
    """Name the techniques that no other one beats in both error and memory."""
    columns = 3
    lines = math.ceil(len(measured) / columns)
    size = (11, 3.3 * lines)
    figure, axes = plt.subplots(lines, columns, figsize=size, squeeze=False, layout="none")
    edge = 0.55 / size[1]
    figure.subplots_adjust(0.06, 1.2 * edge, 0.99, 1 - 0.6 * edge, wspace=0.2, hspace=0.32)
    for place in axes.flat[len(measured) :]:
        place.set_visible(False)
    for place, entry in zip(axes.flat, measured, strict=False):
        rows = [r for r in entry["rows"] if r["technique"] not in NOT_DRAWN and "," not in r["technique"]]
        place.set_title(entry["scene"])
        oitlab.plot.pareto(pd.DataFrame(rows), "bytes_per_pixel", "rmse", floor=AS_EXACT, width=3.6, ax=place)
        wboit = next(r for r in rows if r["technique"] == "wboit")
        place.plot(wboit["bytes_per_pixel"], wboit["rmse"], "s", ms=4, color=ORANGE, zorder=4)
    legend = axes.flat[0].get_legend()
    texts = [text.get_text() for text in legend.get_texts()]
    handles = [*legend.legend_handles, Line2D([], [], linestyle="none", marker="s", ms=4, color=ORANGE)]
    for place in axes.flat[: len(measured)]:
        place.get_legend().remove()
    figure.legend(handles, [*texts, "wboit"], loc="lower right", ncols=len(handles))
    return figure


if __name__ == "__main__":
    main()
