"""The GPU backend against the CPU backend, which is the definition."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import (
    CLIPPED,
    CLIPPED_DEPTH,
    CONFORMS,
    DECIDING,
    DEVICE,
    F32,
    PARAMS,
    ROUNDINGS,
    SCENES,
    SHARE_OF_EQUAL_DEPTHS,
    VARYING_COLOR,
    WHY_NOT,
    around,
    scene_of,
    tolerance,
)

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

IDS = [entry.id for entry in oitlab.techniques() if "gpu" in entry.backends]


def test_the_device_is_described() -> None:
    assert DEVICE is not None
    assert DEVICE.adapter
    assert DEVICE.interface in ("vulkan", "metal", "dx12")
    assert DEVICE.limits["image_side"] >= 8192
    known = set(oitlab.techniques().ids)
    assert set(DEVICE.techniques) | set(DEVICE.refused) == known
    assert set(IDS) == known  # every technique has a form; a device may still lack what it wants
    assert DEVICE.adapter in str(DEVICE)


@pytest.mark.parametrize("name", SCENES)
def test_coverage_and_primitives_are_those_of_the_cpu(name: str) -> None:
    scene = SCENES[name]
    got, expected = oitlab.gpu.capture(scene), oitlab.capture(scene)
    np.testing.assert_array_equal(got.offsets, expected.offsets)
    np.testing.assert_array_equal(got.primitive, expected.primitive)
    np.testing.assert_array_equal(
        np.broadcast_to(got.background, (48, 64, 3)), np.broadcast_to(expected.background, (48, 64, 3))
    )
    assert (got.near, got.far, got.depth_range) == (expected.near, expected.far, expected.depth_range)
    off = np.abs(got.depth - expected.depth)
    if name in CLIPPED:
        assert (off <= CLIPPED_DEPTH * expected.depth).all()
    elif len(off):
        assert (off <= np.spacing(expected.depth)).all()
        assert (off == 0).mean() >= SHARE_OF_EQUAL_DEPTHS
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=VARYING_COLOR)
    np.testing.assert_allclose(got.alpha, expected.alpha, rtol=0, atol=VARYING_COLOR)


@pytest.mark.parametrize("technique", IDS)
@pytest.mark.parametrize("name", SCENES)
def test_images_are_those_of_the_cpu_in_single_precision(name: str, technique: str) -> None:
    scene = SCENES[name]
    params = PARAMS.get(technique, {})
    got = oitlab.render(scene, technique, params, backend="gpu")
    expected = oitlab.render(scene, technique, params)
    varies = 4 * VARYING_COLOR if name in (*CLIPPED, "smooth", "masked") else 0.0
    limit = tolerance(scene, expected) + varies
    most, worst = CONFORMS.get(technique, (limit, limit))
    share = DECIDING.get(technique, 0.95 if technique in CONFORMS else 1.0)
    off = np.abs(got.transmittance - expected.transmittance).reshape(48, 64, -1)
    off = np.maximum(np.abs(got.color - expected.color), off).max(axis=-1)
    assert (off <= most).mean() >= share, (off.max(), most)
    assert technique in DECIDING or off.max() <= worst
    assert got.color.dtype == np.float32
    assert got.transmittance.shape == expected.transmittance.shape
    assert (got.params, got.technique, got.scene_hash) == (
        expected.params,
        expected.technique,
        expected.scene_hash,
    )
    for field in ("fragments", "depth_complexity_mean", "depth_complexity_max", "bytes_per_pixel", "dropped"):
        assert getattr(got.stats, field) == getattr(expected.stats, field), field
    np.testing.assert_array_equal(got.fragment_count, expected.fragment_count)
    assert got.stats.backend == "gpu"


@pytest.mark.parametrize("order", ["as_is", "reversed", "shuffled", "centroid"])
def test_orders_of_primitives_are_those_of_the_cpu(order: str) -> None:
    scene = SCENES["blades"]
    wanted = [("alpha_compositing", {"submission_order": order, "seed": 3})]
    (got,), (expected,) = oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted)
    assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected)


@pytest.mark.parametrize("order", ["as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"])
@pytest.mark.parametrize("technique", ["mlab", "k_buffer"])
def test_lists_of_layers_are_those_of_the_cpu(technique: str, order: str) -> None:
    scene = SCENES["squares"]  # where depths agree to the bit, so that nothing changes places
    wanted = [(technique, {"layers": k, "submission_order": order}) for k in (1, 2, 5, 32)]
    for got, expected in zip(
        oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted), strict=True
    ):
        assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected), got.params


def test_peeled_layers_are_those_of_the_cpu() -> None:
    scene = SCENES["opaque"]
    wanted = [("multilayer_depth_peeling", {"layers": k, "passes": p}) for k, p in ((1, 1), (2, 2), (50, 9))]
    for got, expected in zip(
        oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted), strict=True
    ):
        assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected), got.params


@pytest.mark.parametrize("storage", ["lr", "ll"])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("normalize", [False, True])
def test_bins_are_those_of_the_cpu(storage: str, smooth: bool, normalize: bool) -> None:
    scene = SCENES["blades"]
    base = {"storage": storage, "smooth": smooth, "normalize": normalize}
    more: list[dict[str, Any]] = [
        {"bins": 1},
        {"bins": 7, "weight": "one"},
        {"bins": 64, "shape": False},
        {"bins": 512, "range": "pixel"},
        {"bins": 20, "range": (3.0, 6.0), "bin_function": "tent", "weight": "inv_pow"},
        {"bins": 20, "shape_anchor": "edge"},
    ]
    wanted = [("lwboit", base | params) for params in more]
    for got, expected in zip(
        oitlab.render_many(scene, wanted, backend="gpu"), oitlab.render_many(scene, wanted), strict=True
    ):
        off = np.abs(got.color - expected.color).max(axis=-1)
        # a depth at a bin's edge may be rounded to its other side: with fading bins that makes no difference
        limit = 16 * tolerance(scene, expected)
        assert (off <= limit).mean() >= (1.0 if smooth else 0.999), (got.params, off.max())
        assert np.abs(got.transmittance - expected.transmittance).max() <= (limit if smooth else 1.0)


def test_tinted_glass_is_that_of_the_cpu() -> None:
    for params in ({"transmission": (0.9, 0.5, 0.0)}, {"transmission": 0.3, "divisor_floor": 1e-5}):
        got = oitlab.render(SCENES["opaque"], "phenomenological", params, backend="gpu")
        expected = oitlab.render(SCENES["opaque"], "phenomenological", params)
        assert got.transmittance.shape == (48, 64, 3)
        limit = tolerance(SCENES["opaque"], expected)
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)
        np.testing.assert_allclose(got.transmittance, expected.transmittance, rtol=0, atol=limit)


def test_fragments_that_do_nothing_are_shown_to_whom_they_are_on_the_cpu() -> None:
    rng = np.random.default_rng(1)
    corners = around(rng, 40, 1.0, 2.0)
    colors = rng.random((40, 4))
    colors[::2, 3] = 0  # without coverage there is no premultiplied colour
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3), face_colors=colors)
    for technique in ("weighted_average", "blended_oit"):
        got = oitlab.render(scene_of(mesh), technique, backend="gpu")
        expected = oitlab.render(scene_of(mesh), technique)
        np.testing.assert_allclose(
            got.color, expected.color, rtol=0, atol=tolerance(scene_of(mesh), expected)
        )
        assert got.stats.fragments == expected.stats.fragments > 0


def test_thousands_of_layers_are_sorted_and_none_is_lost() -> None:
    rng = np.random.default_rng(5)
    depth = rng.permutation(np.linspace(-2, 2, 3000))
    corners = np.array([(-2.0, -2, 0), (2, -2, 0), (0, 3, 0)]) + depth[:, None, None] * (0, 0, 1)
    colors = np.column_stack([rng.random((3000, 3)), np.full(3000, 0.01)])
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3), face_colors=colors)
    scene = scene_of(mesh, width=5, height=4)
    got, expected = oitlab.render(scene, "a_buffer", backend="gpu"), oitlab.render(scene, "a_buffer")
    assert got.stats.depth_complexity_max == 3000
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=tolerance(scene, expected))


def test_equal_variants_are_drawn_once_and_calls_repeat_to_the_bit() -> None:
    scene = SCENES["soup"]
    wanted = ["wboit", ("wboit", {"weight": "mb7"}), "a_buffer", "wboit"]
    first = oitlab.render_many(scene, wanted, backend="gpu")
    again = oitlab.render_many(scene, wanted, backend="gpu", skip=False)
    assert [frame.stats.skipped["duplicate_variants"] for frame in first] == [0, 1, 0, 1]
    assert [frame.stats.skipped["duplicate_variants"] for frame in again] == [0, 0, 0, 0]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.color, b.color)
    for frame in first:
        assert min(frame.stats.raster_ms, frame.stats.resolve_ms) > 0
        assert frame.stats.total_ms == frame.stats.raster_ms + frame.stats.resolve_ms
    alone = oitlab.render(scene, "wboit", backend="gpu", threads=1).stats
    assert alone.total_ms > alone.raster_ms + alone.resolve_ms
    assert alone.threads == 1
    assert oitlab.render_many(scene, [], backend="gpu") == []


def test_an_image_of_one_pixel_and_one_of_many() -> None:
    scene = SCENES["blades"]
    for size in ({"width": 1, "height": 1}, {"width": 1, "height": 300}, {"width": 517, "height": 3}):
        sized = scene.replace(**size)
        for technique in ("wboit", "a_buffer"):
            got = oitlab.render(sized, technique, backend="gpu")
            expected = oitlab.render(sized, technique)
            np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=tolerance(sized, expected))
            assert got.stats.fragments == expected.stats.fragments


LEFT_BEHIND: list[tuple[str, dict[str, Any]]] = [
    ("wboit", {}),
    ("wboit", {"layout": "listing4"}),  # other formats
    ("wboit", {"format": "f16"}),
    ("blended_oit", {}),  # formats of the first, of another module
    ("alpha_compositing", {}),  # over the background
    ("phenomenological", {"transmission": (0.9, 0.5, 0.0)}),  # two images
    ("opacity_shadow_maps", {}),  # layers
    ("opacity_shadow_maps", {"bins": 4}),
    ("occupancy_maps", {}),  # words
    ("lwboit", {"storage": "lr"}),  # attachments in parts
    ("depth_peeling", {}),  # an image without targets that are kept
]


@pytest.mark.parametrize("size", [(1300, 700), (5000, 300)])
def test_large_images_have_the_weights_of_the_cpu(size: tuple[int, int]) -> None:
    # depths that are only weighed, far from where they start, and parts that a processor's caches hold
    rng = np.random.default_rng(5)
    # from the near plane to the far one
    z = np.exp(rng.uniform(np.log(0.11), np.log(98), (8, 3)))
    z[:, 0], z[:, 1] = 0.11, 98
    x, y = rng.uniform(-1, 1, (2, 8, 3))
    corners = np.stack([x * size[0] / size[1] * 0.6 * z, y * 0.6 * z, -z], -1)
    meshes = [oitlab.Mesh(c, [(0, 1, 2)], color=(*rng.uniform(0, 1, 3), 0.5)) for c in corners]
    camera = oitlab.Camera(eye=(0, 0, 0), target=(0, 0, -1), fov_y=60)
    scene = oitlab.Scene(meshes, camera=camera, width=size[0], height=size[1])
    for weight in ("mb7", "inv_pow"):
        device = oitlab.render(scene, "wboit", {"weight": weight}, backend="gpu")
        host = oitlab.render(scene, "wboit", {"weight": weight})
        np.testing.assert_allclose(device.color, host.color, rtol=0, atol=1e-6)
        np.testing.assert_allclose(device.transmittance, host.transmittance, rtol=0, atol=1e-6)


def test_targets_of_an_earlier_call_leave_nothing_behind() -> None:
    """Targets and images are kept between calls: full ones, then empty ones of the same kind."""
    full = SCENES["smoke"]
    empty = full.replace(camera=oitlab.Camera(eye=(0, 0, 90), target=(0, 0, 99), near=0.5, far=12.0))
    fewer_rows = empty.replace(height=full.height // 2)
    background = oitlab.render(empty, "a_buffer").color
    assert oitlab.capture(full).offsets[-1] > 0
    assert oitlab.capture(empty).offsets[-1] == 0
    for technique, params in LEFT_BEHIND:
        first = oitlab.render(full, technique, params, backend="gpu")
        for scene in (empty, fewer_rows):
            got = oitlab.render(scene, technique, params, backend="gpu")
            np.testing.assert_allclose(got.color, background[: scene.height], rtol=0, atol=F32)
            np.testing.assert_array_equal(got.transmittance, 1.0)
        again = oitlab.render(full, technique, params, backend="gpu")
        np.testing.assert_array_equal(again.color, first.color)
    # after one that failed, and from several threads at once
    with pytest.raises(ValueError, match="no_such"):
        oitlab.render(full, "wboit", {"weight": "no_such(z)"}, backend="gpu")
    wanted = [(scene, *asked) for scene in (full, empty) for asked in LEFT_BEHIND[:6]]
    expected = [oitlab.render(*one, backend="gpu").color for one in wanted]
    with ThreadPoolExecutor(4) as pool:
        colors = list(pool.map(lambda one: oitlab.render(*one, backend="gpu").color, wanted * 2))
    for color, other in zip(colors, expected * 2, strict=True):
        np.testing.assert_array_equal(color, other)


SMALL_BUFFERS = """
import sys
import numpy as np, oitlab
device = oitlab.gpu.info()
assert device.limits["binding_bytes"] == 16384, device
scene = oitlab.scenes.blades(width=24, height=48, count=400)
got, expected = oitlab.gpu.capture(scene), oitlab.capture(scene)
assert 112 * 400 > 2 * 16384 and 16 * len(expected) > 3 * 16384
np.testing.assert_array_equal(got.offsets, expected.offsets)
np.testing.assert_array_equal(got.primitive, expected.primitive)
for technique in oitlab.gpu.info().techniques:
    pair = [oitlab.render(scene, technique, backend=backend) for backend in ("cpu", "gpu")]
    # moments are less like each other
    limit = 1e-2 if technique.startswith("mboit") else 1e-5
    np.testing.assert_allclose(pair[0].color, pair[1].color, rtol=0, atol=limit)
pair = [oitlab.render(scene, "lwboit", {"bins": 512}, backend=backend) for backend in ("cpu", "gpu")]
np.testing.assert_allclose(pair[0].color, pair[1].color, rtol=0, atol=1e-5)
try:
    oitlab.render(scene, "occupancy_maps", {"bits": 65536}, backend="gpu")
except MemoryError as error:
    assert "the 2048 words of each of a row's 24 pixels" in str(error), error
else:
    sys.exit("words beyond the device were kept")
# a count takes 4 bytes
large = oitlab.scenes.blades(width=160, height=120, count=30)
for technique in ("wboit", "a_buffer", "mlab", "depth_peeling"):
    pair = [oitlab.render(large, technique, backend=backend) for backend in ("cpu", "gpu")]
    np.testing.assert_allclose(pair[0].color, pair[1].color, rtol=0, atol=1e-5)
    assert pair[0].stats.fragments == pair[1].stats.fragments
got, expected = oitlab.gpu.capture(large), oitlab.capture(large)
np.testing.assert_array_equal(got.offsets, expected.offsets)
np.testing.assert_array_equal(got.primitive, expected.primitive)
got, expected = (oitlab.render(expected, "mlab", backend=backend) for backend in ("gpu", "cpu"))
np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=1e-5)
wall = [((-99, -99, 0), (99, -99, 0), (0, 99, 0))] * 20
mesh = oitlab.Mesh(np.reshape(wall, (-1, 3)), np.arange(60).reshape(-1, 3), color=(1, 1, 1, 0.5))
deep = oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=64, height=4)
try:
    oitlab.render(deep, "a_buffer", backend="gpu")
except MemoryError as error:
    assert "1280 fragments of row 0" in str(error), error
else:
    sys.exit("fragments beyond the device were kept")
"""


def with_environment(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_what_does_not_fit_into_buffers_is_drawn_in_parts() -> None:
    done = with_environment(SMALL_BUFFERS, OITLAB_GPU_BUFFER_BYTES="16384")
    assert done.returncode == 0, done.stderr


def test_a_device_that_is_not_there_is_an_error_that_helps() -> None:
    code = "import oitlab; oitlab.gpu.info()"
    done = with_environment(code, WGPU_ADAPTER_NAME="no such adapter")
    assert 'RuntimeError: backend "gpu": no adapter\'s name contains' in done.stderr
    assert DEVICE is not None
    assert DEVICE.adapter in done.stderr
    no_driver = {"VK_ICD_FILENAMES": os.devnull, "VK_DRIVER_FILES": os.devnull, "WGPU_BACKEND": "vulkan"}
    done = with_environment(code, **no_driver)
    assert 'RuntimeError: backend "gpu": no adapter' in done.stderr
    assert "apt-get install mesa-vulkan-drivers" in done.stderr
    for names in ("nonsense", "vulkan,nonsense", ""):
        done = with_environment(code, WGPU_BACKEND=names)
        assert f'the environment has WGPU_BACKEND="{names}"; allowed are, between commas, ' in done.stderr
    arguments = ["compare", "scene:squares", "--backend", "gpu"]
    command = f"import oitlab.cli; raise SystemExit(oitlab.cli.main({arguments}))"
    done = with_environment(command, WGPU_BACKEND="nonsense")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith('oitlab: error: backend "gpu": the environment has')
    done = with_environment(code, OITLAB_GPU_BUFFER_BYTES="many")
    assert 'OITLAB_GPU_BUFFER_BYTES="many" is not a number of bytes' in done.stderr


@pytest.mark.parametrize(
    ("technique", "params", "keywords", "message"),
    [
        ("mlab", {"layers": 33}, {}, "layers is at most 32"),
        ("mlab", {"format": "f16"}, {}, "nodes of other formats than f32"),
        ("multilayer_depth_peeling", {"mode": "bucket"}, {}, 'mode="bucket" has no form'),
        ("wboit", {"summation": "scaled"}, {}, 'wboit: summation="scaled" has no form on the backend "gpu"'),
        ("wboit", {"format": "bf16"}, {}, 'accumulation_format="bf16"'),
        ("blended_oit", {"accumulation_format": "f64"}, {"threads": 2}, 'is one of "f32", "f16"'),
        ("a_buffer", {"overflow": "tail_blend", "capacity": 33}, {}, "there capacity is at most 32"),
        (
            "alpha_compositing",
            {"submission_order": "sorted"},
            {},
            'submission_order="sorted" sorts fragments',
        ),
        ("wboit", {"near": 5.0, "far": 1.0, "weight": "mb10"}, {}, "near must be less than far"),
        ("wboit", {}, {"dtype": "float64"}, "computes in single precision"),
        ("wboit", {}, {"diagnostics": True}, 'numbers are watched on backend "cpu"'),
    ],
)
def test_what_the_device_does_not_do_is_refused_by_name(
    technique: str, params: dict[str, Any], keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.render(SCENES["blades"], technique, params, backend="gpu", **keywords)


def test_sums_beyond_single_precision_are_read_as_on_the_cpu() -> None:
    bright = oitlab.Fragments(
        width=1,
        height=1,
        offsets=[0, 40],
        depth=np.linspace(1, 2, 40),
        color=[(1e38, 1.0, 0.0)] * 40,
        alpha=[1e-3] * 40,
        background=(0.5, 0.5, 0.5),
    )
    for technique in ("weighted_sum", "weighted_average", "blended_oit", "wboit", "phenomenological"):
        got, expected = (oitlab.render(bright, technique, backend=backend) for backend in ("gpu", "cpu"))  # type: ignore[arg-type]
        # coverage, 0.04, is what 40 factors leave of 1 in f32
        rounding = (40 + ROUNDINGS) * 2 * F32 / 0.04
        np.testing.assert_allclose(got.color, expected.color, rtol=rounding)


def test_what_is_no_scene_is_not_captured() -> None:
    with pytest.raises(ValueError, match="scene must be a Scene, got int"):
        oitlab.gpu.capture(3)  # type: ignore[arg-type]


def test_images_beyond_the_device_are_refused() -> None:
    assert DEVICE is not None
    side = DEVICE.limits["image_side"] + 1
    if side > 16_384:
        pytest.skip(f"no image has {side} pixels along a side")
    with pytest.raises(ValueError, match=f"width: {side} is more than"):
        oitlab.render(SCENES["empty"].replace(width=side, height=1), "wboit", backend="gpu")


def test_the_command_line_compares_on_the_gpu(capsys: pytest.CaptureFixture[str]) -> None:
    from oitlab.cli import main

    size = ["--width", "32", "--height", "18"]
    assert main(["compare", "scene:blades", "--backend", "gpu", "--techniques", "wboit,a_buffer", *size]) == 0
    assert "cpu; techniques on the gpu" in capsys.readouterr().out


def test_a_fork_is_told_to_be_spawned() -> None:
    code = """
import os, oitlab
scene = oitlab.scenes.squares(width=16, height=9)
oitlab.render(scene, "wboit", backend="gpu")
child = os.fork()
if child == 0:
    try:
        oitlab.render(scene, "wboit", backend="gpu")
    except RuntimeError as error:
        os._exit(3 if "spawn" in str(error) else 4)
    os._exit(5)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_memory_is_as_fast_as_memory_is() -> None:
    """Some GB/s on a processor, some TB/s on a card."""
    assert 1e8 < oitlab.gpu.copy_bandwidth() < 1e15
