"""Fragments for weights of one's own."""

import pytest

import oitlab


@pytest.fixture(scope="module")
def fragments(small_scene: oitlab.Scene) -> oitlab.Fragments:
    """Some with depths that vary within a primitive."""
    return oitlab.capture(small_scene)
