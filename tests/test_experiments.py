"""The studies run from end to end, and their small runs already show what the large ones measure."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import oitlab
from gpu_scenes import DEVICE, WHY_NOT
from oitlab import cli

FIVE_SCENES = ["squares", "soup", "shells", "smoke", "blades"]
EXPERIMENTS = Path(__file__).parents[1] / "experiments"
PNG = b"\x89PNG\r\n\x1a\n"


def run(name: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-W",
        "error",
        str(EXPERIMENTS / f"{name}.py"),
        "--quick",
        "--output",
        str(folder),
    ]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment})


def results(name: str, folder: Path) -> dict[str, Any]:
    """Run a study; its results, once its table and plots are seen to be there."""
    finished = run(name, folder)
    assert finished.returncode == 0, finished.stderr
    table = (folder / "table.md").read_text()
    assert table.startswith(("|", "<!--", "RMSE"))
    assert table in finished.stdout
    plots = list(folder.glob("*.png"))
    assert len(plots) >= 2
    assert all(plot.read_bytes().startswith(PNG) for plot in plots)
    found = json.loads((folder / "results.json").read_text())
    assert {"command", "date", "commit", "cpu", "cores", "versions"} <= found["about"].keys()
    return found


@pytest.fixture(scope="module")
def figure8(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return results("fee21_figure8", tmp_path_factory.mktemp("fee21_figure8"))


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return results("all_techniques", tmp_path_factory.mktemp("all_techniques"))


@pytest.fixture(scope="module")
def holes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return results("continuum_holes", tmp_path_factory.mktemp("continuum_holes"))


@pytest.fixture(scope="module")
def partition(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return results("lwboit_partition", tmp_path_factory.mktemp("lwboit_partition"))


def test_real_meshes(tmp_path: Path, data: Callable[[str], Path]) -> None:
    files = ("scans/stanford_bunny.ply", "scans/stanford_dragon_res2.ply", "cad/2CylinderEngine.glb",
             "architecture/dabrovic_sponza.obj")  # fmt: skip
    for file in files:
        data(file)
    found = results("real_meshes", tmp_path)
    assert [mesh["file"] for mesh in found["meshes"]] == list(files)
    for mesh in found["meshes"]:
        error = {row["technique"]: row["mse"] for row in mesh["techniques"]}
        assert mesh["depth_complexity_mean"] == pytest.approx(mesh["fragments"] / math.prod(found["size"]))
        assert 2 <= mesh["depth_complexity_max"] <= mesh["fragments"]
        assert error["a_buffer"] == 0.0
        assert 0.0 < error["lwboit 64"] < error["lwboit 8"] < error["wboit"]
        assert error["painter"] < error["wboit"]


def test_real_meshes_names_what_is_missing(tmp_path: Path) -> None:
    finished = run("real_meshes", tmp_path / "out", OITLAB_DATA=str(tmp_path))
    assert finished.returncode == 2
    assert "stanford_bunny.ply" in finished.stderr
    assert "OITLAB_DATA" in finished.stderr
    assert "Traceback" not in finished.stderr


def test_a_shift_steepens_wide_bins_and_flattens_narrow_ones(figure8: dict[str, Any]) -> None:
    sweeps = {(s["alpha"], s["technique"], s["weight"]): s for s in figure8["sweeps"]}
    wide, narrow = sweeps[0.9, "lwboit 8", "inv_pow"], sweeps[0.5, "lwboit 64", "inv_pow"]
    assert wide["best_shift"] < 0.0 < narrow["best_shift"]
    assert wide["red_unshifted"] < 0.0 < narrow["red_unshifted"]
    assert wide["factor"] > 10.0
    assert narrow["factor"] > 10.0


def test_clamped_weights_gain_little_from_a_shift(figure8: dict[str, Any]) -> None:
    opaque = [s for s in figure8["sweeps"] if s["alpha"] >= 0.9 and "mb" in s["weight"]]
    assert len(opaque) == 2 * 7 * 4
    assert all(1.0 <= s["factor"] < 2.5 for s in opaque)


def test_a_front_that_hides_all_errs_less_the_more_opaque_it_is(figure8: dict[str, Any]) -> None:
    edge = {s["alpha"]: s["unshifted"] for s in figure8["sweeps"]
            if (s["technique"], s["weight"]) == ("lwboit 32 edge", "inv_pow")}  # fmt: skip
    assert edge[0.5] > edge[0.9] > edge[0.99]


def test_shared_absorbance_has_no_plateau(partition: dict[str, Any]) -> None:
    for entry in partition["convergence"]:
        last = {name: values[-1] for name, values in entry["rmse"].items()}
        if entry["scene"] == "squares":
            assert last["absorbance"] < 1e-3 < last["SND (all of FEE21)"]
            assert last["smooth"] > 1e-2
        assert last["absorbance"] <= last["smooth, normalised"]


def test_seams(partition: dict[str, Any]) -> None:
    eight = partition["bins"].index(8)
    for entry in partition["seams"]:
        seam = {name: values[eight] for name, values in entry["seam"].items()}
        assert seam["absorbance"] < 0.5 * seam["naive"]
        assert seam["absorbance"] < seam["smooth, normalised"]
        if entry["scene"] == "one tilt":
            assert seam["SND (all of FEE21)"] < 1e-4
            assert seam["absorbance, shaped"] < 1e-4


def test_every_technique_is_in_the_table_of_all(everything: dict[str, Any]) -> None:
    names = oitlab.techniques().ids
    assert [entry["scene"] for entry in everything["scenes"]][:5] == FIVE_SCENES
    for entry in everything["scenes"]:
        rows = {row["technique"]: row for row in entry["rows"]}
        assert tuple(rows)[: len(names)] == names
        assert rows["wboit"]["factor"] == 1.0
        for exact in ("a_buffer", "depth_peeling", "dual_depth_peeling"):
            assert rows[exact]["factor"] is None
            assert rows[exact]["rmse"] <= 1e-6
        assert all(row["rmse"] <= row["max_error"] for row in rows.values())
        assert rows["mlab, shuffled"]["bytes_per_pixel"] == rows["mlab"]["bytes_per_pixel"] == 80.0
        assert "a_buffer, shuffled" not in rows


def test_the_command_that_the_table_of_all_gives_is_the_same(
    everything: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    entry = everything["scenes"][4]
    program, *arguments = entry["command"].split()
    assert program == "oitlab"
    assert cli.main([*arguments, "--techniques", "mlab"]) == 0
    rmse = next(row["rmse"] for row in entry["rows"] if row["technique"] == "mlab")
    assert f"{rmse:.3g}" in capsys.readouterr().out


def test_missing_meshes_are_named_and_left_out(tmp_path: Path) -> None:
    finished = run("all_techniques", tmp_path / "out", OITLAB_DATA=str(tmp_path))
    assert finished.returncode == 0
    assert "left out: Sponza" in finished.stderr
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [entry["scene"] for entry in found["scenes"]] == FIVE_SCENES


def test_two_holes_beat_their_published_neighbours(holes: dict[str, Any]) -> None:
    ratios = {row["label"]: row["ratio"] for group in holes["groups"] for row in group["holes"]}
    for label in ("smallest_error", "discard_furthest, tail, weight=smoke6"):
        assert ratios[label].keys() == set(FIVE_SCENES) - {"squares"}
        assert all(ratio < 0.98 for ratio in ratios[label].values())
    assert min(ratios["over_furthest, second pass, global"].values()) > 1.5


def test_holes_converge_like_what_is_published(holes: dict[str, Any]) -> None:
    for sweep in holes["sweeps"]:
        assert sweep["layers"] == [1, 2, 4, 8, 16]
        for errors in sweep["rmse"].values():
            assert errors[-1] < 0.3 * errors[0]


@pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)
def test_the_gpu_covers_the_same_and_computes_the_same(tmp_path: Path) -> None:
    finished = run("gpu_agreement", tmp_path, OITLAB_DATA=str(tmp_path))
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / "table.md").read_text() in finished.stdout
    found = json.loads((tmp_path / "results.json").read_text())
    assert list(found["coverage"]) == FIVE_SCENES
    assert all(row["same"] and row["depths_off_ulp"] <= 1 for row in found["coverage"].values())
    assert found["techniques"].keys() == set(oitlab.techniques().ids)
    beyond = {
        name for name, row in found["techniques"].items() if any(cell["beyond"] for cell in row.values())
    }
    # what decides between near-ties, and moments, which amplify rounding
    assert beyond <= {"density_clustering", "deep_shadow_maps", "avsm", "mboit_power", "mboit_trig"}
    for shares in found["formats"]["blended_oit"].values():
        assert all(0 < share <= 1 for share in shares.values())
