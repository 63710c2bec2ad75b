"""How they get into the registry, and what is refused there."""

import functools
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab import custom


def constant(batch: oitlab.Batch, *, level: float = 0.5) -> tuple[Any, Any]:
    return np.full((len(batch), 3), level), np.ones(len(batch))


# the registry


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"id": "wboit"}, "id: 'wboit' is taken by the built-in technique 'wboit'"),
        ({"id": "over"}, "id: 'over' is taken by the built-in technique 'a_buffer'"),
        ({"id": "no name"}, "id must be a name of letters"),
        ({"id": ""}, "id must be a name"),
        ({"id": 3}, "id must be a name"),
        ({"order": "random"}, "constant: order must be 'sorted' or 'submission', got 'random'"),
        ({"params": ["level"]}, "constant: params must be a mapping"),
        ({"params": {"level": 0.5, "levle": 1}}, "takes no keyword-only argument 'levle'"),
        ({"params": {"submission_order": "as_is"}}, "the name 'submission_order' is taken"),
        ({"params": {"mse": 1}}, "constant: params: the name 'mse' is taken by a column of the tables"),
        ({"params": {"total_ms": 1}}, "the name 'total_ms' is taken by a column"),
        ({"params": {"width": 1}}, "the name 'width' is taken by a column"),
        ({"params": {"level": 2**63}}, "level: default: 9223372036854775808 is not an integer of 64 bits"),
        ({"params": {"level": [1]}}, "level: default must be a bool, int, float, str or tuple, got"),
        ({"params": {"level": ()}}, "level: default must hold"),
        ({"params": {"level": np.nan}}, "level: default: nan is not a finite number"),
        ({"params": {3: 1}}, "3 is not a name"),
        ({"transmittance": 3}, "transmittance must be a function, got 3"),
        ({"transmittance": lambda batch: 1}, "cannot be called as"),
        ({"name": 3}, "name must be text"),
        ({"doc": 3}, "doc must be text"),
        ({"citation": "Porter1984"}, "citation must be a sequence of keys"),
        ({"citation": [3]}, "citation must be a sequence of keys"),
        ({"unbiased": 1}, "unbiased must be True or False, got 1"),
        ({"colored_transmittance": "yes"}, "colored_transmittance must be True or False"),
        ({"geometry_passes": -1}, "geometry_passes must be a finite number >= 0 or a function, got -1"),
        ({"bytes_per_pixel": "many"}, "bytes_per_pixel must be a finite number"),
        ({"axes": {"colour": "red"}}, "unknown axis 'colour'; the axes are memory"),
        ({"axes": {"memory": 3}}, "must be text"),
        ({"axes": "none"}, "axes must be a mapping"),
    ],
)
def test_bad_registrations_are_refused(keywords: Any, message: str) -> None:
    before = oitlab.techniques()
    with pytest.raises(ValueError, match=message):
        oitlab.technique(**keywords)(constant)
    assert oitlab.techniques() is before


def test_functions_that_cannot_be_called_are_refused() -> None:
    def nothing() -> None: ...
    def needs(batch: Any, *, must: int) -> None: ...

    with pytest.raises(ValueError, match=r"nothing: the function\(\).* cannot be called as \(batch\)"):
        oitlab.technique(nothing)
    with pytest.raises(ValueError, match="needs: params: the function's argument 'must' has no default"):
        oitlab.technique(needs)
    oitlab.technique(params={"must": 3})(needs)
    assert oitlab.techniques()["needs"].params[0].default == 3
    with pytest.raises(ValueError, match="a technique is a function, got 3"):
        oitlab.technique(3)  # type: ignore[call-overload]


def test_arguments_that_would_never_be_params_are_refused() -> None:
    def positional(batch: Any, k: int = 4) -> None: ...
    def only(batch: Any, k: int = 4, /) -> None: ...

    for function in (positional, only):
        message = rf"{function.__name__}: params: .* 'k' .*: make k keyword-only, as in \(batch, \*, k=4\)"
        for params in (None, {"k": 4}):
            with pytest.raises(ValueError, match=message):
                oitlab.technique(params=params)(function)


def test_any_callable_will_do(fragments: oitlab.Fragments) -> None:
    class Level:
        """Not the technique's docstring."""

        def __call__(self, batch: oitlab.Batch, *, level: float = 0.25) -> tuple[Any, Any]:
            return constant(batch, level=level)

    oitlab.technique(id="by_partial")(functools.partial(constant, level=0.75))
    oitlab.technique(id="by_object")(Level())
    one, two = oitlab.render_many(fragments, ["by_partial", ("by_object", {"level": 0.5})])
    assert (one.color[0, 0, 0], two.color[0, 0, 0]) == (0.75, 0.5)
    assert one.params["level"] == 0.75
    for name in ("by_partial", "by_object"):
        assert oitlab.techniques()[name].doc == ""
        assert custom.receive(custom.shippable(name)) == name
    with pytest.raises(ValueError, match="id must be a name of letters"):
        oitlab.technique(Level())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"default": None}, "default must be"),
        ({"default": 3, "min": 5}, "default: 3 is not an integer >= 5"),
        ({"default": 3, "max": 2}, "default: 3 is not an integer <= 2"),
        ({"default": 3, "min": 4, "max": 2}, "min: 4 is greater than max = 2"),
        ({"default": 3, "min": "a"}, "min must be a number"),
        ({"default": "a", "max": 2}, "max is for numbers, and the default is 'a'"),
        ({"default": "a", "choices": "abc"}, "choices must be a sequence"),
        ({"default": "a", "choices": ()}, "choices must be a sequence"),
        ({"default": "a", "choices": ("a", 3)}, "choices: 3 is not of the type"),
        ({"default": "c", "choices": ("a", "b")}, "default: 'c' is not one of"),
        (
            {"default": (1.0, 2.0), "max": 1},
            r"default: \(1.0, 2.0\) is not a tuple \(float, float\), each <= 1",
        ),
        ({"default": (1, 2**64)}, r"default: \(1, 18446744073709551616\) is not a tuple \(int, int\)"),
        ({"default": 1, "doc": 3}, "doc must be text"),
    ],
)
def test_bad_declarations_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.Param(**arguments)


def test_a_second_function_takes_the_place_of_the_first(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    oitlab.technique(lambda batch: constant(batch, level=1.0), id="other")
    levels, ids = [], []
    for level in (0.25, 0.75):
        oitlab.technique(lambda batch, *, k=level: constant(batch, level=k), id="constant")
        levels.append(oitlab.render(fragments, "constant").color[0, 0, 0])
        ids.append(oitlab.techniques().ids[-2:])
    assert levels == [0.25, 0.75]
    assert ids == [("constant", "other")] * 2
    oitlab.unregister("constant")
    assert oitlab.techniques().ids[-1] == "other"
    with pytest.raises(ValueError, match="technique 'constant' is not registered; custom techniques: other"):
        oitlab.unregister("constant")
    with pytest.raises(ValueError, match="technique 'wboit' is built in"):
        oitlab.unregister("wboit")
    with pytest.raises(
        ValueError, match=r'unknown technique "constant"; the techniques are a_buffer, .*, other'
    ):
        oitlab.render(fragments, "constant")


def test_temporary_restores_what_was_there() -> None:
    oitlab.technique(constant)
    before = oitlab.techniques()
    with custom.temporary():
        oitlab.technique(lambda batch: None, id="constant")
        oitlab.technique(id="more")(constant)
        assert oitlab.techniques()["constant"].definition is not before["constant"].definition
    assert oitlab.techniques() == before
    assert oitlab.techniques()["constant"].definition is before["constant"].definition


def test_it_has_no_gpu_form(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    with pytest.raises(ValueError, match="'constant' has no GPU form"):
        oitlab.render(fragments, "constant", backend="gpu")


def test_diagnostics_look_for_nothing(fragments: oitlab.Fragments) -> None:
    oitlab.technique(constant)
    frame = oitlab.render(fragments, "constant", diagnostics=True)
    assert dict(frame.diagnostics) == {}
    assert frame.stats.diagnostics == {}


def test_frames_can_be_pickled_and_written(fragments: oitlab.Fragments, tmp_path: Path) -> None:
    oitlab.technique(constant)
    frame = oitlab.render(fragments, "constant", {"level": 0.25})
    again = pickle.loads(pickle.dumps(frame))
    assert again.params == frame.params
    oitlab.write_exr(tmp_path / "mine.exr", frame)
    np.testing.assert_array_equal(oitlab.read_exr(tmp_path / "mine.exr").color, frame.color)
    json.dumps(frame.params)
