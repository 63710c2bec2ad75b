import os
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

import oitlab
from handmade import FIELDS, frame, random_image
from oitlab.exr import read_exr, write_exr
from oitlab.metrics import error_map


def assert_same(back, original):
    for field in FIELDS:
        expected, actual = getattr(original, field), getattr(back, field)
        if isinstance(expected, np.ndarray):
            assert actual.dtype == expected.dtype
            assert actual.tobytes() == expected.tobytes(), field
        else:
            assert actual == expected, field


def test_round_trip_is_bit_exact(tmp_path):
    original = frame(random_image(1), transmittance=random_image(2)[..., 0].copy())
    write_exr(tmp_path / "a.exr", original)
    assert_same(read_exr(tmp_path / "a.exr"), original)


def test_extreme_floats_survive(tmp_path):
    image = np.zeros((2, 2, 3), np.float32)
    image[0, 0] = (-0.0, np.finfo(np.float32).tiny, np.finfo(np.float32).smallest_subnormal)
    image[1, 1] = (np.finfo(np.float32).max, -1.0, np.nextafter(np.float32(1), np.float32(2)))
    counts = np.array([[0, 1], [2**31, 2**32 - 1]], np.uint32)
    original = frame(image, fragment_count=counts)
    write_exr(tmp_path / "a.exr", original)
    assert_same(read_exr(tmp_path / "a.exr"), original)


def test_coloured_transmittance(tmp_path):
    original = frame(random_image(1), transmittance=random_image(2))
    write_exr(tmp_path / "a.exr", original)
    assert_same(read_exr(tmp_path / "a.exr"), original)


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[::-1],
        lambda a: a[:, ::-1],
        lambda a: a[::2, 1::3],
        np.asfortranarray,
        lambda a: a[..., ::-1],
    ],
)
def test_arrays_that_are_not_contiguous(tmp_path, view):
    image = view(random_image(3, 12, 9))
    original = frame(
        image,
        transmittance=image[..., 0],
        first_depth=image[..., 1],
        fragment_count=np.ones(image.shape[:2], "u4"),
    )
    write_exr(tmp_path / "a.exr", original)
    back = read_exr(tmp_path / "a.exr")
    assert np.array_equal(back.color, image)
    assert np.array_equal(back.transmittance, image[..., 0])
    assert np.array_equal(back.first_depth, image[..., 1])


def test_half_rounds_image_and_transmittance_only(tmp_path):
    original = frame(random_image(1), transmittance=random_image(2)[..., 0].copy())
    write_exr(tmp_path / "a.exr", original, half=True)
    back = read_exr(tmp_path / "a.exr")
    assert np.array_equal(back.color, original.color.astype(np.float16).astype(np.float32))
    assert np.array_equal(back.transmittance, original.transmittance.astype(np.float16).astype(np.float32))
    assert np.array_equal(back.first_depth, original.first_depth)
    types = [
        c.type().name
        for p in OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).parts
        for c in p.channels.values()
    ]
    assert types == ["HALF"] * 4 + ["FLOAT", "UINT"]


def test_float64_is_rounded_to_float32(tmp_path):
    original = frame(random_image(1).astype(np.float64) / 3, transmittance=np.full((5, 7), 1 / 3))
    write_exr(tmp_path / "a.exr", original)
    back = read_exr(tmp_path / "a.exr")
    assert np.array_equal(back.color, original.color.astype(np.float32))
    assert np.array_equal(back.transmittance, np.full((5, 7), np.float32(1 / 3)))


def test_error_map_against_a_reference(tmp_path):
    original, reference = frame(random_image(1)), random_image(2)
    for metric in ("squared", "absolute", "delta_e_itp"):
        write_exr(tmp_path / "a.exr", original, reference=reference, error_metric=metric)
        back, errors = read_exr(tmp_path / "a.exr", error=True)
        assert_same(back, original)
        assert np.array_equal(errors, error_map(original, reference, metric).astype(np.float32))
        assert OpenEXR.File(str(tmp_path / "a.exr")).header(0)["oitlab:error_metric"] == metric


def test_error_map_of_the_callers_own(tmp_path):
    own = random_image(4)[..., 0]
    write_exr(tmp_path / "a.exr", frame(random_image(1)), error=own, error_metric="mine")
    assert np.array_equal(read_exr(tmp_path / "a.exr", error=True)[1], own)


def test_no_error_map(tmp_path):
    write_exr(tmp_path / "a.exr", frame(random_image(1)))
    assert read_exr(tmp_path / "a.exr", error=True)[1] is None


def test_parts_and_attributes_for_other_programs(tmp_path):
    write_exr(tmp_path / "a.exr", frame(random_image(1)), error=np.zeros((5, 7)))
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    assert [(p.name(), sorted(p.channels)) for p in file.parts] == [
        ("image", ["B", "G", "R"]),
        ("transmittance", ["Y"]),
        ("depth", ["Z"]),
        ("fragments", ["count"]),
        ("error", ["Y"]),
    ]
    for part in file.parts:
        expected = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
        assert part.header["chromaticities"] == pytest.approx(expected, abs=1e-7)
    header = file.header(0)
    assert header["oitlab:technique"] == "wboit"
    assert header["oitlab:scene_hash"] == "0123abcd"
    assert '"weight_k": 2.5' in header["oitlab:params"]
    assert header["software"] == f"oitlab {header['oitlab:version']}"


def test_numpy_scalars_in_params(tmp_path):
    given = {"bins": np.int64(8), "shift": np.float32(0.5), "smooth": np.bool_(True), "edges": np.arange(3)}
    write_exr(tmp_path / "a.exr", frame(random_image(1), params=given))
    expected = {"bins": 8, "shift": 0.5, "smooth": True, "edges": (0, 1, 2)}
    assert read_exr(tmp_path / "a.exr").params == expected


def test_params_come_back_equal(tmp_path, small_scene):
    rendered = oitlab.render(small_scene, "opacity_shadow_maps", {"range": (1, 9.5)})
    assert rendered.params["range"] == (1.0, 9.5)
    write_exr(tmp_path / "a.exr", rendered)
    assert_same(read_exr(tmp_path / "a.exr"), rendered)
    nested = {"pairs": [(1, 2), [3, "four"]], "by_name": {"a": (5,)}}
    write_exr(tmp_path / "a.exr", frame(random_image(1), params=nested))
    assert read_exr(tmp_path / "a.exr").params == {"pairs": ((1, 2), (3, "four")), "by_name": {"a": (5,)}}


class TestRefusals:
    @pytest.mark.parametrize(
        ("arguments", "keywords", "message"),
        [
            ((random_image(1),), {}, "frame must be a Frame, got ndarray"),
            ((None,), {}, "frame must be a Frame, got NoneType"),
            ((frame(random_image(1)),), {"half": "no"}, "half must be True or False, got 'no'"),
            ((frame(random_image(1)),), {"error": [["a"]]}, "error: expected numbers"),
            ((frame(random_image(1)),), {"error": [[1], [1, 2]]}, "error: not an array"),
            (
                (frame(random_image(1)),),
                {"error": np.ma.masked_all((5, 7))},
                "error has masked values",
            ),
            ((frame(random_image(1)),), {"error_metric": 3}, "error_metric must be a name, got 3"),
        ],
    )
    def test_arguments_of_the_wrong_kind(self, tmp_path, arguments, keywords, message):
        with pytest.raises(ValueError, match=message):
            write_exr(tmp_path / "a.exr", *arguments, **keywords)
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize(
        ("field", "shape"), [("color", (5, 7, 3)), ("transmittance", (5, 7)), ("first_depth", (5, 7))]
    )
    def test_first_bad_pixel_is_named(self, tmp_path, field, shape):
        values = np.ones(shape, np.float32)
        values[2, 3], values[4, 0] = np.nan, np.nan
        bad = frame(random_image(1)).replace(**{field: values})
        with pytest.raises(ValueError, match=rf"{field}: pixel \(x=3, y=2\) is not finite: nan"):
            write_exr(tmp_path / "a.exr", bad)
        assert not list(tmp_path.iterdir())

    def test_infinity_is_allowed_in_depth_only(self, tmp_path):
        write_exr(tmp_path / "a.exr", frame(random_image(1), first_depth=np.full((5, 7), np.inf, np.float32)))
        with pytest.raises(ValueError, match=r"first_depth: pixel \(x=0, y=0\) is not finite: -inf"):
            write_exr(tmp_path / "a.exr", frame(random_image(1), first_depth=np.full((5, 7), -np.inf, "f4")))
        with pytest.raises(ValueError, match="transmittance"):
            write_exr(tmp_path / "a.exr", frame(random_image(1), transmittance=np.full((5, 7), np.inf, "f4")))

    def test_too_large_for_the_stored_type(self, tmp_path):
        image = random_image(1)
        image[0, 1, 2] = 65520
        with pytest.raises(ValueError, match=r"color as float16: pixel \(x=1, y=0\)"):
            write_exr(tmp_path / "a.exr", frame(image), half=True)
        with pytest.raises(ValueError, match=r"color as float32: pixel \(x=0, y=0\)"):
            write_exr(tmp_path / "a.exr", frame(np.full((2, 2, 3), 1e39)))

    @pytest.mark.parametrize("shape", [(5, 6), (5, 7, 3), (35,)])
    def test_error_map_of_the_wrong_shape(self, tmp_path, shape):
        with pytest.raises(ValueError, match="error: shape"):
            write_exr(tmp_path / "a.exr", frame(random_image(1)), error=np.zeros(shape))

    def test_reference_and_error_together(self, tmp_path):
        with pytest.raises(ValueError, match="not both"):
            write_exr(
                tmp_path / "a.exr", frame(random_image(1)), reference=random_image(2), error=np.zeros((5, 7))
            )

    def test_no_pixels(self, tmp_path):
        with pytest.raises(ValueError, match="no pixels"):
            write_exr(tmp_path / "a.exr", frame(np.zeros((0, 7, 3), np.float32)))

    def test_params_that_json_cannot_hold(self, tmp_path):
        with pytest.raises(ValueError, match=r"params: cannot store .* of type object"):
            write_exr(tmp_path / "a.exr", frame(random_image(1), params={"weight": object()}))

    def test_missing_folder(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="does not exist"):
            write_exr(tmp_path / "missing" / "a.exr", frame(random_image(1)))


class TestDamagedFiles:
    def test_missing(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            read_exr(tmp_path / "missing.exr")

    def test_not_exr(self, tmp_path):
        (tmp_path / "a.exr").write_text("This is not an image.")
        with pytest.raises(OSError, match=r"a\.exr: not a readable EXR file"):
            read_exr(tmp_path / "a.exr")

    def test_every_truncation(self, tmp_path):
        write_exr(tmp_path / "whole.exr", frame(random_image(1, 40, 30)), error=np.zeros((40, 30)))
        whole = (tmp_path / "whole.exr").read_bytes()
        cut = tmp_path / "cut.exr"
        for length in [*range(0, len(whole) - 1, len(whole) // 40), len(whole) - 1]:
            cut.write_bytes(whole[:length])
            with pytest.raises(OSError, match=r"cut\.exr: (not a readable EXR file|truncated or damaged)"):
                read_exr(cut)

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            (b"oitlab:parts", b"oitlab:pxrts"),
            (b"oitlab:scene_hash", b"oitlab:scene_hasg"),
            (b"oitlab:technique", b"oitlab:techniqux"),
            (b"oitlab:params\0string", b"oitlab:params\0strang"),
            (b"oitlab:stats\0string", b"oitlab:stats\0strunk"),
            (b"oitlab:stats\0string\0", b"oitlab:stats\0string\xff"),
            (b'{"weight": ', b'{"weight"; '),
            (b'{"weight": ', b'{"weigh\xff": '),
            (b'{"weight": "mb7"', b'["weight", "mb7"'),
            (b'{"total_ms"', b'{"total_mx"'),
            (b'["image"', b'["imago"'),
            (b"0123abcd", b"0123ab\xff\xfe"),
            (b"scanlineimage", b"scanlineimagf"),
        ],
    )
    def test_damaged_attributes(self, tmp_path, old, new):
        write_exr(tmp_path / "whole.exr", frame(random_image(1)))
        whole = (tmp_path / "whole.exr").read_bytes()
        assert old in whole
        (tmp_path / "bent.exr").write_bytes(whole.replace(old, new))
        with pytest.raises(OSError, match=r"bent\.exr: (not a readable EXR file|truncated or damaged): ."):
            read_exr(tmp_path / "bent.exr")

    def test_single_damaged_bytes(self, tmp_path):
        write_exr(tmp_path / "whole.exr", frame(random_image(1)), error=np.zeros((5, 7)))
        whole = (tmp_path / "whole.exr").read_bytes()
        bent = tmp_path / "bent.exr"
        verdicts = []
        for place in range(0, len(whole), 7):
            bent.write_bytes(whole[:place] + bytes([whole[place] ^ 0x80]) + whole[place + 1 :])
            try:
                read_exr(bent)
            except (OSError, ValueError) as error:
                verdicts.append(str(error))
        assert len(verdicts) > 100
        assert all("bent.exr: " in verdict for verdict in verdicts)

    def test_another_versions_statistics(self, tmp_path):
        write_exr(tmp_path / "a.exr", frame(random_image(1)))
        version = oitlab.__version__.encode()
        other = version[:-1] + bytes([version[-1] ^ 1])
        old = (tmp_path / "a.exr").read_bytes().replace(version, other)
        (tmp_path / "a.exr").write_bytes(old)
        assert read_exr(tmp_path / "a.exr").technique == "wboit"
        (tmp_path / "a.exr").write_bytes(old.replace(b"total_ms", b"total_us"))
        with pytest.raises(ValueError, match=r"a\.exr: written by oitlab .*, whose statistics differ"):
            read_exr(tmp_path / "a.exr")

    def test_somebody_elses_file(self, tmp_path):
        header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        OpenEXR.File(header, {"RGB": random_image(1)}).write(str(tmp_path / "a.exr"))
        with pytest.raises(ValueError, match=r"a\.exr: not a file that oitlab\.write_exr wrote"):
            read_exr(tmp_path / "a.exr")


class TestAtomicity:
    @pytest.mark.parametrize("step", ["fsync", "replace"])
    def test_failure_leaves_the_old_file_whole(self, tmp_path, monkeypatch, step):
        path = tmp_path / "a.exr"
        write_exr(path, frame(random_image(1)))
        before = path.read_bytes()

        def fail(*_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, step, fail)
        with pytest.raises(OSError, match="No space left"):
            write_exr(path, frame(random_image(2)))
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]

    def test_process_that_dies_before_the_rename(self, tmp_path):
        path = tmp_path / "a.exr"
        write_exr(path, frame(random_image(1)))
        before = path.read_bytes()
        program = (
            "import os, sys; sys.path.insert(0, sys.argv[2])\n"
            "from handmade import FIELDS, frame, random_image\n"
            "from oitlab.exr import write_exr\n"
            "os.replace = lambda *_: os._exit(9)\n"
            "write_exr(sys.argv[1], frame(random_image(2)))\n"
        )
        here = os.path.dirname(__file__)
        assert subprocess.run([sys.executable, "-c", program, str(path), here], check=False).returncode == 9
        assert path.read_bytes() == before
        write_exr(path, frame(random_image(3)))
        assert np.array_equal(read_exr(path).color, random_image(3))

    def test_what_killed_writers_left_goes_after_a_day(self, tmp_path):
        old, young, other = (tmp_path / f".{name}.{'0a' * 6}.tmp" for name in ("a.exr", "b.exr", "a_exr"))
        unrelated = tmp_path / ".a.exr.notes.tmp"
        for path in (old, young, other, unrelated):
            path.write_text("half a file")
        for path in (old, other, unrelated):
            os.utime(path, (0, 0))
        for name in ("a.exr", "b.exr"):
            write_exr(tmp_path / name, frame(random_image(1)))
        assert sorted(path for path in tmp_path.iterdir() if path.suffix == ".tmp") == sorted(
            [young, other, unrelated]
        )

    @pytest.mark.parametrize("name", ["🦊" * 62 + ".exr", "x" * 251 + ".exr", "ü.exr"])
    def test_names_as_long_as_the_file_system_takes(self, tmp_path, name):
        write_exr(tmp_path / name, frame(random_image(1)))
        assert [path.name for path in tmp_path.iterdir()] == [name]
        assert read_exr(tmp_path / name).technique == "wboit"

    def test_link_stays_a_link(self, tmp_path):
        (tmp_path / "link.exr").symlink_to(tmp_path / "target.exr")
        write_exr(tmp_path / "link.exr", frame(random_image(1)))
        assert (tmp_path / "link.exr").is_symlink()
        assert np.array_equal(read_exr(tmp_path / "target.exr").color, random_image(1))
