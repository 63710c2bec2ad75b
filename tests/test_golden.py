"""Golden images: what every technique made of a small scene, to the last bit that a platform may change.

`python tests/test_golden.py` (or `make golden`) renews them after a change that is meant.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import CONFORMS

GOLDEN = Path(__file__).parent / "golden"
# exp and pow differ by an ulp between C libraries, and a device sums in f32; everything else is exact
TOLERANCE = 2e-6


def scene() -> oitlab.Scene:
    """Interpenetrating triangles, up to a dozen layers."""
    return oitlab.scenes.blades(seed=7, width=48, height=27, count=90)


def techniques() -> list[str]:
    return list(oitlab.techniques().ids)


@pytest.mark.parametrize("technique", techniques())
def test_golden(technique: str, backend: Any) -> None:
    path = GOLDEN / f"{technique}.npy"
    assert path.exists(), f"{technique} has no golden image: run `make golden` and look at it"
    color = oitlab.render(scene(), technique, backend=backend).color
    bound = CONFORMS.get(technique, (0.0, 0.0))[1] if backend == "gpu" else 0.0
    np.testing.assert_allclose(color, np.load(path), rtol=0, atol=max(TOLERANCE, bound))


def test_no_golden_without_a_technique() -> None:
    assert {path.stem for path in GOLDEN.glob("*.npy")} == set(techniques())


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for name in techniques():
        np.save(GOLDEN / f"{name}.npy", oitlab.render(scene(), name).color)
