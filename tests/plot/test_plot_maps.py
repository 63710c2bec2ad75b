"""`plot.depth_complexity` and `plot.error_map`."""

import math
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import BoundaryNorm, LogNorm

import handmade
import oitlab
from oitlab import plot
from plotting import shown


def test_depth_complexity_shows_the_counts(fragments: oitlab.Fragments, frames: list[oitlab.Frame]) -> None:
    for source in (fragments, frames[1]):
        figure = plot.depth_complexity(source)
        (image,) = figure.axes[0].get_images()
        data = image.get_array()
        assert (data.filled(0) == fragments.counts).all()
        assert (data.mask == (fragments.counts == 0)).all()
        assert figure.axes[1].get_ylabel() == "fragments per pixel (number)"
        assert f"largest {fragments.counts.max()}" in shown(figure)
        assert f"{(fragments.counts == 0).sum():,} pixels without" in shown(figure)
        assert int(image.norm.vmax) == fragments.counts.max()


def test_depth_complexity_scales(fragments: oitlab.Fragments) -> None:
    few = plot.depth_complexity(fragments, limit=5)
    (image,) = few.axes[0].get_images()
    assert isinstance(image.norm, BoundaryNorm)
    assert image.norm(np.array([1, 5])).tolist() == image.norm(np.array([1, 9])).tolist()
    assert [t.get_text() for t in few.axes[1].get_yticklabels()] == ["1", "2", "3", "4", "5"]
    (image,) = plot.depth_complexity(fragments, log=True, limit=100).axes[0].get_images()
    assert isinstance(image.norm, LogNorm)
    assert (image.norm.vmin, image.norm.vmax) == (1, 100)
    empty = oitlab.Fragments(
        width=3, height=2, offsets=[0] * 7, depth=[], color=[], alpha=[], background=(0, 0, 0)
    )
    assert "largest 0; white: 6 pixels without" in shown(plot.depth_complexity(empty))
    with pytest.raises(ValueError, match="source must be a Frame or Fragments, got list"):
        plot.depth_complexity([1])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="limit must be >= 1"):
        plot.depth_complexity(fragments, limit=0)


def test_a_large_map_keeps_its_largest_number() -> None:
    counts = np.zeros((40, 4000), np.uint32)
    counts[17, 3001] = 99
    figure = plot.depth_complexity(handmade.frame(np.zeros((40, 4000, 3)), fragment_count=counts))
    (image,) = figure.axes[0].get_images()
    assert image.get_array().shape[1] < 4000
    assert image.get_array().max() == 99


def test_error_maps_share_a_stated_scale(frames: list[oitlab.Frame]) -> None:
    exact, *others = frames
    figure = plot.error_map(others, exact, "absolute")
    assert [axes.get_title() for axes in figure.axes[:3]] == ["wboit", "mlab", "lwboit bins=4"]
    for axes, frame in zip(figure.axes[:3], others, strict=True):
        (image,) = axes.get_images()
        errors = oitlab.error_map(frame, exact, "absolute")
        assert (image.get_array() == np.maximum(errors, 1e-4)).all()
        assert (image.norm.vmin, image.norm.vmax) == (1e-4, 1.0)
        assert image.get_cmap().name == "magma"
        assert f"largest {errors.max():.3g}" in axes.get_xlabel()
    bar = figure.axes[3]
    assert bar.get_ylabel() == "largest error of R, G, B (linear RGB, 1 = white)" or "\n" in bar.get_ylabel()
    assert bar.get_yscale() == "log"


def test_error_map_limits(frames: list[oitlab.Frame]) -> None:
    exact, wboit, *_ = frames
    (image,) = plot.error_map(wboit, exact, limits=(0, 0.1), log=False).axes[0].get_images()
    assert (image.norm.vmin, image.norm.vmax) == (0, 0.1)
    (image,) = plot.error_map({"mine": wboit.color}, exact, "delta_e_2000").axes[0].get_images()
    assert (image.norm.vmin, image.norm.vmax) == (0, 10)
    for wrong in ((0, 1), (1, 0.5), (0.1, math.inf)):
        with pytest.raises(ValueError, match="limits must be finite with 0 < low < high"):
            plot.error_map(wboit, exact, limits=wrong)
    for arguments, message in (
        ({"frames": []}, "frames is empty"),
        ({"metric": "mse"}, "metric must be one of 'squared'"),
        ({"columns": 0}, "columns must be >= 1"),
        ({"limits": 3}, "limits must be two numbers"),
        ({"limits": (1, 2, 3)}, "limits must be two numbers"),
        ({"frames": 3}, "frames must be one or several, got 3"),
        ({"metric": "flip"}, "pixels_per_degree"),
    ):
        given: dict[str, Any] = {"frames": wboit, **arguments}
        with pytest.raises(ValueError, match=message):
            plot.error_map(given.pop("frames"), exact, **given)
