"""Sweeps on the GPU: backends as an axis, stores that keep devices apart, executors that have the device."""

import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import oitlab
from gpu_scenes import DEVICE, WHY_NOT, tolerance
from oitlab.sweeping import devices, work

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

GRID: dict[str, Any] = {"wboit": {"weight": ["mb7", "mb9"]}, "mlab": {"layers": [2, 4]}}
BOTH: Any = ["cpu", "gpu"]
sweep = partial(oitlab.sweep, progress=False)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Backends and sizes of the groups that were rendered."""
    groups: list[tuple[str, int]] = []

    def counting(source: Any, requests: Any, *, backend: Any, **keywords: Any) -> Any:
        groups.append((backend, len(requests)))
        return oitlab.render_many(source, requests, backend=backend, **keywords)

    monkeypatch.setattr(work, "render_many", counting)
    return groups


def test_backends_are_an_axis(small_scene: oitlab.Scene, rendered: list[tuple[str, int]]) -> None:
    table = sweep(small_scene, GRID, backend=BOTH)
    assert table["backend"].tolist() == BOTH * 4
    assert table["weight"][:4].tolist() == ["mb7", "mb7", "mb9", "mb9"]
    assert rendered == [("cpu", 4), ("gpu", 4)]
    assert table["gpu"].isna().tolist() == [True, False] * 4
    assert DEVICE is not None
    assert table["gpu"][1].startswith(DEVICE.adapter)
    errors = oitlab.to_xarray(table[table["technique"] == "wboit"], dims=["weight", "backend"])["mse"]
    assert dict(errors.sizes) == {"weight": 2, "backend": 2}
    # against the reference of the CPU, both of them
    exact = oitlab.render(small_scene, "a_buffer")
    frame = oitlab.render(small_scene, "wboit", backend="gpu")
    assert table["mse"][1] == oitlab.compare(frame, exact)["mse"]
    assert abs(errors.sel(backend="gpu") - errors.sel(backend="cpu")).max() <= tolerance(small_scene, exact)


def test_one_backend_or_each_once(small_scene: oitlab.Scene) -> None:
    grid = {"wboit": None, "stochastic_transparency": {"samples": 4}}
    table = sweep(small_scene, grid, backend="gpu", seeds=[1, 2])
    assert table["backend"].tolist() == ["gpu"] * 3
    assert table["seed"].tolist() == [pd.NA, 1, 2]
    assert len(sweep(small_scene, grid, backend=["gpu", "gpu"])) == 2


def test_a_store_keeps_backends_and_devices_apart(
    small_scene: oitlab.Scene, rendered: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "study.sqlite"
    on_cpu = sweep(small_scene, GRID, store=store)
    both = sweep(small_scene, GRID, store=store, backend=BOTH)
    assert rendered == [("cpu", 4), ("gpu", 4)]
    pd.testing.assert_series_equal(both["mse"][::2].reset_index(drop=True), on_cpu["mse"])
    again = sweep(small_scene, GRID, store=store, backend=BOTH)
    assert len(rendered) == 2
    pd.testing.assert_frame_equal(again, both)
    assert sorted(oitlab.read_study(store)["backend"]) == ["cpu"] * 4 + ["gpu"] * 4
    for module in (devices, work):
        monkeypatch.setattr(module, "named" if module is devices else "check_same", lambda *_: "another")
    assert sweep(small_scene, GRID, store=store, backend="gpu")["gpu"].tolist() == ["another"] * 4
    assert rendered[2:] == [("gpu", 4)]


def test_threads_share_the_device(small_scene: oitlab.Scene) -> None:
    with ThreadPoolExecutor(2) as pool:
        table = sweep(small_scene, GRID, backend=BOTH, executor=pool, group=1)
    expected = sweep(small_scene, GRID, backend=BOTH)
    assert table["mse"].tolist() == expected["mse"].tolist()
    assert table["gpu"].tolist() == expected["gpu"].tolist()


@pytest.fixture(scope="module")
def spawned() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        yield pool


def test_processes_have_devices_of_their_own(
    small_scene: oitlab.Scene, spawned: ProcessPoolExecutor, tmp_path: Path
) -> None:
    store = tmp_path / "study.sqlite"
    table = sweep(small_scene, GRID, backend=BOTH, executor=spawned, store=store)
    assert (table["executor"] == "ProcessPoolExecutor").all()
    again = sweep(small_scene, GRID, backend=BOTH, store=store)
    pd.testing.assert_frame_equal(again, table)


@pytest.mark.skipif("fork" not in get_all_start_methods(), reason="this system does not fork")
def test_forks_of_a_process_that_has_used_the_device_are_refused_before_any_work(
    small_scene: oitlab.Scene, tmp_path: Path
) -> None:
    oitlab.render(small_scene, "wboit", backend="gpu")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        with (
            ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool,
            pytest.raises(RuntimeError, match='start workers by "spawn"'),
        ):
            sweep(small_scene, GRID, backend="gpu", executor=pool, store=tmp_path / "new.sqlite")
    assert list(tmp_path.iterdir()) == []


def test_a_worker_with_another_device_does_not_fill_its_rows(small_scene: oitlab.Scene) -> None:
    with pytest.raises(RuntimeError, match="this sweep's rows are of the device 'another', and a worker has"):
        devices.check_same("another")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"backend": "tpu"}, "unknown backend 'tpu'; known: cpu, gpu"),
        ({"backend": ["cpu", 3]}, "unknown backend 3"),
        ({"backend": []}, "backend is empty"),
        ({"backend": None}, "unknown backend None"),
        ({"grid": {"mlab": {"layers": [2, 33]}}}, "layers=33 has no form"),
        ({"grid": {"wboit": {"weight": lambda z, a: a}}}, "weight"),
        ({"measure_memory": True}, 'it is for backend="cpu"'),
    ],
)
def test_what_the_device_does_not_do_is_refused_before_any_work(
    small_scene: oitlab.Scene, rendered: list[Any], tmp_path: Path, arguments: dict[str, Any], message: str
) -> None:
    given = {"grid": {"wboit": None}, "backend": BOTH, "store": tmp_path / "new.sqlite"} | arguments
    with pytest.raises(ValueError, match=message):
        sweep(small_scene, **given)
    assert rendered == []
    assert list(tmp_path.iterdir()) == []


def test_images_beyond_the_device_are_refused_before_any_work(rendered: list[Any]) -> None:
    assert DEVICE is not None
    side = DEVICE.limits["image_side"] + 1
    if side > 16_384:
        pytest.skip(f"no image has {side} pixels along a side")
    wide = oitlab.scenes.squares(width=side, height=1)
    with pytest.raises(ValueError, match=f"width: {side} is more than"):
        sweep([wide.replace(width=1), wide], {"wboit": None}, backend=BOTH)
    assert rendered == []


def test_the_command_line_sweeps_on_both(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from oitlab.cli import main

    arguments = ["scene:blades", "--grid", "wboit:weight=mb7,mb9", "--width", "16", "--height", "9"]
    assert main(["sweep", *arguments, "--backend", "cpu,gpu", "-o", str(tmp_path / "a.csv")]) == 0
    assert pd.read_csv(tmp_path / "a.csv")["backend"].tolist() == BOTH * 2
    assert main(["sweep", *arguments, "--backend", "tpu"]) == 2
    assert "unknown backend 'tpu'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["compare", "render"])
def test_refusals_come_before_any_bar_or_image(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str
) -> None:
    from oitlab.cli import main

    def nothing(*_: Any, **__: Any) -> None:
        raise AssertionError("something was rendered")

    monkeypatch.setattr("oitlab._oitlab.render", nothing)
    monkeypatch.setattr("oitlab._oitlab.render_gpu", nothing)
    size = ["scene:blades", "--backend", "gpu", "--width", "16", "--height", "9"]
    asked = {
        "compare": ["--techniques", "wboit,mlab:layers=33"],
        "render": ["--technique", "mlab", "--param", "layers=33", "-o", str(tmp_path / "a.png")],
    }
    if command == "render":
        monkeypatch.undo()  # the core itself refuses before it draws
    assert main([command, *size, *asked[command]]) == 2
    error = capsys.readouterr().err
    assert error.startswith("oitlab: error: mlab: layers=33 has no form"), error
    assert list(tmp_path.iterdir()) == []
    assert main(["compare", *size, "--techniques", "wboit", "--reference", "exact"]) == 2
    assert capsys.readouterr().err.startswith("oitlab: error: unknown technique")
