"""Meshes, cameras and scenes are values: compared, hashed, pickled, replaced, and checked on construction."""

import pickle
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab import Camera, Mesh, Scene

CORNERS = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 1.0, 0.0)]
FACE = [(0, 1, 2)]


def test_mesh_keeps_what_it_was_given() -> None:
    colors = np.linspace(0, 1, 12).reshape(3, 4)
    mesh = Mesh(
        CORNERS,
        FACE,
        vertex_colors=colors,
        alpha_mode="mask",
        alpha_cutoff=0.25,
        shading="lambert",
        emission=(1, 2, 3),
        double_sided=False,
        opacity=0.35,
    )
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    np.testing.assert_array_equal(mesh.faces, FACE)
    np.testing.assert_array_equal(mesh.colors, colors.astype(np.float32))
    assert (mesh.color_domain, mesh.alpha_mode, mesh.alpha_cutoff) == ("vertex", "mask", 0.25)
    assert (mesh.shading, mesh.emission, mesh.double_sided) == ("lambert", (1.0, 2.0, 3.0), False)
    assert mesh.opacity == 0.35
    np.testing.assert_array_equal(mesh.bounds, [(-1, -1, 0), (1, 1, 0)])


@pytest.mark.parametrize(
    ("keywords", "domain", "rows"),
    [
        ({}, "mesh", 1),
        ({"color": (0.1, 0.2, 0.3, 0.4)}, "mesh", 1),
        ({"vertex_colors": np.full((3, 4), 0.5)}, "vertex", 3),
        ({"face_colors": [(1, 0, 0, 1)]}, "face", 1),
    ],
)
def test_colors_belong_to_a_domain(keywords: dict[str, Any], domain: str, rows: int) -> None:
    mesh = Mesh(CORNERS, FACE, **keywords)
    assert mesh.color_domain == domain
    assert mesh.colors.shape == (rows, 4)
    assert mesh.colors.dtype == np.float32


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int8])
def test_mesh_takes_any_numeric_dtype(dtype: Any) -> None:
    mesh = Mesh(np.array(CORNERS, dtype=dtype)[::-1], np.array(FACE, dtype=np.uint16))
    np.testing.assert_array_equal(mesh.vertices, CORNERS[::-1])


def test_empty_mesh_has_no_bounds() -> None:
    mesh = Mesh([], [])
    assert mesh.vertices.shape == mesh.faces.shape == (0, 3)
    assert np.isnan(mesh.bounds).all()


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        (([(0, 0)], FACE), {}, "vertices must have shape"),
        ((CORNERS, [(0, 1)]), {}, "faces must have shape"),
        ((CORNERS, [(0.0, 1.0, 2.0)]), {}, "faces must hold integers"),
        (([("a", "b", "c")], FACE), {}, "vertices must hold real numbers"),
        (([(0, 0, 0), (1,)], FACE), {}, "vertices is not a regular array"),
        (([(1j, 0, 0)] * 3, FACE), {}, "vertices must hold real numbers"),
        (([(0, 0, 0), (1, np.nan, 0), (0, 1, 0)], FACE), {}, r"vertices.*1"),
        (([(0, 0, 0), (1, 0, 0), (0, 1, np.inf)], FACE), {}, r"vertices.*2"),
        ((CORNERS, [(0, 1, 3)]), {}, r"faces.*3 vertices"),
        ((CORNERS, [(0, 1, -1)]), {}, r"faces.*-1"),
        ((CORNERS, [(0, 1, 2**40)]), {}, r"faces"),
        ((CORNERS, np.array([(0, 1, 2**63)], dtype=np.uint64)), {}, r"faces.*9223372036854775808"),
        ((CORNERS, FACE), {"color": (1, 1, 1)}, "color must have shape"),
        ((CORNERS, FACE), {"color": (1, 1, 1, 1.5)}, "color"),
        ((CORNERS, FACE), {"color": (1, 1, 1, -0.1)}, "color"),
        ((CORNERS, FACE), {"color": (np.nan, 1, 1, 1)}, "color"),
        ((CORNERS, FACE), {"color": (1e39, 1, 1, 1)}, "color"),
        ((CORNERS, FACE), {"vertex_colors": np.zeros((2, 4))}, "vertex_colors must have shape"),
        ((CORNERS, FACE), {"face_colors": np.zeros((3, 4))}, "face_colors must have shape"),
        ((CORNERS, FACE), {"face_colors": [(0, 0, 0, 2)]}, "face_colors.*0"),
        ((CORNERS, FACE), {"color": (1,) * 4, "face_colors": [(1,) * 4]}, "one of color"),
        ((CORNERS, FACE), {"alpha_mode": "glass"}, "alpha_mode.*glass"),
        ((CORNERS, FACE), {"alpha_cutoff": np.nan}, "alpha_cutoff"),
        ((CORNERS, FACE), {"alpha_cutoff": "half"}, "alpha_cutoff"),
        ((CORNERS, FACE), {"shading": "phong"}, "shading.*phong"),
        ((CORNERS, FACE), {"emission": (1, 1)}, "emission must have shape"),
        ((CORNERS, FACE), {"emission": (np.inf, 0, 0)}, "emission"),
        ((CORNERS, FACE), {"opacity": 1.5}, "opacity.*1.5"),
        ((CORNERS, FACE), {"opacity": -0.5}, "opacity"),
    ],
)
def test_bad_mesh_is_refused_by_name(arguments: Any, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(*arguments, **keywords)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"near": 1.0, "far": 1.0}, "near|far"),
        ({"near": 0.0}, "near"),
        ({"near": -1.0}, "near"),
        ({"far": np.inf}, "far"),
        ({"fov_y": 0.0}, "fov_y"),
        ({"fov_y": 180.0}, "fov_y"),
        ({"fov_y": "wide"}, "fov_y"),
        ({"ortho_height": 0.0}, "ortho_height"),
        ({"fov_y": 45.0, "ortho_height": 1.0}, "not both"),
        ({"eye": (0, 0, np.nan)}, "eye"),
        ({"eye": (0, 0)}, "eye must have shape"),
        ({"eye": (0, 0, 0)}, "target|eye"),
        ({"up": (0, 0, 1)}, "up"),
        ({"up": (0, 0, 0)}, "up"),
    ],
)
def test_bad_camera_is_refused_by_name(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Camera(**keywords)


def test_camera_keeps_what_it_was_given() -> None:
    camera = Camera((1, 2, 3), (4, 5, 6), (0, 0, 1), 30, 0.5, 50)
    assert (camera.eye, camera.target, camera.up) == ((1, 2, 3), (4, 5, 6), (0, 0, 1))
    assert (camera.fov_y, camera.near, camera.far, camera.ortho_height) == (30, 0.5, 50, None)
    assert Camera().fov_y == 45.0
    assert Camera(ortho_height=2).fov_y is None
    assert camera.replace(ortho_height=3).replace(fov_y=30) == camera
    with pytest.raises(TypeError, match="zoom"):
        camera.replace(zoom=2)


def screen(camera: Camera, points: np.ndarray, aspect: float) -> np.ndarray:
    """Image coordinates in [-1, 1] of points, from the definition of a pinhole and a parallel camera."""
    forward = np.subtract(camera.target, camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    offset = points - np.array(camera.eye)
    plane = offset @ np.stack([right, np.cross(right, forward)], axis=1)
    if camera.ortho_height is not None:
        half = camera.ortho_height / 2
    else:
        assert camera.fov_y is not None
        half = (offset @ forward * np.tan(np.radians(camera.fov_y) / 2))[:, None]
    return plane / half / (aspect, 1)


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 0, 0), (0.3, 0.2, -1), (0, 1, 0), (0, -1, 1e-9)])
@pytest.mark.parametrize("kind", ["pinhole", "parallel"])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 16 / 9])
def test_framing_encloses_the_box_tightly(direction: Any, kind: str, aspect: float) -> None:
    low, high = np.array([(-1.0, 2.0, -0.5), (3.0, 3.0, 4.0)])
    corners = np.array([[(low, high)[i][axis] for axis, i in enumerate(c)] for c in np.ndindex(2, 2, 2)])
    ortho: Any = "fit" if kind == "parallel" else None
    camera = Camera.framing(
        [low, high], direction=direction, aspect=aspect, fov_y=30, ortho_height=ortho, margin=1
    )
    reach = np.abs(screen(camera, corners, aspect)).max()
    assert reach == pytest.approx(1, abs=1e-9)
    depths = camera.depths(corners)
    assert camera.near == pytest.approx(0.98 * depths.min())
    assert camera.far == pytest.approx(1.02 * depths.max())
    wider = Camera.framing([low, high], direction=direction, aspect=aspect, fov_y=30, ortho_height=ortho)
    assert np.abs(screen(wider, corners, aspect)).max() < 1


def test_framing_points_is_tighter_than_framing_their_box() -> None:
    points = np.array([(0, 0, 0), (1, 2, 0), (0.5, 0.5, -3)])
    bounds = [points.min(axis=0), points.max(axis=0)]
    camera = Camera.framing(bounds, points=points, margin=1, aspect=1.5)
    assert np.abs(screen(camera, points, 1.5)).max() == pytest.approx(1)
    boxed = Camera.framing(bounds, margin=1, aspect=1.5)
    assert np.abs(screen(boxed, points, 1.5)).max() < 0.99
    assert camera.near == pytest.approx(0.98 * camera.depths(points).min())


@pytest.mark.parametrize("box", [[(1, 2, 3), (1, 2, 3)], [(0, 0, 0), (0, 0, 9)], [(1e6, 0, 0), (1e6, 0, 0)]])
def test_framing_copes_with_flat_boxes(box: Any) -> None:
    camera = Camera.framing(box, direction=(0, 0, 1))
    assert 0 < camera.near < camera.depths(box).min()
    assert camera.depths(box).max() < camera.far


@pytest.mark.parametrize(
    ("bounds", "keywords", "message"),
    [
        ([(0, 0, 0), (np.nan, 1, 1)], {}, "bounds"),
        ([(1, 0, 0), (0, 1, 1)], {}, "bounds"),
        ([(0, 0, 0)], {}, "bounds must have shape"),
        ([(0, 0, 0), (1, 1, 1)], {"aspect": 0}, "aspect"),
        ([(0, 0, 0), (1, 1, 1)], {"margin": 0.5}, "margin"),
        ([(0, 0, 0), (1, 1, 1)], {"direction": (0, 0, 0)}, "direction"),
        ([(0, 0, 0), (1, 1, 1)], {"fov_y": 200}, "fov_y"),
    ],
)
def test_bad_framing_is_refused_by_name(bounds: Any, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Camera.framing(bounds, **keywords)


def test_tightened_leaves_a_camera_without_points_alone() -> None:
    assert Camera().tightened([]) == Camera()
    behind = Camera(eye=(0, 0, 1)).tightened([(0, 0, 2), (0, 0, 0)])
    assert (behind.near, behind.far) == (pytest.approx(1.02e-4), pytest.approx(1.02))


def test_scene_replace_shares_meshes(pane: Mesh) -> None:
    scene = Scene([pane, pane], camera=Camera(), width=64, height=36)
    smaller = scene.replace(width=32, background=(0, 0, 0))
    assert (smaller.width, smaller.height, smaller.background) == (32, 36, (0.0, 0.0, 0.0))
    assert smaller.meshes[0] is pane
    assert scene.replace() == scene
    np.testing.assert_array_equal(scene.bounds, pane.bounds)
    with pytest.raises(TypeError, match="depth"):
        scene.replace(depth=3)


def test_empty_scene_has_no_bounds() -> None:
    assert np.isnan(Scene([], camera=Camera()).bounds).all()


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"width": 0}, "width"),
        ({"height": 0}, "height"),
        ({"width": -1}, "width"),
        ({"width": 1.5}, "width must be an integer"),
        ({"background": (0, 0)}, "background must have shape"),
        ({"background": (0, 0, np.nan)}, "background"),
        ({"camera": "front"}, "camera must be a Camera"),
        ({"meshes": ["ball"]}, r"meshes\[0\]"),
    ],
)
def test_bad_scene_is_refused_by_name(pane: Mesh, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scene(**{"meshes": [pane], "camera": Camera(), "width": 8, "height": 8, **keywords})


VARIATIONS: list[dict[str, Any]] = [
    {"width": 33},
    {"height": 17},
    {"background": (0.2, 0.2, 0.25)},
    {"camera": Camera(near=0.2)},
    {"camera": Camera(ortho_height=3)},
    {"meshes": []},
]
MESH_VARIATIONS: list[dict[str, Any]] = [
    {"color": (1, 1, 1, 0.6)},
    {"face_colors": [(1, 1, 1, 0.5)]},
    {"alpha_mode": "opaque"},
    {"alpha_mode": "mask", "alpha_cutoff": 0.6},
    {"shading": "lambert"},
    {"emission": (0, 0, 1)},
    {"double_sided": False},
    {"opacity": 0.5},
]


def test_everything_that_matters_changes_the_hash() -> None:
    plain = Scene([Mesh(CORNERS, FACE, color=(1, 1, 1, 0.5))], camera=Camera(), width=32, height=18)
    scenes = [plain, *(plain.replace(**change) for change in VARIATIONS)]
    for change in MESH_VARIATIONS:
        keywords = {} if "face_colors" in change else {"color": (1, 1, 1, 0.5)}
        scenes.append(plain.replace(meshes=[Mesh(CORNERS, FACE, **{**keywords, **change})]))
    assert len({scene.content_hash for scene in scenes}) == len(scenes)
    assert len(set(scenes)) == len(scenes)
    assert len(set(scene.meshes for scene in scenes)) == 2 + len(MESH_VARIATIONS)


def test_equal_content_is_equal(pane: Mesh) -> None:
    again = Mesh(pane.vertices, pane.faces, color=pane.colors[0])
    assert again == pane
    assert hash(again) == hash(pane)
    one, two = (Scene([mesh], camera=Camera(), width=8, height=8) for mesh in (pane, again))
    assert one == two
    assert hash(one) == hash(two)
    assert one != "scene"
    assert pane != Mesh(pane.vertices, pane.faces, color=pane.colors[0], opacity=0.5)
    assert Camera() != Camera(near=0.5)
    assert hash(Camera()) == hash(Camera())


@pytest.mark.parametrize("domain", ["color", "vertex_colors", "face_colors"])
def test_pickles_hold_everything(domain: str) -> None:
    rows = {"color": (), "vertex_colors": (3,), "face_colors": (1,)}[domain]
    colors = np.random.default_rng(0).random((*rows, 4))
    mesh = Mesh(CORNERS, FACE, **{domain: colors}, alpha_mode="mask", opacity=0.25, emission=(1, 0, 0))
    scene = Scene([mesh, mesh], camera=Camera(ortho_height=3), width=20, height=10, background=(1, 0, 0))
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.content_hash == scene.content_hash
    assert copy.meshes[0] == mesh
    assert copy.meshes[0] is copy.meshes[1]
    assert copy.camera == scene.camera


@pytest.mark.parametrize("name", ["vertices", "alpha_mode", "anything"])
def test_values_cannot_be_changed(pane: Mesh, name: str) -> None:
    for value in (pane, Camera(), Scene([pane], camera=Camera())):
        with pytest.raises(AttributeError):
            setattr(value, name, 1)


def test_reprs_say_what_it_is(pane: Mesh) -> None:
    assert repr(Camera(near=0.5)).startswith("Camera(eye=(0.0, 0.0, 5.0)")
    assert eval(repr(Camera(near=0.5)), {"Camera": Camera}) == Camera(near=0.5)
    assert repr(Scene([pane], camera=Camera(), width=8, height=4)) == "Scene(1 meshes, 1 faces, 8 x 4)"
    assert oitlab.Mesh is Mesh
