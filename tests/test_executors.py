"""Sweeps whose groups are rendered by threads, processes and a Dask cluster, some of which die."""

import importlib
import os
import signal
import sys
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path

import pandas as pd
import pytest

import oitlab
from oitlab.sweeping import shipping

sweep = partial(oitlab.sweep, progress=False)
GRID = {"lwboit": {"bins": list(range(2, 22))}, "wboit": {"weight": ["mb7", "mb9"]}}
TIMES = ("_ms", "executor", "threads", "shared_with", "commit")


def untimed(table: pd.DataFrame) -> pd.DataFrame:
    return table[[name for name in table.columns if not any(part in name for part in TIMES)]]


@pytest.fixture(scope="module")
def expected(small_scene):
    return untimed(sweep(small_scene, GRID, metrics=["mse", "bad_pixels"]))


@pytest.fixture(scope="module")
def processes():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        yield pool


def test_threads_give_the_same_rows(small_scene, expected):
    with ThreadPoolExecutor(2) as pool:
        table = sweep(small_scene, GRID, metrics=["mse", "bad_pixels"], executor=pool)
    pd.testing.assert_frame_equal(untimed(table), expected)
    assert (table["executor"] == "ThreadPoolExecutor").all()
    assert (table["threads"] == 1).all()
    assert shipping._own == {}
    assert shipping._kept == {}, "threads find the scene in their own process"


def test_processes_give_the_same_rows(small_scene, expected, processes, tmp_path):
    store = tmp_path / "study.sqlite"
    scenes = {"a": small_scene, "b": oitlab.capture(small_scene)}
    table = sweep(scenes, GRID, metrics=["mse", "bad_pixels"], executor=processes, store=store, group=5)
    for name in scenes:
        found = untimed(table[table["scene"] == name]).reset_index(drop=True)
        same = [column for column in expected if column not in ("scene", "scene_hash")
                and not column.startswith("skipped.")]  # fmt: skip
        pd.testing.assert_frame_equal(found[same], expected[same])
    assert (table["executor"] == "ProcessPoolExecutor").all()
    assert sorted(oitlab.read_study(store)["bins"].dropna()) == sorted([*range(2, 22)] * 2)
    again = sweep(scenes, GRID, metrics=["mse", "bad_pixels"], store=store)
    pd.testing.assert_frame_equal(again, table)


def test_functions_of_this_process_reach_the_workers(small_scene, processes):
    offset = 0.25
    metrics = {"mine": lambda frame, reference: offset + float(frame.color.sum() - reference.color.sum())}
    table = sweep(small_scene, {"wboit": None, "mlab": None}, metrics=metrics, executor=processes)
    expected = sweep(small_scene, {"wboit": None, "mlab": None}, metrics=metrics)
    assert table["mine"].tolist() == expected["mine"].tolist()


@pytest.mark.skipif("fork" not in get_all_start_methods(), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.parametrize("threads", [2, None])
def test_forked_processes_do_not_hang(small_scene, expected, threads):
    oitlab.render(small_scene, "wboit")  # threads are there before the fork
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        table = sweep(small_scene, GRID, metrics=["mse", "bad_pixels"], executor=pool, threads=threads)
    pd.testing.assert_frame_equal(untimed(table), expected)


class _Elsewhere(Executor):
    """Runs tasks in a thread, as on a machine without the file of the scene: its path is changed."""

    def __init__(self) -> None:
        self.calls: list[bool] = []
        self._pool = ThreadPoolExecutor(1)

    def submit(self, function, message, scene=None):  # type: ignore[override]
        import pickle

        import cloudpickle

        techniques, task, path, prints = pickle.loads(message)
        assert Path(path).exists()
        self.calls.append(scene is not None)
        moved = cloudpickle.dumps((techniques, task, "/nowhere/" + Path(path).name, prints))
        return self._pool.submit(self._run, function, moved, scene)

    @staticmethod
    def _run(function, message, scene):
        kept = dict(shipping._own)
        shipping._own.clear()  # another process would not have it
        try:
            return function(message, scene)
        finally:
            shipping._own.update(kept)

    def shutdown(self, *arguments, **keywords):
        self._pool.shutdown()


def test_a_worker_on_another_machine_is_sent_the_scene_once(small_scene, expected):
    with _Elsewhere() as executor:
        table = sweep(small_scene, GRID, metrics=["mse", "bad_pixels"], executor=executor, group=11)
    pd.testing.assert_frame_equal(untimed(table), expected)
    assert executor.calls.count(True) >= 1
    assert len(shipping._kept) == 1
    shipping._kept.clear()


def test_workers_keep_few_scenes(small_scene):
    with _Elsewhere() as executor:
        scenes = [small_scene.replace(width=20 + n) for n in range(shipping.KEPT + 3)]
        assert len(sweep(scenes, {"wboit": None}, executor=executor)) == len(scenes)
    assert len(shipping._kept) == shipping.KEPT
    shipping._kept.clear()


def killing(victims: str):
    """Make a metric that kills its process, once for every file in a folder."""

    def metric(frame, reference):
        import os
        import signal

        if frame.params["bins"] == 10:
            for name in os.listdir(victims):
                try:
                    os.unlink(os.path.join(victims, name))
                except FileNotFoundError:
                    continue
                os.kill(os.getpid(), signal.SIGKILL)
        return float(frame.params["bins"])

    return {"bins_again": metric}


def test_a_pool_that_breaks_keeps_what_is_finished(small_scene, tmp_path):
    store, victims = tmp_path / "study.sqlite", tmp_path / "victims"
    victims.mkdir()
    (victims / "one").touch()
    grid = {"lwboit": {"bins": list(range(2, 22))}}
    arguments = {"metrics": killing(str(victims)), "store": store, "group": 2}
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(
            oitlab.SweepFailed, match=r"terminated abruptly.*8 of 20 rows are finished; .*study.sqlite"
        ),
    ):
        sweep(small_scene, grid, executor=pool, **arguments)
    assert oitlab.read_study(store)["bins"].tolist() == list(range(2, 10))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        table = sweep(small_scene, grid, executor=pool, **arguments)
    assert table["bins_again"].tolist() == list(range(2, 22))


class _Stopping(Executor):
    """Finishes one task, then Ctrl-C is pressed."""

    def __init__(self) -> None:
        self.futures: list[Future] = []

    def submit(self, function, *arguments):  # type: ignore[override]
        future: Future = Future()
        if not self.futures:
            future.set_result(function(*arguments))
            threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        self.futures.append(future)
        return future


@pytest.mark.skipif(os.name != "posix", reason="kills a process by a POSIX signal")
def test_ctrl_c_cancels_what_has_not_begun(small_scene):
    executor = _Stopping()
    with pytest.warns(oitlab.SweepInterrupted, match="5 of 22 rows are finished"):
        table = sweep(small_scene, GRID, executor=executor, group=5)
    assert table["bins"].tolist() == [2, 3, 4, 5, 6]
    assert [future.cancelled() for future in executor.futures] == [False] + [True] * 4


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_dask_cluster_one_of_whose_workers_is_killed(small_scene, tmp_path):
    """Two worker processes; one is killed by kill -9 in the middle of its task; every row arrives once."""
    distributed = pytest.importorskip("distributed")
    import dask

    store, victims = tmp_path / "study.sqlite", tmp_path / "victims"
    victims.mkdir()
    (victims / "one").touch()
    grid = {"lwboit": {"bins": list(range(2, 42))}}
    with (
        dask.config.set({"distributed.worker.daemon": True, "temporary-directory": str(tmp_path)}),
        distributed.LocalCluster(
            n_workers=2, processes=True, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        before = set(client.run(os.getpid).values())
        table = sweep(small_scene, grid, metrics=killing(str(victims)), group=2, store=store,
                      executor=client.get_executor())  # fmt: skip
        assert list(victims.iterdir()) == []
        client.wait_for_workers(2, timeout=60)
        after = set(client.run(os.getpid).values())
    assert len(before - after) == 1
    assert table["bins"].tolist() == list(range(2, 42))
    assert table["bins_again"].tolist() == list(range(2, 42))
    assert (table["executor"] == "ClientExecutor").all()
    assert sorted(oitlab.read_study(store)["bins"]) == list(range(2, 42))


def test_a_dask_client_is_told_to_give_its_executor(small_scene):
    class Client:
        def get_executor(self):
            """As Dask's."""

    with pytest.raises(ValueError, match=r"got Client; a Dask client's is client.get_executor\(\)"):
        sweep(small_scene, GRID, executor=Client())


class TestOwnTechniques:
    """Techniques that a user registered reach the workers, and their code is part of a row's key."""

    @staticmethod
    def register(share):
        def background_only(batch):
            return share * batch.background, batch.background[:, 0] * 0 + 1

        oitlab.technique(background_only, id="sweep_test")

    def test_they_reach_the_workers(self, small_scene, processes):
        with oitlab.custom.temporary():
            self.register(0.5)
            here, there = (sweep(small_scene, {"sweep_test": None, "wboit": None}, executor=e)
                           for e in (None, processes))  # fmt: skip
        assert here["mse"].tolist() == there["mse"].tolist()
        assert here["mse"].iloc[0] > 0

    def test_their_code_is_part_of_the_key(self, small_scene, tmp_path):
        found = []
        with oitlab.custom.temporary():
            for share in (0.5, 0.25, 0.5):
                self.register(share)
                table = sweep(small_scene, {"sweep_test": None}, store=tmp_path / "s.sqlite")
                found.append(table["mse"].iloc[0])
        assert found[0] == found[2] != found[1]
        assert len(oitlab.read_study(tmp_path / "s.sqlite")) == 2


EDITED = """
import numpy as np, oitlab
def weight(z, alpha):
    return alpha * z ** -1.0
def metric(frame, reference):
    return 1.0
@oitlab.technique
def from_a_module(batch):
    return batch.background * 1.0, np.ones(len(batch))
"""


@pytest.mark.parametrize("what", ["technique", "weight", "metric", "reference"])
def test_a_worker_with_an_older_module_gives_no_rows(small_scene, tmp_path, monkeypatch, what):
    name = f"edited_{what}"
    file = tmp_path / f"{name}.py"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def arguments():
        module = sys.modules[name]
        return {
            "technique": {"grid": {"from_a_module": None}},
            "weight": {"grid": {"wboit": {"weight": module.weight}}},
            "metric": {"grid": ["wboit"], "metrics": {"mine": module.metric}},
            "reference": {"grid": ["wboit"], "reference": ("wboit", {"weight": module.weight})},
        }[what]

    with oitlab.custom.temporary(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        file.write_text(EDITED)
        importlib.import_module(name)
        store = tmp_path / "s.sqlite"
        assert len(sweep(small_scene, **arguments(), executor=pool, store=store)) == 1
        file.write_text(EDITED.replace("1.0", "0.25"))
        importlib.invalidate_caches()
        importlib.reload(sys.modules[name])
        message = f"the worker has another version of module '{name}'.*restart the workers"
        for _ in range(2):
            with pytest.raises(oitlab.SweepFailed, match=message):
                sweep(small_scene, **arguments(), executor=pool, store=store)
    assert len(oitlab.read_study(store)) == 1


def test_what_cannot_travel_is_named(small_scene):
    lock = threading.Lock()

    def weight(z, alpha):
        with lock:
            return alpha

    with ThreadPoolExecutor(1) as pool:
        for arguments, what in (
            ({"grid": {"wboit": {"weight": ["mb7", weight]}}}, "wboit's 'weight'"),
            ({"grid": ["wboit"], "metrics": {"mine": weight}}, "metric 'mine'"),
        ):
            with pytest.raises(ValueError, match=f"{what} cannot be sent to a worker: cannot pickle"):
                sweep(small_scene, **arguments, executor=pool)


class _Unpicklable(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def test_errors_that_cannot_travel_are_told(small_scene, processes):
    def metric(frame, reference):
        if frame.params["bins"] == 3:
            raise _Unpicklable("no", "more")
        return 1.0

    message = r"^scene0: lwboit \(bins=3\): _Unpicklable: no more \(2 of 3 rows are finished\)"
    with pytest.raises(oitlab.SweepFailed, match=message) as caught:
        sweep(small_scene, {"lwboit": {"bins": [2, 3, 4]}}, metrics={"mine": metric}, executor=processes)
    assert caught.value.table["bins"].tolist() == [2, 4]
