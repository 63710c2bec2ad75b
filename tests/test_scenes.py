"""Procedural scenes: seeded, of the stated statistics, closed where they should be, tightly clipped."""

from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab.scenes import SCENES

SMALL: dict[str, dict[str, Any]] = {
    "squares": {"count": 8},
    "soup": {"count": 500},
    "shells": {"count": 3, "subdivisions": 2},
    "smoke": {"count": 40},
    "blades": {"count": 30},
    "torus_knot": {"segments": 30, "sides": 6},
}


def small(name: str, seed: int = 0) -> oitlab.Scene:
    return SCENES[name](seed, 32, 18, **SMALL[name])


def test_every_scene_has_a_small_form() -> None:
    assert SMALL.keys() == SCENES.keys()


@pytest.mark.parametrize("name", SCENES)
def test_the_seed_decides_everything(name: str) -> None:
    assert small(name, 3) == small(name, 3)
    assert small(name, 3) != small(name, 4)


@pytest.mark.parametrize("name", SCENES)
def test_clip_planes_are_tight(name: str) -> None:
    scene = small(name)
    depths = scene.camera.depths(scene.meshes[0].vertices)
    assert scene.camera.near == pytest.approx(0.98 * depths.min())
    assert scene.camera.far == pytest.approx(1.02 * depths.max())


@pytest.mark.parametrize("name", ["squares", "smoke", "soup", "blades", "shells"])
def test_count_zero_is_an_empty_scene(name: str) -> None:
    assert len(SCENES[name](count=0, width=8, height=8).meshes[0].faces) == 0


@pytest.mark.parametrize(
    ("name", "faces", "alphas"),
    [
        ("squares", 128, (0.9, 0.9)),
        ("soup", 200_000, (0.3, 0.3)),
        ("smoke", 2100, (0.05, 0.2)),
        ("blades", 400, (0.3, 0.3)),
        ("shells", 8 * 20 * 4**6, (0.35, 0.35)),
    ],
)
def test_defaults_are_those_of_the_papers_stand_ins(name: str, faces: int, alphas: Any) -> None:
    scene = SCENES[name]()
    (mesh,) = scene.meshes
    assert (scene.width, scene.height, scene.background) == (1280, 720, (0.2, 0.2, 0.2))
    assert (scene.camera.fov_y, scene.camera.target) == (40.0, (0.0, 0.0, 0.0))
    assert (len(mesh.faces), mesh.color_domain, mesh.alpha_mode) == (faces, "face", "blend")
    alpha = mesh.colors[:, 3]
    assert alpha.min() >= np.float32(alphas[0])
    assert alpha.max() <= np.float32(alphas[1])


def test_squares_face_the_camera_in_even_layers() -> None:
    scene = oitlab.scenes.squares(seed=5, count=16, alpha=0.99)
    vertices, faces = scene.meshes[0].vertices, scene.meshes[0].faces
    corners = vertices.reshape(16, 4, 3)
    np.testing.assert_allclose(corners[:, :, 2], np.linspace(-1.5, 1.5, 16)[:, None].repeat(4, 1))
    sides = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2)
    np.testing.assert_allclose(sides, sides[:, :1].repeat(4, 1))
    assert ((sides >= 0.5) & (sides <= 1.1)).all()
    assert (scene.meshes[0].colors[:, 3] == np.float32(0.99)).all()
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(vertices[faces], axis=1), 1, 0)), axis=1)
    np.testing.assert_allclose(area.sum() / 2, (sides[:, 0] ** 2).sum())


def test_the_two_halves_of_a_square_share_their_colour() -> None:
    (mesh,) = oitlab.scenes.smoke(count=20).meshes
    square = mesh.faces.min(axis=1) // 4
    for index in range(20):
        assert len(np.unique(mesh.colors[square == index], axis=0)) == 1


@pytest.mark.parametrize("name", ["shells", "torus_knot"])
def test_surfaces_are_closed_and_face_outwards(name: str) -> None:
    (mesh,) = small(name).meshes
    faces = mesh.faces.astype(np.int64)
    edges = faces[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2)
    forward = {tuple(edge) for edge in edges.tolist()}
    assert len(forward) == len(edges)
    assert forward == {(b, a) for a, b in forward}
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_spheres_are_round() -> None:
    (mesh,) = oitlab.scenes.shells(count=2, subdivisions=3).meshes
    for vertices, radius in zip(mesh.vertices.reshape(2, -1, 3), (0.45, 1.15), strict=True):
        centre = vertices.mean(axis=0)
        np.testing.assert_allclose(np.linalg.norm(vertices - centre, axis=1), radius, rtol=1e-12)
        assert (np.abs(centre) <= (0.25, 0.15, 0.25)).all()


@pytest.mark.parametrize("name", [name for name in SCENES if name != "torus_knot"])
def test_bad_counts_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="count"):
        SCENES[name](count=-1)
    with pytest.raises(ValueError, match="count"):
        SCENES[name](count=2.5)


def test_a_tube_needs_three_sides() -> None:
    with pytest.raises(ValueError, match="sides"):
        oitlab.scenes.torus_knot(sides=2)
