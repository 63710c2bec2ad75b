"""Fixtures that several test files share."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

import oitlab
from backends import BACKENDS

DATA = Path(os.environ.get("OITLAB_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data() -> Callable[[str], Path]:
    """Path of a file of the development assets; skips the test where they are absent."""

    def find(name: str) -> Path:
        if not (DATA / name).exists():
            pytest.skip(f"{name} is not in {DATA} (set OITLAB_DATA)")
        return DATA / name

    return find


@pytest.fixture(scope="module", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> str:
    """Each backend in turn: what a test asks of one holds on the other."""
    name: str = request.param
    return name


@pytest.fixture(scope="session")
def small_scene() -> oitlab.Scene:
    """A scene with several layers in most pixels."""
    return oitlab.scenes.blades(width=48, height=27, count=60)


@pytest.fixture
def pane() -> oitlab.Mesh:
    """One triangle that faces the default camera."""
    return oitlab.Mesh([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], [(0, 1, 2)], color=(1.0, 0.5, 0.25, 0.5))
