"""Fragments, frames and figures of every kind, made once per file."""

import pytest
from matplotlib.figure import Figure

import oitlab
from plotting import every_kind


@pytest.fixture(scope="module")
def fragments() -> oitlab.Fragments:
    return oitlab.capture(oitlab.scenes.blades(width=48, height=27, count=60))


@pytest.fixture(scope="module")
def frames(fragments: oitlab.Fragments) -> list[oitlab.Frame]:
    return oitlab.render_many(fragments, ["a_buffer", "wboit", "mlab", ("lwboit", {"bins": 4})])


@pytest.fixture(scope="module")
def figures(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> dict[str, Figure]:
    return every_kind(fragments, frames)
