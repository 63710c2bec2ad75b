import csv
import io
import math

import matplotlib
import numpy as np
import pytest
from PIL import Image
from rich.console import Console

import oitlab
from handmade import frame, random_image
from oitlab import report
from oitlab._image import srgb_bytes
from oitlab.metrics import compare
from oitlab.report import Comparison, compare_techniques, headline, label, table, write_csv
from oitlab.sheet import write_contact_sheet


def comparison(*images, reference, labels=None):
    """Measure hand-made images; the first stands for wboit."""
    exact = frame(reference, technique="a_buffer")
    frames = tuple(frame(image) for image in images)
    baseline = compare(images[0], reference)["mse"]
    names = labels or [f"technique{index}" for index in range(len(images))]
    rows = tuple(report._row(n, f, exact, baseline) for n, f in zip(names, frames, strict=True))
    return Comparison(exact, frames, rows)


def printed(result):
    console = Console(file=io.StringIO(), width=200)
    console.print(table(result))
    return f"{headline(result, 'soup')}\n{console.file.getvalue()}"


class TestRows:
    def test_closed_form(self):
        reference = np.full((2, 2, 3), 0.5)
        off = reference.copy()
        off[0, 0, 0] = 0.75
        rows = comparison(reference + 0.25, off, reference, reference=reference).rows
        assert [row.mse for row in rows] == [0.0625, 0.0625 / 12, 0.0]
        assert [row.rmse for row in rows] == pytest.approx([0.25, 0.25 / math.sqrt(12), 0.0])
        assert [row.factor for row in rows] == [1.0, 12.0, math.inf]
        assert rows[0].mse_255 == 0.0625 * 65025
        assert rows[0].max_error == 0.25
        assert (rows[0].resolve_ms, rows[0].total_ms, rows[0].dropped) == (1.25, 3.5, 3)

    def test_table(self):
        reference = np.full((2, 2, 3), 0.5)
        text = printed(comparison(reference + 0.25, reference, reference=reference, labels=["wboit", "over"]))
        lines = [line.split() for line in text.splitlines()]
        assert (
            "soup, 2 x 2: 12,345 fragments, 2.50 per pixel (at most 7), raster 2.0 ms, 2 threads, cpu" in text
        )
        assert ["wboit", "0.25", "0.0625", "4.06e+03", "0.25", "1", "1.2", "3.5", "10", "1", "3"] in lines
        assert ["over", "0", "0", "0", "0", "exact", "1.2", "3.5", "10", "1", "3"] in lines

    def test_without_wboit_there_is_no_factor(self):
        image = np.zeros((1, 1, 3))
        row = report._row("x", frame(image), frame(image), math.nan)
        assert math.isnan(row.factor)
        assert printed(Comparison(frame(image), (), (row,))).split()[-6] == "-"

    def test_what_is_no_scene_is_refused(self):
        with pytest.raises(ValueError, match="source must be a Scene or Fragments, got int"):
            compare_techniques(3, [])

    def test_csv(self, tmp_path):
        result = comparison(
            random_image(1), random_image(2), reference=random_image(3), labels=["a", "b k=1,2"]
        )
        write_csv(tmp_path / "a.csv", result)
        with open(tmp_path / "a.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        assert [row["technique"] for row in rows] == ["a", "b k=1,2"]
        assert [float(row["rmse"]) for row in rows] == [row.rmse for row in result.rows]
        assert [float(row["total_ms"]) for row in rows] == [3.5, 3.5]

    def test_factors(self):
        factors = [1.0, 119.6, 0.01234, 4.39e13, math.inf, math.nan]
        assert [report._factor_text(factor) for factor in factors] == [
            "1",
            "120",
            "0.0123",
            "> 1e6",
            "exact",
            "-",
        ]

    def test_label(self):
        assert label("wboit", {}) == "wboit"
        assert label("lwboit", {"bins": 8, "smooth": True}) == "lwboit bins=8 smooth=true"


class TestCompareTechniques:
    scene = oitlab.scenes.squares(width=48, height=27)

    def test_measures_what_compare_measures(self):
        variants = [("wboit", {"weight": "mb9"}), ("a_buffer", {}), ("wboit", {})]
        done = []
        result = compare_techniques(self.scene, variants, progress=done.append)
        assert done == ["wboit weight=mb9", "a_buffer", "wboit"]
        exact = oitlab.render(self.scene, "a_buffer")
        for row, frame_, (technique, params) in zip(result.rows, result.frames, variants, strict=True):
            direct = oitlab.render(self.scene, technique, params)
            assert np.array_equal(frame_.color, direct.color)
            assert row.mse == oitlab.compare(direct, exact)["mse"]
        baseline, exact_row, default = result.rows
        assert default.factor == 1.0
        assert exact_row.factor == math.inf
        assert baseline.factor == pytest.approx(default.mse / baseline.mse)

    def test_baseline_is_rendered_but_not_shown(self):
        result = compare_techniques(self.scene, [("weighted_sum", {})])
        assert [row.label for row in result.rows] == ["weighted_sum"]
        assert len(result.frames) == 1
        expected = compare_techniques(self.scene, [("wboit", {}), ("weighted_sum", {})]).rows[1].factor
        assert result.rows[0].factor == expected

    def test_frames_carry_the_scenes_hash(self):
        for frame_ in compare_techniques(self.scene, [("wboit", {})]).frames:
            assert frame_.scene_hash == self.scene.content_hash

    def test_too_many_fragments_to_keep(self, monkeypatch):
        variants = [("wboit", {}), ("lwboit", {"bins": 8})]
        kept = compare_techniques(self.scene, variants)
        monkeypatch.setattr(report, "_CAPTURE_LIMIT", 0)
        streamed = compare_techniques(self.scene, variants)
        for one, two in zip(kept.frames, streamed.frames, strict=True):
            assert np.array_equal(one.color, two.color)
        assert [row.mse for row in kept.rows] == [row.mse for row in streamed.rows]

    def test_every_technique_of_the_registry(self):
        names = oitlab.techniques().ids
        result = compare_techniques(self.scene, [(name, {}) for name in names])
        assert tuple(row.label for row in result.rows) == names
        assert all(np.isfinite(row.mse) for row in result.rows)

    def test_headline(self):
        text = headline(compare_techniques(self.scene, []), "squares")
        fragments = int(oitlab.capture(self.scene).counts.sum())
        assert text.startswith(f"squares, 48 x 27: {fragments:,} fragments, ")


class TestContactSheet:
    def sheet(self, tmp_path, result, **options):
        write_contact_sheet(tmp_path / "a.png", result, "title", **options)
        with Image.open(tmp_path / "a.png") as image:
            return np.asarray(image)

    def test_pictures_are_srgb_and_maps_use_the_stated_scale(self, tmp_path):
        """An error of 0.01 is the middle of the logarithmic scale from 0.0001 to 1."""
        reference = np.full((40, 64, 3), 0.2, np.float32)
        result = comparison(reference + np.float32(0.01), reference, reference=reference)
        pixels = self.sheet(tmp_path, result, cell_width=64)
        assert (pixels == srgb_bytes(np.float64(0.2))).all(axis=2).sum() >= 2 * 40 * 64
        middle = (np.array(matplotlib.colormaps["inferno"](0.5)[:3]) * 255).round()
        assert (np.abs(pixels.astype(float) - middle).max(axis=2) <= 4).sum() >= 40 * 64
        black = np.array(matplotlib.colormaps["inferno"](0.0)[:3]) * 255
        assert (np.abs(pixels.astype(float) - black).max(axis=2) <= 1).sum() >= 40 * 64

    def test_pictures_are_placed_pixel_for_pixel(self, tmp_path):
        image = random_image(5, 70, 100)
        result = comparison(image, reference=random_image(6, 70, 100))
        pixels = self.sheet(tmp_path, result, cell_width=100)
        for expected in (srgb_bytes(result.reference.color), srgb_bytes(image)):
            windows = np.lib.stride_tricks.sliding_window_view(pixels, (70, 100, 3))[:, :, 0]
            starts = np.argwhere((pixels[:-69, :-99] == expected[0, 0]).all(axis=2))
            assert any(np.array_equal(windows[y, x], expected) for y, x in starts)

    def test_reduction_keeps_means_and_isolated_errors(self):
        from oitlab._image import reduced

        image = np.zeros((5, 7))
        image[4, 6] = 8.0
        assert reduced(image, 2, np.max).tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 8]]
        assert reduced(np.arange(16.0).reshape(4, 4), 2, np.mean).tolist() == [[2.5, 4.5], [10.5, 12.5]]

    @pytest.mark.parametrize("count", [1, 5])
    @pytest.mark.parametrize("size", [(1, 1), (3, 200), (200, 3), (131, 257)])
    def test_odd_sizes(self, tmp_path, size, count):
        result = comparison(*[random_image(i, *size) for i in range(count)], reference=random_image(9, *size))
        assert self.sheet(tmp_path, result, cell_width=64, columns=3).shape[2] == 3

    def test_long_labels_stay_on_their_cell(self, tmp_path):
        """A label never runs into its neighbour: the gap column right of the first technique stays white."""
        images = [random_image(i, 20, 64) for i in range(3)]
        result = comparison(
            *images, reference=random_image(9, 20, 64), labels=["lwboit " + "bins=64 " * 30] * 3
        )
        pixels = self.sheet(tmp_path, result, cell_width=64, columns=4)
        gap = pixels[56:100, 14 + 64 + 2 : 14 + 64 + 12]
        assert (gap == 255).all()

    @pytest.mark.parametrize("options", [{"columns": 1}, {"cell_width": 10}, {"exposure": np.nan}])
    def test_wrong_arguments(self, tmp_path, options):
        with pytest.raises(ValueError, match=r"columns|cell_width|exposure"):
            self.sheet(tmp_path, comparison(random_image(1), reference=random_image(2)), **options)
        assert not list(tmp_path.iterdir())
