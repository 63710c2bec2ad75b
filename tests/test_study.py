"""Stored sweeps: they resume, survive being killed, can be read meanwhile, and touch nobody else's files."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import oitlab
from oitlab.sweeping import work
from oitlab.sweeping.study import APPLICATION_ID, VERSION, Study

sweep = partial(oitlab.sweep, progress=False)
GRID = {"lwboit": {"bins": [2, 4, 8]}, "wboit": {"weight": ["mb7", "mb9"]}}


@pytest.fixture
def store(tmp_path):
    return tmp_path / "study.sqlite"


@pytest.fixture
def rendered(monkeypatch):
    """Requests that were rendered."""
    requests = []

    def counting(source, some, **keywords):
        requests.extend(some)
        return oitlab.render_many(source, some, **keywords)

    monkeypatch.setattr(work, "render_many", counting)
    return requests


class TestResuming:
    def test_what_is_there_is_read_and_not_computed(self, small_scene, store, rendered):
        first = sweep(small_scene, GRID, store=store)
        assert len(rendered) == 5
        again = sweep(small_scene, GRID, store=store)
        assert len(rendered) == 5
        pd.testing.assert_frame_equal(first, again)
        pd.testing.assert_frame_equal(first, oitlab.read_study(store))
        assert first.attrs == again.attrs

    def test_a_larger_grid_computes_what_is_new(self, small_scene, store, rendered):
        sweep(small_scene, {"lwboit": {"bins": [2, 8]}}, store=store)
        table = sweep(small_scene, {"lwboit": {"bins": [2, 4, 8]}}, store=store)
        assert [params["bins"] for _, params in rendered] == [2, 8, 4]
        assert table["bins"].tolist() == [2, 4, 8]
        assert oitlab.read_study(store)["bins"].tolist() == [2, 8, 4]

    def test_values_come_back_as_they_were(self, small_scene, store):
        grid = [
            ("opacity_shadow_maps", {"range": ["pixel", (1.0, 9.0)]}),
            ("a_buffer", None),
            ("wboit", {"weight": "inv_pow", "weight_k": [0.1, 1 / 3], "listing3_clamp": True}),
        ]
        options = {"metrics": "psnr", "metric_options": {"data_range": 1.0}, "repeats": 2}
        first = sweep(small_scene, grid, store=store, **options)
        pd.testing.assert_frame_equal(first, sweep(small_scene, grid, store=store, **options))
        assert first["psnr"].iloc[2] == np.inf
        connection = sqlite3.connect(store)
        valid = connection.execute(
            "SELECT json_valid(metrics) AND json_valid(params) FROM finished"
        ).fetchall()
        connection.close()
        assert valid == [(1,)] * 5
        assert first["range"].iloc[1] == (1.0, 9.0)

    @pytest.mark.parametrize(
        "changed",
        [
            {"scenes": oitlab.scenes.blades(width=48, height=27, count=61)},
            {"scenes": oitlab.scenes.blades(width=47, height=27, count=60)},
            {"reference": ("a_buffer", {"format": "f16"})},
            {"reference": np.zeros((27, 48, 3))},
            {"metrics": "rmse"},
            {"metric_options": {"threshold": 0.5}},
            {"metrics": {"mine": lambda frame, reference: 2.0}},
            {"repeats": 2},
        ],
        ids=lambda changed: next(iter(changed)),
    )
    def test_what_numbers_depend_on_is_part_of_the_key(self, small_scene, store, rendered, changed):
        sweep(small_scene, {"wboit": None}, store=store)
        sweep(**{"scenes": small_scene, "grid": {"wboit": None}, "store": store} | changed)
        assert len(rendered) == 2 + (changed.get("repeats", 1) - 1)
        assert len(oitlab.read_study(store)) == 2

    @pytest.mark.parametrize(
        "changed",
        [
            {"threads": 1},
            {"group": 1},
            {"reference": ("over", {"format": "f32"})},
            {"metrics": ["max_error", "mse"]},
            {"grid": {"wboit": {"weight": "mb7", "weight_k": 9.0}}},
        ],
        ids=lambda changed: next(iter(changed)),
    )
    def test_what_they_do_not_depend_on_is_not(self, small_scene, store, rendered, changed):
        sweep(small_scene, {"wboit": None}, store=store)
        sweep(**{"scenes": small_scene, "grid": {"wboit": None}, "store": store} | changed)
        assert len(rendered) == 1

    def test_another_core_computes_anew(self, small_scene, store, rendered, monkeypatch):
        sweep(small_scene, {"wboit": None}, store=store)
        monkeypatch.setattr(oitlab.sweeping.plan, "core_digest", lambda: "another")
        sweep(small_scene, {"wboit": None}, store=store)
        assert len(rendered) == 2

    def test_functions_count_by_what_they_do(self, small_scene, store, rendered):
        def metric(scale):
            return {"mine": lambda frame, reference: scale * 1.0}

        for scale in (1, 1, 2, 2):
            table = sweep(small_scene, {"wboit": None}, metrics=metric(scale), store=store)
            assert table["mine"].tolist() == [scale]
        assert len(rendered) == 2

    def test_a_scene_under_another_name_is_the_same(self, small_scene, store, rendered):
        sweep({"old": small_scene}, {"wboit": None}, store=store)
        table = sweep({"new": small_scene, "newer": small_scene}, {"wboit": None}, store=store)
        assert table["scene"].tolist() == ["new", "newer"]
        assert len(rendered) == 1
        assert oitlab.read_study(store)["scene"].tolist() == ["old", "new", "newer"]

    def test_rows_that_another_sweep_finished_meanwhile_are_taken(self, small_scene, store, rendered):
        grid = {"lwboit": {"bins": [2, 4, 8]}}
        seen = str(store.with_name("seen"))  # a list would be part of the metric's closure, and of its key

        def metric(frame, reference):
            if not os.path.exists(seen):
                os.mkdir(seen)
                sweep(small_scene, grid, metrics={"mine": metric}, store=store)
            return 1.0

        table = sweep(small_scene, grid, metrics={"mine": metric}, store=store, group=1)
        assert table["bins"].tolist() == [2, 4, 8]
        assert [params["bins"] for _, params in rendered] == [2, 2, 4, 8]
        assert len(oitlab.read_study(store)) == 3


KILLED = """
import sys, time, oitlab
scene = oitlab.scenes.blades(width=64, height=36, count=60)
def slow(frame, reference):
    time.sleep(0.01)  # all kills come before the end
    print(frame.params["bins"], flush=True)
    return float(frame.params["bins"])
oitlab.sweep(scene, {"lwboit": {"bins": range(1, 121)}}, metrics={"slow": slow}, group=4,
             store=sys.argv[1], progress=False)
print("done", flush=True)
"""


def test_killed_at_any_moment_it_loses_and_repeats_nothing(store):
    """Kill -9 a sweep several times; what it had finished is there unchanged and is not measured again."""
    rng = random.Random(8)
    before: list[tuple] = []
    measured: list[int] = []
    kills = 0
    for attempt in range(40):
        with subprocess.Popen(
            [sys.executable, "-c", KILLED, store], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            lines = [process.stdout.readline().strip()]
            if attempt < 5:  # from the first row on; sooner there is nothing to lose
                time.sleep(rng.uniform(0.0, 0.12))
                process.send_signal(signal.SIGKILL)
                kills += 1
            lines += [line.strip() for line in process.stdout]
        table = oitlab.read_study(store)
        columns = (
            ("bins", "slow", "total_ms", "commit") if len(table) else ()
        )  # killed before the first commit
        rows = list(zip(*(table[name] for name in columns), strict=True))
        assert rows[: len(before)] == before
        assert len({row[0] for row in rows}) == len(table)
        assert all(slow == bins for bins, slow, *_ in rows)
        new = [int(line) for line in lines if line.isdigit()]
        # a metric that was computed is stored before the next; only the last one may have been cut off
        assert [row[0] for row in rows[len(before) :]] in (new, new[:-1])
        assert not set(new) & {row[0] for row in before}
        measured += new
        before = rows
        if "done" in lines:
            break
    assert kills == 5
    assert sorted(table["bins"]) == list(range(1, 121))
    assert len(measured) <= 120 + kills


def test_it_is_read_while_it_is_written(store):
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, store], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        sizes = []
        for line in process.stdout:
            if line.strip().isdigit() and int(line) % 8 == 0:
                sizes.append(len(oitlab.read_study(store)))
                assert sizes[-1] >= int(line) - 1
    assert process.returncode == 0
    assert sizes == sorted(sizes)
    assert sizes[0] < 120
    assert len(oitlab.read_study(store)) == 120


def test_two_sweeps_write_one_store(store):
    command = [sys.executable, "-c", KILLED, store]
    both = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for _ in "ab"
    ]
    for process in both:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    table = oitlab.read_study(store)
    assert sorted(table["bins"]) == list(range(1, 121))
    with sqlite3.connect(store) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


@pytest.mark.parametrize("is_study", [False, True])
def test_it_is_opened_while_somebody_else_writes(store, is_study):
    """SQLite does not wait for others where the kind of journal changes."""
    if is_study:
        Study(store).close()
    other = sqlite3.connect(store, isolation_level=None, check_same_thread=False)
    assert other.execute("PRAGMA journal_mode = DELETE").fetchone() == ("delete",)
    other.execute("BEGIN IMMEDIATE")
    later = threading.Timer(0.3, lambda: other.execute("COMMIT"))
    later.start()
    Study(store).close()
    assert not other.in_transaction
    later.join()
    other.close()
    assert len(oitlab.read_study(store)) == 0


class TestFiles:
    def test_the_header_says_what_it_is(self, small_scene, store):
        sweep(small_scene, {"wboit": None}, store=str(store))
        connection = sqlite3.connect(store)
        assert connection.execute("PRAGMA application_id").fetchone() == (APPLICATION_ID,)
        assert connection.execute("PRAGMA user_version").fetchone() == (VERSION,)
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        (mse,) = connection.execute("SELECT json_extract(metrics, '$.mse') FROM finished").fetchone()
        connection.close()
        assert mse == oitlab.read_study(store)["mse"].iloc[0]
        assert not Path(f"{store}-wal").exists()

    def test_commits_are_flushed(self, store):
        study = Study(store)
        full = 2
        assert study._connection.execute("PRAGMA synchronous").fetchone() == (full,)
        study.close()

    @pytest.mark.parametrize(
        "content", [b"scene,technique\n", b"SQLite format 3\0" + bytes(200), b"x" * 5000]
    )
    def test_other_files_are_left_alone(self, small_scene, store, content):
        store.write_bytes(content)
        for call in (
            lambda: sweep(small_scene, {"wboit": None}, store=store),
            lambda: oitlab.read_study(store),
        ):
            with pytest.raises((ValueError, OSError), match=r"study\.sqlite"):
                call()
        assert store.read_bytes() == content

    def test_other_databases_are_left_alone(self, small_scene, store):
        connection = sqlite3.connect(store)
        connection.execute("CREATE TABLE finished (key TEXT)")
        connection.commit()
        connection.close()
        content = store.read_bytes()
        for call in (
            lambda: sweep(small_scene, {"wboit": None}, store=store),
            lambda: oitlab.read_study(store),
        ):
            with pytest.raises(ValueError, match="a database of something else"):
                call()
        assert store.read_bytes() == content

    def test_a_newer_study_is_refused(self, small_scene, store):
        sweep(small_scene, {"wboit": None}, store=store)
        connection = sqlite3.connect(store)
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
        connection.commit()
        connection.close()
        with pytest.raises(ValueError, match="written by a newer oitlab"):
            oitlab.read_study(store)
        with pytest.raises(ValueError, match="written by a newer oitlab"):
            sweep(small_scene, {"wboit": None}, store=store)

    def test_a_study_of_the_version_before_is_read_and_goes_on(self, small_scene, store):
        first = sweep(small_scene, {"wboit": {"weight": ["mb7"]}}, store=store)
        connection = sqlite3.connect(store)
        connection.execute("ALTER TABLE finished DROP COLUMN invalid_weights")
        connection.execute("PRAGMA user_version = 1")
        connection.commit()
        connection.close()
        old = oitlab.read_study(store)
        assert old["invalid_weights"].isna().all()
        assert old["mse"].tolist() == first["mse"].tolist()
        table = sweep(small_scene, {"wboit": {"weight": ["mb7", "mb9"]}}, store=store)
        assert table["invalid_weights"].tolist() == [pd.NA, 0]
        assert oitlab.read_study(store)["invalid_weights"].tolist() == [pd.NA, 0]

    def test_an_empty_file_becomes_a_study(self, small_scene, store):
        store.touch()
        assert len(oitlab.read_study(store)) == 0
        sweep(small_scene, {"wboit": None}, store=store)
        assert len(oitlab.read_study(store)) == 1

    def test_paths(self, small_scene, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"the folder .*nowhere does not exist"):
            sweep(small_scene, {"wboit": None}, store=tmp_path / "nowhere" / "s.sqlite")
        with pytest.raises(IsADirectoryError, match="is a folder"):
            sweep(small_scene, {"wboit": None}, store=tmp_path)
        with pytest.raises(IsADirectoryError, match="is a folder"):
            oitlab.read_study(tmp_path)
        with pytest.raises(FileNotFoundError, match="no study"):
            oitlab.read_study(tmp_path / "none.sqlite")
        assert list(tmp_path.iterdir()) == []

    def test_a_folder_that_cannot_be_written_to_can_be_read(self, small_scene, store, monkeypatch):
        sweep(small_scene, {"wboit": None}, store=store)
        monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
        store.parent.chmod(0o555)
        try:
            assert len(oitlab.read_study(store)) == 1
        finally:
            store.parent.chmod(0o755)

    def test_odd_names_are_names(self, small_scene, tmp_path):
        store = tmp_path / "a study? 50% #1.sqlite"
        table = sweep(small_scene, {"wboit": None}, store=store)
        pd.testing.assert_frame_equal(table, oitlab.read_study(store))
