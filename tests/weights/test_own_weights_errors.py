"""What is wrong with weights and bin functions of one's own is said by name, line and column."""

import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from test_own_weights import Floats, counted, mb7, one_per_pixel

import oitlab

FRAGMENTS = one_per_pixel(np.float32([2, 3]))
WRONG = [
    ({"weight": "z +\n  * a"}, "weight:2:3"),
    ({"weight": "z + exp(z, z)"}, r"exp\(z, z\)"),
    ({"weight": "vec2(z)"}, "weight"),
    ({"weight": "(z"}, "weight:1:"),
    ({"weight": "z; a"}, "not part of an expression"),
    ({"weight": "fn weight(z: f32) -> i32 { return 1; }"}, "`weight` has to return f32"),
    ({"weight": "fn weight(z: i32) -> f32 { return 1.0; }"}, "`z` has to be f32"),
    ({"weight": "fn weigh(z: f32) -> f32 { return z; }"}, "there is no `fn weight"),
    (
        {
            "weight": "@group(0) @binding(0) var t: texture_2d<f32>;\n"
            "fn weight(z: f32) -> f32 { return textureLoad(t, vec2(0, 0), 0).x; }"
        },
        "`t`: variables, textures and buffers",
    ),
    ({"weight": "fn weight(z: f32) -> f32 { loop { } return z; }"}, "never ends"),
    ({"weight": "mat2x2(z, z, z, z)[0].x"}, "matrices are not supported"),
    ({"weight": "array(z, a)[0]"}, "arrays are not supported"),
    ({"weight": "z + " * 3000}, "at most 8192"),
    ({"weight": "mb77"}, r'"weight" is "mb77"; allowed is one of "one".*WGSL.*callable'),
    ({"weight": ""}, r'"weight" is ""; allowed is one of'),
    ({"weight": 3}, r'"weight" is 3; allowed is one of'),
    ({"weight": "exp(-k * z)"}, r'"weight.k" is missing.*uniforms of "weight" are k'),
    ({"weight": "exp(-k * z)", "weight.k": 1, "weight.q": 2}, r'unknown parameter "weight.q".*are k'),
    ({"weight": "exp(-k * z)", "weight.k": "x"}, r'"weight.k" is "x"; allowed is a finite number'),
    ({"weight": "exp(-k * z)", "weight.k": np.inf}, r'"weight.k" is inf; allowed is a finite number'),
    ({"weight": "exp(-k * z)", "weight.k": 1e39}, r'"weight.k" is 1e39; allowed is a finite number'),
    ({"weight": "mb7", "weight.k": 1}, r'unknown parameter "weight.k".*has no uniforms'),
    ({"weight.k": 1}, r'unknown parameter "weight.k".*has no uniforms'),
    ({"layout.k": 1}, r'unknown parameter "layout.k"'),
    ({"layout": mb7}, '"layout" is <function mb7'),
    ({"weight": "1.0 - d", "near": 5.0, "far": 2.0}, "near must be less than far"),
]


@pytest.mark.parametrize(("params", "message"), WRONG, ids=[str(i) for i in range(len(WRONG))])
def test_refusals(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"(?s){message}") as caught:
        oitlab.render(FRAGMENTS, "wboit", params)
    assert "wboit: " in str(caught.value)


def test_a_syntax_error_is_shown_in_the_users_text() -> None:
    with pytest.raises(ValueError, match="weight:2:3") as caught:
        oitlab.render(FRAGMENTS, "wboit", {"weight": "z +\n  * a"})
    lines = str(caught.value).splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("2 │"))
    assert lines[at] == "2 │   * a"
    assert lines[at + 1].index("^") == lines[at].index("*")
    assert "return" not in str(caught.value)


class Trouble(Exception):
    """Raised by a weight."""


@pytest.mark.parametrize("technique", ["wboit", "lwboit"])
def test_what_callables_raise_comes_back(technique: str, small_scene: oitlab.Scene) -> None:
    trouble = Trouble("no idea")

    def weight(z: Floats, alpha: Floats) -> Floats:
        raise trouble

    for source in (small_scene, oitlab.capture(small_scene)):
        with pytest.raises(Trouble) as caught:
            oitlab.render(source, technique, {"weight": weight})
        assert caught.value is trouble
    assert oitlab.render(small_scene, technique, {"weight": mb7}).color.shape == (27, 48, 3)


RETURNS: list[tuple[Any, str]] = [
    (lambda z, a: z[:-1], r"weight: <function .* returned an array of shape \(\d+,\), not \(\d+,\)"),
    (lambda z, a: 1.0, r"shape \(\), not \(\d+,\)"),
    (lambda z, a: np.ones((len(z), 2)), r"shape \(\d+, 2\), not"),
    (lambda z, a: None, "dtype object, not of real numbers"),
    (lambda z, a: z * 1j, "dtype complex64, not of real numbers"),
    (lambda z, a: ["x"] * len(z), "dtype <U1, not of real numbers"),
    (lambda z, a: np.ma.masked_array(z, mask=z > 0), "masked values"),
]


@pytest.mark.parametrize(("weight", "message"), RETURNS)
def test_what_callables_may_not_return(weight: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.render(FRAGMENTS, "wboit", {"weight": weight})


def test_callables_cannot_render() -> None:
    def weight(z: Floats, alpha: Floats) -> Floats:
        oitlab.render(FRAGMENTS, "wboit")
        return z

    with pytest.raises(RuntimeError, match="from within a technique or a function that a render calls"):
        oitlab.render(FRAGMENTS, "wboit", {"weight": weight})


def test_loops_without_end_are_counted() -> None:
    endless = "fn weight(z: f32) -> f32 { var i = 0; while i < 10 || z > 7.0 { i++; } return 1.0; }"
    depth = np.linspace(1, 20, 64, dtype=np.float32)
    assert (
        counted(one_per_pixel(depth), "wboit", {"weight": endless}).stats.invalid_weights == (depth > 7).sum()
    )


INTERRUPTED = """
import time
import oitlab
scene = oitlab.scenes.smoke(width=320, height=180)
def weight(z, alpha):
    time.sleep(0.05)
    return 1 / z
print("ready", flush=True)
try:
    oitlab.render(scene, "lwboit", {"weight": weight})
except KeyboardInterrupt:
    print("stopped", oitlab.render(scene.replace(width=8, height=8), "wboit").color.shape)
"""


def test_ctrl_c_stops_callables() -> None:
    command = [sys.executable, "-c", INTERRUPTED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert output == "stopped (8, 8, 3)\n"
    assert process.returncode == 0


def test_inspection_takes_ones_own(fragments: oitlab.Fragments) -> None:
    moved = oitlab.order_sensitivity(fragments, "wboit", {"weight": mb7}, n=4)
    assert moved.max() < 1e-10


def test_frames_with_callables_can_be_written(tmp_path: Any, fragments: oitlab.Fragments) -> None:
    oitlab.write_exr(tmp_path / "own.exr", oitlab.render(fragments, "wboit", {"weight": mb7}))
    again = oitlab.read_exr(tmp_path / "own.exr")
    assert "mb7" in again.params["weight"]


def test_command_line(tmp_path: Any) -> None:
    command = [sys.executable, "-m", "oitlab", "render", "scene:squares", "--technique", "wboit"]
    size = ["--width", "32", "--height", "18"]
    own = ["--param", "weight=a * exp(-k * z)", "--param", "weight.k=0.5"]
    finished = subprocess.run(
        [*command, *size, *own, "-o", str(tmp_path / "own.exr")], capture_output=True, text=True
    )
    assert finished.returncode == 0, finished.stderr
    params = oitlab.read_exr(tmp_path / "own.exr").params
    assert (params["weight"], params["weight.k"]) == ("a * exp(-k * z)", 0.5)
