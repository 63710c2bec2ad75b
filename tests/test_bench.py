"""The benchmarks run from end to end and say what they measured; no time is asserted."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import oitlab
from gpu_scenes import DEVICE

BENCHES = Path(__file__).parents[1] / "benches"
SCENES = ["squares", "soup", "smoke", "shells", "blades"]
HAS_GPU = DEVICE is not None


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """All parts, small, against peers of which some may be absent; what each part wrote."""
    folder = tmp_path_factory.mktemp("bench")
    command = [sys.executable, "-W", "error", str(BENCHES / "bench.py"), "--quick", "--output", str(folder)]
    finished = subprocess.run([*command, "--peers", "embree", "ppll"], capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    parts = (
        "peers",
        "pareto",
        "scaling",
        "skips",
        "memory",
        "sweep",
        "weights",
        *(["gpu"] if HAS_GPU else []),
    )
    found = {part: json.loads((folder / f"{part}.json").read_text()) for part in parts}
    for part in parts:
        assert {"command", "date", "commit", "cpu", "cores", "versions"} <= found[part]["about"].keys()
        assert (folder / f"{part}.md").read_text() in finished.stdout
    for plot in ("pareto", "scaling"):
        assert (folder / f"{plot}.png").read_bytes().startswith(b"\x89PNG")
    return found


def test_peers_draw_the_same_image_or_are_skipped_by_name(bench: dict[str, Any]) -> None:
    peers = bench["peers"]
    assert list(peers["scenes"]) == SCENES
    assert peers["skipped"].keys() <= {"embree", "ppll"}
    for row in peers["scenes"].values():
        assert list(row["oitlab"]) == ["wboit", "lwboit", "mlab", "a_buffer", "painter"]
        assert row["oitlab"]["a_buffer"]["rmse"] == 0.0
        assert 0.0 < row["oitlab"]["lwboit"]["rmse"] < row["oitlab"]["wboit"]["rmse"]
        for found in row["peers"].values():
            assert "failed" in found or found["rmse"] < 0.05
            assert "failed" in found or found["min_ms"] <= found["median_ms"] <= found["max_ms"]


def test_every_technique_has_an_error_and_a_time(bench: dict[str, Any]) -> None:
    ids = [technique.id for technique in oitlab.techniques()]
    for row in bench["pareto"]["scenes"].values():
        assert list(row["techniques"]) == ids
        assert row["techniques"]["a_buffer"]["rmse"] < 1e-6
        assert row["techniques"]["a_buffer"]["ns_per_fragment"] > 0
        fastest = min(ids, key=lambda name: row["techniques"][name]["median_ms"])
        assert row["pareto_front"][0] == fastest
        errors = [row["techniques"][name]["rmse"] for name in row["pareto_front"]]
        assert errors == sorted(errors, reverse=True)


def test_curves_grow_in_what_they_say(bench: dict[str, Any]) -> None:
    scaling = bench["scaling"]
    for size, together in (
        ("fragments", "fragments_in_growing_images"),
        ("triangles", "triangles_in_growing_images"),
    ):
        for name in (size, together):
            points = scaling[name]["points"]
            sizes = [point[size] for point in points]
            assert sizes == sorted(sizes)
            assert sizes[-1] / sizes[0] == pytest.approx(10, rel=0.5)
            pixels = [point["width"] * point["height"] for point in points]
            assert pixels[-1] / pixels[0] == pytest.approx(10 if name == together else 1, rel=0.2)
    assert set(scaling["fragments"]["exponents"]) >= {"wboit", "a_buffer"}
    assert set(scaling["triangles"]["exponents_of_the_larger_half"]) >= {"wboit", "a_buffer"}
    gains = scaling["threads"]["speedup"].values()
    assert all(math.isfinite(gain) for kinds in gains for gain in kinds.values())


def test_what_is_skipped_is_what_the_scene_lacks(bench: dict[str, Any]) -> None:
    rows = bench["skips"]["scenes"]
    pixels = 160 * 90
    assert rows["empty"]["fragments"] == 0
    assert rows["hidden behind a wall"]["fragments"] == 0
    assert rows["hidden behind a wall"]["skipped"]["occluded_primitives"] > 0
    assert rows["single layer"]["fragments"] == pixels
    tiles = 3 * 2
    assert rows["empty"]["skipped"]["empty_tiles"] == tiles
    assert rows["single layer"]["skipped"]["one_color_tiles"] == tiles
    assert rows["uniform colour"]["skipped"]["one_color_tiles"] == tiles
    assert rows["full"]["skipped"]["layered_tiles"] == tiles
    assert rows["uniform colour"]["fragments"] == rows["full"]["fragments"]
    assert rows["5 % transparent"]["fragments"] == pytest.approx(0.05 * rows["full"]["fragments"], rel=0.3)
    for row in bench["skips"]["extra_variants"].values():
        assert set(row["share_per_variant"]) == {
            "another weight",
            "another blended technique",
            "the same again",
        }
        assert row["lists_together_over_alone"] > 0.0


def test_ones_own_weights_are_measured_against_the_published_one(bench: dict[str, Any]) -> None:
    cases = bench["weights"]["cases"]
    assert {row["technique"] for row in cases} == {"wboit", "lwboit"}
    for row in cases:
        assert list(row["ratios"]) == ["WGSL", "callable"]
        assert all(ratio > 0 for ratio in row["ratios"].values())


@pytest.mark.skipif(sys.platform != "linux", reason="peaks of memory are read from /proc")
def test_memory_is_measured_on_the_scene_that_was_built(bench: dict[str, Any]) -> None:
    memory = bench["memory"]
    assert memory["stack"] > 10_000
    assert list(memory["layouts"]) == ["facing", "tilted"]
    for techniques in memory["layouts"].values():
        assert list(techniques) == ["a_buffer", "lwboit", "mlab"]
        for row in techniques.values():
            assert row["stack_max"] == memory["stack"]
            assert row["depth_complexity_max"] == row["counted_max"] >= memory["stack"]
            assert row["fragments"] == row["counted_fragments"]
            assert 0 < row["peak_bytes"] < memory["limit_bytes"]
            assert row["before_bytes"] > 0
            assert row["within_limit"]


def test_sweeps_have_all_their_points_and_a_best_one(bench: dict[str, Any]) -> None:
    for name, row in bench["sweep"]["sweeps"].items():
        assert row["points"] == bench["sweep"]["points"] == 30, name
        assert row["seconds"] > 0
        assert row["stored_rows"] == row["points"]
        assert row["again_seconds"] < row["seconds"]
        assert 0 < row["best"]["mse"] <= row["worst"]["mse"]
    assert bench["sweep"]["one_by_one"]["same_mse"]


@pytest.mark.skipif(not HAS_GPU, reason="no device")
def test_the_device_is_measured_beside_the_cpu(bench: dict[str, Any]) -> None:
    found = bench["gpu"]
    assert DEVICE is not None
    assert found["device"]["adapter"] == DEVICE.adapter
    assert found["device"]["copy_bandwidth"] > 1e8
    (rows,) = found["sizes"].values()
    assert list(rows) == SCENES
    for row in rows.values():
        assert {"wboit", "lwboit", "a_buffer"} <= row["techniques"].keys()
        assert row["techniques"]["a_buffer"]["rmse"] < 1e-6
        for technique in ("wboit", "a_buffer", "mlab", "opacity_shadow_maps"):
            assert row["techniques"][technique]["off_cpu"] < 1e-4
        for technique in row["techniques"].values():
            assert abs(technique["rmse"] - technique["rmse_cpu"]) < 1e-3
            assert technique["call_ms"] > 0
        assert set(row["pareto_front"]) <= row["techniques"].keys()
    ways = {"linked lists", "counted lists", "layers", "triangles"}
    assert all(row.keys() == ways for row in found["storages"].values())
    for row in found["paths"].values():
        assert all(times["hardware"] > 0 and times["compute"] > 0 for times in row.values())
