"""The registry as Python sees it."""

from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab.registry import TechniqueTable

TABLE = oitlab.techniques()
BIBLIOGRAPHY = Path(__file__).parents[1] / "references.bib"
AXES = {"memory", "insertion", "merge", "normalize", "opacity"}


def test_it_is_an_immutable_sequence() -> None:
    assert isinstance(TABLE, TechniqueTable)
    assert len(TABLE) == len(TABLE.ids) == len(set(TABLE.ids)) >= 9
    assert TABLE[0] == next(iter(TABLE))
    assert TABLE[:2].ids == TABLE.ids[:2]
    assert oitlab.techniques() == TABLE
    assert hash(TABLE) == hash(oitlab.techniques())
    with pytest.raises(FrozenInstanceError):
        TABLE[0].id = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        TABLE[0] = TABLE[1]  # type: ignore[index]
    with pytest.raises(TypeError):
        TABLE[0].axes["memory"] = "all"  # type: ignore[index]


def test_it_is_indexed_by_id_and_alias() -> None:
    assert TABLE["a_buffer"] is TABLE["over"]
    assert "over" in TABLE
    assert TABLE[0] in TABLE
    assert "no_such" not in TABLE
    assert TABLE.get("no_such") is None
    with pytest.raises(KeyError, match=r"no_such.*a_buffer"):
        TABLE["no_such"]
    with pytest.raises(IndexError):
        TABLE[len(TABLE)]


@pytest.mark.parametrize("entry", TABLE, ids=TABLE.ids)
def test_every_entry_is_complete(entry: oitlab.TechniqueInfo) -> None:
    assert entry.name
    assert entry.doc.strip()
    assert entry.citation
    assert set(entry.axes) == AXES
    assert isinstance(entry.properties["order_independent"], bool)
    assert entry.backends in (("cpu",), ("cpu", "gpu"))
    assert entry.geometry_passes
    assert entry.bytes_per_pixel
    names = [param.name for param in entry.params]
    assert len(names) == len(set(names))
    for param in entry.params:
        assert param.type
        assert param.range
        assert param.doc


@pytest.mark.parametrize("entry", TABLE, ids=TABLE.ids)
def test_every_citation_is_in_the_bibliography(entry: oitlab.TechniqueInfo) -> None:
    text = BIBLIOGRAPHY.read_text()
    for key in entry.citation:
        assert f"{{{key}," in text


@pytest.mark.parametrize("entry", TABLE, ids=TABLE.ids)
def test_stated_defaults_and_resolved_params_give_the_default_image(
    entry: oitlab.TechniqueInfo, small_scene: oitlab.Scene, backend: Any
) -> None:
    plain = oitlab.render(small_scene, entry.id, backend=backend)
    stated = {param.name: param.default for param in entry.params if not is_derived(param)}
    assert stated == {name: plain.params[name] for name in stated}
    resolved = {name: value for name, value in plain.params.items() if value is not None}
    for params in (stated, resolved):
        again = oitlab.render(small_scene, entry.id, params, backend=backend)
        assert again.params == plain.params
        np.testing.assert_array_equal(again.color, plain.color)


def is_derived(param: oitlab.ParamInfo) -> bool:
    """Whether the default is a text that says what it is derived from."""
    return isinstance(param.default, str) and repr(param.default)[1:-1] not in param.range


def test_it_prints_as_an_aligned_table() -> None:
    lines = str(TABLE).splitlines()
    assert max(map(len, lines)) <= 160
    assert {line.split()[0] for line in lines[2:] if line[0] != " "} == set(TABLE.ids)
    start = lines[0].index("name")
    for entry in TABLE:
        (line,) = (line for line in lines if line.split(" ")[0] == entry.id)
        assert line[start:].startswith(entry.name.split()[0])
    assert repr(TABLE) == str(TABLE)


def test_it_shows_as_html_in_notebooks() -> None:
    html = TABLE._repr_html_()
    assert html.count("<tr>") == 1 + len(TABLE)
    assert all(f"<td>{name}</td>" in html for name in TABLE.ids)


def test_an_entry_prints_its_params() -> None:
    text = str(TABLE["lwboit"])
    assert text.startswith("lwboit")
    assert all(param.name in text for param in TABLE["lwboit"].params)


COST_PARAMS = {
    "lwboit": [{"bins": 8}, {"bins": 64}, {"storage": "ll"}],
    "mlab": [{"layers": 8}],
    "depth_peeling": [{"passes": 3}],
    "stochastic_transparency": [{"samples": 16, "mode": "depth"}],
}


@pytest.mark.parametrize("entry", TABLE, ids=TABLE.ids)
def test_the_cost_is_that_of_a_render(
    entry: oitlab.TechniqueInfo, small_scene: oitlab.Scene, backend: Any
) -> None:
    for params in ({}, *COST_PARAMS.get(entry.id, [])):
        stats = oitlab.render(small_scene, entry.id, params, backend=backend).stats
        cost = entry.cost(
            params,
            depth_complexity_mean=stats.depth_complexity_mean,
            depth_complexity_max=stats.depth_complexity_max,
        )
        assert cost == oitlab.Cost(stats.geometry_passes, stats.bytes_per_pixel)


def test_the_cost_follows_params_and_depth_complexity() -> None:
    def bytes_per_pixel(name: str, mean: float, **params: object) -> float:
        return TABLE[name].cost(params, depth_complexity_mean=mean, depth_complexity_max=40).bytes_per_pixel

    assert [bytes_per_pixel("mlab", 3.0, layers=k) for k in (1, 4)] == [20.0, 80.0]
    assert bytes_per_pixel("mlab", 3.0, layers=4, node_color_format="unorm8") == 32.0
    assert [bytes_per_pixel("a_buffer", n) for n in (0.0, 2.5)] == [4.0, 74.0]
    assert [bytes_per_pixel("wboit", n) for n in (0.0, 2.5)] == [20.0, 20.0]
    assert bytes_per_pixel("wboit", 2.5, format="f16", revealage_format="unorm8") == 9.0
    peeling = TABLE["depth_peeling"].cost(depth_complexity_mean=3, depth_complexity_max=np.int64(40))
    assert peeling.geometry_passes == 41.0


@pytest.mark.parametrize(
    ("params", "mean", "largest", "message"),
    [
        ({"bins": 0}, 1.0, 4, "bins"),
        ({"nis": 8}, 1.0, 4, "nis"),
        (None, -1.0, 4, "depth_complexity_mean: -1 is not a number from 0 to depth_complexity_max = 4"),
        (None, float("nan"), 4, "depth_complexity_mean"),
        (None, 5.0, 4, "depth_complexity_mean"),
        (None, "2", 4, "depth_complexity_mean must be a number"),
        (None, 1.0, 4.5, "depth_complexity_max must be an integer"),
        (None, 1.0, -1, "depth_complexity_max must not be negative"),
    ],
)
def test_costs_of_nothing_possible_are_refused(
    params: dict, mean: object, largest: object, message: str
) -> None:  # type: ignore[type-arg]
    with pytest.raises(ValueError, match=message):
        TABLE["lwboit"].cost(params, depth_complexity_mean=mean, depth_complexity_max=largest)  # type: ignore[arg-type]


def test_the_axes_are_wymans() -> None:
    table = TABLE.axes_table()
    lines = str(table).splitlines()
    assert max(map(len, lines)) <= 170
    assert repr(table) == str(table)
    assert {line.split()[0] for line in lines[2:] if line[0] != " "} == set(TABLE.ids)
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["mlab"][:5] == ("k layers", "always", "merge furthest", "no", "alpha")
    assert rows["mlab"][5:] == ("no", "no", "yes")
    assert rows["wboit"][:5] == ("empirical func", "never", "discard all", "α-weighted average", "alpha")
    for entry in TABLE:
        assert set(entry.axes.values()) <= set(rows[entry.id])
    html = table._repr_html_()
    assert html.count("<tr>") == 1 + len(TABLE)
    assert html.count("<td>") == len(TABLE) * len(table.columns)
