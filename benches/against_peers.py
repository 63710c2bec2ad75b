"""The five scenes by oitlab and by every peer that is installed: milliseconds, ratios, and the floors.

Every mode of every peer runs in a process of its own on the same arrays, camera and size. oitlab runs before
and after the peers of each scene, and the medians of both are pooled.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from arrays import Arrays
from harness import SCENES, Run, markdown_table, pooled, scene, three_digits
from peers import PEERS

HERE = Path(__file__).parent
OURS = {"wboit": "wboit", "lwboit": "exact", "mlab": "exact", "a_buffer": "exact", "painter": "painter"}
"""Our techniques, and the kind of peer each is compared with; lwboit and mlab, which no peer has, stand
in for an exact one."""
FLOORS = {
    "wboit": {"squares": 6, "soup": 4, "smoke": 4, "shells": 3.5, "blades": 5},
    "a_buffer": {"squares": 3, "soup": 5, "smoke": 7, "shells": 3.5, "blades": 7},
}
"""Times faster than the best peer of the kind that the project means to be."""
DISTURBED = 0.1


def one(python: str, peer: str, mode: str, folder: Path, run: Run) -> dict[str, Any]:
    """Run the worker; its times, or why there are none."""
    command = [python, str(HERE / "worker.py"), peer, mode, str(folder / "scene.npz")]
    command += ["--image", str(folder / "image.npy")]
    command += ["--repeats", str(run.repeats), "--budget", str(run.budget)]
    environment = dict(os.environ)
    if peer == "ours":
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    else:
        environment.pop("PYTHONPATH", None)
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=run.timeout, env=environment)
    except subprocess.TimeoutExpired:
        return {"failed": f"over {run.timeout:.0f} s"}
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    if done.returncode:
        return {"failed": lines[-1][:200] if lines else f"exit status {done.returncode}"}
    result = json.loads(lines[-1])
    if "times_ms" in result:
        result["image"] = np.load(folder / "image.npy")
    return result


def measured(results: list[dict[str, Any]], references: dict[str, Any], kind: str) -> dict[str, Any]:
    """Pool the runs of one mode; errors are against the exact image and against the image of its own kind."""
    failed = [result for result in results if "times_ms" not in result]
    if failed:
        return failed[0]
    last = results[-1]
    found: dict[str, Any] = pooled(time for result in results for time in result["times_ms"])
    found["first_ms"] = results[0]["first_ms"]
    found["others_cpu"] = max(result["others_cpu"] for result in results)
    found["rmse"] = _rmse(last["image"], references["exact"])
    found["rmse_to_own_kind"] = _rmse(last["image"], references[kind])
    return {**found, "info": last["info"], "kind": kind}


def on_scene(name: str, run: Run, absent: dict[str, str]) -> dict[str, Any]:
    """Measure everything on one scene; what is not installed is noted in `absent` and not tried again."""
    what = scene(name, run)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        Arrays.of(what).save(folder / "scene.npz")
        ours = {mode: [one(sys.executable, "ours", mode, folder, run)] for mode in OURS}
        for mode, results in ours.items():
            if "times_ms" not in results[0]:
                raise RuntimeError(f"oitlab's {mode} on {name}: {results[0]}")
        references = {"exact": ours["a_buffer"][0]["image"], "wboit": ours["wboit"][0]["image"],
                      "painter": ours["painter"][0]["image"]}  # fmt: skip
        rows: dict[str, Any] = {}
        for peer in run.peers:
            for mode, kind in PEERS[peer].items():
                if peer in absent:
                    continue
                result = one(run.peer_python, peer, mode, folder, run)
                if "skipped" in result:
                    absent[peer] = result["skipped"]
                    continue
                rows[f"{peer} {mode}"] = measured([result], references, kind)
        for mode in OURS:
            ours[mode].append(one(sys.executable, "ours", mode, folder, run))
    own = {
        mode: measured(results, references, mode if mode in references else "exact")
        for mode, results in ours.items()
    }
    return {"oitlab": own, "peers": rows, "ratios": ratios({} if run.quick else FLOORS, name, own, rows)}


def ratios(floors: dict[str, Any], name: str, ours: dict[str, Any], peers: dict[str, Any]) -> dict[str, Any]:
    """How many times faster than the best peer of its kind our techniques are, and the floor, if any."""
    found = {}
    for mode, rival_kind in OURS.items():
        rivals = {peer: row["median_ms"] for peer, row in peers.items() if row.get("kind") == rival_kind}
        if rivals:
            best = min(rivals, key=rivals.__getitem__)
            found[mode] = {
                "best_peer": best,
                "times_faster": rivals[best] / ours[mode]["median_ms"],
                "floor": floors.get(mode, {}).get(name),
            }
    return found


def main(run: Run) -> None:
    """Measure, and write peers.json and peers.md."""
    absent: dict[str, str] = {}
    results = {name: on_scene(name, run, absent) for name in SCENES}
    for peer, reason in absent.items():
        print(f"skipped: {peer} ({reason})")
    run.save("peers", {"scenes": results, "skipped": absent}, tables(results, absent))


def tables(results: dict[str, Any], absent: dict[str, str]) -> str:
    """Ratios and floors first, then all milliseconds."""
    mode_rows = [[mode, *(_ratio(results[name]["ratios"].get(mode)) for name in results)] for mode in OURS]
    rivals = dict.fromkeys(peer for row in results.values() for peer in row["peers"])
    time_rows = [[f"**oitlab {m}**", *(_time(row["oitlab"][m]) for row in results.values())] for m in OURS]
    time_rows += [[p, *(_time(row["peers"].get(p)) for row in results.values())] for p in rivals]
    parts = [
        "Times faster than the best peer of its kind (lwboit and mlab: than the best exact one); "
        "in brackets the floor, where the project has one.",
        markdown_table(["technique", *results], mode_rows),
        "Milliseconds per frame: median (fastest to slowest); * = others had over 10 % of the cores.",
        markdown_table(["", *results], time_rows),
        "Skipped: " + ("; ".join(f"{peer} ({why})" for peer, why in absent.items()) or "none") + ".",
    ]
    return "\n\n".join(parts)


def _ratio(found: dict[str, Any] | None) -> str:
    if found is None:
        return "no peer"
    floor = found["floor"]
    if floor is None:
        return f"{found['times_faster']:.1f}"
    reached = "reached" if found["times_faster"] >= floor else "**not reached**"
    return f"{found['times_faster']:.1f} ({floor}, {reached})"


def _time(row: dict[str, Any] | None) -> str:
    if row is None or "median_ms" not in row:
        return row["failed"] if row and "failed" in row else "-"
    star = "*" if row["others_cpu"] > DISTURBED else ""
    spread = f"{three_digits(row['min_ms'])} to {three_digits(row['max_ms'])}"
    return f"{three_digits(row['median_ms'])}{star} ({spread})"


def _rmse(image: Any, reference: Any) -> float:
    return float(np.sqrt(np.mean((image.astype(float) - reference) ** 2)))
