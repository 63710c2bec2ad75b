"""What becomes of a sweep's table: xarray, and the command line."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import oitlab
from oitlab import cli
from oitlab.sweeping import plan, work
from oitlab.sweeping.bind import bound
from oitlab.sweeping.metrics import Measure

sweep = partial(oitlab.sweep, progress=False)


class TestXarray:
    @pytest.fixture
    def table(self, small_scene):
        grid = {"lwboit": {"bins": [2, 4, 8], "bin_function": ["bell", "tent"]}}
        return sweep({"a": small_scene, "b": small_scene.replace(width=40)}, grid)

    def test_it_has_the_numbers_of_the_table(self, table):
        cube = oitlab.to_xarray(table)
        assert dict(cube.sizes) == {"scene": 2, "bins": 3, "bin_function": 2}
        for _, row in table.iterrows():
            at = {name: row[name] for name in cube.dims}
            assert float(cube["mse"].sel(at)) == row["mse"]
            assert float(cube["total_ms"].sel(at)) == row["total_ms"]
        assert cube.attrs["technique"] == "lwboit"
        assert cube["mse"].dtype == np.float64
        assert cube["bins"].dtype == np.int64
        assert "seed" not in cube.attrs

    def test_pandas_own_way_works_too(self, table):
        cube = table.set_index(["scene", "bins", "bin_function"])[["mse", "max_error"]].to_xarray()
        assert cube["mse"].shape == (2, 3, 2)

    def test_holes_are_nan(self, table):
        cube = oitlab.to_xarray(table.iloc[1:], dims=["scene", "bins", "bin_function"])
        assert int(cube["mse"].isnull().sum()) == 1

    @pytest.mark.parametrize(
        ("dims", "message"),
        [
            (["bins"], "12 rows share their bins; add scene or bin_function"),
            (["mse", "bin"], "no column 'bin'"),
            (["bins", "bins"], "'bins' is named twice"),
            ([], "at least one row and one dimension"),
            (3, "dims must be names of columns, got 3"),
            (["seed"], "'seed' has no value in 12 rows"),
        ],
    )
    def test_what_is_no_grid_is_refused(self, table, dims, message):
        with pytest.raises(ValueError, match=message):
            oitlab.to_xarray(table, dims)

    def test_tables_without_a_memory_want_dims(self, table, tmp_path):
        table.to_csv(tmp_path / "t.csv", index=False)
        back = pd.read_csv(tmp_path / "t.csv")
        with pytest.raises(ValueError, match="name the columns"):
            oitlab.to_xarray(back)
        assert oitlab.to_xarray(back, ["scene", "bins", "bin_function"])["mse"].shape == (2, 3, 2)
        with pytest.raises(ValueError, match="table must be a DataFrame"):
            oitlab.to_xarray([1])


INTERRUPTED = """
import sys, warnings, oitlab
warnings.simplefilter("always")
scene = oitlab.scenes.smoke(width=320, height=180, count=300)
grid = {"lwboit": {"bins": range(2, 502), "s_max": [3.0, 10.0], "partition": "absorbance"}}
def told(frame, reference):
    print("row", flush=True)
    return 0.0
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    table = oitlab.sweep(scene, grid, metrics={"told": told}, group=2, store=sys.argv[1], progress=False)
print("kept", len(table), table["bins"].tolist() == [2 + i // 2 for i in range(len(table))])
print([w.category.__name__ for w in caught], str(caught[0].message))
print("alive", oitlab.render(scene, "wboit").color.shape)
"""


def test_ctrl_c_returns_what_is_finished(tmp_path: Path) -> None:
    store = tmp_path / "study.sqlite"
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, store], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for _ in range(3):
            assert process.stdout.readline() == "row\n"
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        lines = [line for line in process.communicate(timeout=60)[0].splitlines() if line != "row"]
    assert process.returncode == 0, lines
    kept = int(lines[0].split()[1])
    assert 2 <= kept < 1000
    assert lines[0] == f"kept {kept} True"
    assert lines[1] == (
        f"['SweepInterrupted'] stopped by Ctrl-C: {kept} of 1000 rows are finished; {store} keeps them"
    )
    assert lines[2] == "alive (180, 320, 3)"
    assert len(oitlab.read_study(store)) == kept


class TestCommand:
    def run(self, *arguments):
        command = [sys.executable, "-W", "error", "-m", "oitlab", "sweep", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    def test_a_grid_to_a_file_and_again_from_the_store(self, tmp_path):
        small = ["scene:squares", "--width", 48, "--height", 27, "--store", tmp_path / "s.sqlite"]
        grid = ["--grid", "wboit:weight=mb7,mb9:weight_shift=0,1", "--grid", "lwboit:range=pixel,[1,9]"]
        tables = []
        for name in ("one.csv", "two.csv"):
            done = self.run(*small, *grid, "-o", tmp_path / name, "--metrics", "psnr,mse", "--data-range", 1)
            assert done.returncode == 0, done.stderr
            assert f"wrote {tmp_path / name}: 6 rows" in done.stdout
            tables.append((tmp_path / name).read_text())
        assert tables[0] == tables[1]
        table = pd.read_csv(tmp_path / "one.csv")
        assert table["scene"].unique().tolist() == ["squares"]
        assert table["weight_shift"].tolist() == [0, 1, 0, 1, 0, 0]
        assert table["range"].tolist()[4:] == ["pixel", "(1.0, 9.0)"]
        scene = oitlab.scenes.squares(width=48, height=27)
        expected = sweep(scene, {"wboit": {"weight": ["mb7", "mb9"], "weight_shift": [0, 1]}})["mse"]
        assert table["mse"].tolist()[:4] == expected.tolist()

    def test_it_prints_what_varies(self, capsys):
        arguments = [
            "scene:squares",
            "scene:blades",
            "--width",
            "32",
            "--height",
            "18",
            "--grid",
            "lwboit:bins=2,4",
        ]
        assert cli.main(["sweep", *arguments, "--seeds", "1,2"]) == 0
        header, *rows = capsys.readouterr().out.splitlines()
        assert header.split() == ["scene", "technique", "bins", "mse", "max_error", "resolve_ms", "total_ms"]
        assert [row.split()[:3] for row in rows] == [
            [scene, "lwboit", bins] for scene in ("squares", "blades") for bins in "24"
        ]

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--grid", "wboit:bins"], "expected name=value,value"),
            (["--grid", "wbot"], "unknown technique 'wbot'"),
            (["--grid", "wboit", "--seeds", "a"], "--seeds: expected integers"),
            (["--grid", "wboit", "--workers", "0"], "--workers must be at least 1"),
            (["--grid", "wboit", "-o", "table.xlsx"], "ends in .csv"),
            (["--grid", "wboit", "-o", "nowhere/t.csv"], "does not exist"),
            (["--grid", "wboit", "--metrics", "flip"], "flip needs pixels_per_degree"),
        ],
    )
    def test_errors_are_one_line(self, capsys, arguments, message):
        status = cli.main(["sweep", "scene:squares", "--width", "8", "--height", "8", *arguments])
        err = capsys.readouterr().err
        assert status == 2
        assert err.startswith("oitlab: error: ")
        assert message in err
        assert err.count("\n") == 1

    def test_ctrl_c_writes_what_is_finished(self, tmp_path):
        output = tmp_path / "t.csv"
        bins = ",".join(map(str, range(2, 502)))
        command = [sys.executable, "-m", "oitlab", "sweep", "scene:smoke", "--width=640", "--height=360"]
        command += [
            f"--grid=lwboit:bins={bins}",
            "--group=1",
            f"--store={tmp_path / 's.sqlite'}",
            f"-o{output}",
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 60
            while not _rows(tmp_path / "s.sqlite"):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            os.kill(process.pid, signal.SIGINT)
            _, err = process.communicate(timeout=60)
        assert process.returncode == 130
        assert "stopped by Ctrl-C" in err
        assert 1 <= len(pd.read_csv(output)) < 500


def _rows(store: Path) -> int:
    try:
        return len(oitlab.read_study(store))
    except FileNotFoundError:
        return 0


def test_scenes_pickle_to_the_same_bits(small_scene):
    import pickle

    fragments = oitlab.capture(small_scene)
    for source in (small_scene, fragments):
        back = pickle.loads(pickle.dumps(source))
        assert back.content_hash == source.content_hash
        assert np.array_equal(oitlab.render(back, "wboit").color, oitlab.render(source, "wboit").color)


def test_rows_are_plain_data(small_scene):
    """What is stored is what JSON knows."""
    package = work.Package(small_scene, None)
    (variant,) = bound(small_scene, [("lwboit", {"range": (1.0, 2.0)})], None)
    measure = Measure()
    ((_, row),) = work.Task("p", (variant,), ("k",), measure, 1, None).rows(package)
    assert json.loads(json.dumps(row)) == {**row, "params": {**row["params"], "range": [1.0, 2.0]}}


def test_importing_oitlab_imports_no_more_than_it_needs():
    """Sweeps are imported when they are asked for, and so is what they need."""
    heavy = ["oitlab.sweeping", "pandas", "sqlite3", "tqdm", "cloudpickle", "xarray", "dask", "matplotlib"]
    program = f"import sys, oitlab; assert not set({heavy}) & set(sys.modules); print(oitlab.sweep.__name__)"
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "sweep\n"
    assert {"sweep", "read_study", "to_xarray", "SweepFailed"} <= set(dir(oitlab))
    with pytest.raises(AttributeError, match="has no attribute 'swept'"):
        oitlab.swept  # noqa: B018


def test_reference_images_of_many_scenes_are_not_kept(small_scene, monkeypatch):
    packages = []
    create = plan.Package

    def keeping(*arguments):
        packages.append(create(*arguments))
        return packages[-1]

    monkeypatch.setattr(plan, "Package", keeping)
    kept = []

    def count(frame, reference):
        kept.append(sum(package._exact is not None for package in packages))
        return 0.0

    scenes = [small_scene.replace(width=20 + n) for n in range(4)]
    sweep(scenes, {"lwboit": {"bins": [2, 4]}}, metrics={"count": count}, group=1)
    assert kept == [1] * 8
