"""Files that are broken, empty or odd: a clear error that names the file, or a correct image."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oitlab
from gltf_files import document, write_glb, write_gltf

Find = Callable[[str], Path]

REFUSED = {
    "IndexOutOfRange.gltf": "geometry 'Mesh': face 0 refers to vertex 255, but there are 24 vertices",
    "OutOfMemory.off": "truncated: 353535235358 vertices",
    "index_buffer_oob.gltf": "geometry 'GLTF': face 1 refers to vertex 5, but there are 4 vertices",
    "integer-out-of-bounds.gltf": "byteLength must be a whole number",
    "invalid-buffer-index.gltf": "buffer view 1 refers to buffer 1, but there are 1",
    "invalid_magic.glb": "magic",
    "malformed.obj": "line 28: a face refers to vertex 0",
    "nancolor.obj": "line 7 has a vertex that is not finite",
    "truncated_chunk_data.glb": "truncated: the header announces 48 bytes, the file has 47",
}
DRAWN = {
    "Mesh_PrimitiveMode_04.gltf": 2,
    "busted.STL": 3878,
    "comments.off": 12,
    "cubevc.glb": 48,
    "metadata.ply": 2,
    "negative_indices.obj": 12,
    "noimg.obj": 1000,
    "notenoughindices.obj": 1,
    "polygonfaces.obj": 3,
    "singlevn.obj": 2,
    "soup.stl": 100,
}
EMPTY = [
    "empty.obj",
    "empty.ply",
    "empty.stl",
    "empty_nodes.glb",
    "invalid_elements_float.gltf",
    "obj_points.obj",
    "ply_empty_header.ply",
    "points_emptyface.ply",
]


def test_every_file_of_the_corpus_has_its_verdict(data: Find) -> None:
    files = {path.name for path in data("bad_input").iterdir()}
    companions = {name for name in files if name.endswith((".bin", ".png", ".txt", ".md"))}
    assert files - companions == {*REFUSED, *DRAWN, *EMPTY}


@pytest.mark.parametrize("name", REFUSED)
def test_broken_files_are_refused_by_name(data: Find, name: str) -> None:
    with pytest.raises((ValueError, OSError)) as caught:
        oitlab.load(data(f"bad_input/{name}"))
    assert name in str(caught.value)
    assert REFUSED[name] in str(caught.value)


@pytest.mark.filterwarnings("ignore::oitlab.LoadWarning")
@pytest.mark.parametrize("name", DRAWN)
def test_odd_files_are_drawn(data: Find, name: str) -> None:
    scene = oitlab.load(data(f"bad_input/{name}"), opacity=0.5, width=32, height=18)
    assert sum(len(mesh.faces) for mesh in scene.meshes) == DRAWN[name]
    frame = oitlab.render(scene, "a_buffer")
    assert np.isfinite(frame.color).all()
    assert frame.stats.fragments > 0


@pytest.mark.filterwarnings("ignore::oitlab.LoadWarning")
@pytest.mark.parametrize("name", EMPTY)
def test_empty_files_show_the_background(data: Find, name: str) -> None:
    scene = oitlab.load(data(f"bad_input/{name}"), opacity=0.5, width=4, height=3, background=(1, 0, 0.5))
    assert scene.meshes == ()
    np.testing.assert_array_equal(oitlab.render(scene, "wboit").color, np.full((3, 4, 3), (1, 0, 0.5)))


def test_splats_are_points(data: Find) -> None:
    with pytest.warns(oitlab.LoadWarning, match="PointCloud"):
        assert oitlab.load(data("splat/guitar_3dgs.ply")).meshes == ()
    with pytest.raises(ValueError, match=r"guitar\.compressed\.ply: no field of name x"):
        oitlab.load(data("splat/guitar.compressed.ply"))


def test_missing_and_unreadable_paths_are_oserrors(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone\.glb"):
        oitlab.load(tmp_path / "gone.glb")
    with pytest.raises(OSError, match=tmp_path.name):
        oitlab.load(tmp_path)
    header, _ = document()
    header["buffers"][0]["uri"] = "gone.bin"
    path = tmp_path / "x.gltf"
    path.write_text(json.dumps(header))
    with pytest.raises(OSError, match=r"x\.gltf.*gone\.bin"):
        oitlab.load(path)


@pytest.mark.parametrize("name", ["x.unknown", "x", "x.txt"])
def test_unknown_kinds_are_refused_by_name(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("hello")
    with pytest.raises(ValueError, match=f"cannot read .*{name}: "):
        oitlab.load(tmp_path / name)


@pytest.mark.parametrize("suffix", ["glb", "gltf", "ply", "stl", "off"])
@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"\xff" * 30, b"{}", b"[1]", b"null", b"ply\n"])
def test_garbage_is_refused_or_empty(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"garbage.{suffix}"
    path.write_bytes(content)
    try:
        verdict = repr(oitlab.load(path))
    except (ValueError, OSError) as error:
        verdict = str(error)
    assert verdict.startswith(("Scene(0 meshes", f"cannot read {path}: "))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_truncated_glb_is_an_oserror(tmp_path: Path, share: float) -> None:
    path = write_glb(tmp_path / "cut.glb", *document())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(OSError, match=r"cut\.glb: truncated"):
        oitlab.load(path)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
@pytest.mark.parametrize(
    "name", ["scans/stanford_dragon_res2.ply", "bad_input/soup.stl", "bad_input/comments.off"]
)
def test_truncated_files_of_other_kinds_are_refused(
    tmp_path: Path, data: Find, name: str, share: float
) -> None:
    path = tmp_path / f"cut{Path(name).suffix}"
    whole = data(name).read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises((ValueError, OSError), match="cut"):
        oitlab.load(path)


def test_a_model_too_large_to_frame_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "x.obj").write_text("v 0 0 0\nv 3e38 0 0\nv 0 3e38 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"x\.obj: no camera can frame it: eye"):
        oitlab.load(tmp_path / "x.obj")


def break_gltf(change: str) -> tuple[dict[str, Any], bytes]:
    header, blob = document(material={})
    primitive = header["meshes"][0]["primitives"][0]
    match change:
        case "cycle":
            header["nodes"] = [{"children": [1]}, {"children": [0], "mesh": 0}]
        case "two parents":
            header["nodes"] = [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]
        case "node":
            header["scenes"][0]["nodes"] = [5]
        case "scene":
            header["scene"] = 3
        case "material":
            primitive["material"] = 9
        case "accessor":
            primitive["indices"] = 77
        case "view":
            header["bufferViews"][0]["byteLength"] = 10**9
        case "sparse":
            header["accessors"][0]["sparse"] = {"count": 1}
        case "normalized":
            header["accessors"][0]["normalized"] = True
        case "huge":
            header["accessors"][0] = {"componentType": 5126, "count": 10**12, "type": "VEC3"}
        case "extension":
            header["extensionsRequired"] = ["EXT_meshopt_compression"]
        case "version":
            header["asset"]["version"] = "1.0"
        case "mode":
            header["materials"][0]["alphaMode"] = "GLASS"
        case "factor":
            header["materials"][0]["pbrMetallicRoughness"] = {"baseColorFactor": [1, 1]}
        case "alpha":
            header["materials"][0]["pbrMetallicRoughness"] = {"baseColorFactor": [1, 1, 1, 7]}
        case "matrix":
            header["nodes"][0]["matrix"] = [1] * 7
        case "nan":
            header["nodes"][0]["scale"] = [float("nan"), 1, 1]
        case "meshes":
            header["meshes"] = 5
    return header, blob


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("cycle", "node 0 is reached twice"),
        ("two parents", "node 2 is reached twice"),
        ("node", "node 5, but there are 1"),
        ("scene", "scene 3, but there are 1"),
        ("material", "material 9"),
        ("accessor", "accessor 77, but there are 2"),
        ("view", "buffer view 0 ends at byte"),
        ("sparse", "POSITION is a sparse accessor"),
        ("normalized", "normalized integer positions"),
        ("huge", "1000000000000 items"),
        ("extension", "EXT_meshopt_compression"),
        ("version", "glTF version 1.0"),
        ("mode", "unknown alphaMode 'GLASS'"),
        ("factor", "broken"),
        ("alpha", "geometry 'thing': color"),
        ("matrix", "broken"),
        ("nan", "geometry 'thing' is placed by a transform that is not finite"),
        ("meshes", "broken"),
    ],
)
def test_broken_gltf_is_refused_by_name(tmp_path: Path, change: str, message: str) -> None:
    path = write_gltf(tmp_path / "broken.gltf", *break_gltf(change))
    with pytest.raises(ValueError, match=r"broken\.gltf") as caught:
        oitlab.load(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n", "line 5: face 1 refers to vertex 9"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "line 4: a face refers to vertex -4 of 3"),
        ("v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "line 2 has a vertex that is not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "x.obj"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "x.obj"),
    ],
)
def test_broken_obj_is_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.obj").write_text(text)
    with pytest.raises(ValueError, match=r"x\.obj") as caught:
        oitlab.load(tmp_path / "x.obj")
    assert message in str(caught.value)


def test_errors_keep_their_cause(data: Find, tmp_path: Path) -> None:
    shutil.copy(data("bad_input/OutOfMemory.off"), tmp_path / "copy.off")
    with pytest.raises(OSError, match=r"copy\.off") as caught:
        oitlab.load(tmp_path / "copy.off")
    assert isinstance(caught.value.__cause__, OSError)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"opacity": 1.5}, "opacity"),
        ({"opacity": "half"}, "opacity"),
        ({"shading": "phong"}, "shading"),
        ({"width": 0}, "width"),
        ({"height": -1}, "height"),
        ({"background": (0, 0)}, "background"),
        ({"camera": 3}, "camera"),
    ],
)
def test_bad_arguments_are_refused_by_name(tmp_path: Path, keywords: dict[str, Any], message: str) -> None:
    path = write_gltf(tmp_path / "x.gltf", *document())
    with pytest.raises(ValueError, match=message):
        oitlab.load(path, **keywords)
