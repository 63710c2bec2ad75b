import csv
import json
import subprocess
import sys
import warnings

import numpy as np
import pytest
from PIL import Image

import oitlab
from oitlab import cli
from oitlab._image import srgb_bytes

SMALL = ["--width", "48", "--height", "27"]
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "tetrahedron.obj"
    path.write_text(TETRAHEDRON)
    return path


def run(capsys, *arguments):
    """Give status, stdout and stderr of a command."""
    status = cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def read(path):
    with Image.open(path) as image:
        return np.asarray(image)


class TestParameters:
    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("bins=64", ("bins", 64)),
            ("weight_k=-2.5e1", ("weight_k", -25.0)),
            ("smooth=true", ("smooth", True)),
            ("seed=null", ("seed", None)),
            ("weight=mb7", ("weight", "mb7")),
            ("weight=z<1?2=3", ("weight", "z<1?2=3")),
            ("edges=[1]", ("edges", (1,))),
            ("range=[1,2.5]", ("range", (1, 2.5))),
            ("range = 1, 2.5 ", ("range", (1, 2.5))),
            ("range=[1,[2]]", ("range", "[1,[2]]")),
            ("range=[1,", ("range", "[1,")),
            ("range=[]", ("range", "[]")),
            ("names=a,b", ("names", "a,b")),
            ('name="a"', ("name", '"a"')),
            ('by={"a":1}', ("by", '{"a":1}')),
            (" bins = 8 ", ("bins", 8)),
            ("name=", ("name", "")),
        ],
    )
    def test_values(self, text, expected):
        name, value = cli.parse_param(text)
        assert (name, value) == expected
        assert type(value) is type(expected[1])

    @pytest.mark.parametrize("text", ["bins", "=8", ""])
    def test_without_a_name_or_value(self, text):
        with pytest.raises(ValueError, match="expected name=value"):
            cli.parse_param(text)

    def test_variants(self):
        assert cli.parse_variant("wboit") == ("wboit", {})
        assert cli.parse_variant("lwboit:bins=8:smooth=false") == ("lwboit", {"bins": 8, "smooth": False})

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("wboit", ["wboit"]),
            ("a,b:x=1,c", ["a", "b:x=1", "c"]),
            ("a:range=[1,2]:b=3,c:edges=[4,5,6],d", ["a:range=[1,2]:b=3", "c:edges=[4,5,6]", "d"]),
            ("a:x=[1,b", ["a:x=[1", "b"]),
            ("a,", ["a", ""]),
        ],
    )
    def test_lists_of_variants(self, text, expected):
        assert cli.split_variants(text) == expected


class TestRender:
    @pytest.mark.parametrize("text", ["range=[1,9.5]", "range=1,9.5"])
    def test_params_of_several_numbers(self, capsys, tmp_path, text):
        path = tmp_path / "a.exr"
        arguments = ["--technique", "opacity_shadow_maps", "--param", text, "-o", path]
        status, _, err = run(capsys, "render", "scene:squares", *SMALL, *arguments)
        assert (status, err) == (0, "")
        assert oitlab.read_exr(path).params["range"] == (1.0, 9.5)

    def test_exr_and_png(self, capsys, tmp_path, model):
        output = tmp_path / "out.exr"
        arguments = [
            "--technique",
            "lwboit",
            "--param",
            "bins=16",
            "--opacity",
            "0.35",
            "-o",
            output,
            "--png",
        ]
        status, out, err = run(capsys, "render", model, *SMALL, *arguments)
        assert (status, err) == (0, "")
        assert f"wrote {output}" in out
        scene = oitlab.load(model, opacity=0.35, width=48, height=27)
        expected = oitlab.render(scene, "lwboit", {"bins": 16})
        back = oitlab.read_exr(output)
        assert np.array_equal(back.color, expected.color)
        assert (back.technique, back.params, back.scene_hash) == (
            "lwboit",
            expected.params,
            scene.content_hash,
        )
        assert np.array_equal(read(tmp_path / "out.png"), srgb_bytes(expected.color))
        assert len(np.unique(back.color.reshape(-1, 3), axis=0)) > 1

    def test_png_alone_with_exposure(self, capsys, tmp_path):
        path = tmp_path / "a.png"
        status, _, err = run(capsys, "render", "scene:squares", *SMALL, "--png", path, "--exposure", -1)
        assert (status, err) == (0, "")
        exact = oitlab.render(oitlab.scenes.squares(width=48, height=27), "a_buffer")
        assert np.array_equal(read(path), srgb_bytes(exact.color, -1.0))

    def test_seed_and_background(self, capsys, tmp_path):
        path = tmp_path / "a.exr"
        run(capsys, "render", "scene:smoke", *SMALL, "--seed", 3, "--background", 1, 0, 0.5, "-o", path)
        scene = oitlab.scenes.smoke(seed=3, width=48, height=27).replace(background=(1, 0, 0.5))
        assert oitlab.read_exr(path).scene_hash == scene.content_hash

    def test_reference_gives_errors(self, capsys, tmp_path):
        path = tmp_path / "a.exr"
        arguments = ["--technique", "wboit", "--reference", "a_buffer", "-o", path]
        status, out, _ = run(capsys, "render", "scene:squares", *SMALL, *arguments)
        frame, errors = oitlab.read_exr(path, error=True)
        exact = oitlab.render(oitlab.scenes.squares(width=48, height=27), "a_buffer")
        assert status == 0
        assert np.array_equal(errors, oitlab.error_map(frame, exact).astype(np.float32))
        assert f"rmse: {oitlab.compare(frame, exact)['rmse']:.6g}" in out

    def test_half(self, capsys, tmp_path):
        run(capsys, "render", "scene:squares", *SMALL, "--half", "-o", tmp_path / "a.exr")
        color = oitlab.read_exr(tmp_path / "a.exr").color
        assert np.array_equal(color, color.astype(np.float16))


class TestCompare:
    def test_table(self, capsys, model):
        names = "wboit,lwboit:bins=8,a_buffer"
        status, out, _ = run(capsys, "compare", model, *SMALL, "--opacity", 0.35, "--techniques", names)
        assert status == 0
        lines = out.splitlines()
        assert "48 x 27" in lines[0]
        assert all(word in out for word in ("RMSE", "resolve ms", "total ms", "bytes/pixel", "dropped"))
        assert [
            line.split()[0] for line in lines if line.split()[:1] and line.split()[0] in names.split(",")
        ] == [
            "wboit",
            "a_buffer",
        ]
        assert "lwboit bins=8" in out
        assert "exact" in out

    def test_variants_with_several_numbers(self, capsys):
        names = "opacity_shadow_maps:range=[1,9.5]:bins=8,wboit"
        status, out, _ = run(capsys, "compare", "scene:squares", *SMALL, "--techniques", names)
        assert status == 0
        assert "opacity_shadow_maps range=(1, 9.5) bins=8 " in out

    def test_table_is_never_cut_off(self, capsys, monkeypatch, model):
        monkeypatch.setenv("COLUMNS", "30")
        _, out, _ = run(capsys, "compare", model, *SMALL, "--techniques", "lwboit:bins=8:smooth=false")
        assert "lwboit bins=8 smooth=false" in out
        assert "…" not in out

    def test_files(self, capsys, tmp_path):
        folder = tmp_path / "deep" / "out"
        status, _, _ = run(
            capsys, "compare", "scene:squares", *SMALL, "--techniques", "wboit,lwboit:bins=8", "-o", folder
        )
        assert status == 0
        assert sorted(path.name for path in folder.iterdir()) == [
            "squares-lwboit-bins=8.exr",
            "squares-wboit.exr",
            "squares.csv",
            "squares.png",
        ]
        with open(folder / "squares.csv", newline="") as file:
            rows = {row["technique"]: row for row in csv.DictReader(file)}
        frame, errors = oitlab.read_exr(folder / "squares-wboit.exr", error=True)
        assert float(rows["wboit"]["mse"]) == pytest.approx(float(errors.mean(dtype=np.float64)), rel=1e-6)
        assert frame.scene_hash == oitlab.scenes.squares(width=48, height=27).content_hash

    def test_progress_goes_to_stderr(self, capsys, model):
        _, out, err = run(capsys, "compare", model, *SMALL, "--techniques", "wboit")
        assert "%|" in err
        assert "%|" not in out


class TestDemo:
    def test_all_techniques_on_three_scenes(self, capsys, tmp_path):
        status, out, _ = run(capsys, "demo", *SMALL, "-o", tmp_path)
        assert status == 0
        for scene in ("squares", "torus_knot", "blades"):
            assert (tmp_path / f"{scene}.png").is_file()
            assert f"{scene}, 48 x 27" in out
            for name in oitlab.techniques().ids:
                assert oitlab.read_exr(tmp_path / f"{scene}-{name}.exr").technique == name


class TestTechniques:
    def test_list(self, capsys):
        status, out, err = run(capsys, "techniques")
        assert (status, out, err) == (0, f"{oitlab.techniques()}\n", "")

    def test_ids(self, capsys):
        assert run(capsys, "techniques", "--ids")[1].split() == list(oitlab.techniques().ids)

    def test_description(self, capsys):
        out = run(capsys, "techniques", "wboit", "over")[1]
        assert out == f"{oitlab.techniques()['wboit']}\n\n{oitlab.techniques()['a_buffer']}\n"

    def test_axes(self, capsys):
        assert run(capsys, "techniques", "--axes") == (0, f"{oitlab.techniques().axes_table()}\n", "")
        out = run(capsys, "techniques", "--axes", "mlab", "over")[1]
        assert [line.split()[0] for line in out.splitlines()[2:] if line[0] != " "] == ["mlab", "a_buffer"]


class TestErrors:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["render", "missing.glb", "-o", "a.exr"], "missing.glb"),
            (["render", "scene:nothing", "-o", "a.exr"], "unknown scene 'nothing'; known: squares"),
            (["render", "scene:squares"], "nothing to write"),
            (["render", "scene:squares", "--png"], "--png: name its file"),
            (["render", "scene:squares", "-o", "a.jpg"], "a.jpg: expected a name that ends in .exr or .png"),
            (["render", "scene:squares", "-o", "no/such/a.exr"], "the folder no/such does not exist"),
            (["render", "scene:squares", "-o", "a.exr", "--technique", "wbiot"], "wbiot"),
            (["render", "scene:squares", "-o", "a.exr", "--param", "bins"], "expected name=value"),
            (["render", "scene:squares", "-o", "a.exr", "--param", "bins=8"], "bins"),
            (
                ["render", "scene:squares", "-o", "a.exr", "--opacity", "0.5"],
                "--opacity: only for mesh files",
            ),
            (["render", "a.obj", "-o", "a.exr", "--seed", "1"], "--seed: only for procedural scenes"),
            (["render", "scene:squares", "-o", "a.exr", "--width", "0"], "width"),
            (["render", "scene:squares", "-o", "a.exr", "--threads", "0"], "threads"),
            (["render", "scene:squares", "--png", "a.png", "--exposure", "nan", *SMALL], "exposure"),
            (["compare", "scene:squares", "--techniques", "wboit,"], "technique"),
            (["compare", "scene:squares", "--techniques", "lwboit:bins=0", *SMALL], "bins"),
            (["techniques", "wbiot"], "unknown technique 'wbiot'; known: "),
        ],
    )
    def test_one_line_and_status_two(self, capsys, tmp_path, monkeypatch, arguments, message):
        monkeypatch.chdir(tmp_path)
        status, out, err = run(capsys, *arguments)
        assert status == 2
        assert out == ""
        last = err.splitlines()[-1]
        assert last.startswith("oitlab: error: ") or last.split("\r")[-1].startswith("oitlab: error: ")
        assert message in last
        assert "Traceback" not in err
        assert not list(tmp_path.iterdir())

    def test_usage(self, capsys):
        with pytest.raises(SystemExit) as exit_:
            cli.main([])
        assert exit_.value.code == 2
        assert "usage: oitlab" in capsys.readouterr().err

    def test_interrupt(self, capsys, monkeypatch):
        def interrupted(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr(cli, "_demo", interrupted)
        assert run(capsys, "demo") == (130, "", "oitlab: interrupted\n")

    def test_warnings_are_one_line(self, capsys, monkeypatch):
        def warn(*_):
            warnings.warn("texture of 'glass' is not read", oitlab.TextureWarning, stacklevel=1)

        monkeypatch.setattr(cli, "_demo", warn)
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            assert run(capsys, "demo") == (0, "", "oitlab: warning: texture of 'glass' is not read\n")


class TestProcess:
    def test_module(self):
        done = subprocess.run(
            [sys.executable, "-m", "oitlab", "techniques", "--ids"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.split() == list(oitlab.techniques().ids)
        assert done.stderr == ""

    def test_reader_that_goes_away(self):
        program = f"{json.dumps(sys.executable)} -m oitlab techniques | true; exit ${{PIPESTATUS[0]}}"
        done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=False)
        assert "Traceback" not in done.stderr
        assert "Exception" not in done.stderr

    def test_help_is_fast_and_needs_no_heavy_import(self):
        program = (
            "import sys; from oitlab import cli\n"
            "cli._parser()\n"
            "heavy = set('trimesh colour OpenEXR matplotlib pandas PIL tqdm rich scipy'.split())\n"
            "print(sorted(heavy & set(sys.modules)))\n"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout == "[]\n"
