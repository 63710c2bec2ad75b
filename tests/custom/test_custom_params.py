"""Their params and what they say that they cost."""

from typing import Any

import numpy as np
import pytest

import oitlab


def constant(batch: oitlab.Batch, *, level: float = 0.5) -> tuple[Any, Any]:
    return np.full((len(batch), 3), level), np.ones(len(batch))


# params


DECLARED = {
    "on": True,
    "count": 3,
    "factor": 1.0,
    "mode": "a",
    "bounds": (0.0, 1.0),
    "layers": oitlab.Param(4, min=1, max=64, doc="kept per pixel"),
    "weight": oitlab.Param("one", choices=("one", "two")),
}


def declared() -> oitlab.TechniqueInfo:
    def with_params(batch: oitlab.Batch, *, factor: float, **others: Any) -> tuple[Any, Any]:
        assert {*others, "factor"} == set(DECLARED)
        return np.full((len(batch), 3), factor), np.ones(len(batch))

    oitlab.technique(params=DECLARED)(with_params)
    return oitlab.techniques()["with_params"]


def test_the_entry_says_what_it_takes() -> None:
    entry = declared()
    assert (entry.custom, entry.backends, entry.name) == (True, ("cpu",), "with params")
    table = {param.name: (param.type, param.range, param.default) for param in entry.params}
    orders = oitlab.techniques()["wboit"].params[-2]
    assert table == {
        "on": ("bool", "True or False", True),
        "count": ("int", "an integer of 64 bits", 3),
        "factor": ("float", "a finite number", 1.0),
        "mode": ("str", "text", "a"),
        "bounds": ("tuple", "a tuple (float, float)", (0.0, 1.0)),
        "layers": ("int", "an integer in [1, 64]", 4),
        "weight": ("str", 'one of "one", "two"', "one"),
        "submission_order": (orders.type, orders.range, orders.default),
        "seed": ("int", "an integer >= 0", 0),
    }
    assert entry.params[5].doc == "kept per pixel"
    assert entry.fingerprint is not None
    assert oitlab.techniques()["wboit"].fingerprint is None
    assert not oitlab.techniques()["wboit"].custom
    assert set(entry.axes) == set(oitlab.techniques()["wboit"].axes)
    assert set(entry.properties) == set(oitlab.techniques()["wboit"].properties)
    for text in (str(entry), str(oitlab.techniques()), str(oitlab.techniques().axes_table())):
        assert "with_params" in text


def test_params_are_read_as_their_defaults_are(fragments: oitlab.Fragments) -> None:
    declared()
    given = {
        "on": np.bool_(False),
        "count": np.int64(7),
        "factor": 2,
        "mode": "b",
        "bounds": np.array([2, 3]),
        "layers": 64,
        "weight": "two",
        "seed": 9,
    }
    frame = oitlab.render(fragments, "with_params", given)
    assert frame.technique == "with_params"
    assert frame.params == {
        "on": False,
        "count": 7,
        "factor": 2.0,
        "mode": "b",
        "bounds": (2.0, 3.0),
        "layers": 64,
        "weight": "two",
        "submission_order": "as_is",
        "seed": 9,
    }
    assert type(frame.params["factor"]) is float
    assert oitlab.render(fragments, "with_params", {"count": None}).params["count"] == 3


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"cuont": 3}, r'unknown parameter "cuont"; its parameters are on \(True or False\), count'),
        ({"on": 1}, 'parameter "on" is 1; allowed is True or False; its parameters are on, count'),
        ({"count": 2.5}, '"count" is 2.5; allowed is an integer'),
        ({"count": True}, '"count" is True'),
        ({"count": 2**63}, '"count" is 9223372036854775808; allowed is an integer of 64 bits'),
        ({"count": -(2**63) - 1}, '"count" is -9223372036854775809; allowed is an integer of 64 bits'),
        ({"factor": "big"}, "\"factor\" is 'big'; allowed is a finite number"),
        ({"factor": np.inf}, '"factor" is inf'),
        ({"factor": np.nan}, '"factor" is nan'),
        ({"mode": 3}, '"mode" is 3; allowed is text'),
        ({"bounds": 1.0}, r'"bounds" is 1.0; allowed is a tuple \(float, float\)'),
        ({"bounds": (1.0, 2.0, 3.0)}, '"bounds"'),
        ({"bounds": (1.0, "x")}, '"bounds"'),
        ({"layers": 0}, r'"layers" is 0; allowed is an integer in \[1, 64\]'),
        ({"layers": 65}, '"layers" is 65'),
        ({"weight": "three"}, '"weight" is \'three\'; allowed is one of "one", "two"'),
        ({"seed": -1}, '"seed" is -1; allowed is an integer in'),
        ({"submission_order": "sideways"}, '"submission_order" is \'sideways\'; allowed is one of "as_is"'),
    ],
)
def test_bad_params_are_refused_by_name(fragments: oitlab.Fragments, params: Any, message: str) -> None:
    declared()
    with pytest.raises(ValueError, match="^with_params: .*" + message):
        oitlab.render_many(fragments, ["a_buffer", ("with_params", params)])


def test_a_large_integer_is_as_large_as_a_table_takes(fragments: oitlab.Fragments) -> None:
    declared()
    for count in (2**63 - 1, -(2**63)):
        assert oitlab.render(fragments, "with_params", {"count": count}).params["count"] == count


def test_seed_reaches_a_function_that_takes_it(fragments: oitlab.Fragments) -> None:
    calls = []

    @oitlab.technique
    def noisy(batch: oitlab.Batch, *, seed: int = 0) -> tuple[Any, Any]:
        calls.append(seed)
        return constant(batch, level=seed / 100)

    frames = oitlab.render_many(
        fragments, [("noisy", {"seed": 5}), ("noisy", {"seed": 6}), ("noisy", {"seed": 5})]
    )
    assert sorted(calls) == [5, 6]
    assert [frame.params["seed"] for frame in frames] == [5, 6, 5]
    assert frames[0].color[0, 0, 0] == np.float32(0.05)
    assert [param.name for param in oitlab.techniques()["noisy"].params] == ["submission_order", "seed"]


def test_equal_requests_are_rendered_once(fragments: oitlab.Fragments) -> None:
    calls = []

    @oitlab.technique
    def called(batch: oitlab.Batch, *, level: float = 0.5) -> tuple[Any, Any]:
        calls.append(level)
        return constant(batch, level=level)

    variants: list[Any] = [
        "called",
        ("called", {"level": 0.5}),
        ("called", {"level": 1}),
        ("called", {"seed": 4}),
    ]
    frames = oitlab.render_many(fragments, variants)
    assert sorted(calls) == [0.5, 1.0]
    assert [frame.stats.skipped["duplicate_variants"] for frame in frames] == [1, 1, 0, 0]
    assert [frame.color[0, 0, 0] for frame in frames] == [0.5, 0.5, 1, 0.5]
    frames[0].color[:] = 7
    assert frames[1].color[0, 0, 0] == 0.5
    calls.clear()
    oitlab.render_many(fragments, variants, skip=False)
    assert len(calls) == 4


# cost


def test_costs(mine: list[str], small_scene: oitlab.Scene) -> None:
    frame = oitlab.render(small_scene, "numba_over")
    assert frame.stats.geometry_passes == 1
    assert frame.stats.bytes_per_pixel == 28 * frame.stats.depth_complexity_mean + 4
    assert frame.stats.resolve_ms > 0
    assert frame.stats.total_ms >= frame.stats.raster_ms
    entry = oitlab.techniques()["numba_over"]
    cost = entry.cost(depth_complexity_mean=2.0, depth_complexity_max=5)
    assert cost == oitlab.Cost(1.0, 60.0)
    assert (entry.geometry_passes, entry.bytes_per_pixel) == ("1", "by params")
    with pytest.raises(ValueError, match="depth_complexity_mean: 6"):
        entry.cost(depth_complexity_mean=6.0, depth_complexity_max=5)
    unsaid = oitlab.render(small_scene, "own_mlab").stats
    assert np.isnan([unsaid.geometry_passes, unsaid.bytes_per_pixel]).all()
    oitlab.technique(bytes_per_pixel=lambda params, mean, largest: -params["level"])(constant)
    with pytest.raises(ValueError, match=r"constant: bytes_per_pixel is -0.5, not a finite number >= 0"):
        oitlab.render(small_scene, "constant")


def test_costs_that_fail_name_the_technique(fragments: oitlab.Fragments) -> None:
    wrong: list[Any] = [
        lambda params, mean, largest: params["levle"],
        lambda params: 3,
        lambda params, mean, largest: 1 / 0,
    ]
    for function, error in zip(wrong, ("KeyError: 'levle'", "TypeError: ", "ZeroDivisionError"), strict=True):
        oitlab.technique(bytes_per_pixel=function)(constant)
        message = f"^constant: bytes_per_pixel, called with params of the names level, .* raised {error}"
        with pytest.raises(ValueError, match=message):
            oitlab.render(fragments, "constant")
