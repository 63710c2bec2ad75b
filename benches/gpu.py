"""The GPU backend: milliseconds on the device, errors against them, wboit beside peers on the same driver.

Times of passes are the device's own (timestamp queries), readback apart; the whole call has it, and all else.
A first frame compiles shaders and takes the scene to the device; it is shown apart. On a driver that
runs on the processor, such as lavapipe, the peers are those of `peers` that draw with OpenGL or Vulkan there;
their times are whole calls with 8-bit images, which ours is compared with without its float readback.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
from against_peers import one
from arrays import Arrays
from harness import SCENES, Run, markdown_table, plot_style, pooled, scene, three_digits
from pacing import paced
from pareto import front
from peers import PEERS

import oitlab

SIZES = {"1280 x 720": (1280, 720), "3840 x 2160": (3840, 2160)}
"""Of a card's images; --huge for those of a processor, too, which takes minutes for some of them."""
OF_A_PROCESSOR = {"640 x 360": (640, 360)}
Way = Literal["hardware", "compute", "linked_lists"]
STORAGES: dict[str, tuple[str, Way]] = {
    "linked lists": ("ll", "linked_lists"),
    "counted lists": ("ll", "hardware"),
    "layers": ("lr", "hardware"),
}
"""What stores lwboit's fragments: its `storage`, and the path."""
PATHS: tuple[Way, ...] = ("hardware", "compute")
ON_BOTH_PATHS = ("wboit", "alpha_compositing", "mlab", "k_buffer", "multilayer_depth_peeling")
BLENDED = (
    "alpha_compositing",
    "weighted_sum",
    "weighted_average",
    "blended_oit",
    "wboit",
    "phenomenological",
)
"""What draws once and keeps nothing of a pixel but its targets, which every fragment reads and writes."""
AIM = 1.5
"""Times the fastest peer's milliseconds that wboit may take on a driver that runs on the processor."""


def frames(
    what: oitlab.Scene,
    name: str,
    params: dict[str, Any],
    run: Run,
    path: Way = "hardware",
) -> dict[str, Any]:
    """The first frame's whole call, and medians of further ones' passes and calls, as many as time allows."""
    start = time.perf_counter()
    frame = oitlab.gpu.render(what, name, params, path=path)
    first = 1e3 * (time.perf_counter() - start)
    if first < 1e3 * run.budget:
        # some drivers compile while they draw; what takes longer than that is not changed by it
        oitlab.gpu.render(what, name, params, path=path)
    calls: list[float] = []
    passes: list[tuple[float, float]] = []
    while not calls or (len(calls) < min(run.repeats, 5) and sum(calls) < 1e3 * run.budget):
        start = time.perf_counter()
        frame = oitlab.gpu.render(what, name, params, path=path)
        calls.append(1e3 * (time.perf_counter() - start))
        passes.append((frame.stats.raster_ms, frame.stats.resolve_ms))
    raster, resolve = (statistics.median(times) for times in zip(*passes, strict=True))
    return {
        **pooled(sum(times) for times in passes),
        "raster_ms": raster,
        "resolve_ms": resolve,
        "bytes_per_pixel": frame.stats.bytes_per_pixel,
        "call_ms": statistics.median(calls),
        "first_call_ms": first,
        "fragments_per_second": 1e3 * frame.stats.fragments / max(raster + resolve, 1e-9),
        "frame": frame,
    }


def on_scene(name: str, run: Run, size: tuple[int, int], info: Any) -> dict[str, Any]:
    """Every technique with a form on one scene."""
    what = of_size(name, run, size)
    exact = oitlab.render(what, "a_buffer", dtype="float64")
    rows = {}
    for technique in info.techniques:
        found = frames(what, technique, {}, run)
        frame = found.pop("frame")
        cpu = oitlab.render(what, technique)
        found["rmse"] = oitlab.compare(frame, exact)["rmse"]
        found["rmse_cpu"] = oitlab.compare(cpu, exact)["rmse"]
        found["off_cpu"] = float(np.abs(frame.color - cpu.color).max())
        found["cpu_ms"] = cpu.stats.total_ms
        rows[technique] = found
    best = front({n: (row["median_ms"], row["rmse"]) for n, row in rows.items()})
    return {"fragments": exact.stats.fragments, "techniques": rows, "pareto_front": best}


def of_size(name: str, run: Run, size: tuple[int, int]) -> oitlab.Scene:
    """A scene for images of that size."""
    what = scene(name, run)
    return what if run.quick else what.replace(width=size[0], height=size[1])


def storages(run: Run, size: tuple[int, int]) -> dict[str, dict[str, float]]:
    """FEE21 table 3: lwboit by linked lists and by layered rendering, on every scene."""
    found: dict[str, dict[str, float]] = {}
    for name in SCENES:
        what = of_size(name, run, size)
        times = {
            label: frames(what, "lwboit", {"storage": storage}, run, path)["median_ms"]
            for label, (storage, path) in STORAGES.items()
        }
        found[name] = {**times, "triangles": sum(len(mesh.faces) for mesh in what.meshes)}
    return found


def paths(run: Run, size: tuple[int, int]) -> dict[str, dict[str, dict[str, float]]]:
    """What has a form for both rasters, by both."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in SCENES:
        what = of_size(name, run, size)
        found[name] = {
            technique: {path: frames(what, technique, {}, run, path)["median_ms"] for path in PATHS}
            for technique in ON_BOTH_PATHS
        }
    return found


def passes_of_wboit(what: oitlab.Scene, run: Run) -> list[float]:
    """Milliseconds of all passes of a frame, of as many frames as are timed of a peer."""
    oitlab.gpu.render(what, "wboit")
    found = paced(lambda: oitlab.gpu.render(what, "wboit").stats, run.repeats, run.budget)
    return [stats.raster_ms + stats.resolve_ms for _, stats in found]


def beside_peers(run: Run) -> dict[str, dict[str, Any]]:
    """Measure the WBOIT peers on every scene, each in a process of its own, between two runs of wboit."""
    modes = [(p, mode) for p in run.peers for mode, kind in PEERS[p].items() if kind == "wboit"]
    found: dict[str, dict[str, Any]] = {}
    for name in SCENES:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            Arrays.of(scene(name, run)).save(folder / "scene.npz")
            ours = passes_of_wboit(scene(name, run), run)
            found[name] = {}
            for peer, mode in modes:
                result = one(run.peer_python, peer, mode, folder, run)
                if "times_ms" in result:
                    found[name][f"{peer} {mode}"] = pooled(result["times_ms"])
            ours += passes_of_wboit(scene(name, run), run)
            found[name]["wboit"] = pooled(ours)
    return found


def main(run: Run) -> None:
    """Measure, and write gpu.json, gpu.md and gpu.png; say why not where there is no device."""
    try:
        info = oitlab.gpu.info()
    except RuntimeError as error:
        print(f"skipped: {error}\n", file=sys.stderr)
        return
    is_processor = info.kind == "Cpu"
    sizes = SIZES if run.huge or not is_processor else OF_A_PROCESSOR
    if run.quick:
        sizes = {"160 x 90": (160, 90)}
    results = {
        label: {name: on_scene(name, run, size, info) for name in SCENES} for label, size in sizes.items()
    }
    layers = storages(run, next(iter(sizes.values())))
    rasters = paths(run, next(iter(sizes.values())))
    peers = beside_peers(run) if is_processor else {}
    first = next(iter(results.values()))
    draw(first, run)
    device = {
        "adapter": info.adapter,
        "kind": info.kind,
        "driver": f"{info.driver} {info.driver_info}",
        "interface": info.interface,
        "features": dict(info.features),
        "limits": dict(info.limits),
        "copy_bandwidth": oitlab.gpu.copy_bandwidth(),
    }
    parts = [f"Device: {info.adapter} ({info.kind}, {info.interface}; {info.driver} {info.driver_info})."]
    for label, found in results.items():
        parts += tables(label, found)
        parts += table_of_memory(label, found, device["copy_bandwidth"])
    parts += table_of_storages(layers)
    parts += table_of_paths(rasters)
    parts += table_of_peers(peers)
    saved = {"device": device, "sizes": results, "storages": layers, "paths": rasters, "peers": peers}
    run.save("gpu", saved, "\n\n".join(parts))


def tables(label: str, results: dict[str, Any]) -> list[str]:
    """Device time with its error, whole calls, and fragments per second."""
    names = list(next(iter(results.values()))["techniques"])

    def table(cell: Any) -> str:
        rows = [[n, *(cell(row["techniques"][n], n, row) for row in results.values())] for n in names]
        return markdown_table(["technique", *results], rows)

    def timed(found: dict[str, Any], name: str, row: dict[str, Any]) -> str:
        text = f"{three_digits(found['median_ms'])}, {found['rmse']:.1e}"
        return f"**{text}**" if name in row["pareto_front"] else text

    def calls(found: dict[str, Any], _name: str, _row: dict[str, Any]) -> str:
        numbers = (found["call_ms"], found["first_call_ms"], found["cpu_ms"])
        return " / ".join(three_digits(number) for number in numbers)

    return [
        f"{label}: milliseconds of all passes on the device, and RMSE against the float64 exact image; bold: "
        "on the Pareto front.",
        table(timed),
        f"{label}: milliseconds of a whole call with readback / of the first one, which compiles and uploads "
        "/ of the CPU backend.",
        table(calls),
        f"{label}: millions of fragments per second on the device / largest difference from the CPU backend.",
        table(lambda f, _n, _r: f"{f['fragments_per_second'] / 1e6:,.0f} / {f['off_cpu']:.0e}"),
    ]


def table_of_memory(label: str, results: dict[str, Any], bandwidth: float) -> list[str]:
    """What blended fragments ask of the device's memory, beside what it does when it copies."""

    def share(found: dict[str, Any], fragments: int) -> str:
        asked = 2 * found["bytes_per_pixel"] * fragments / (1e-3 * max(found["raster_ms"], 1e-9))
        return f"{100 * asked / bandwidth:.0f} %"

    rows = [
        [name, *(share(row["techniques"][name], row["fragments"]) for row in results.values())]
        for name in BLENDED
        if all(name in row["techniques"] for row in results.values())
    ]
    return [
        f"{label}: bytes of targets that fragments read and write per second of the passes over the geometry,"
        f" in parts of the {bandwidth / 1e9:,.1f} GB/s of a copy. Caches may take them beyond all of it.",
        markdown_table(["technique", *results], rows),
    ]


def table_of_storages(found: dict[str, dict[str, float]]) -> list[str]:
    """Milliseconds of all."""
    rows = [
        [
            name,
            f"{row['triangles']:,}",
            *(three_digits(row[s]) for s in STORAGES),
            f"{row['layers'] / row['linked lists']:.2f}",
        ]
        for name, row in found.items()
    ]
    return [
        "lwboit by lists, which draw the geometry once (linked) or twice (counted), and by layered rendering,"
        " as often as its bins and its shape ask for: milliseconds on the device (FEE21 table 3).",
        markdown_table(["scene", "triangles", *STORAGES, "layers / linked lists"], rows),
    ]


def table_of_paths(found: dict[str, dict[str, dict[str, float]]]) -> list[str]:
    """Milliseconds of both."""
    rows = [
        [
            technique,
            *(" / ".join(three_digits(row[technique][path]) for path in PATHS) for row in found.values()),
        ]
        for technique in ON_BOTH_PATHS
    ]
    return [
        "Milliseconds on the device by its own raster / by the one in compute.",
        markdown_table(["technique", *found], rows),
    ]


def table_of_peers(peers: dict[str, dict[str, Any]]) -> list[str]:
    """Compare wboit's passes with the fastest peer's call on each scene."""
    rows = []
    for name, found in peers.items():
        others = {peer: row["median_ms"] for peer, row in found.items() if peer != "wboit"}
        if not others:
            continue
        best = min(others, key=lambda peer: others[peer])
        theirs, ours = others[best], found["wboit"]["median_ms"]
        rows.append([name, best, three_digits(theirs), three_digits(ours), f"{ours / theirs:.2f}"])
    if not rows:
        return []
    header = ["scene", "fastest WBOIT peer", "its ms", "wboit ms", f"ratio (aim: {AIM})"]
    return ["wboit's passes beside the fastest peer on the same driver.", markdown_table(header, rows)]


def draw(results: dict[str, Any], run: Run) -> None:
    """One panel per scene: error against the device's time, the front joined and named."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from pareto import draw_front, name_front

    plot_style()
    figure, panels = plt.subplots(2, 3, figsize=(11, 7))
    for axes, (name, row) in zip(panels.flat, results.items(), strict=False):
        draw_front(axes, name, row)
        axes.set_xlabel("milliseconds on the device")
    panels.flat[-1].axis("off")
    panels.flat[-1].text(0, 0.7, "Every technique with a GPU form, default params.\n"
                         "Blue: the Pareto front, named where\nthere is room.\n"
                         "Errors below 1e-7 are drawn at 1e-7.", fontsize=9)  # fmt: skip
    figure.draw_without_rendering()
    for axes, row in zip(panels.flat, results.values(), strict=False):
        name_front(axes, row)
    run.save_figure(figure, "gpu")
    plt.close(figure)
