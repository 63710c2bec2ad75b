"""Sweeps in this process: what is asked for, what comes back, and what is refused before any work."""

import re
import subprocess
import sys
from functools import partial

import numpy as np
import pandas as pd
import pytest

import oitlab
from handmade import random_image
from oitlab._errors import BLOCK_PIXELS, errors_of
from oitlab.sweeping import plan, work
from oitlab.sweeping.metrics import Measure
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
