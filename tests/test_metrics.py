import math
import sys

import numpy as np
import pytest

from handmade import frame, random_image
from oitlab.metrics import METRICS, compare, error_map

REC_709 = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
REC_2020 = np.array([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046]])
D65 = np.array([0.3127, 0.3290])

# From the published CIEDE2000 test data [Sharma2005], the pairs that Rec. 709 can show.
CIEDE2000 = [
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.49, -0.001), (50, -2.49, 0.0011), 7.2195),
    ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
    ((50, -0.001, 2.49), (50, 0.0011, -2.49), 4.7461),
    ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (61, -5, 29), 22.8977),
    ((50, 2.5, 0), (58, 24, 15), 19.4535),
    ((50, 2.5, 0), (50, 3.1736, 0.5854), 1.0),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((61.2901, 3.7196, -5.3901), (61.4292, 2.2480, -4.9620), 1.8731),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((36.4612, 47.8580, 18.3852), (36.2715, 50.5065, 21.2231), 1.4146),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((6.7747, -0.2908, -2.4247), (5.8714, -0.0985, -2.2286), 0.6377),
]


def xyz_of_rgb(primaries):
    """RGB to XYZ from chromaticities: columns scaled so that (1, 1, 1) is the white point."""
    columns = np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in primaries]).T
    white = np.array([D65[0] / D65[1], 1.0, (1 - D65.sum()) / D65[1]])
    return columns * np.linalg.solve(columns, white)


def rgb_of_lab(lab):
    lightness, a, b = lab
    fy = (lightness + 16) / 116
    f = np.array([fy + a / 500, fy, fy - b / 200])
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    white = xyz_of_rgb(REC_709) @ np.ones(3)
    return np.linalg.solve(xyz_of_rgb(REC_709), xyz * white)


def pq(luminance):
    """SMPTE ST 2084: cd/m2 to signal."""
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    power = (np.asarray(luminance) / 10_000) ** m1
    return ((c1 + c2 * power) / (1 + c3 * power)) ** m2


def itp(rgb_709, luminance):
    """BT.2124's I, T, P of linear Rec. 709, written from the recommendation's integers."""
    rgb = luminance * np.linalg.solve(xyz_of_rgb(REC_2020), xyz_of_rgb(REC_709) @ rgb_709)
    lms = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096 @ rgb
    ictcp = np.array([[2048, 2048, 0], [6610, -13613, 7003], [17933, -17390, -543]]) / 4096 @ pq(lms)
    return ictcp * (1.0, 0.5, 1.0)


def pixel(color):
    return np.asarray(color, dtype=np.float64).reshape(1, 1, 3)


class TestCheapMetrics:
    def test_closed_form(self):
        reference = np.full((2, 2, 3), 0.5)
        image = reference.copy()
        image[1, 0] = (0.75, 0.5, 0.25)
        result = compare(frame(image), reference, data_range=1.0)
        mse = 2 * 0.25**2 / 12
        assert result == pytest.approx(
            {
                "mse": mse,
                "rmse": math.sqrt(mse),
                "psnr": -10 * math.log10(mse),
                "max_error": 0.25,
                "mse_255": mse * 65025,
                "bad_pixels": 0.25,
            },
            rel=1e-14,
        )

    def test_psnr_of_a_tenth_is_twenty_decibels(self):
        result = compare(np.full((3, 3, 3), 0.6), np.full((3, 3, 3), 0.5), metrics="psnr", data_range=1)
        assert result["psnr"] == pytest.approx(20.0, abs=1e-12)
        doubled = compare(np.full((3, 3, 3), 0.6), np.full((3, 3, 3), 0.5), metrics="psnr", data_range=2)
        assert doubled["psnr"] == pytest.approx(20.0 + 20 * math.log10(2), abs=1e-12)

    def test_equal_images(self):
        image = random_image(1)
        result = compare(image, image, data_range=1.0)
        assert result.pop("psnr") == math.inf
        assert set(result.values()) == {0.0}

    def test_arithmetic_is_float64(self):
        """A difference of one float32 step at 1.0 is not lost, nor is its square."""
        step = np.float32(2.0**-23)
        result = compare(np.full((64, 64, 3), 1 + step, np.float32), np.ones((64, 64, 3), np.float32))
        assert result["mse"] == 2.0**-46

    def test_high_dynamic_range_is_not_clipped(self):
        assert compare(pixel((8, 1, 1)), pixel((2, 1, 1)))["max_error"] == 6.0

    def test_threshold_counts_strictly_larger_errors(self):
        reference, image = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
        image[0, :, 2] = (0.0, 0.5, -0.75, 1.0)
        assert compare(image, reference, threshold=0.5)["bad_pixels"] == 0.5
        assert compare(image, reference, threshold=0.0)["bad_pixels"] == 0.75

    def test_extreme_but_finite_numbers(self):
        """No warning, no overflow: the largest errors allowed, and ranges whose squares leave float64."""
        image = np.full((64, 64, 3), 1e149)
        result = compare(image, 0 * image, data_range=1e200)
        assert result["mse_255"] == pytest.approx(255**2 * 1e298)
        assert result["psnr"] == pytest.approx(20 * (200 - 149))
        assert compare(image, 0 * image, data_range=1e-200)["psnr"] == pytest.approx(20 * (-200 - 149))
        huge = np.full((2, 2, 3), 1e308)
        assert compare(huge, huge, metrics=["mse", "delta_e_itp"], luminance=1e300) == {
            "mse": 0.0,
            "delta_e_itp": 0.0,
        }


class TestPerceptualMetrics:
    @pytest.mark.parametrize(("first", "second", "expected"), CIEDE2000)
    def test_published_ciede2000_pairs(self, first, second, expected):
        one, two = pixel(rgb_of_lab(first)), pixel(rgb_of_lab(second))
        for image, reference in ((one, two), (two, one)):
            result = compare(image, reference, metrics="delta_e_2000")
            assert result["delta_e_2000"] == pytest.approx(expected, abs=5.1e-5)

    def test_white_and_black_are_a_hundred_apart(self):
        assert compare(pixel((1, 1, 1)), pixel((0, 0, 0)), metrics="delta_e_2000")[
            "delta_e_2000"
        ] == pytest.approx(100.0, abs=1e-9)

    def test_delta_e_2000_clips_to_the_display(self):
        assert compare(pixel((3, 1, 1)), pixel((1, 1, 1)), metrics="delta_e_2000") == {"delta_e_2000": 0.0}

    @pytest.mark.parametrize("luminance", [100.0, 203.0, 1000.0])
    @pytest.mark.parametrize(
        ("one", "two"),
        [((1, 0, 0), (0, 1, 0)), ((0.2, 0.4, 0.6), (0.21, 0.39, 0.61)), ((0.02, 0.02, 0.02), (0, 0, 0.001))],
    )
    def test_itp_from_the_recommendation(self, one, two, luminance):
        expected = 720 * np.linalg.norm(itp(one, luminance) - itp(two, luminance))
        result = compare(pixel(one), pixel(two), metrics="delta_e_itp", luminance=luminance)
        assert result["delta_e_itp"] == pytest.approx(expected, rel=1e-6)

    def test_itp_of_grey_is_720_steps_of_pq(self):
        """White of 100 cd/m2 has the PQ signal 0.5081, black 0.0000007; a grey has no T and P."""
        result = compare(pixel((1, 1, 1)), pixel((0, 0, 0)), metrics="delta_e_itp")
        assert result["delta_e_itp"] == pytest.approx(720 * 0.508078, abs=1e-3)
        brightest = compare(pixel((1, 1, 1)), pixel((0, 0, 0)), metrics="delta_e_itp", luminance=10_000)
        assert brightest["delta_e_itp"] == pytest.approx(720.0, abs=1e-3)

    def test_itp_stays_finite_outside_its_signal(self):
        result = compare(pixel((-1, 0, 0)), pixel((1e6, 0, 0)), metrics="delta_e_itp")
        assert math.isfinite(result["delta_e_itp"])

    def test_inputs_are_left_alone(self):
        image, reference = random_image(2).astype(np.float64), random_image(3).astype(np.float64)
        before = image.copy(), reference.copy()
        compare(image, reference, metrics=["delta_e_2000", "delta_e_itp"])
        assert np.array_equal(image, before[0])
        assert np.array_equal(reference, before[1])

    def test_global_colour_scale_does_not_matter(self):
        import colour

        image, reference = random_image(2), random_image(3)
        names = ["delta_e_2000", "delta_e_itp"]
        expected = compare(image, reference, metrics=names)
        with colour.domain_range_scale("1"):
            assert compare(image, reference, metrics=names) == expected

    def test_flip(self):
        pytest.importorskip("flip_evaluator", reason="the extra oitlab[flip] is not installed")
        black, white = np.zeros((16, 16, 3)), np.ones((16, 16, 3))
        same = compare(white, white, metrics="flip", pixels_per_degree=67.0)
        far = compare(white, black, metrics="flip", pixels_per_degree=67.0)
        assert same["flip"] == 0.0
        assert 0.9 < far["flip"] <= 1.0
        # Linear light goes in: the same as feeding FLIP the sRGB-encoded pictures.
        from flip_evaluator import evaluate

        from oitlab._image import srgb_encode

        image, reference = random_image(4, 20, 30), random_image(5, 20, 30)
        encoded = [srgb_encode(x).astype(np.float32) for x in (reference, image)]
        _, expected, _ = evaluate(*encoded, "LDR", inputsRGB=True, applyMagma=False, parameters={"ppd": 40.0})
        result = compare(image, reference, metrics="flip", pixels_per_degree=40.0)
        assert result["flip"] == pytest.approx(expected, abs=1e-5)

    def test_flip_without_its_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "flip_evaluator", None)
        with pytest.raises(ImportError, match=r"pip install 'oitlab\[flip\]'"):
            compare(random_image(1), random_image(2), metrics="flip", pixels_per_degree=67.0)


class TestErrorMap:
    def test_maps_agree_with_the_metrics(self):
        pytest.importorskip("flip_evaluator", reason="the extra oitlab[flip] is not installed")
        image, reference = random_image(6, 9, 12), random_image(7, 9, 12)
        values = compare(image, reference, metrics="all", data_range=1, pixels_per_degree=30.0)
        assert tuple(values) == METRICS
        assert error_map(image, reference).mean() == pytest.approx(values["mse"], rel=1e-12)
        assert error_map(image, reference, "absolute").max() == values["max_error"]
        for name in ("delta_e_2000", "delta_e_itp", "flip"):
            result = error_map(image, reference, name, pixels_per_degree=30.0)
            assert result.shape == (9, 12)
            assert result.dtype == np.float64
            assert result.mean() == pytest.approx(values[name], rel=1e-6)

    def test_error_stays_in_its_pixel(self):
        image, reference = np.zeros((3, 4, 3)), np.zeros((3, 4, 3))
        image[2, 1] = (0.0, 0.3, 0.0)
        for name in ("squared", "absolute", "delta_e_2000", "delta_e_itp"):
            assert np.argwhere(error_map(image, reference, name)).tolist() == [[2, 1]]


class TestRefusals:
    def test_first_non_finite_pixel_is_named(self):
        image = random_image(1)
        image[3, 2, 1] = np.nan
        image[4, 0, 0] = np.inf
        with pytest.raises(ValueError, match=r"image: pixel \(x=2, y=3\) is not finite: nan in channel 1"):
            compare(frame(image), random_image(2))
        with pytest.raises(ValueError, match=r"reference: pixel \(x=2, y=3\)"):
            error_map(random_image(2), image)

    @pytest.mark.parametrize(
        ("image", "message"),
        [
            (np.zeros((2, 3, 3)), r"differ in shape: \(2, 3, 3\) and \(2, 2, 3\)"),
            (np.zeros((2, 2)), r"image: expected shape \(H, W, 3\), got \(2, 2\)"),
            (np.zeros((2, 2, 4)), r"got \(2, 2, 4\)"),
            (np.full((2, 2, 3), "a"), "image: expected numbers"),
            (np.zeros((2, 2, 3), complex), "image: expected numbers"),
            ([[0.0], [0.0, 1.0]], "image: not an array"),
        ],
    )
    def test_wrong_images(self, image, message):
        with pytest.raises(ValueError, match=message):
            compare(image, np.zeros((2, 2, 3)))

    def test_no_pixels(self):
        with pytest.raises(ValueError, match="no pixels"):
            compare(np.zeros((0, 4, 3)), np.zeros((0, 4, 3)))

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"metrics": "ssim"}, "unknown ssim; known: mse"),
            ({"metrics": ["mse", "PSNR"]}, "unknown PSNR"),
            ({"metrics": "psnr"}, "psnr needs data_range"),
            ({"metrics": "all"}, "psnr needs data_range"),
            ({"metrics": "flip"}, "flip needs pixels_per_degree"),
            ({"data_range": 0.0}, "data_range: expected a finite number > 0"),
            ({"threshold": -1.0}, "threshold"),
            ({"threshold": math.nan}, "threshold"),
            ({"metrics": "delta_e_itp", "luminance": 0.0}, "luminance"),
            ({"metrics": "flip", "pixels_per_degree": -1.0}, "pixels_per_degree"),
            ({"threshold": "x"}, "threshold must be a number"),
            ({"threshold": None}, "threshold must be a number"),
            ({"data_range": "1"}, "data_range must be a number"),
            ({"luminance": None}, "luminance must be a number"),
            ({"pixels_per_degree": [1]}, "pixels_per_degree must be a number"),
            ({"metrics": 3}, "metrics: expected names among mse, .*, got 3"),
            ({"metrics": [["mse"]]}, "metrics: expected names among"),
        ],
    )
    def test_wrong_arguments(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            compare(random_image(1), random_image(2), **arguments)

    def test_maps_refuse_the_same(self):
        with pytest.raises(ValueError, match="luminance"):
            error_map(random_image(1), random_image(2), "delta_e_itp", luminance=None)
        with pytest.raises(ValueError, match="pixels_per_degree"):
            error_map(random_image(1), random_image(2), "flip", pixels_per_degree="far")

    def test_masked_images(self):
        masked = np.ma.masked_greater(random_image(1), 0.5)
        with pytest.raises(ValueError, match="reference has masked values"):
            compare(random_image(1), masked)

    @pytest.mark.parametrize("metrics", [None, "all"])
    def test_errors_too_large_to_square(self, metrics):
        image, reference = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
        image[1, 2, 1] = 1e300
        for huge in (image, image * 1e8, -image):
            with pytest.raises(ValueError, match=r"pixel \(x=2, y=1\) is off by (2e\+300|inf) in channel 1"):
                compare(huge, reference - huge, metrics=metrics, data_range=1.0, pixels_per_degree=60.0)
            with pytest.raises(ValueError, match="at most 1e"):
                error_map(huge, reference)

    def test_unknown_map(self):
        with pytest.raises(ValueError, match="unknown error map 'psnr'; known: squared"):
            error_map(random_image(1), random_image(2), "psnr")
