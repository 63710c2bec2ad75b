"""Loading: colours, alpha modes, transforms, sides and framing of files with known contents."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oitlab
from gltf_files import TRIANGLE, document, write_glb, write_gltf

Find = Callable[[str], Path]
GREY = np.float32(0.6)


def load_gltf(folder: Path, **keywords: Any) -> oitlab.Scene:
    return oitlab.load(write_gltf(folder / "thing.gltf", *document(**keywords)), width=8, height=8)


def decoded(byte: float) -> float:
    """Linear value of an sRGB byte (IEC 61966-2-1)."""
    v = byte / 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("write", [write_gltf, write_glb])
def test_gltf_factors_are_exact_and_linear(tmp_path: Path, write: Any) -> None:
    factor = [0.016, 0.3, 0.7, 0.123456789]
    material = {"pbrMetallicRoughness": {"baseColorFactor": factor}, "alphaMode": "BLEND"}
    suffix = ".glb" if write is write_glb else ".gltf"
    (mesh,) = oitlab.load(write(tmp_path / f"x{suffix}", *document(material=material))).meshes
    np.testing.assert_array_equal(mesh.colors, np.array([factor], dtype=np.float32))
    np.testing.assert_array_equal(mesh.vertices, TRIANGLE)
    assert (mesh.alpha_mode, mesh.shading) == ("blend", "lambert")


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        ({}, ("opaque", 0.5, True)),
        ({"alphaMode": "OPAQUE", "doubleSided": True}, ("opaque", 0.5, True)),
        ({"alphaMode": "BLEND", "doubleSided": False}, ("blend", 0.5, False)),
        ({"alphaMode": "MASK"}, ("mask", 0.5, True)),
        ({"alphaMode": "MASK", "alphaCutoff": 0.2}, ("mask", 0.2, True)),
    ],
)
def test_gltf_modes_and_sides(tmp_path: Path, material: Any, expected: Any) -> None:
    (mesh,) = load_gltf(tmp_path, material=material).meshes
    assert (mesh.alpha_mode, mesh.alpha_cutoff, mesh.double_sided) == expected


def test_gltf_without_material_is_white_and_opaque(tmp_path: Path) -> None:
    (mesh,) = load_gltf(tmp_path).meshes
    np.testing.assert_array_equal(mesh.colors, [(1, 1, 1, 1)])
    assert mesh.alpha_mode == "opaque"


def test_gltf_emission_and_unlit(tmp_path: Path) -> None:
    extensions = {"KHR_materials_unlit": {}, "KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
    (mesh,) = load_gltf(tmp_path, material={"emissiveFactor": [0.5, 0, 1], "extensions": extensions}).meshes
    assert mesh.emission == (2.0, 0.0, 4.0)
    assert mesh.shading == "unlit"


@pytest.mark.parametrize(
    ("colors", "expected"),
    [
        (np.array([(1, 0.5, 0, 0.5)] * 3, dtype=np.float32), (0.5, 0.25, 0, 0.25)),
        (np.array([(255, 51, 0, 102)] * 3, dtype=np.uint8), (0.5, 0.1, 0, 0.2)),
        (np.array([(65535, 13107, 0, 26214)] * 3, dtype=np.uint16), (0.5, 0.1, 0, 0.2)),
        (np.array([(1, 0.5, 0)] * 3, dtype=np.float32), (0.5, 0.25, 0, 0.5)),
    ],
)
@pytest.mark.parametrize("with_material", [True, False])
def test_gltf_vertex_colours_multiply_the_factor(
    tmp_path: Path, colors: Any, expected: Any, with_material: bool
) -> None:
    material = {"pbrMetallicRoughness": {"baseColorFactor": [0.5] * 4}, "alphaMode": "BLEND"}
    scene = load_gltf(tmp_path, colors=colors, material=material if with_material else None)
    (mesh,) = scene.meshes
    factor = 1 if with_material else 2
    assert mesh.color_domain == "vertex"
    np.testing.assert_allclose(mesh.colors, [np.array(expected) * factor] * 3, rtol=1e-6)


def test_gltf_instances_are_placed_and_mirrors_keep_their_front(tmp_path: Path) -> None:
    nodes = [
        {"children": [1, 2, 3], "translation": [0, 0, 10]},
        {"mesh": 0, "scale": [2, 2, 2], "camera": 0},
        {"mesh": 0, "scale": [-1, 1, 1]},
        {"mesh": 0, "rotation": [0, 0, 2**-0.5, 2**-0.5], "translation": [5, 0, 0]},
    ]
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}
    scene = load_gltf(tmp_path, nodes=nodes, cameras=[camera])
    placed = [mesh.vertices[mesh.faces[0]] for mesh in scene.meshes]
    base = TRIANGLE.astype(np.float64)
    expected = [
        2 * base + (0, 0, 10),
        np.add((base * (-1, 1, 1))[::-1], (0, 0, 10)),
        base @ np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1)]) + (5, 0, 10),
    ]
    assert len(placed) == len(expected)
    for want in expected:
        (got,) = (triangle for triangle in placed if np.allclose(triangle, want, atol=1e-12))
        assert np.cross(got[1] - got[0], got[2] - got[0])[2] > 0


def test_gltf_two_primitives_keep_their_own_materials(tmp_path: Path) -> None:
    header, blob = document(material={"name": "same", "alphaMode": "BLEND"})
    header["materials"].append({"name": "same", "alphaMode": "MASK"})
    second = {**header["meshes"][0]["primitives"][0], "material": 1}
    header["meshes"][0]["primitives"].append(second)
    scene = oitlab.load(write_glb(tmp_path / "two.glb", header, blob))
    assert [mesh.alpha_mode for mesh in scene.meshes] == ["blend", "mask"]


def test_textures_are_named_once(tmp_path: Path) -> None:
    header, blob = document(
        material={
            "name": "leaf",
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 0, 0, 1]},
            "emissiveTexture": {"index": 0},
            "emissiveFactor": [1, 1, 1],
        },
        nodes=[{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0}],
        textures=[{"source": 0}],
        images=[{"uri": "missing.png"}],
    )
    with pytest.warns(oitlab.TextureWarning, match=r"t\.gltf.*leaf$") as caught:
        scene = oitlab.load(write_gltf(tmp_path / "t.gltf", header, blob))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    np.testing.assert_array_equal(scene.meshes[0].colors, [(1, 0, 0, 1)])
    assert scene.meshes[0].emission == (0, 0, 0)


@pytest.mark.parametrize("mode", [0, 1, 2, 3, 6])
def test_points_and_lines_are_named_and_passed_over(tmp_path: Path, mode: int) -> None:
    header, blob = document()
    header["meshes"][0]["primitives"][0]["mode"] = mode
    with pytest.warns(oitlab.LoadWarning, match="thing"):
        scene = oitlab.load(write_gltf(tmp_path / "x.gltf", header, blob), width=8, height=8)
    assert scene.meshes == ()


def test_meshes_in_no_scene_are_named(tmp_path: Path) -> None:
    header, blob = document()
    header["scenes"] = [{"nodes": []}]
    with pytest.warns(oitlab.LoadWarning, match="'thing' \\(in no scene\\)"):
        assert oitlab.load(write_gltf(tmp_path / "x.gltf", header, blob)).meshes == ()


def mtl(tmp_path: Path, lines: str) -> oitlab.Mesh:
    (tmp_path / "m.mtl").write_bytes(f"# müde\nnewmtl grün\n{lines}\n".encode("latin-1"))
    text = "# grün\nmtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl grün\nf 1 2 3\n"
    (tmp_path / "m.obj").write_bytes(text.encode("latin-1"))
    (mesh,) = oitlab.load(tmp_path / "m.obj", width=8, height=8).meshes
    return mesh


@pytest.mark.parametrize(
    ("lines", "rgba", "mode"),
    [
        ("Kd 0.5 1 0.0031", (decoded(127.5), 1, 0.0031 / 12.92, 1), "opaque"),
        ("Kd 1 1 1\nd 0.25", (1, 1, 1, 0.25), "blend"),
        ("Kd 1 1 1\nd -halo 0.25", (1, 1, 1, 0.25), "blend"),
        ("Kd 1 1 1\nTr 0.75", (1, 1, 1, 0.25), "blend"),
        ("Kd 1 1 1\nTr 0.5\nd 0.25", (1, 1, 1, 0.25), "blend"),
        ("Kd 1 1 1\nd 1.0", (1, 1, 1, 1), "opaque"),
        ("illum 1", (0.6, 0.6, 0.6, 1), "opaque"),
    ],
)
def test_mtl_gives_colour_and_alpha(tmp_path: Path, lines: str, rgba: Any, mode: str) -> None:
    mesh = mtl(tmp_path, lines)
    np.testing.assert_allclose(mesh.colors[0], rgba, rtol=1e-6)
    assert mesh.alpha_mode == mode


def test_mtl_emission_and_textures(tmp_path: Path) -> None:
    assert mtl(tmp_path, "Ke 0.5 0 2").emission == (0.5, 0.0, 2.0)
    with pytest.warns(oitlab.TextureWarning, match="grün"):
        mtl(tmp_path, "map_d leaves.png")
    with pytest.raises(ValueError, match=r"m\.obj.*grün.*d is not a number"):
        mtl(tmp_path, "d half")


def test_missing_material_library_is_named(tmp_path: Path) -> None:
    (tmp_path / "x.obj").write_text("mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.warns(oitlab.LoadWarning, match="gone.mtl"):
        (mesh,) = oitlab.load(tmp_path / "x.obj").meshes
    np.testing.assert_array_equal(mesh.colors, [(GREY, GREY, GREY, 1)])


def test_relative_obj_indices_count_from_their_line(tmp_path: Path) -> None:
    first = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n"
    (tmp_path / "x.obj").write_text(first + first.replace(" 0\n", " 9\n"))
    (mesh,) = oitlab.load(tmp_path / "x.obj").meshes
    assert sorted(mesh.vertices[mesh.faces][:, :, 2].sum(axis=1)) == [0, 27]


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
{vertex}element face 1
property list uchar int vertex_indices
{face}end_header
0 0 0{v}
1 0 0{v}
0 1 0{v}
3 0 1 2{f}
"""
UCHARS = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))


@pytest.mark.parametrize(("domain", "rows"), [("vertex", 3), ("face", 1)])
@pytest.mark.parametrize(("alpha", "mode"), [(255, "opaque"), (51, "blend")])
def test_ply_colours_are_decoded(tmp_path: Path, domain: str, rows: int, alpha: int, mode: str) -> None:
    values = f" 255 128 0 {alpha}"
    fields = {"vertex": "", "face": "", "v": "", "f": ""} | {domain: UCHARS, domain[0]: values}
    (tmp_path / "x.ply").write_text(PLY.format(**fields))
    (mesh,) = oitlab.load(tmp_path / "x.ply").meshes
    assert (mesh.color_domain, mesh.alpha_mode) == (domain, mode)
    np.testing.assert_allclose(mesh.colors, [(1, decoded(128), 0, alpha / 255)] * rows, rtol=1e-6)


def test_uncoloured_ply_is_grey_and_opaque(tmp_path: Path) -> None:
    (tmp_path / "x.ply").write_text(PLY.format(vertex="", face="", v="", f=""))
    (mesh,) = oitlab.load(tmp_path / "x.ply", shading="unlit").meshes
    np.testing.assert_array_equal(mesh.colors, [(GREY, GREY, GREY, 1)])
    assert (mesh.alpha_mode, mesh.shading) == ("opaque", "unlit")


STL = """solid grün
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid
"""
OFF = "OFF # grün\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
LATIN = {"stl": STL, "off": OFF, "ply": PLY.format(vertex="comment grün\n", face="", v="", f="")}


@pytest.mark.parametrize("suffix", LATIN)
@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_text_in_any_encoding_is_read(tmp_path: Path, suffix: str, encoding: str) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(LATIN[suffix].encode(encoding))
    (mesh,) = oitlab.load(path).meshes
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[0]], TRIANGLE)


def test_opacity_replaces_every_alpha(tmp_path: Path) -> None:
    path = write_gltf(tmp_path / "x.gltf", *document())
    camera = oitlab.Camera(eye=(0.25, 0.25, 5), target=(0.25, 0.25, 0))
    keywords: Any = {"camera": camera, "width": 9, "height": 9, "background": (0, 0, 0), "shading": "unlit"}
    solid = oitlab.render(oitlab.load(path, **keywords), "a_buffer")
    glass = oitlab.render(oitlab.load(path, 0.25, **keywords), "a_buffer")
    np.testing.assert_array_equal(solid.color[4, 4], 1)
    np.testing.assert_allclose(glass.color[4, 4], 0.25)
    assert (solid.stats.fragments, glass.fragment_count[4, 4]) == (0, 1)


def test_the_given_camera_and_settings_are_used(tmp_path: Path) -> None:
    path = write_gltf(tmp_path / "x.gltf", *document())
    camera = oitlab.Camera(eye=(1, 2, 3))
    scene = oitlab.load(path, camera=camera, width=20, height=10, background=(1, 0, 0))
    assert scene.camera is camera
    assert (scene.width, scene.height, scene.background) == (20, 10, (1.0, 0.0, 0.0))
    assert oitlab.load(str(path)).content_hash == oitlab.load(path).content_hash


def test_framing_ignores_vertices_that_no_face_uses(tmp_path: Path) -> None:
    far_away = np.concatenate([TRIANGLE, np.float32([(1000, 0, 0)])])
    frames = [load_gltf(tmp_path, vertices=vertices).camera for vertices in (TRIANGLE, far_away)]
    assert frames[0] == frames[1]


FACES = {
    "architecture/dabrovic_sponza.obj": (1, 66_454),
    "cad/2CylinderEngine.glb": (115, 121_496),
    "foliage/GlassVaseFlowers.glb": (4, 14_036),
    "gltf_alpha/AlphaBlendModeTest.glb": (9, 61),
    "gltf_alpha/Material_AlphaBlend_04.glb": (1, 2),
    "scans/stanford_bunny.ply": (1, 69_451),
    "scans/stanford_dragon_res2.ply": (1, 202_520),
    "scenes/CesiumMilkTruck.glb": (5, 3_624),
    "scenes/ToyCar.glb": (3, 108_936),
}


@pytest.mark.filterwarnings("ignore::oitlab.TextureWarning")
@pytest.mark.parametrize("name", FACES)
def test_real_files_load_whole_and_fill_the_image(data: Find, name: str) -> None:
    scene = oitlab.load(data(name), opacity=0.35, width=64, height=36)
    assert (len(scene.meshes), sum(len(mesh.faces) for mesh in scene.meshes)) == FACES[name]
    frame = oitlab.render(scene, "a_buffer")
    assert np.isfinite(frame.color).all()
    covered = frame.fragment_count > 0
    assert covered.mean() > 0.05
    assert covered.any(axis=1).mean() > 0.5 or covered.any(axis=0).mean() > 0.5


@pytest.mark.filterwarnings("ignore::oitlab.TextureWarning")
def test_alpha_modes_of_a_real_file(data: Find) -> None:
    scene = oitlab.load(data("gltf_alpha/AlphaBlendModeTest.glb"))
    masks = sorted(mesh.alpha_cutoff for mesh in scene.meshes if mesh.alpha_mode == "mask")
    assert masks == [0.25, 0.5, 0.75]
    assert [mesh.alpha_mode for mesh in scene.meshes].count("blend") == 2


def test_vertex_alpha_times_factor_of_a_real_file(data: Find) -> None:
    (mesh,) = oitlab.load(data("gltf_alpha/Material_AlphaBlend_04.glb")).meshes
    (plain,) = oitlab.load(data("gltf_alpha/Material_AlphaBlend_00.glb")).meshes
    np.testing.assert_allclose(mesh.colors[:, 3], np.float32(0.7) * plain.colors[:, 3], rtol=1e-6)
    assert plain.color_domain == "vertex"
    assert mesh.alpha_mode == "blend"


def test_draco_file_equals_its_plain_twin(data: Find) -> None:
    pytest.importorskip("DracoPy", reason="DracoPy is not installed")
    with pytest.warns(oitlab.TextureWarning):
        one, two = (oitlab.load(data(f"scenes/chess_board{kind}.glb"), 0.5) for kind in ("", "_draco"))
    np.testing.assert_allclose(one.bounds, two.bounds)
