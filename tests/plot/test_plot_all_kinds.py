"""Every kind of plot: what can be read in print, and where it shows."""

import io
import math
import pickle
import re
import subprocess
import sys

import matplotlib as mpl
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import oitlab
from oitlab import _palette, plot
from oitlab.plot._weights import MCGUIRE
from plotting import PALETTE, SMALLEST_TYPE, every_kind, prices, seeds, texts


def test_every_public_function_is_tried(figures: dict[str, Figure]) -> None:
    assert sorted(figures) == sorted(plot.__all__)


def test_type_is_readable_at_the_printed_size(figures: dict[str, Figure]) -> None:
    for kind, figure in figures.items():
        assert figure.get_figwidth() in (3.3, 7.0), kind
        for text in texts(figure):
            assert text.get_fontsize() >= SMALLEST_TYPE, (kind, text.get_text())


def test_no_text_leaves_the_page(figures: dict[str, Figure]) -> None:
    for kind, figure in figures.items():
        width, height = figure.get_size_inches() * figure.dpi
        for text in texts(figure):
            box = text.get_window_extent()
            inside = box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1
            assert inside, (kind, text.get_text(), box)


def test_titles_captions_and_cells_do_not_cover_each_other(figures: dict[str, Figure]) -> None:
    for kind in ("strip", "axes_table", "error_map"):
        found = [t for t in texts(figures[kind]) if not re.search(r"10\^|^\$", t.get_text())]
        boxes = [(t.get_text(), t.get_window_extent()) for t in found]
        for index, (one, box) in enumerate(boxes):
            for other, its in boxes[index + 1 :]:
                apart = (
                    box.x1 <= its.x0 + 1
                    or its.x1 <= box.x0 + 1
                    or box.y1 <= its.y0 + 1
                    or its.y1 <= box.y0 + 1
                )
                assert apart, (kind, one, other)


def test_lines_have_colours_of_the_palette_and_differ_without_them(figures: dict[str, Figure]) -> None:
    for kind in ("convergence", "weight_curves", "transmittance"):
        lines = [line for line in figures[kind].axes[0].lines if line.get_label()[0] != "_"]
        assert len(lines) >= 3
        assert {to_hex(line.get_color()).upper() for line in lines} <= PALETTE
        looks = {(line.get_linestyle(), line.get_marker(), line.get_linewidth()) for line in lines}
        assert len(looks) == len(lines), kind


def test_the_palette_has_seventy_looks() -> None:
    assert len({_palette.series(index)[::2] for index in range(70)}) == 70


def test_axes_have_units(figures: dict[str, Figure]) -> None:
    labelled = ("convergence", "pareto", "weight_curves", "transmittance")
    for kind in labelled:
        axes = figures[kind].axes[0]
        assert "(" in axes.get_xlabel(), kind
        assert "(" in axes.get_ylabel(), kind
    for kind in ("depth_complexity", "error_map"):
        assert "(" in figures[kind].axes[-1].get_ylabel(), kind


def test_nothing_global_changes(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> None:
    import matplotlib.pyplot as plt

    windows = plt.get_fignums()
    with mpl.rc_context():
        before = dict(mpl.rcParams)
        for figure in every_kind(fragments, frames).values():
            figure.savefig(io.BytesIO(), dpi=20)
        assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == windows


def test_the_users_settings_do_not_matter() -> None:
    def pixels() -> bytes:
        data = io.BytesIO()
        plot.convergence(seeds(), "samples").savefig(data, format="rgba", dpi=60)
        return data.getvalue()

    plain = pixels()
    assert pixels() == plain
    with mpl.rc_context(
        {"font.size": 30, "xtick.labelsize": 2, "lines.linewidth": 9, "axes.facecolor": "red"}
    ):
        assert pixels() == plain


def test_figures_show_themselves_once_and_survive_pickling(figures: dict[str, Figure]) -> None:
    for figure in figures.values():
        assert figure._repr_png_()[:4] == b"\x89PNG"  # type: ignore[attr-defined]
    again = {kind: pickle.loads(pickle.dumps(figure)) for kind, figure in figures.items()}
    assert len(again["weight_curves"].axes[0].lines) == len(MCGUIRE)


def test_pdf_has_truetype_fonts(figures: dict[str, Figure]) -> None:
    data = io.BytesIO()
    figures["convergence"].savefig(data, format="pdf")
    assert b"/FontType 3" not in data.getvalue()
    assert b"/Type0" in data.getvalue()


def test_axes_of_ones_own_are_drawn_in() -> None:
    figure = Figure(figsize=(7, 3), layout="constrained")
    left, right = figure.subplots(1, 2)
    assert plot.convergence(seeds(), "samples", ax=left) is figure
    assert plot.pareto(prices(), ax=right) is figure
    figure.savefig(io.BytesIO(), dpi=30)
    assert left.lines
    assert right.lines
    assert figure.get_figheight() == 3
    assert all(t.get_fontsize() >= SMALLEST_TYPE for t in texts(figure) if t.get_text() != "x")
    with pytest.raises(ValueError, match="ax must be matplotlib Axes, got Figure"):
        plot.convergence(seeds(), "samples", ax=figure)  # type: ignore[arg-type]


def test_widths() -> None:
    assert plot.weight_curves(["one"], z=[1, 2], width=5).get_figwidth() == 5
    for wrong, message in (
        ("wide", "single"),
        (1, r"\[1.5, 40\]"),
        (math.nan, r"\[1.5, 40\]"),
        (None, "number"),
    ):
        with pytest.raises(ValueError, match=f"width must be .*{message}"):
            plot.weight_curves(["one"], z=[1, 2], width=wrong)  # type: ignore[arg-type]


def test_import_is_lazy() -> None:
    code = "import sys, oitlab; assert 'matplotlib' not in sys.modules and 'plot' in dir(oitlab)"
    code += "; oitlab.plot.pareto"
    subprocess.run(
        [sys.executable, "-c", code + "; assert 'matplotlib.pyplot' not in sys.modules"], check=True
    )
    with pytest.raises(AttributeError, match="no attribute 'plots'"):
        oitlab.plots  # type: ignore[attr-defined]  # noqa: B018
