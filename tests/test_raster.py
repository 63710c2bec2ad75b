"""The rasterisers' guarantees through the package, on trimesh's solids and the five procedural scenes."""

from typing import Any

import numpy as np
import pytest
import trimesh

import oitlab

SOLIDS = {
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=4),
    "uv_sphere": lambda: trimesh.creation.uv_sphere(count=[40, 40]),
    "torus": lambda: trimesh.creation.torus(1.0, 0.35, major_sections=96, minor_sections=48),
    "box": lambda: trimesh.creation.box((1.0, 0.7, 1.3)),
    "capsule": lambda: trimesh.creation.capsule(1.0, 0.4),
    "cylinder": lambda: trimesh.creation.cylinder(0.5, 1.2, sections=64),
    "cone": lambda: trimesh.creation.cone(0.6, 1.2),
    "annulus": lambda: trimesh.creation.annulus(0.3, 0.6, 0.8),
}
DIRECTIONS = [(0, 0, 1), (1, 0, 0), (0.3, 1, 0.2), (-0.5, 0.4, -0.8), (1, 1, 1)]


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("ortho", [False, True])
def test_a_closed_mesh_has_an_even_number_of_fragments_everywhere(
    name: str, direction: tuple[float, float, float], ortho: bool, backend: str
) -> None:
    solid = SOLIDS[name]()
    assert solid.is_watertight
    mesh = oitlab.Mesh(solid.vertices, solid.faces, color=(1, 1, 1, 0.5))
    camera = oitlab.Camera.framing(solid.bounds, direction=direction)
    if ortho:
        eye = np.asarray(camera.eye) / 3
        camera = oitlab.Camera(eye=tuple(3 * eye), ortho_height=2.5, near=0.01, far=100)
    scene = oitlab.Scene([mesh], camera=camera, width=161, height=97, background=(0, 0, 0))
    count = captured(scene, backend).counts
    assert count.max() >= 2
    assert (count % 2 == 0).all()


def captured(scene: oitlab.Scene, backend: str) -> oitlab.Fragments:
    return oitlab.capture(scene) if backend == "cpu" else oitlab.gpu.capture(scene)


def composite(fragments: oitlab.Fragments) -> np.ndarray:
    """Sorted OVER in float64, layer by layer, from the captured arrays alone."""
    pixel = np.repeat(np.arange(len(fragments.offsets) - 1), np.diff(fragments.offsets))
    order = np.lexsort((fragments.primitive, fragments.depth, pixel))
    color, alpha = fragments.color[order].astype(float), fragments.alpha[order].astype(float)
    image = np.zeros((len(fragments.offsets) - 1, 3))
    transmittance = np.ones(len(image))
    count, start = np.diff(fragments.offsets), fragments.offsets[:-1]
    for layer in range(int(count.max(initial=0))):
        live = np.nonzero(count > layer)[0]
        at = start[live] + layer
        image[live] += transmittance[live, None] * color[at]
        transmittance[live] *= 1 - alpha[at]
    background = np.broadcast_to(fragments.background, (fragments.height, fragments.width, 3))
    return image.reshape(background.shape) + transmittance.reshape(*background.shape[:2], 1) * background


# one rounding of a colour below 2 to float32, where the CPU sums in float64
FLOAT32 = 1.2e-7
# of sums and products in f32, a rounding each per layer
SUMS = 1e-6
SIZE = {"cpu": {"width": 320, "height": 180}, "gpu": {"width": 96, "height": 54}}


@pytest.mark.parametrize("name", ["squares", "soup", "smoke", "shells", "blades"])
def test_the_reference_is_the_composite_of_the_captured_fragments(name: str, backend: Any) -> None:
    small = (
        {"shells": {"subdivisions": 4}, "soup": {"count": 20_000}}.get(name, {}) if backend == "gpu" else {}
    )
    scene = oitlab.scenes.SCENES[name](**SIZE[backend], **small)
    fragments = captured(scene, backend)
    exact = composite(fragments)
    double = oitlab.render(fragments, "a_buffer", dtype="float64").color
    np.testing.assert_allclose(double, exact, rtol=0, atol=1e-14)
    single, peeled = oitlab.render_many(scene, ["a_buffer", "depth_peeling"], backend=backend)
    np.testing.assert_allclose(single.color, exact, rtol=0, atol=FLOAT32 if backend == "cpu" else SUMS)
    np.testing.assert_allclose(peeled.color, exact, rtol=0, atol=SUMS)


def test_captured_arrays_are_views_that_cannot_be_written(backend: str) -> None:
    fragments = captured(oitlab.scenes.squares(width=32, height=18), backend)
    for name in ("offsets", "depth", "color", "alpha", "primitive", "background"):
        array = getattr(fragments, name)
        assert array.base is not None
        assert not array.flags.writeable
        assert np.shares_memory(array, getattr(fragments, name))
