"""Sweeps in this process: what is asked for, what comes back, and what is refused before any work."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import oitlab
from handmade import random_image
from oitlab import cli
from oitlab._errors import BLOCK_PIXELS, errors_of
from oitlab.sweeping import plan, work
from oitlab.sweeping.bind import bound
from oitlab.sweeping.metrics import Measure
from oitlab.sweeping.study import Study, named_row
from oitlab.sweeping.table import _AFTER, from_rows

ROUNDING = 1e-12
"""Relative; sums of squares may be added in another order."""

sweep = partial(oitlab.sweep, progress=False)


@pytest.fixture
def rendered(monkeypatch):
    """Requests that were rendered, group by group."""
    groups = []

    def counting(source, requests, **keywords):
        groups.append(list(requests))
        return oitlab.render_many(source, requests, **keywords)

    monkeypatch.setattr(work, "render_many", counting)
    return groups


class TestTable:
    def test_a_row_per_combination_with_the_numbers_of_compare(self, small_scene):
        grid = {"wboit": {"weight": ["mb7", "mb9"], "weight_shift": np.array([0.0, 0.5])}, "mlab": None}
        table = sweep(small_scene, grid, metrics=["rmse", "bad_pixels"])
        assert list(table["technique"]) == ["wboit"] * 4 + ["mlab"]
        assert list(table["weight"][:4]) == ["mb7", "mb7", "mb9", "mb9"]
        assert list(table["weight_shift"][:4]) == [0.0, 0.5, 0.0, 0.5]
        exact = oitlab.render(small_scene, "a_buffer")
        for _, row in table.iterrows():
            params = {} if row["technique"] == "mlab" else {n: row[n] for n in ("weight", "weight_shift")}
            frame = oitlab.render(small_scene, row["technique"], params)
            expected = oitlab.compare(frame, exact)
            assert (row["rmse"], row["bad_pixels"]) == (expected["rmse"], expected["bad_pixels"])
            stats = frame.stats
            assert row["fragments"] == stats.fragments
            assert row["dropped"] == stats.dropped
            assert row["depth_complexity_max"] == stats.depth_complexity_max
            assert row["depth_complexity_mean"] == stats.depth_complexity_mean
            assert row["geometry_passes"] == stats.geometry_passes
            assert row["bytes_per_pixel"] == stats.bytes_per_pixel
            skipped = {
                n: row[f"skipped.{n}"] for n in stats.skipped if "tiles" in n and n.startswith("empty")
            }
            assert skipped == {"empty_tiles": stats.skipped["empty_tiles"]}
            assert row["scene_hash"] == small_scene.content_hash
        assert table["rmse"].gt(0).all()

    def test_params_that_a_technique_lacks_or_that_do_nothing_are_missing(self, small_scene):
        table = sweep(small_scene, {"wboit": {"weight": ["mb7", "inv_pow"]}, "a_buffer": {}})
        assert table["weight_k"].isna().tolist() == [True, False, True]
        assert table["weight"].isna().tolist() == [False, False, True]
        assert table["overflow"].isna().tolist() == [True, True, False]
        assert table["seed"].isna().all()
        assert table["weight_k"].dtype == "Float64"
        assert table["seed"].dtype == "Int64"

    def test_a_tuple_is_one_value_and_is_shown_as_it_is(self, small_scene):
        table = sweep(small_scene, {"opacity_shadow_maps": {"range": (1.0, 9.0), "bins": range(4, 6)}})
        assert table["range"].tolist() == [(1.0, 9.0)] * 2
        assert table["bins"].tolist() == [4, 5]
        mixed = sweep(small_scene, {"opacity_shadow_maps": {"range": ["pixel", (1.0, 9.0)]}})
        assert mixed["range"].tolist() == ["pixel", (1.0, 9.0)]

    def test_what_differs_in_nothing_that_matters_is_one_row_and_runs_once(self, small_scene, rendered):
        weights = {"weight": ["mb7", "inv_pow"], "weight_k": [1, 2.0, 3], "seed": [0, 1]}
        grid = [("wboit", weights), "wboit", ("wboit", {"weight": "inv_pow", "weight_k": np.float32(2)})]
        table = sweep(small_scene, grid)
        assert len(table) == 1 + 3
        assert sum(map(len, rendered)) == 4
        assert table["weight_k"].dropna().tolist() == [1.0, 2.0, 3.0]
        assert (table["skipped.duplicate_variants"] == 0).all()

    def test_groups_share_a_rasterisation_and_give_the_same_images(self, small_scene, rendered):
        grid = {"lwboit": {"bins": [2, 3, 4, 5, 6]}}
        together = sweep(small_scene, grid)
        alone = sweep(small_scene, grid, group=1)
        assert list(map(len, rendered)) == [5, 1, 1, 1, 1, 1]
        assert together["mse"].tolist() == alone["mse"].tolist()
        assert (together["shared_with"] == 4).all()
        assert (alone["shared_with"] == 0).all()
        assert (together["raster_share_ms"] == together["raster_ms"] / 5).all()

    def test_large_images_come_in_groups_that_fit_the_memory(self, pane):
        scene = oitlab.Scene([pane], camera=oitlab.Camera(), width=2048, height=2048)
        requests = [("lwboit", {"bins": n}) for n in range(1, 11)]
        wanted = plan.wanted_rows({"a": scene}, {"a": ("p", None)}, requests, None, [])
        make = partial(work.Task, measure=Measure(), repeats=1, threads=None)
        rows = plan.tasks_of(wanted, {"p": work.Package(scene, None)}, make, None, 64)
        assert [len(task.variants) for task in rows] == [4, 4, 2]

    def test_scenes_by_name_and_fragments(self, small_scene):
        fragments = oitlab.capture(small_scene)
        table = sweep({"one": small_scene, "two": fragments}, {"wboit": None})
        assert table["scene"].tolist() == ["one", "two"]
        assert table["mse"].nunique() == 1
        assert table["scene_hash"].tolist() == [small_scene.content_hash, fragments.content_hash]
        assert sweep([small_scene, fragments], ["wboit"])["scene"].tolist() == ["scene0", "scene1"]

    def test_one_scene_under_two_names_is_rendered_once(self, small_scene, rendered):
        table = sweep({"one": small_scene, "two": small_scene.replace()}, {"wboit": None})
        assert table["scene"].tolist() == ["one", "two"]
        assert len(rendered) == 1

    def test_seeds_go_to_what_draws_random_numbers(self, small_scene, rendered):
        grid = {"stochastic_transparency": {"samples": [2, 4]}, "wboit": None,
                "painter": None}  # fmt: skip
        table = sweep(small_scene, grid, seeds=[3, 1, 3])
        assert table["seed"].tolist() == [3, 1, 3, 1, pd.NA, pd.NA]
        assert table["mse"].nunique() == 6
        assert sum(map(len, rendered)) == 6

    def test_times_are_medians_with_spreads(self, small_scene, rendered):
        once, thrice = (sweep(small_scene, {"wboit": None}, repeats=n) for n in (1, 3))
        assert len(rendered) == 4
        for name in ("resolve_ms", "raster_ms", "total_ms"):
            assert once[f"{name}_spread"].isna().all()
            assert (thrice[f"{name}_spread"] > 0).all()
            assert (thrice[name] > 0).all()
        assert once["mse"].tolist() == thrice["mse"].tolist()
        assert once["executor"].isna().all()

    def test_versions_are_told(self, small_scene):
        (row,) = sweep(small_scene, {"wboit": None}).to_dict("records")
        assert row["oitlab_version"] == oitlab.__version__
        assert row["numpy_version"] == np.__version__
        assert row["python_version"] == sys.version.split()[0]
        assert row["threads"] >= 1
        assert row["backend"] == "cpu"
        assert (row["width"], row["height"]) == (48, 27)

    def test_a_param_named_like_a_column_gets_a_prefix(self):
        row = {"scene": "s", "technique": "t", "seed": None, "scene_hash": "h", "skipped": {}, "versions": {}}
        row |= {"params": {"threads": 1, "mse": 2.0}, "metrics": {"mse": 0.5, "width": 3.0}}
        row |= {name: None for name in _AFTER}
        table = from_rows([row])
        found = table[["param.threads", "mse", "metric.mse", "metric.width"]].iloc[0].tolist()
        assert found == [1, 2.0, 0.5, 3.0]

    @pytest.mark.skipif(sys.platform != "linux", reason="peaks of memory are read from /proc")
    def test_memory_is_measured_alone(self):
        scene = oitlab.scenes.blades(width=320, height=180, count=30)
        table = sweep(scene, {"wboit": None}, measure_memory=True)
        image = 4 * (3 + 1)
        assert image < table["bytes_per_pixel_measured"].iloc[0] < 1000 * image
        assert sweep(scene, {"wboit": None})["bytes_per_pixel_measured"].isna().all()

    def test_the_bar_counts_rows(self, small_scene, capsys):
        oitlab.sweep(small_scene, {"wboit": {"weight": ["mb7", "mb9"]}})
        assert "2/2" in capsys.readouterr().err
        sweep(small_scene, {"wboit": None})
        assert capsys.readouterr().err == ""


class TestReference:
    def test_it_is_rendered_once_per_scene(self, small_scene, monkeypatch):
        asked = []

        def render(source, technique, *params, **keywords):
            asked.append(technique)
            return oitlab.render(source, technique, *params, **keywords)

        monkeypatch.setattr(work, "render", render)
        scenes = [small_scene, small_scene.replace(width=40)]
        sweep(scenes, {"lwboit": {"bins": [2, 4]}}, ("depth_peeling", {"passes": 3}), group=1)
        assert asked == ["depth_peeling"] * 2

    def test_an_image_serves_as_well(self, small_scene):
        exact = oitlab.render(small_scene, "a_buffer")
        expected = sweep(small_scene, {"wboit": None})["mse"].tolist()
        for reference in (exact, exact.color, {"scene0": exact}):
            assert sweep(small_scene, {"wboit": None}, reference)["mse"].tolist() == expected

    def test_none_measures_nothing(self, small_scene):
        table = sweep(small_scene, {"wboit": None}, None)
        assert "mse" not in table
        assert table.attrs["metrics"] == []


class TestMetrics:
    def test_options_and_functions(self, small_scene):
        metrics = {
            "psnr": None,
            "bad_pixels": None,
            "bias": lambda frame, exact: (frame.color - exact.color).mean(),
        }
        options = {"data_range": 2.0, "threshold": 0.1}
        (row,) = sweep(small_scene, {"wboit": None}, metrics=metrics, metric_options=options).to_dict(
            "records"
        )
        frame, exact = oitlab.render_many(small_scene, ["wboit", "a_buffer"])
        expected = oitlab.compare(frame, exact, **options)
        assert (row["psnr"], row["bad_pixels"]) == (expected["psnr"], expected["bad_pixels"])
        assert row["bias"] == float((frame.color - exact.color).mean())

    def test_perceptual_ones_come_by_name(self, small_scene):
        table = sweep(small_scene, {"wboit": None}, metrics=["delta_e_itp", "mse"])
        exact = oitlab.render(small_scene, "a_buffer")
        expected = oitlab.compare(oitlab.render(small_scene, "wboit"), exact, metrics="delta_e_itp")
        assert table["delta_e_itp"].tolist() == [expected["delta_e_itp"]]
        assert table.attrs["metrics"] == ["mse", "delta_e_itp"]

    def test_exact_images_have_an_infinite_psnr(self, small_scene):
        options = {"data_range": 1.0}
        table = sweep(small_scene, {"a_buffer": None}, metrics="psnr", metric_options=options)
        assert table["psnr"].tolist() == [np.inf]

    @pytest.mark.parametrize("pixels", [(1, 1), (7, 5), (3, BLOCK_PIXELS)])
    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
    def test_blocks_add_up(self, pixels, dtype):
        test, exact = (random_image(seed, *pixels).astype(dtype) for seed in (1, 2))
        found = errors_of(test, exact, 0.5)
        errors = test.astype(np.float64) - exact.astype(np.float64)
        assert found.squared == pytest.approx(np.square(errors).sum(), rel=ROUNDING)
        assert found.largest == np.abs(errors).max()
        assert found.bad_pixels == np.count_nonzero(np.abs(errors).max(axis=2) > 0.5)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("place", [0, 2 * BLOCK_PIXELS])
    def test_what_is_not_finite_is_seen_in_every_block(self, bad, place):
        test = np.zeros((3, BLOCK_PIXELS, 3))
        test[place // BLOCK_PIXELS, 1, 2] = bad
        assert not np.isfinite(errors_of(test, np.zeros_like(test)).largest)
        y = place // BLOCK_PIXELS
        with pytest.raises(ValueError, match=re.escape(f"image: pixel (x=1, y={y}) is not finite")):
            oitlab.compare(test, np.zeros_like(test))
        with pytest.raises(ValueError, match="reference: pixel"):
            oitlab.compare(np.zeros_like(test), test)


class TestRefused:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"scenes": 3}, "scenes must be a Scene"),
            ({"scenes": []}, "scenes is empty"),
            ({"scenes": {"a": 3}}, r"scenes\['a'\] must be a Scene"),
            ({"scenes": {3: None}}, "named by strings"),
            ({"grid": {}}, "grid is empty"),
            ({"grid": "wboit"}, "grid must map"),
            ({"grid": {"wbot": None}}, "unknown technique 'wbot'"),
            ({"grid": [("wboit", {}, 1)]}, r"grid\[0\] must be a technique id or"),
            ({"grid": [("wboit", 3)]}, "params of 'wboit' must be a mapping"),
            ({"grid": {"wboit": {3: 4}}}, "must have names for keys"),
            ({"grid": {"wboit": {"weight": []}}}, "wboit's 'weight' is an empty list"),
            ({"grid": {"wboit": {"weight": np.array([])}}}, "wboit's 'weight' is an empty list"),
            ({"grid": {"wboit": {"weight": [["mb7"]]}}}, "one value of several numbers is a tuple"),
            ({"grid": {"wboit": {"weight_k": np.ones((2, 2))}}}, r"one dimension, got shape \(2, 2\)"),
            ({"grid": {"wboit": {"weight": {"mb7"}}}}, "must be a value or a list of values, got set"),
            ({"grid": {"wboit": {"weight": iter(["mb7"])}}}, "must be a value or a list of values, got"),
            ({"grid": {"wboit": {"bins": [3]}}}, 'wboit: unknown parameter "bins"'),
            ({"grid": {"wboit": {"weight": ["mb7", "mb6"]}}}, 'wboit: parameter "weight" is "mb6"'),
            ({"grid": {"lwboit": {"bins": [4, 0]}}}, 'lwboit: parameter "bins" is 0'),
            ({"reference": "exact"}, "unknown technique"),
            ({"reference": ("lwboit", {"bins": -1})}, 'parameter "bins" is -1'),
            ({"reference": 3}, "reference must be a technique id"),
            ({"reference": np.zeros((2, 2, 3))}, "does not fit 'scene0', which has 27 rows of 48 pixels"),
            ({"reference": np.zeros((2, 2))}, r"reference: expected shape \(H, W, 3\)"),
            ({"reference": {"other": "a_buffer"}}, r"reference names \['other'\], but the scenes are"),
            ({"metrics": "ssim"}, "metrics: unknown ssim"),
            ({"metrics": ["psnr"]}, "psnr needs data_range"),
            ({"metrics": ["flip"]}, "flip needs pixels_per_degree"),
            ({"metrics": {"mine": 3}}, "'mine' must be a function"),
            ({"metrics": {"mse": len}}, "'mse' is oitlab.compare's"),
            ({"metrics": 3}, "metrics must be names"),
            ({"metrics": ["mse"], "reference": None}, "mse need a reference"),
            ({"metric_options": {"ppd": 3}}, "metric_options: unknown ppd"),
            ({"metric_options": {"threshold": -1}}, "threshold: expected a finite number >= 0"),
            ({"seeds": []}, "seeds is empty"),
            ({"seeds": 3}, "seeds must be an iterable"),
            ({"seeds": [0.5]}, r"seeds\[0\] must be an integer"),
            ({"seeds": [-1]}, "seeds must be at least 0"),
            ({"seeds": [1], "grid": {"slab": {"seed": 3}}}, "slab has seeds of its own"),
            ({"repeats": 0}, "repeats"),
            ({"repeats": 1.5}, "repeats must be an integer"),
            ({"group": 0}, "group must be at least 1"),
            ({"threads": 0}, "threads"),
            ({"measure_memory": 1}, "measure_memory must be True or False"),
            ({"progress": "no"}, "progress must be True or False"),
            ({"executor": "dask"}, "executor must be a concurrent.futures.Executor, got str"),
            ({"store": 3}, "store must be the path of a file"),
            ({"store": ""}, "store must be the path of a file"),
            ({"store": ":memory:"}, "':memory:' would be lost"),
            (
                {"grid": {"wboit": {"weight": ["mb7", "a * k"], "weight.k": [1.0, 2.0]}}},
                "'weight.k' is a uniform of one's own texts, which 'mb7' is not; put the two in",
            ),
            (
                {"grid": {"wboit": {"weight": np.frompyfunc(lambda z, a: a, 2, 1)}}},
                r"wboit's 'weight' has a ufunc '<lambda> \(vectorized\)' in it, whose code",
            ),
            ({"metrics": {"mine": np.frompyfunc(lambda a, b: 1, 2, 1)}}, "metric 'mine' has a ufunc"),
            (
                {"reference": ("wboit", {"weight": np.frompyfunc(lambda z, a: a, 2, 1)})},
                "wboit's 'weight' has a ufunc",
            ),
        ],
    )
    def test_before_any_work(self, small_scene, rendered, tmp_path, arguments, message):
        given = {"scenes": small_scene, "grid": {"wboit": None}, "store": tmp_path / "new.sqlite"} | arguments
        with pytest.raises(ValueError, match=message):
            oitlab.sweep(**({"progress": False} | given))
        assert rendered == []
        assert list(tmp_path.iterdir()) == []

    def test_a_silent_sweep_leaves_widgets_alone(self):
        # tqdm.auto warns in notebooks without widgets, which would end up beside a silent sweep's table
        program = (
            "import sys, oitlab; scene = oitlab.scenes.blades(width=8, height=6, count=3); "
            "oitlab.sweep(scene, ['wboit'], progress=False); print('tqdm.auto' in sys.modules)"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert (done.stdout, done.stderr) == ("False\n", "")

    def test_an_error_on_the_way_keeps_what_is_finished(self, small_scene):
        calls = []

        def fails_at_the_third(frame, reference):
            calls.append(frame)
            if len(calls) == 3:
                raise RuntimeError("no more")
            return 1.0

        message = r"^scene0: lwboit \(bins=3\): no more \(3 of 4 rows are finished\)$"
        with pytest.raises(oitlab.SweepFailed, match=message) as caught:
            sweep(small_scene, {"lwboit": {"bins": [1, 2, 3, 4]}}, metrics={"mine": fails_at_the_third})
        assert caught.value.table["bins"].tolist() == [1, 2, 4]
        assert type(caught.value.__cause__) is RuntimeError

    def test_a_metric_that_gives_no_number(self, small_scene):
        with pytest.raises(oitlab.SweepFailed, match="metric 'mine' gave None"):
            sweep(small_scene, {"wboit": None}, metrics={"mine": lambda frame, reference: None})


class Power:
    """A weight that is an object."""

    def __init__(self, k):
        self.k = k

    def __call__(self, z, alpha):
        return alpha * z**-self.k

    def half(self, z, alpha):
        return 0.5 * self(z, alpha)


def module_weight(z, alpha):
    return alpha / z


def hidden(ufunc):
    return lambda z, alpha: ufunc(z, alpha).astype(np.float32)


def never(z, alpha):
    return np.full_like(z, np.nan)


def raising(z, alpha):
    if len(z):
        raise ZeroDivisionError("no such weight")
    return z


class TestFunctions:
    """Weights of one's own: told apart, warned of once, blamed by name."""

    @pytest.mark.parametrize(
        "make",
        [
            lambda k: np.vectorize(lambda z, a: a * z**-k, otypes=[np.float32]),
            lambda k: hidden(np.frompyfunc(lambda z, a: float(a * z**-k), 2, 1)),
        ],
        ids=["vectorize", "ufunc"],
    )
    def test_different_ones_are_different_rows(self, small_scene, make):
        weights = [make(1.0), make(4.0)]
        table = sweep(small_scene, {"wboit": {"weight": [*weights, weights[0]]}})
        assert table["mse"].nunique() == len(table) == 2
        assert table["weight"].nunique() == 2

    def test_different_ones_are_different_rows_of_a_store(self, small_scene, tmp_path):
        for k in (1.0, 4.0):
            table = sweep(small_scene, {"wboit": {"weight": Power(k)}}, store=tmp_path / "s.sqlite")
            expected = oitlab.render(small_scene, "wboit", {"weight": Power(k)})
            exact = oitlab.render(small_scene, "a_buffer")
            assert table["mse"].tolist() == [oitlab.compare(expected, exact)["mse"]]
        assert len(oitlab.read_study(tmp_path / "s.sqlite")) == 2

    def test_rows_show_which_one_it_was(self, small_scene):
        weights = [Power(1.0), Power(2.0), Power(1.0).half, partial(Power(1.0)), lambda z, alpha: z]
        table = sweep(small_scene, {"wboit": {"weight": [*weights, module_weight]}})
        shown = table["weight"].tolist()
        assert len(set(shown)) == 6
        assert shown[5] == "module_weight"
        names = [name.rpartition("#")[0].rpartition(".")[2] for name in shown[:5]]
        assert names == ["Power", "Power", "half", "partial", "<lambda>"]

    @pytest.mark.parametrize("executor", [False, True])
    def test_one_warning_tells_of_all_rows(self, small_scene, tmp_path, executor):
        grid = {"wboit": {"weight": [never, module_weight], "weight_shift": [0.0, 1.0]}}
        message = r"^2 rows have fragments .* invalid_weights counts them: wboit \(weight='never'\)$"
        for _ in range(2):  # computed, then read
            with ExitStack() as stack:
                pool = stack.enter_context(ThreadPoolExecutor(2)) if executor else None
                with pytest.warns(oitlab.WeightWarning, match=message) as caught:
                    table = sweep(small_scene, grid, store=tmp_path / "s.sqlite", group=1, executor=pool)
            assert [Path(warning.filename) for warning in caught] == [Path(__file__)]
            fragments = table["fragments"].iloc[0]
            assert table["invalid_weights"].tolist() == [fragments, fragments, 0, 0]
        assert oitlab.read_study(tmp_path / "s.sqlite")["invalid_weights"].sum() == 2 * fragments

    @pytest.mark.parametrize("executor", [False, True])
    def test_one_that_fails_is_named_and_the_others_are_kept(self, small_scene, executor):
        weights = {"weight": ["mb7", raising, "mb9"], "weight_shift": 0.5}
        told = r"^scene0: wboit \(weight='raising', weight_shift=0.5\): no such weight \(2 of 3 rows"
        with ExitStack() as stack:
            pool = stack.enter_context(ThreadPoolExecutor(1)) if executor else None
            with pytest.raises(oitlab.SweepFailed, match=told) as caught:
                sweep(small_scene, {"wboit": weights}, executor=pool)
        assert caught.value.table["weight"].tolist() == ["mb7", "mb9"]
        assert isinstance(caught.value.__cause__, ZeroDivisionError)

    @pytest.mark.parametrize(
        "call",
        [
            lambda scene: oitlab.order_sensitivity(scene, "wboit", {"weight": never}, n=2),
            lambda scene: oitlab.error_split(scene, "wboit", {"weight": never}),
            lambda scene: oitlab.render(scene, "wboit", {"weight": never}),
            lambda scene: oitlab.stress("wboit", {"weight": never}),
        ],
        ids=["order_sensitivity", "error_split", "render", "stress"],
    )
    def test_other_verbs_warn_their_callers(self, small_scene, call):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", oitlab.WeightWarning)
            call(small_scene)
        assert {Path(warning.filename) for warning in caught} == {Path(__file__)}

    def test_order_sensitivity_says_nothing_of_good_weights(self, small_scene):
        oitlab.order_sensitivity(small_scene, "wboit", {"weight": module_weight}, n=2)


def test_integers_beyond_64_bits_are_columns_and_stored(small_scene, tmp_path):
    """As a store has them that another version wrote, which took them."""
    numbers = [2**70, -(2**63) - 1, 3, 0.5]
    variants = bound(small_scene, [("lwboit", {"bins": 2 + n}) for n in range(len(numbers))], None)
    task = work.Task("p", tuple(variants), ("a", "b", "c", "d"), Measure(), 1, None)
    rows = [(key, named_row(row, "s")) for key, row in task.rows(work.Package(small_scene, None))]
    for (_, row), number in zip(rows, numbers, strict=True):
        row["params"]["n"] = number
    with closing(Study(tmp_path / "s.sqlite")) as study:
        study.add(rows)
    assert from_rows([row for _, row in rows])["n"].tolist() == numbers
    assert oitlab.read_study(tmp_path / "s.sqlite")["n"].tolist() == numbers


class TestBinding:
    def test_no_param_that_changes_the_image_is_taken_for_inactive(self):
        scene = oitlab.scenes.blades(width=24, height=16, count=40)
        checked = 0
        for entry in oitlab.techniques():
            (variant,) = bound(scene, [(entry.id, {})], None)
            plain = oitlab.render(scene, entry.id)
            for param in entry.params:
                if param.name not in variant.inactive:
                    continue
                for other in (1, 2, 0.5, True, (1.0, 2.0), *re.findall(r'"([^"]*)"', param.range)):
                    try:
                        frame = oitlab.render(scene, entry.id, {param.name: other})
                    except ValueError:
                        continue
                    checked += 1
                    assert np.array_equal(frame.color, plain.color), (entry.id, param.name, other)
        assert checked > 50

    def test_clip_planes_of_the_camera_are_defaults(self, small_scene):
        camera = small_scene.camera
        requests = [("wboit", {"weight": "mb10"}), ("wboit", {"weight": "mb10", "near": camera.near})]
        assert len(bound(small_scene, requests, None)) == 1
        assert len(bound(oitlab.capture(small_scene), requests, None)) == 1
        other = small_scene.replace(camera=oitlab.Camera(near=0.2))
        assert len(bound(other, requests, None)) == 2


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
