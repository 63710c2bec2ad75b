"""Error and time of wboit, lwboit and the painter's algorithm on four meshes that people know.

Every mesh is drawn at 1280 x 720 with opacity 0.35, framed by `oitlab.load` itself. The error is the MSE of
linear RGB against the exact image, given as the factor by which it is smaller than wboit's, as FEE21
[Friederichs2021] gives it. Times are medians of five calls of `oitlab.render`, the techniques taking turns,
so that a busy machine is busy for all of them.
"""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _study import (
    BLUE,
    CHECKOUT,
    GREY,
    ORANGE,
    RED,
    Study,
    markdown_table,
    plot_style,
    show_image,
    srgb,
    stop,
    three_digits,
)

import oitlab

MESHES = {
    "bunny": "scans/stanford_bunny.ply",
    "dragon": "scans/stanford_dragon_res2.ply",
    "engine": "cad/2CylinderEngine.glb",
    "Sponza": "architecture/dabrovic_sponza.obj",
}
OPACITY = 0.35
BINS = (8, 16, 32, 64)
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "a_buffer": ("a_buffer", {}),
    "painter": ("painter", {}),
    "wboit": ("wboit", {}),
    **{f"lwboit {bins}": ("lwboit", {"bins": bins}) for bins in BINS},
}


def main() -> None:
    """Measure, plot, and print the README's table."""
    study = Study.from_command_line("real_meshes", __doc__)
    size, repeats = ((160, 90), 1) if study.quick else ((1280, 720), 5)
    meshes, images = [], []
    for name, path in _found().items():
        scene = oitlab.load(path, opacity=OPACITY, width=size[0], height=size[1])
        record, frames = _measure(scene, repeats)
        meshes.append({"mesh": name, "file": MESHES[name], **record})
        images.append((name, frames))
    plot_style()
    study.save_figure(_sheet(images), "images.png")
    study.save_figure(_error_against_time(meshes), "error_time.png")
    study.save({"opacity": OPACITY, "size": size, "repeats": repeats, "meshes": meshes}, _markdown(meshes))


def _found() -> dict[str, Path]:
    """Find the meshes that are there; say which are not."""
    folder = Path(os.environ.get("OITLAB_DATA", CHECKOUT.parent / "shared" / "data"))
    missing = [name for name in MESHES.values() if not (folder / name).is_file()]
    if missing:
        note = (
            f"not in {folder}: {', '.join(missing)}\nThe meshes are not part of the repository: bunny and "
            "dragon are Stanford's scans, 2CylinderEngine is one of Khronos' glTF samples, Sponza is Marko "
            "Dabrovic's. Put them there, or let OITLAB_DATA name the folder that holds them."
        )
        if len(missing) == len(MESHES):
            stop(note)
        print(note, file=sys.stderr)
    return {name: folder / path for name, path in MESHES.items() if path not in missing}


def _measure(scene: oitlab.Scene, repeats: int) -> tuple[dict[str, Any], dict[str, oitlab.Frame]]:
    frames = dict(zip(VARIANTS, oitlab.render_many(scene, VARIANTS.values()), strict=True))
    calls: dict[str, list[float]] = {label: [] for label in VARIANTS}
    resolves: dict[str, list[float]] = {label: [] for label in VARIANTS}
    for _ in range(repeats):
        for label, (technique, params) in VARIANTS.items():
            start = time.perf_counter()
            frame = oitlab.render(scene, technique, params)
            calls[label].append(1e3 * (time.perf_counter() - start))
            resolves[label].append(frame.stats.resolve_ms)
    exact = frames["a_buffer"]
    error = {label: oitlab.compare(frame, exact, metrics="mse")["mse"] for label, frame in frames.items()}
    rows = [
        {
            "technique": label,
            "mse": error[label],
            "factor": error["wboit"] / error[label] if error[label] else None,
            "call_ms": median(calls[label]),
            "resolve_ms": median(resolves[label]),
            "call_ms_range": [min(calls[label]), max(calls[label])],
        }
        for label in VARIANTS
    ]
    stats = exact.stats
    record = {
        "triangles": sum(len(mesh.faces) for mesh in scene.meshes),
        "fragments": stats.fragments,
        "depth_complexity_mean": stats.depth_complexity_mean,
        "depth_complexity_max": stats.depth_complexity_max,
        "covered": float((exact.fragment_count > 0).mean()),
        "threads": stats.threads,
        "techniques": rows,
    }
    return record, frames


def _markdown(meshes: list[dict[str, Any]]) -> str:
    header = ["mesh", "triangles", "fragments", "per pixel, mean / max", *VARIANTS]
    overview = [
        [
            mesh["mesh"],
            f"{mesh['triangles']:,}",
            f"{mesh['fragments']:,}",
            f"{mesh['depth_complexity_mean']:.2f} / {mesh['depth_complexity_max']}",
            *(_cell(row) for row in mesh["techniques"]),
        ]
        for mesh in meshes
    ]
    details = [
        [
            mesh["mesh"],
            row["technique"],
            f"{255**2 * row['mse']:.3g}",
            _factor(row),
            f"{row['call_ms']:.0f} ({row['call_ms_range'][0]:.0f} to {row['call_ms_range'][1]:.0f})",
            f"{row['resolve_ms']:.1f}",
        ]
        for mesh in meshes
        for row in mesh["techniques"]
    ]
    names = ["mesh", "technique", "MSE (0-255)", "wboit MSE / MSE", "call ms (range)", "resolve ms"]
    return "\n".join(
        [
            "<!-- real_meshes: begin -->",
            markdown_table(header, overview),
            "",
            "Cells: by what factor the MSE is smaller than wboit's; milliseconds of the whole call, of the "
            "resolve alone.",
            "<!-- real_meshes: end -->",
            "",
            markdown_table(names, details),
        ]
    )


def _cell(row: dict[str, Any]) -> str:
    return f"{_factor(row)}; {row['call_ms']:.0f}, {row['resolve_ms']:.0f} ms"


def _factor(row: dict[str, Any]) -> str:
    return "exact" if row["factor"] is None else f"{three_digits(row['factor'])} x"


def _sheet(images: list[tuple[str, dict[str, oitlab.Frame]]]) -> Any:
    """Exact image, depth complexity, and where wboit, painter and lwboit err."""
    labels = ("wboit", "painter", f"lwboit {BINS[-1]}")
    figure, axes = plt.subplots(len(images), 5, figsize=(11, 1.16 * len(images) + 0.4), squeeze=False)
    for row, (name, frames) in zip(axes, images, strict=True):
        exact = frames["a_buffer"]
        show_image(row[0], srgb(exact.color))
        row[0].set_ylabel(name)
        counts = np.where(exact.fragment_count > 0, exact.fragment_count, np.nan)
        heat = show_image(row[1], counts, cmap="cividis", vmin=1)
        figure.colorbar(heat, ax=row[1], fraction=0.03, pad=0.02, label="fragments")
        maps = [oitlab.error_map(frames[label], exact, "absolute") for label in labels]
        highest = max(float(np.quantile(found, 0.999)) for found in maps)
        for place, found in zip(row[2:], maps, strict=True):
            error = show_image(place, found, cmap="inferno", vmin=0, vmax=highest)
        figure.colorbar(error, ax=row[4], fraction=0.03, pad=0.02, label="linear RGB")
    titles = ("exact", "fragments per pixel", *(f"error of {label}" for label in labels))
    for place, title in zip(axes[0], titles, strict=True):
        place.set_title(title)
    return figure


def _error_against_time(meshes: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(
        1, len(meshes), figsize=(1.9 * len(meshes) + 0.4, 2.5), sharey=True, squeeze=False
    )
    for place, mesh in zip(axes[0], meshes, strict=True):
        rows = {row["technique"]: row for row in mesh["techniques"]}
        layered = [rows[f"lwboit {bins}"] for bins in BINS]
        _draw(place, layered, "-", BLUE, None)
        for size, row in enumerate(layered):
            label = "lwboit, 8 to 64 bins, the larger the more" if size == 2 else None
            _draw(place, [row], "o", BLUE, label, size=3 + size)
        _draw(place, [rows["wboit"]], "s", ORANGE, "wboit")
        _draw(place, [rows["painter"]], "^", RED, "painter")
        place.axvline(rows["a_buffer"]["call_ms"], color=GREY, ls=":", lw=1, label="a_buffer (exact)")
        place.set(title=mesh["mesh"], xlabel="whole call (ms)", yscale="log")
        place.set_xlim(0, 1.25 * max(row["call_ms"] for row in mesh["techniques"]))
    axes[0][0].set_ylabel("RMSE, linear RGB (1 = white)")
    handles, names = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4)
    return figure


def _draw(
    place: Any, rows: list[dict[str, Any]], form: str, color: str, label: str | None, *, size: float = 5.0
) -> None:
    times = [row["call_ms"] for row in rows]
    place.plot(times, [math.sqrt(row["mse"]) for row in rows], form, color=color, ms=size, label=label)


if __name__ == "__main__":
    main()
