import numpy as np
import pytest
from PIL import Image

from handmade import frame, random_image
from oitlab._image import srgb_encode
from oitlab.png import write_png


def read(path):
    with Image.open(path) as image:
        assert image.mode == "RGB"
        return np.asarray(image)


def test_srgb_encoding(tmp_path):
    """Values computed from IEC 61966-2-1: 12.92 x below 0.0031308, 1.055 x^(1/2.4) - 0.055 above."""
    levels = np.array([-1.0, 0.0, 0.001, 0.0031308, 0.18, 0.2, 0.5, 1.0, 4.0])
    write_png(tmp_path / "a.png", np.repeat(levels[None, :, None], 3, axis=2))
    assert read(tmp_path / "a.png")[0, :, 0].tolist() == [0, 0, 3, 10, 118, 124, 188, 255, 255]


def test_every_byte_survives_decoding_and_encoding(tmp_path):
    bytes_ = np.arange(256)
    encoded = bytes_ / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    write_png(tmp_path / "a.png", np.repeat(linear[None, :, None], 3, axis=2).astype(np.float32))
    assert np.array_equal(read(tmp_path / "a.png")[0, :, 1], bytes_)


def test_curve_has_no_jump():
    around = srgb_encode(np.array([0.0031308, 0.0031308 + 1e-12]))
    assert abs(around[1] - around[0]) < 1e-6


def test_layout_and_channel_order(tmp_path):
    image = np.zeros((2, 3, 3), np.float32)
    image[0, 2] = (1, 0, 0)
    image[1, 0] = (0, 0, 1)
    write_png(tmp_path / "a.png", frame(image))
    expected = np.where(image > 0, 255, 0)
    assert np.array_equal(read(tmp_path / "a.png"), expected)


def test_exposure_is_in_stops(tmp_path):
    image = random_image(1)
    write_png(tmp_path / "a.png", image, exposure=-2)
    write_png(tmp_path / "b.png", image / 4)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_file_says_srgb(tmp_path):
    write_png(tmp_path / "a.png", random_image(1))
    with Image.open(tmp_path / "a.png") as image:
        assert image.info["srgb"] == 0


def test_first_bad_pixel_is_named_and_the_old_file_stays(tmp_path):
    path = tmp_path / "a.png"
    write_png(path, random_image(1))
    before = path.read_bytes()
    image = random_image(2)
    image[1, 4, 2] = -np.inf
    with pytest.raises(ValueError, match=r"image: pixel \(x=4, y=1\) is not finite: -inf in channel 2"):
        write_png(path, frame(image))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_crash_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    write_png(path, random_image(1))
    before = path.read_bytes()

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", fail)
    with pytest.raises(OSError, match="No space left"):
        write_png(path, random_image(2))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("exposure", [np.nan, np.inf, 1e9, "x", None, True])
def test_exposure_out_of_range(tmp_path, exposure):
    with pytest.raises(ValueError, match="exposure"):
        write_png(tmp_path / "a.png", random_image(1), exposure=exposure)


def test_bright_light_and_large_exposure_stay_white(tmp_path):
    write_png(tmp_path / "a.png", np.full((1, 1, 3), 1e300), exposure=100)
    assert read(tmp_path / "a.png").tolist() == [[[255, 255, 255]]]


def test_no_pixels(tmp_path):
    with pytest.raises(ValueError, match="no pixels"):
        write_png(tmp_path / "a.png", np.zeros((0, 3, 3)))


def test_missing_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        write_png(tmp_path / "missing" / "a.png", random_image(1))


def test_a_folder_is_not_a_file(tmp_path):
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        write_png(tmp_path, random_image(1))
