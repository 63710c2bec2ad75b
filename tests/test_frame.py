"""`Frame`: fields that are made when they are asked for."""

import copy
import gc
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
import pytest

import oitlab
from handmade import FIELDS, frame, random_image

LATER = ("scene_hash", "first_depth", "fragment_count")


class Maker:
    """A function that counts its calls."""

    def __init__(self, value: Any) -> None:
        self.value, self.calls = value, 0

    def __call__(self) -> Any:
        self.calls += 1
        return self.value


def lazy_frame() -> tuple[oitlab.Frame, dict[str, Maker]]:
    eager = frame(random_image(1))
    makers = {name: Maker(getattr(eager, name)) for name in LATER}
    return eager.replace(**makers), makers


def test_nothing_is_made_before_it_is_asked_for_and_nothing_twice() -> None:
    lazy, makers = lazy_frame()
    assert (repr(lazy), lazy.color.shape) == (repr(frame(random_image(1))), (5, 7, 3))
    for number, name in enumerate(LATER):
        assert [maker.calls for maker in makers.values()] == [1] * number + [0] * (3 - number)
        assert getattr(lazy, name) is getattr(lazy, name) is makers[name].value


def test_a_copy_with_changes_leaves_the_rest_unmade() -> None:
    lazy, makers = lazy_frame()
    changed = lazy.replace(scene_hash="other", technique="mine")
    assert (changed.scene_hash, changed.technique, lazy.technique) == ("other", "mine", "wboit")
    assert not any(maker.calls for maker in makers.values())
    with pytest.raises(TypeError, match=r"Frame has no \['colour'\]; it has color, "):
        lazy.replace(colour=1)


@pytest.mark.parametrize("duplicate", [lambda f: pickle.loads(pickle.dumps(f)), copy.deepcopy, copy.copy])
def test_copies_and_pickles_hold_values(small_scene: oitlab.Scene, duplicate: Any, backend: Any) -> None:
    original = oitlab.render(small_scene, "wboit", backend=backend)
    back = duplicate(original)
    for name in FIELDS:
        np.testing.assert_equal(getattr(back, name), getattr(original, name))
    assert back != original
    assert hash(original) == hash(original)


def test_a_maker_is_let_go_once_it_has_given_its_value() -> None:
    lazy, makers = lazy_frame()
    watch = weakref.ref(makers.pop("first_depth"))
    assert lazy.first_depth is lazy.first_depth
    gc.collect()
    assert watch() is None


def test_a_maker_that_fails_is_asked_again() -> None:
    outcomes = [MemoryError(), None]

    def fail_first() -> str:
        if error := outcomes.pop(0):
            raise error
        return "found"

    lazy = frame(random_image(1), scene_hash=fail_first)
    with pytest.raises(MemoryError):
        _ = lazy.scene_hash
    assert lazy.scene_hash == "found"


def test_threads_share_one_array() -> None:
    start = Barrier(4)
    lazy = frame(random_image(1), first_depth=lambda: np.zeros((5, 7), np.float32))

    def ask(_: int) -> Any:
        start.wait()
        return lazy.first_depth

    with ThreadPoolExecutor(4) as pool:
        arrays = list(pool.map(ask, range(4)))
    assert all(array is lazy.first_depth for array in arrays)


@pytest.mark.parametrize("name", FIELDS)
def test_fields_cannot_be_set(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(frame(random_image(1)), name, None)


def test_inactive_params_are_those_that_do_nothing(backend: Any) -> None:
    scene = oitlab.scenes.squares(width=8, height=6)
    named, own = oitlab.render_many(
        scene,
        [("wboit", {"weight": "mb7"}), ("continuum", {"layers": 2, "weight": "a / z * k", "weight.k": 2.0})],
        backend=backend,
    )
    assert {"weight_k", "near", "far"} <= named.inactive_params <= named.params.keys()
    assert not {"weight", "weight_shift"} & named.inactive_params
    assert {"weight", "weight.k"} <= own.inactive_params  # nothing is weighed there
    assert named.replace(technique="mine").inactive_params == named.inactive_params
