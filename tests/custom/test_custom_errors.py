"""What can go wrong in a function of one's own."""

import subprocess
import sys
import threading
import traceback
from typing import Any

import numpy as np
import pytest

import oitlab

# what goes wrong


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda n: None, "returned None, not"),
        (lambda n: np.ones((n, 3)), "returned an array of shape .* not"),
        (lambda n: (np.ones((n, 3)),), "returned a tuple of 1"),
        (lambda n: (np.ones((n, 4)), np.ones(n)), r"color has shape \(19, 4\) for 19 pixels, not \(19, 3\)"),
        (lambda n: (np.ones((n, 3), int), np.ones(n)), "color has dtype int64, not a float's"),
        (lambda n: (np.ones((n, 3)), np.ones(n - 1)), r"transmittance has shape \(18,\) .* not \(19,\)"),
        (lambda n: (np.ones((n, 3)), np.ones((n, 3))), "three channels need colored_transmittance=True"),
        (lambda n: (np.ones((n, 3)), 1.0), r"transmittance has shape \(\)"),
        (lambda n: (np.ones((n, 3)), ["a"] * n), "transmittance has dtype <U1"),
        (lambda n: (np.ones((n, 3)), [[1.0], 2.0]), "transmittance is not a regular array"),
        (
            lambda n: (spoiled((n, 3), np.nan), np.ones(n)),
            r"color of pixel \(x=3, y=1\) is \[nan, .* not finite",
        ),
        (lambda n: (spoiled((n, 3), np.inf), np.ones(n)), r"color of pixel \(x=3, y=1\) is \[inf,"),
        (
            lambda n: (np.ones((n, 3)), spoiled(n, np.nan)),
            r"transmittance of pixel \(x=3, y=1\) is nan, not in",
        ),
        (lambda n: (np.ones((n, 3)), spoiled(n, 1.5)), r"transmittance of pixel \(x=3, y=1\) is 1.5"),
        (lambda n: (np.ones((n, 3)), spoiled(n, -0.1)), r"transmittance of pixel \(x=3, y=1\) is -0.1"),
        (lambda n: (np.ma.masked_equal(spoiled((n, 3), 0), 0), np.ones(n)), "color has masked values"),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), np.ones(n)),
            "dropped is an array of .* float64, not 19 integers",
        ),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), -np.ones(n, int)),
            r"pixel \(x=0, y=0\) dropped -1 fragments",
        ),
        (
            lambda n: (np.ones((n, 3)), np.ones(n), np.full(n, 99, np.uint64)),
            r"pixel \(x=0, y=0\) dropped 99 fragments, but has only \d+",
        ),
    ],
)
def test_what_comes_back_is_checked(fragments: oitlab.Fragments, result: Any, message: str) -> None:
    oitlab.technique(lambda batch: result(len(batch)), id="wrong")
    with pytest.raises(ValueError, match="wrong: .*" + message):
        oitlab.render(fragments, "wrong", threads=1)


def spoiled(shape: Any, value: float) -> Any:
    """Ones, but for the place of pixel (3, 1) in a batch that lacks (3, 0)."""
    array = np.ones(shape)
    array[7] = value
    return array


@pytest.mark.parametrize("threads", [1, 4])
def test_exceptions_reach_the_caller_as_they_are(small_scene: oitlab.Scene, threads: int) -> None:
    raised = KeyError("mine")

    @oitlab.technique
    def failing(batch: oitlab.Batch) -> tuple[Any, Any]:
        helper = raised
        raise helper

    for source in (small_scene, oitlab.capture(small_scene)):
        with pytest.raises(KeyError) as caught:
            oitlab.render_many(source, ["a_buffer", "failing"], threads=threads)
        assert caught.value is raised
        text = "".join(traceback.format_exception(caught.value))
        assert "raise helper" in text
        assert "in render_many" in text
        raised.__traceback__ = None
    with pytest.raises(KeyError, match="mine"):
        oitlab.order_sensitivity(small_scene, "failing", n=2)
    assert np.isfinite(oitlab.render(small_scene, "a_buffer").color).all()


def test_rendering_from_within_a_technique_is_refused(small_scene: oitlab.Scene) -> None:
    fragments = oitlab.capture(small_scene)

    @oitlab.technique
    def nested(batch: oitlab.Batch) -> tuple[Any, Any]:
        oitlab.render(fragments, "a_buffer")
        return batch.background, np.ones(len(batch))

    with pytest.raises(RuntimeError, match="from within a technique or a function that a render calls"):
        oitlab.render(small_scene, "nested")


def test_renders_of_several_threads_do_not_lock_each_other_out(
    mine: list[str], small_scene: oitlab.Scene
) -> None:
    images: list[Any] = []
    work = [
        threading.Thread(target=lambda: images.append(oitlab.render(small_scene, "numpy_over").color))
        for _ in range(4)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join(60)
    assert len(images) == 4
    for image in images:
        np.testing.assert_array_equal(image, images[0])


INTERRUPTED = """
import os, signal, threading, time
import numpy as np, oitlab

# a shell's background jobs ignore it, and so would this
signal.signal(signal.SIGINT, signal.default_int_handler)

@oitlab.technique
def slow(batch):
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        np.ones(100).sum()
    print("left")
    return batch.background, np.ones(len(batch))

scene = oitlab.scenes.blades(width=48, height=27, count=60)
try:
    oitlab.render(scene, "slow")
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent the POSIX way")
def test_ctrl_c_works_while_the_function_runs() -> None:
    result = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    # the function is left alone at once, and waited for before the interpreter goes
    assert (result.returncode, result.stdout) == (0, "interrupted\nleft\n"), result.stderr
