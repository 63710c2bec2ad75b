"""`plot.transmittance`: T(z) of a pixel."""

from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab import plot
from plotting import of_kind, shown


def test_transmittance_draws_both_functions(fragments: oitlab.Fragments) -> None:
    y, x = np.unravel_index(np.argmax(fragments.counts), fragments.counts.shape)
    figure = plot.transmittance(fragments, ["avsm", ("fourier_opacity_maps", {"frequencies": 3})])
    exact, avsm, fourier = figure.axes[0].lines
    assert [line.get_label() for line in (exact, avsm, fourier)] == [
        "exact",
        "avsm",
        "fourier_opacity_maps frequencies=3",
    ]
    z = exact.get_xdata()
    assert (np.diff(z) > 0).all()
    curve = oitlab.transmittance(fragments, "avsm", pixel=(int(x), int(y)), depths=z)
    assert (exact.get_ydata() == curve.exact).all()
    assert (avsm.get_ydata() == curve.reconstructed).all()
    assert (curve.exact[0], curve.exact[-1]) == (
        1.0,
        pytest.approx(np.prod(1 - fragments.pixel(x, y)["alpha"].astype(float))),
    )
    ticks = of_kind(figure.axes[0].collections, "fragments")[0].get_segments()
    assert sorted(float(s[0, 0]) for s in ticks) == sorted(fragments.pixel(x, y)["depth"].tolist())
    assert f"pixel (x={x}, y={y}), {fragments.counts.max()} fragments" in shown(figure)


def test_transmittance_logarithmic_and_ringing(fragments: oitlab.Fragments) -> None:
    figure = plot.transmittance(fragments, {"series": ("tfm", {"frequencies": 2})})
    low, high = figure.axes[0].get_ylim()
    values = figure.axes[0].lines[1].get_ydata()
    assert low < min(values.min(), 0)
    assert high > max(values.max(), 1)
    axes = plot.transmittance(fragments, "avsm", logy=True).axes[0]
    assert axes.get_yscale() == "log"
    assert axes.get_ylim()[0] > 0


def test_transmittance_refuses(fragments: oitlab.Fragments) -> None:
    y, x = np.argwhere(fragments.counts == 0)[0]
    for arguments, message in (
        ({"pixel": (48, 0)}, r"pixel \(48, 0\) is outside the 48 x 27 image"),
        ({"pixel": (x, y)}, r"has no fragments; the deepest pixel is \("),
        ({"pixel": 3}, "pixel must be a pair"),
        ({"pixel": (1, 2, 3)}, "pixel must be a pair"),
        ({"pixel": (0.5, 1)}, "pixel must be a pair"),
        ({"techniques": []}, "techniques is empty"),
        ({"techniques": 3}, "techniques must be a technique"),
        ({"techniques": ["avsm", "avsm"]}, "techniques has 'avsm' twice"),
        ({"techniques": "painter"}, "painter"),
        ({"depths": []}, "depths is empty"),
        ({"source": 3}, "source must be a Scene or Fragments, got int"),
    ):
        given: dict[str, Any] = {"source": fragments, "techniques": "avsm", **arguments}
        with pytest.raises(ValueError, match=message):
            plot.transmittance(given.pop("source"), given.pop("techniques"), **given)
