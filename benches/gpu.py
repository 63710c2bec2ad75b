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
from typing import Any

import numpy as np
from against_peers import one
from arrays import Arrays
from harness import SCENES, Run, markdown_table, plot_style, pooled, scene, three_digits
from pareto import front
from peers import PEERS

import oitlab

SIZES = {"1280 x 720": (1280, 720), "3840 x 2160": (3840, 2160)}
"""The larger one where the device is no processor, or with --huge."""
ASKED: dict[str, dict[str, Any]] = {"lwboit": {"storage": "ll"}}
"""Params of techniques whose defaults have no form."""
STORAGES = ("ll", "lr")
AIM = 1.5
"""Times the fastest peer's milliseconds that wboit may take on a driver that runs on the processor."""


def forms(info: Any) -> dict[str, dict[str, Any]]:
    """Every technique that the device renders, and the params that it takes for that."""
    known = {name: ASKED.get(name, {}) for name in info.techniques}
    return known | {name: params for name, params in ASKED.items() if "gpu" in backends(name)}


def backends(name: str) -> tuple[str, ...]:
    """Where a technique runs."""
    return tuple(oitlab.techniques()[name].backends)


def frames(what: oitlab.Scene, name: str, params: dict[str, Any], repeats: int) -> dict[str, Any]:
    """The first frame's whole call, and the medians of the others' passes and calls."""
    start = time.perf_counter()
    frame = oitlab.render(what, name, params, backend="gpu")
    first = 1e3 * (time.perf_counter() - start)
    # some drivers compile while they draw
    oitlab.render(what, name, params, backend="gpu")
    calls, passes = [], []
    for _ in range(repeats):
        start = time.perf_counter()
        frame = oitlab.render(what, name, params, backend="gpu")
        calls.append(1e3 * (time.perf_counter() - start))
        passes.append((frame.stats.raster_ms, frame.stats.resolve_ms))
    raster, resolve = (statistics.median(times) for times in zip(*passes, strict=True))
    return {
        **pooled(sum(times) for times in passes),
        "raster_ms": raster,
        "resolve_ms": resolve,
        "call_ms": statistics.median(calls),
        "first_call_ms": first,
        "fragments_per_second": 1e3 * frame.stats.fragments / max(raster + resolve, 1e-9),
        "frame": frame,
    }


def on_scene(name: str, run: Run, size: tuple[int, int], info: Any) -> dict[str, Any]:
    """Every technique with a form on one scene."""
    what = scene(name, run)
    if not run.quick:
        what = what.replace(width=size[0], height=size[1])
    exact = oitlab.render(what, "a_buffer", dtype="float64")
    rows = {}
    for technique, params in forms(info).items():
        found = frames(what, technique, params, min(run.repeats, 5))
        frame = found.pop("frame")
        cpu = oitlab.render(what, technique, params)
        found["rmse"] = oitlab.compare(frame, exact)["rmse"]
        found["rmse_cpu"] = oitlab.compare(cpu, exact)["rmse"]
        found["off_cpu"] = float(np.abs(frame.color - cpu.color).max())
        found["cpu_ms"] = cpu.stats.total_ms
        rows[technique] = found
    best = front({n: (row["median_ms"], row["rmse"]) for n, row in rows.items()})
    return {"fragments": exact.stats.fragments, "techniques": rows, "pareto_front": best}


def storages(run: Run, size: tuple[int, int]) -> dict[str, dict[str, float]]:
    """FEE21 table 3: lwboit by linked lists and by layered rendering, on every scene."""
    found: dict[str, dict[str, float]] = {}
    for name in SCENES:
        what = scene(name, run)
        if not run.quick:
            what = what.replace(width=size[0], height=size[1])
        found[name] = {}
        for storage in STORAGES:
            try:
                row = frames(what, "lwboit", {"storage": storage}, min(run.repeats, 5))
            except ValueError:  # this storage has no form, or not on this device
                continue
            found[name][storage] = row["median_ms"]
    return found


def beside_peers(run: Run) -> dict[str, dict[str, Any]]:
    """The WBOIT peers on every scene, each in a process of its own."""
    modes = [(p, mode) for p in run.peers for mode, kind in PEERS[p].items() if kind == "wboit"]
    found: dict[str, dict[str, Any]] = {}
    for name in SCENES:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            Arrays.of(scene(name, run)).save(folder / "scene.npz")
            found[name] = {}
            for peer, mode in modes:
                result = one(run.peer_python, peer, mode, folder, run)
                if "times_ms" in result:
                    found[name][f"{peer} {mode}"] = pooled(result["times_ms"])
    return found


def main(run: Run) -> None:
    """Measure, and write gpu.json, gpu.md and gpu.png; say why not where there is no device."""
    try:
        info = oitlab.gpu.info()
    except RuntimeError as error:
        print(f"skipped: {error}\n", file=sys.stderr)
        return
    is_processor = info.kind == "Cpu"
    sizes = {
        name: size for name, size in SIZES.items() if size == (1280, 720) or run.huge or not is_processor
    }
    if run.quick:
        sizes = {"160 x 90": (160, 90)}
    results = {
        label: {name: on_scene(name, run, size, info) for name in SCENES} for label, size in sizes.items()
    }
    layers = storages(run, next(iter(sizes.values())))
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
    }
    parts = [f"Device: {info.adapter} ({info.kind}, {info.interface}; {info.driver} {info.driver_info})."]
    for label, found in results.items():
        parts += tables(label, found)
    parts += table_of_storages(layers)
    parts += table_of_peers(first, peers)
    saved = {"device": device, "sizes": results, "storages": layers, "peers": peers}
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


def table_of_storages(found: dict[str, dict[str, float]]) -> list[str]:
    """Empty where only one of them runs."""
    rows = [[name, *(three_digits(row[s]) for s in STORAGES)] for name, row in found.items() if len(row) == 2]
    if not rows:
        return []
    return [
        "lwboit by lists (ll, which draws the geometry twice) and by layered rendering (lr, as often as its "
        "bins and its shape ask for), milliseconds on the device (FEE21 table 3).",
        markdown_table(["scene", *STORAGES], rows),
    ]


def table_of_peers(found: dict[str, Any], peers: dict[str, dict[str, Any]]) -> list[str]:
    """Compare wboit's passes with the fastest peer's call on each scene."""
    rows = []
    for name, all_peers in peers.items():
        if not all_peers:
            continue
        best = min(all_peers, key=lambda peer: all_peers[peer]["median_ms"])
        theirs, ours = all_peers[best]["median_ms"], found[name]["techniques"]["wboit"]["median_ms"]
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
    from pareto import draw_front

    plot_style()
    figure, panels = plt.subplots(2, 3, figsize=(11, 7))
    for axes, (name, row) in zip(panels.flat, results.items(), strict=False):
        draw_front(axes, name, row)
        axes.set_xlabel("milliseconds on the device")
    panels.flat[-1].axis("off")
    panels.flat[-1].text(0, 0.7, "Every technique with a GPU form, default params.\nBlue: the Pareto front.\n"
                         "Errors below 1e-7 are drawn at 1e-7.", fontsize=9)  # fmt: skip
    run.save_figure(figure, "gpu")
    plt.close(figure)
