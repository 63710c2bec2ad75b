"""Where a call's work runs: renders beside each other, and in forks of a process that has threads."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import oitlab

FORK = """
import os, signal
import numpy as np, oitlab

scene = oitlab.scenes.squares(width=40, height=30)
count = 20_000  # so many depths are sorted by several threads
rng = np.random.default_rng(0)
fragments = oitlab.Fragments(
    width=1, height=1, offsets=[0, count], depth=1 + rng.random(count), color=0.1 * rng.random((count, 3)),
    alpha=rng.random(count), primitive=np.arange(count), background=(1, 1, 1),
    primitive_depth=rng.random(count),
)

def by_centroid():
    depths = np.array([1.5, 2.5], np.float32)
    return oitlab.transmittance(
        fragments, "mlab", {"submission_order": "centroid"}, pixel=(0, 0), depths=depths
    )

WORKS = {
    "transmittance": by_centroid,
    "render": lambda: oitlab.render(scene, "wboit").color,
    "threads": lambda: oitlab.render(scene, "wboit", threads=1).color,
    "capture": lambda: oitlab.capture(scene).depth,
    "depth": lambda: oitlab.render(scene, "wboit").first_depth,
}
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize("before", ["transmittance", "render", "threads", None])
def test_forks_work_whatever_was_done_before(before: str | None) -> None:
    code = f"""
    before = {before!r}
    if before is not None:
        WORKS[before]()
    for name, work in WORKS.items():
        child = os.fork()
        if child == 0:
            signal.alarm(60)  # a hang ends the child with a signal
            work()
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, name
    """
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK + textwrap.dedent(code)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def test_a_number_of_threads_does_not_wait_for_the_shared_ones() -> None:
    scene = oitlab.scenes.blades(width=64, height=48, count=40)
    expected = oitlab.render(scene, "wboit").color
    let_go, blocked = threading.Event(), threading.Event()

    def weight(z: np.ndarray, a: np.ndarray) -> np.ndarray:
        blocked.set()
        assert let_go.wait(120)
        return np.ones_like(z)

    with ThreadPoolExecutor(1) as pool:
        held = pool.submit(oitlab.render, scene, "wboit", params={"weight": weight})
        try:
            assert blocked.wait(60)
            for _ in range(3):
                # while the shared threads wait for the weight
                assert (oitlab.render(scene, "wboit", threads=1).color == expected).all()
            assert not held.done()
        finally:
            let_go.set()
        assert np.isfinite(held.result().color).all()


def test_renders_beside_each_other_are_those_of_one() -> None:
    scenes = [oitlab.scenes.squares(seed=seed, width=130, height=70) for seed in range(4)]
    expected = [oitlab.render(scene, "wboit").color for scene in scenes]
    with ThreadPoolExecutor(8) as pool:
        jobs = [
            (which, pool.submit(oitlab.render, scenes[which], "wboit", threads=threads))
            for _ in range(10)
            for which in range(4)
            for threads in (None, 1, 2)
        ]
        assert all((job.result().color == expected[which]).all() for which, job in jobs)
