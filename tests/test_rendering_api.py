"""`render`, `render_many` and `capture`: what goes in, what comes out, what is refused."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import oitlab

IDS = oitlab.techniques().ids


@pytest.mark.parametrize("technique", IDS)
@pytest.mark.parametrize("dtype", ["float32", np.float64])
def test_a_frame_has_the_promised_shapes(
    small_scene: oitlab.Scene, technique: str, dtype: Any, backend: Any
) -> None:
    if backend == "gpu" and dtype != "float32":
        with pytest.raises(ValueError, match="computes in single precision"):
            oitlab.render(small_scene, technique, dtype=dtype, backend=backend)
        return
    frame = oitlab.render(small_scene, technique, dtype=dtype, backend=backend)
    size = (small_scene.height, small_scene.width)
    assert frame.color.shape == (*size, 3)
    colored = oitlab.techniques()[technique].properties["colored_transmittance"]
    assert frame.transmittance.shape == ((*size, 3) if colored else size)
    assert frame.color.dtype == frame.transmittance.dtype == np.dtype(dtype)
    assert (frame.first_depth.shape, frame.first_depth.dtype) == (size, np.float32)
    assert (frame.fragment_count.shape, frame.fragment_count.dtype) == (size, np.uint32)
    assert np.isfinite(frame.color).all()
    assert frame.technique == technique
    assert frame.scene_hash == small_scene.content_hash
    assert frame.params.keys() == {param.name for param in oitlab.techniques()[technique].params}
    frame.color[:] = 0
    frame.first_depth[:] = 0


def test_statistics_agree_with_the_image(small_scene: oitlab.Scene, backend: Any) -> None:
    frame = oitlab.render(small_scene, "a_buffer", threads=1, backend=backend)
    stats, count = frame.stats, frame.fragment_count
    assert stats.fragments == count.sum()
    assert stats.depth_complexity_max == count.max()
    assert stats.dropped == 0
    assert (stats.backend, stats.threads) == (backend, 1)
    assert stats.total_ms >= stats.raster_ms >= 0
    assert stats.resolve_ms >= 0
    np.testing.assert_array_equal(np.isinf(frame.first_depth), count == 0)
    assert all(isinstance(amount, int) for amount in stats.skipped.values())
    assert stats.skipped.keys() == oitlab.render(small_scene, "a_buffer").stats.skipped.keys()


def test_render_many_gives_what_render_gives(small_scene: oitlab.Scene, backend: Any) -> None:
    variants: list[Any] = ["a_buffer", ("wboit", {"weight": "mb9"}), ("wboit", None), "a_buffer"]
    frames = oitlab.render_many(small_scene, variants, backend=backend)
    alone = [
        oitlab.render(small_scene, technique, params, backend=backend)
        for technique, params in (("a_buffer", None), ("wboit", {"weight": "mb9"}), ("wboit", None))
    ]
    assert [frame.technique for frame in frames] == ["a_buffer", "wboit", "wboit", "a_buffer"]
    assert frames[1].params["weight"] == "mb9"
    for many, one in zip(frames, [*alone, alone[0]], strict=True):
        np.testing.assert_array_equal(many.color, one.color)
        assert many.params == one.params


def test_frames_own_their_arrays(small_scene: oitlab.Scene, backend: Any) -> None:
    one, two = oitlab.render_many(small_scene, ["a_buffer", "a_buffer"], backend=backend)
    before = two.color.copy()
    one.color[:] = 7
    one.first_depth[:] = 7
    one.fragment_count[:] = 7
    np.testing.assert_array_equal(two.color, before)
    assert not (two.first_depth == 7).any()
    assert not (two.fragment_count == 7).all()


def test_no_variants_give_no_frames(small_scene: oitlab.Scene, backend: Any) -> None:
    assert oitlab.render_many(small_scene, [], backend=backend) == []


@pytest.mark.parametrize("alias_of", [entry for entry in oitlab.techniques() if entry.aliases])
def test_aliases_are_resolved(
    small_scene: oitlab.Scene, alias_of: oitlab.TechniqueInfo, backend: Any
) -> None:
    for alias in alias_of.aliases:
        assert oitlab.render(small_scene, alias, backend=backend).technique == alias_of.id


def test_numpy_scalars_are_params(small_scene: oitlab.Scene, backend: Any) -> None:
    plain, numpy, whole = (
        oitlab.render(small_scene, "lwboit", params, backend=backend)
        for params in (
            {"bins": 16, "weight_k": 2.0},
            {"bins": np.int64(16), "weight_k": np.float32(2)},
            {"bins": np.array(16), "weight_k": 2},
        )
    )
    assert plain.params == numpy.params == whole.params
    np.testing.assert_array_equal(plain.color, numpy.color)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_change_nothing(small_scene: oitlab.Scene, threads: int, backend: Any) -> None:
    expected = oitlab.render(small_scene, "wboit", backend=backend).color
    again = oitlab.render(small_scene, "wboit", threads=threads, backend=backend).color
    np.testing.assert_array_equal(again, expected)


def test_without_geometry_the_background_shows(backend: Any) -> None:
    scene = oitlab.Scene([], camera=oitlab.Camera(), width=5, height=3, background=(0.25, 0.5, 0.75))
    for frame in oitlab.render_many(scene, IDS, backend=backend):
        np.testing.assert_array_equal(frame.color, np.broadcast_to((0.25, 0.5, 0.75), (3, 5, 3)))
        np.testing.assert_array_equal(frame.transmittance, 1)
        assert np.isinf(frame.first_depth).all()
        assert frame.stats.fragments == frame.stats.depth_complexity_max == 0
        assert frame.stats.depth_complexity_mean == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 101), (301, 1), (17, 33)])
def test_odd_image_sizes(pane: oitlab.Mesh, shape: tuple[int, int], backend: Any) -> None:
    scene = oitlab.Scene([pane], camera=oitlab.Camera(), height=shape[0], width=shape[1])
    frame = oitlab.render(scene, "a_buffer", backend=backend)
    assert frame.color.shape == (*shape, 3)
    half = [(0.5 * c + 0.5 * 0.2) for c in (1.0, 0.5, 0.25)]
    y, x = shape[0] // 2, shape[1] // 2
    np.testing.assert_allclose(frame.color[y, x], half, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        (("no_such",), {}, "no_such"),
        (("wboit", {"wieght": "mb7"}), {}, "wieght.*"),
        (("wboit", {"weight": "heavy"}), {}, "weight"),
        (("wboit", {"weight": 3}), {}, "weight"),
        (("lwboit", {"bins": 0}), {}, "bins"),
        (("lwboit", {"bins": 513}), {}, "bins"),
        (("lwboit", {"bins": 8.5}), {}, "bins"),
        (("lwboit", {"weight_k": np.nan}), {}, "weight_k"),
        (("wboit", [("weight", "mb7")]), {}, "params of 'wboit' must be a mapping"),
        ((3,), {}, "named by its id, got 3"),
        (("wboit",), {"backend": "tpu"}, "unknown backend 'tpu'"),
        (("wboit",), {"dtype": "float16"}, "dtype must be"),
        (("wboit",), {"dtype": "colour"}, "dtype must be"),
        (("wboit",), {"threads": 0}, "threads"),
        (("wboit",), {"threads": -1}, "threads"),
        (("wboit",), {"threads": 1.5}, "threads must be an integer"),
    ],
)
def test_bad_requests_are_refused_by_name(
    small_scene: oitlab.Scene, arguments: Any, keywords: dict[str, Any], message: str, backend: Any
) -> None:
    with pytest.raises(ValueError, match=message):
        oitlab.render(small_scene, *arguments, **({"backend": backend} | keywords))


def test_bad_sources_and_variants_are_refused(small_scene: oitlab.Scene, backend: Any) -> None:
    with pytest.raises(ValueError, match="source must be"):
        oitlab.render(np.zeros((4, 4)), "wboit", backend=backend)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="scene must be"):
        oitlab.capture(oitlab.capture(small_scene))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="a variant is"):
        oitlab.render_many(small_scene, [("wboit", {}, 1)], backend=backend)  # type: ignore[list-item]


def test_importing_oitlab_imports_nothing_heavy() -> None:
    heavy = "{'trimesh', 'OpenEXR', 'colour', 'matplotlib', 'pandas', 'PIL', 'tqdm', 'rich', 'scipy'}"
    code = f"import sys, oitlab; print(sorted({heavy} & sys.modules.keys()))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
