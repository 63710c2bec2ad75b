"""The stress lab: the battery, its table, its files; and errors split by whose they are."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import oitlab
from oitlab import _storage, _stress_report, cli
from oitlab._stress_cases import CASES

PNG = b"\x89PNG\r\n\x1a\n"
COLUMNS = ["technique", "case", "format", "stored_as", "layers", "error_f64", "error_exact", "finite"]
COLUMNS += ["rescued", "monotone", "exact_coverage", "layers_storage", "layers_exact"]
QUICK = ["depth_wide", "hdr_1e6", "alpha_mixed", "mb13_overflow"]


def by_case(technique: str, format: str, *cases: str, **keywords: Any) -> pd.DataFrame:
    return oitlab.stress(technique, formats=[format], cases=cases, **keywords).set_index("case")


def test_the_battery_covers_what_it_says() -> None:
    cases = {case.name: case.fragments(0) for case in CASES}
    assert len(cases) == len(CASES)
    counts = [int(fragments.counts.max()) for fragments in cases.values()]
    assert (min(min(case.layers) for case in CASES), max(counts)) == (1, 100_000)
    alphas = np.concatenate([np.unique(fragments.alpha) for fragments in cases.values()])
    assert {0.0, np.float32(1e-7), np.float32(1 - 2.0**-23), 1.0} <= set(alphas)
    wide = cases["depth_wide"].depth
    assert (wide.min(), wide.max()) == (np.float32(1e-3), 1e7)
    assert np.unique(cases["depth_equal"].depth).size == 1
    assert cases["hdr_1e6"].color.max() / 0.2 > 65_504 > 6e4 >= cases["hdr_6e4"].color.max() / 0.2
    assert cases["near_far_1e8"].far / cases["near_far_1e8"].near == pytest.approx(1e8)
    clusters = np.sort(cases["depth_clusters"].depth)
    assert np.diff(clusters).max() > 1e5 > 1.0 > clusters[clusters < 1.5].max() - clusters.min()


def test_seeds_make_the_battery() -> None:
    for case in CASES[3:6]:
        assert case.fragments(3) == case.fragments(3)
    assert CASES[3].fragments(3) != CASES[3].fragments(4)
    list(map(_same_prefix, CASES[3:8]))


def _same_prefix(case: Any) -> None:
    """The first layers of a deep pixel are those of a shallow one."""
    fragments = case.fragments(0)
    few, many = fragments.pixel(1, 0)["depth"], fragments.pixel(2, 0)["depth"]
    np.testing.assert_array_equal(few, many[: len(few)])


@pytest.mark.parametrize("entry", oitlab.techniques(), ids=oitlab.techniques().ids)
def test_every_technique_takes_the_battery(entry: oitlab.TechniqueInfo) -> None:
    table = oitlab.stress(entry.id, cases=QUICK)
    assert list(table.columns) == COLUMNS
    expected = [name for name in ("f32", "f16", "unorm8") if _storage.stored_in(entry, {}, name) is not None]
    assert list(dict.fromkeys(table["format"])) == expected
    assert len(table) == len(expected) * len(QUICK)
    assert table["finite"].all()
    assert (table["error_exact"] >= 0).all()
    stored = _storage.in_f64(entry, {}) is not None
    assert table["error_f64"].notna().all() == stored
    if entry.properties["exact_coverage"]:
        assert table.loc[table["format"] == "f32", "exact_coverage"].all()


def test_the_reference_has_no_error() -> None:
    table = oitlab.stress(
        "a_buffer", formats=["f32"], cases=["layers_faint", "depth_clusters", "order_sorted"]
    )
    assert (table["error_exact"] == 0).all()
    assert table["monotone"].all()


def test_halves_end_where_mcguire_and_bavoil_say() -> None:
    assert by_case("wboit", "f16", "mb13_overflow")["layers_storage"].tolist() == [22]
    assert by_case("wboit", "f32", "mb13_overflow")["layers_storage"].isna().all()
    assert by_case("wboit", "f16", "mb13_underflow")["error_f64"].item() > 0.1
    assert by_case("wboit", "unorm8", "mb13_revealage")["exact_coverage"].tolist() == [False]
    printed = by_case("wboit", "f32", "mb13_listing3")
    assert printed["error_exact"].item() > 0.05 > 1e-6 > printed["error_f64"].item()
    scaled = by_case("wboit", "f16", "mb13_overflow", params={"summation": "scaled_double"})
    assert scaled["rescued"].isna().all()
    assert scaled["layers_storage"].isna().all()


def test_rows_by_layers_are_those_of_all() -> None:
    whole = oitlab.stress("wboit", formats=["f16"], cases=["layers_dense"])
    rows = oitlab.stress("wboit", formats=["f16"], cases=["layers_dense"], per_layers=True)
    assert rows["layers"].is_monotonic_increasing
    assert rows["error_f64"].max() == whole["error_f64"].item()
    beyond = rows[rows["error_f64"] > 1 / 255]
    assert beyond["layers"].iloc[0] == whole["layers_storage"].item()
    assert (
        oitlab.stress("wboit", formats=["f16"], cases=["layers_dense"], tolerance=9)["layers_exact"]
        .isna()
        .all()
    )


def test_what_not_every_target_can_be_in_is_said() -> None:
    assert by_case("wboit", "unorm8", "alpha_1")["stored_as"].item() == "f16, revealage unorm8"
    assert by_case("lwboit", "unorm8", "alpha_1")["stored_as"].item() == "f16, revealage unorm8"
    assert oitlab.stress("wboit", formats=["srgb8"], cases=["alpha_1"]).empty


def test_series_are_seen_to_rise() -> None:
    assert by_case("fourier_opacity_maps", "f32", "alpha_mixed")["monotone"].tolist() == [False]
    assert by_case("opacity_shadow_maps", "f32", "alpha_mixed")["monotone"].tolist() == [True]
    assert by_case("wboit", "f32", "alpha_mixed")["monotone"].isna().all()


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        (("no_such",), {}, "unknown technique 'no_such'"),
        (("wboit",), {"formats": "f16"}, "formats must be an iterable"),
        (("wboit",), {"formats": ["f17"]}, "formats: unknown 'f17'; known: f64"),
        (("wboit",), {"cases": ["dark"]}, "cases: unknown 'dark'; known: layers_faint"),
        (("wboit",), {"cases": "depth_wide"}, "cases must be an iterable"),
        (("wboit", {"format": "f16"}), {}, "params: format would overrule"),
        (("wboit", {"wieght": "mb7"}), {}, "wieght"),
        (("wboit",), {"seed": -1}, "seed must not be negative"),
        (("wboit",), {"tolerance": 0}, "tolerance: expected a finite number > 0"),
        (("wboit",), {"per_layers": 1}, "per_layers must be True or False"),
        (("wboit",), {"threads": 0}, "threads"),
    ],
)
def test_bad_requests_are_refused_by_name(arguments: Any, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.stress(*arguments, **keywords)


def test_the_command_writes_tables_and_a_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "stress"
    assert cli.main(["stress", "wboit", "over", "--formats", "f32,f16", "--output", str(folder)]) == 0
    assert "wrote" in capsys.readouterr().out
    text = (folder / "table.md").read_text()
    assert "| `wboit` | f16 |" in text
    assert "`oitlab stress wboit over --formats f32,f16`" in text
    assert "mb13_overflow" in text
    assert (folder / "error_against_layers.png").read_bytes().startswith(PNG)
    table = pd.read_csv(folder / "table.csv")
    assert list(table.columns) == COLUMNS
    assert set(table["technique"]) == {"wboit", "a_buffer"}
    assert set(table["case"]) == {case.name for case in CASES}


def test_the_command_prints_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["stress", "no_such"]) == 2
    assert "unknown technique 'no_such'" in capsys.readouterr().err
    assert cli.main(["stress", "wboit", "--formats", "f17"]) == 2
    assert "unknown 'f17'" in capsys.readouterr().err
    assert cli.main(["stress", "wboit", "--formats", "srgb8"]) == 2
    assert "none of wboit can store anything in srgb8" in capsys.readouterr().err
    assert cli.main(["stress", "wboit", "wboit", "--formats", "f32"]) == 0
    assert capsys.readouterr().out.count("| `wboit` | f32 |") == 2  # by technique, and what MB13 say


def test_the_plot_has_units_and_a_line_for_each_format() -> None:
    curves = oitlab.stress("wboit", cases=[_stress_report.PLOTTED], per_layers=True)
    drawing = _stress_report.figure(curves, 1 / 255)
    panel = drawing.axes[0]
    assert len(panel.lines) == 1 + 3 + 1  # tolerance, formats, a_buffer
    assert len({line.get_color() for line in panel.lines[1:]}) == 4
    assert "number" in drawing.get_supxlabel()
    assert "linear RGB" in drawing.get_supylabel()


def stack(n: int, alpha: float) -> oitlab.Fragments:
    ramp = np.linspace(0, 1, n)
    return oitlab.Fragments(
        width=2, height=1, offsets=[0, n, n], depth=1 + ramp, alpha=np.full(n, alpha),
        color=alpha * np.stack([ramp, ramp, ramp], axis=1), background=(1, 1, 1),
    )  # fmt: skip


def test_parts_of_an_error_add_up() -> None:
    fragments = stack(50, 1 / 600)
    split = oitlab.error_split(fragments, "wboit", {"revealage_format": "unorm8"}, "f16")
    whole = oitlab.render(fragments, "wboit", {"format": "f64"}, dtype="float64").color
    exact = oitlab.render(fragments, "a_buffer", dtype="float64").color
    np.testing.assert_array_equal(split.algorithmic.map, whole - exact)
    np.testing.assert_allclose(split.algorithmic.map + split.storage.map, split.total.map, atol=1e-15)
    for part in (split.algorithmic, split.storage, split.total):
        assert part.map.shape == (1, 2, 3)
        assert part.rmse == pytest.approx(np.sqrt(np.mean(part.map**2)))
        assert part.max == np.abs(part.map).max()
        assert not part.map[0, 1].any()  # nothing there
    assert (split.params["format"], split.params["revealage_format"]) == ("f16", "unorm8")


def test_in_f64_nothing_is_the_storages() -> None:
    split = oitlab.error_split(stack(9, 0.5), "wboit", format="f64")
    assert split.storage.max == 0.0
    assert split.algorithmic.max == split.total.max > 0.01
    given = oitlab.error_split(stack(9, 0.5), "wboit", {"format": "f16"})
    assert 0.0 < given.storage.max < 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("no_such",), "no_such"),
        (("wboit", {"format": "f16"}, "f32"), "format: params say 'f16' already"),
        (("wboit", None, "d24"), '"format" is "d24"'),
        (("wboit", {"wieght": 1}), "wieght"),
    ],
)
def test_splits_that_make_no_sense_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.error_split(stack(3, 0.5), *arguments)
    with pytest.raises(ValueError, match="source must be"):
        oitlab.error_split(np.zeros(3), "wboit")  # type: ignore[arg-type]


def test_techniques_without_formats_cannot_be_split(monkeypatch: pytest.MonkeyPatch) -> None:
    formats_of = _storage.format_params
    monkeypatch.setattr(
        "oitlab.splitting.format_params", lambda entry: {} if entry.id == "mlab" else formats_of(entry)
    )
    with pytest.raises(ValueError, match=r"'mlab' has no storage formats; those that have: .*wboit"):
        oitlab.error_split(stack(3, 0.5), "mlab")
