"""Sweeps over functions of one's own: told apart, bound, warned of, blamed by name."""

import re
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import oitlab
from oitlab.sweeping import work
from oitlab.sweeping.bind import bound
from oitlab.sweeping.metrics import Measure
from oitlab.sweeping.study import Study, named_row
from oitlab.sweeping.table import from_rows

sweep = partial(oitlab.sweep, progress=False)


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
