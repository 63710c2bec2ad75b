"""`plot.strip`: images with insets."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from PIL import Image

import handmade
import oitlab
from oitlab import plot
from oitlab._image import srgb_bytes
from plotting import PALETTE, of_kind, shown

INSETS = [(20, 10, 8, 4), (0, 0, 3, 5), (45, 26, 3, 1)]


def test_insets_show_exactly_their_pixels(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, INSETS, reference=exact, exposure=0.5)
    shown_insets = of_kind(figure.axes, "inset")
    assert len(shown_insets) == 4 * len(INSETS)
    for index, axes in enumerate(shown_insets):
        frame, (x, y, w, h) = frames[index // 3], INSETS[index % 3]
        (image,) = axes.get_images()
        assert (image.get_array() == srgb_bytes(frame.color[y : y + h, x : x + w], 0.5)).all()
        assert image.get_interpolation() == "nearest"
        box = axes.get_position()
        across, down = figure.get_size_inches()
        assert (box.width * across) / (box.height * down) == pytest.approx(w / h)


def test_insets_are_aligned_and_coloured(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, INSETS, reference=exact)
    pictures = [axes for axes in figure.axes if axes.get_title()]
    shown_insets = of_kind(figure.axes, "inset")
    for number in range(3):
        row = shown_insets[number::3]
        offsets = {
            round(a.get_position().x0 - p.get_position().x0, 9) for a, p in zip(row, pictures, strict=True)
        }
        assert len(offsets) == len({round(a.get_position().y0, 9) for a in row}) == 1
        (color,) = {to_hex(a.spines["left"].get_edgecolor()).upper() for a in row}
        assert color in PALETTE
        x, y, w, h = INSETS[number]
        for axes in pictures:
            outline = of_kind(axes.patches, "inset")[number]
            assert (outline.get_xy(), outline.get_width(), outline.get_height()) == ((x - 0.5, y - 0.5), w, h)
            assert to_hex(outline.get_edgecolor()).upper() == color
    assert len({to_hex(a.spines["left"].get_edgecolor()) for a in shown_insets}) == 3


def test_strip_says_what_it_did(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.strip(others, reference=exact, metrics=["rmse", "psnr"], data_range=1.0, exposure=4)
    text = " ".join(shown(figure).split())
    for frame in others:
        error = oitlab.compare(frame, exact, metrics=["rmse", "psnr"], data_range=1.0)
        assert f"RMSE {error['rmse']:.3g}" in text
        assert f"PSNR {error['psnr']:.3g} dB" in text
    assert "sRGB, exposure +4 stops, clipped to [0, 1] (at most" in text
    assert [a.get_title() for a in figure.axes] == ["a_buffer (reference)", "wboit", "mlab", "lwboit bins=4"]
    bare = plot.strip(others, reference=exact, show_reference=False, labels=["one", "two", "three"])
    assert [a.get_title() for a in bare.axes] == ["one", "two", "three"]
    assert "RMSE" in shown(bare)
    assert "RMSE" not in shown(plot.strip(others))


def test_strip_shows_whole_images_as_write_png_does(frames: list[oitlab.Frame], tmp_path: Path) -> None:
    figure = plot.strip(frames[1].color)
    oitlab.write_png(tmp_path / "a.png", frames[1])
    with Image.open(tmp_path / "a.png") as written:
        assert (figure.axes[0].get_images()[0].get_array() == np.asarray(written)).all()
    assert figure.axes[0].get_title() == "image 0"


def test_strip_breaks_into_rows_and_long_names_into_lines() -> None:
    images = {f"a_rather_long_name_of_a_technique_{i}": handmade.random_image(i) for i in range(7)}
    figure = plot.strip(images, [(0, 0, 2, 2)], columns=3, width="single")
    pictures = [axes for axes in figure.axes if axes.get_title()]
    assert len({round(axes.get_position().y0, 6) for axes in pictures}) == 3
    for axes in pictures:
        room = axes.get_position().width * figure.get_figwidth() * figure.dpi
        assert axes.title.get_window_extent().width <= room + 2
    assert [axes.get_title().replace("\n", "") for axes in pictures] == list(images)


def test_strip_reduces_in_linear_light() -> None:
    image = np.zeros((2, 9000, 3))
    image[:, ::2] = 1.0
    shown_image = plot.strip(image, width=2).axes[0].get_images()[0].get_array()
    assert shown_image.shape[1] < 9000
    assert (
        np.abs(shown_image[0, 5].astype(int) - srgb_bytes(np.array(0.5))).max() <= 12
    )  # 8 or 7 of 15 are white


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"insets": [(0, 0, 0, 4)]},
            r"insets\[0\] is \(0, 0, 0, 4\), which is empty or leaves the 48 x 27 image",
        ),
        ({"insets": [(0, 0, 4, 4), (45, 0, 4, 4)]}, r"insets\[1\]"),
        ({"insets": [(-1, 0, 4, 4)]}, r"insets\[0\]"),
        ({"insets": [(0.5, 0, 4, 4)]}, r"insets\[0\] x must be an integer"),
        ({"insets": 3}, "insets must be one or several, got 3"),
        ({"labels": 3}, "labels must be one or several, got 3"),
        ({"insets": [3]}, r"insets\[0\] must be \(x, y, w, h\)"),
        ({"insets": [(0, 0, 1, 1)] * 7}, "at most 6"),
        ({"labels": ["one"]}, "labels: expected 3"),
        ({"labels": ["one"] * 3}, "labels must differ"),
        ({"columns": 0}, "columns must be >= 1"),
        ({"metrics": "sharpness"}, "sharpness"),
        ({"metrics": "psnr"}, "psnr needs data_range"),
        ({"exposure": 1000}, "exposure"),
        ({"reference": np.zeros((2, 2, 3))}, "shape"),
    ],
)
def test_strip_refuses(frames: list[oitlab.Frame], arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot.strip(frames[1:], **{"reference": frames[0], **arguments})


def test_strip_refuses_images_of_two_sizes_by_name() -> None:
    images = {"first": handmade.random_image(0), "second": handmade.random_image(1, height=6)}
    with pytest.raises(ValueError, match=r"frames\['second'\] is 7 x 6 pixels, the first 7 x 5"):
        plot.strip(images)
    bad = handmade.random_image(0)
    bad[2, 3, 1] = np.nan
    with pytest.raises(ValueError, match=r"frames\['bad'\]: pixel \(x=3, y=2\) is not finite"):
        plot.strip({"bad": bad})
