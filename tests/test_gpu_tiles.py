"""The raster in compute against the device's own: the same pixels, and the same images but for rounding."""

import re
import time
from typing import Any

import numpy as np
import pytest

import oitlab
from gpu_scenes import (
    CLIPPED,
    CONFORMS,
    DECIDING,
    DEVICE,
    F32,
    PARAMS,
    PERSPECTIVE,
    ROUNDINGS,
    SCENES,
    VARYING_COLOR,
    WHY_NOT,
    around,
    mesh_of,
    scene_of,
    tolerance,
)
from test_gpu import with_environment
from test_promises import bounds, off, values_of

pytestmark = pytest.mark.skipif(DEVICE is None, reason=WHY_NOT)

BLENDED = (
    "alpha_compositing",
    "painter",
    "weighted_sum",
    "weighted_average",
    "blended_oit",
    "wboit",
    "phenomenological",
)
LAYERED = (
    "mlab",
    "k_buffer",
    "multilayer_depth_peeling",
    "z3",
    "mlcb",
    "adaptive_transparency",
    "hybrid_transparency",
    "avsm",
)
STREAMED = (
    *LAYERED,
    "mlab_buckets",
    "a_buffer",
    "slab",
    "stochastic_transparency",
    "screen_door",
    "alpha_testing",
)
TWO_PASS = (
    "opacity_shadow_maps",
    "deep_opacity_maps",
    "occupancy_maps",
    "fourier_opacity_maps",
    "tfm",
    "wavelet",
    "mboit_power",
    "mboit_trig",
)
OTHERS = ("lwboit", "depth_peeling", "dual_depth_peeling", "continuum", "gs_wsr")
# what looks at all fragments of a pixel at once, in lists that tiles fill
LISTED = ("density_clustering", "deep_shadow_maps")
TILED = (*BLENDED, *STREAMED, *TWO_PASS, *OTHERS, *LISTED)


def test_every_technique_runs_in_tiles() -> None:
    assert {entry.id for entry in oitlab.techniques()} == set(TILED)


@pytest.mark.parametrize(
    ("technique", "params"),
    [
        ("gs_wsr", {"variant": "linear"}),
        ("gs_wsr", {"variant": "exp", "sigma": 0.3}),
        ("slab", {"replay": "as_is"}),
        ("depth_peeling", {"passes": 3, "early_out": True}),
        ("dual_depth_peeling", {"passes": 2}),
        ("multilayer_depth_peeling", {"layers": 20, "passes": 3}),
        ("lwboit", {"storage": "ll", "range": "pixel"}),
        ("stochastic_transparency", {"mode": "depth", "correction": "alpha", "samples": 40}),
        ("slab", {"variant": "alpha", "accumulate": "stored", "layers": 2}),
        ("screen_door", {"samples": 1000}),
        ("avsm", {"nodes_format": "f32", "thickness": 0.2, "composite": "normalize"}),
        ("wavelet", {"range": "pixel"}),
        ("continuum", {"merge": "smallest_error", "accumulate": "all"}),
        ("continuum", {"opacity": "coverage", "insertion": "stochastic", "merge": "discard_furthest"}),
    ],
)
def test_params_in_tiles_are_those_of_the_cpu(technique: str, params: dict[str, Any]) -> None:
    for name in ("squares", "blades"):
        scene = SCENES[name]
        got = oitlab.gpu.render(scene, technique, params, path="compute")
        expected = oitlab.render(scene, technique, params)
        # exponentials of depths, and sums of bins
        limit = (8 if technique in ("gs_wsr", "lwboit") else 1) * tolerance(scene, expected)
        # nodes as good as each other may change roles where depths are a unit in the last place apart
        share = 1.0 if name == "squares" else 0.999
        assert (np.abs(got.color - expected.color).max(axis=-1) <= limit).mean() >= share


@pytest.mark.parametrize("technique", TILED)
def test_under_every_param_tiles_do_what_the_other_raster_does(technique: str) -> None:
    scene = oitlab.scenes.squares(width=70, height=9)  # in two bins
    compared = 0
    for param in oitlab.techniques()[technique].params:
        for value in values_of(param):
            params = {param.name: value}
            try:
                expected = oitlab.gpu.render(scene, technique, params)
            except (ValueError, MemoryError):
                continue
            got = oitlab.gpu.render(scene, technique, params, path="compute")
            distance = off(got, expected.color, expected.transmittance)
            most, worst, share = bounds(technique, params)
            assert distance.max() <= worst, (params, distance.max())
            assert (distance <= most).mean() >= share, params
            compared += 1
    assert compared >= 2


@pytest.mark.parametrize("path", ["compute", "linked_lists"])
def test_passes_that_follow_each_other_say_how_long_they_took(path: str) -> None:
    """Stamps of compute passes may miss most of their time: then the clock on the wall has to do."""
    scene = oitlab.scenes.soup(width=480, height=270, count=20_000)
    for _ in range(2):  # the first call compiles
        start = time.perf_counter()
        stats = oitlab.gpu.render(scene, "deep_shadow_maps", path=path).stats  # type: ignore[arg-type]
        whole = 1e3 * (time.perf_counter() - start)
    assert 0.1 * whole < stats.raster_ms + stats.resolve_ms < whole
    assert min(stats.raster_ms, stats.resolve_ms) > 0


LISTS: list[tuple[str, dict[str, Any]]] = [
    ("density_clustering", {"bins": 3}),
    ("deep_shadow_maps", {"eps": 0.05}),
    ("deep_shadow_maps", {"vertices": 5, "composite": "normalize"}),
    ("tfm", {"project": "transmittance", "range": "pixel"}),
    ("continuum", {"memory": "unbounded", "merge": "none"}),
    ("continuum", {"memory": "samples", "merge": "discard_occluded", "opacity": "coverage"}),
    ("continuum", {"memory": "bins", "merge": "sum", "accumulate": "all"}),
    ("continuum", {"memory": "bins", "merge": "discard_occupied", "insertion": "stochastic"}),
]


@pytest.mark.parametrize(("technique", "params"), LISTS)
def test_lists_that_tiles_fill_are_those_of_the_other_raster(technique: str, params: dict[str, Any]) -> None:
    """The same kernels look at them, so that images agree to the bit."""
    for name in ("squares", "smoke", "soup", "near plane", "opaque", "empty"):
        scene = SCENES[name]
        for order in ("as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"):
            ordered = {"submission_order": order, "seed": 3} if technique == "continuum" else {}
            got, expected = on_paths(scene, technique, params | ordered)
            np.testing.assert_array_equal(got.color, expected.color, err_msg=f"{name} {order}")
            np.testing.assert_array_equal(got.transmittance, expected.transmittance)
            if not ordered:
                break


def on_paths(
    scene: oitlab.Scene, technique: str, params: dict[str, Any] | None = None
) -> tuple[oitlab.Frame, oitlab.Frame]:
    compute = oitlab.gpu.render(scene, technique, params, path="compute")
    return compute, oitlab.gpu.render(scene, technique, params)


def agree(
    scene: oitlab.Scene, technique: str, params: dict[str, Any] | None = None, factor: float = 1.0
) -> oitlab.Frame:
    got, expected = on_paths(scene, technique, params)
    limit = factor * tolerance(scene, expected)
    np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)
    np.testing.assert_allclose(got.transmittance, expected.transmittance, rtol=0, atol=limit)
    assert got.stats.fragments == expected.stats.fragments
    return got


@pytest.mark.parametrize("technique", TILED)
@pytest.mark.parametrize("name", SCENES)
def test_images_are_those_of_the_other_path_and_of_the_cpu(name: str, technique: str) -> None:
    scene, params = SCENES[name], PARAMS.get(technique, {})
    if technique in CONFORMS:  # a product is added in one step or in two, which moments amplify
        try:
            got = oitlab.gpu.render(scene, technique, params, path="compute")
        except RuntimeError as error:
            # one invocation solves for all of a pixel's fragments
            if name != "shells" or "ends loops before they are done" not in str(error):
                raise
            return
    else:
        # of bins that are blended by weights, those may be summed up another way than where they are layers
        got = agree(scene, technique, params, factor=16 if technique == "lwboit" else 1)
    expected = oitlab.render(scene, technique, params)
    varies = 4 * VARYING_COLOR if name in (*CLIPPED, "smooth", "masked") else 0.0
    limit = tolerance(scene, expected) + varies
    most, worst = CONFORMS.get(technique, (limit, limit))
    share = DECIDING.get(technique, 0.95 if technique in CONFORMS else 1.0)
    off = np.abs(got.color - expected.color).max(axis=-1)
    assert (off <= most).mean() >= share, (off.max(), most)
    assert technique in DECIDING or off.max() <= worst, off.max()
    assert (got.technique, got.params, got.scene_hash) == (
        expected.technique,
        expected.params,
        expected.scene_hash,
    )


@pytest.mark.parametrize("name", SCENES)
def test_coverage_is_that_of_the_cpu(name: str) -> None:
    """A fragment of weight one each: the sum of alphas counts fragments where each has the alpha 2^-12."""
    scene = SCENES[name]
    faint = [oitlab.Mesh(m.vertices, m.faces, color=(1, 1, 1, 2.0**-12)) for m in scene.meshes]
    counted = oitlab.Scene(
        faint, camera=scene.camera, width=scene.width, height=scene.height, background=(0, 0, 0)
    )
    got = oitlab.gpu.render(counted, "weighted_sum", path="compute")
    counts = np.diff(oitlab.capture(counted).offsets).reshape(scene.height, scene.width)
    np.testing.assert_array_equal(got.color[..., 0] * 2**12, counts)
    np.testing.assert_array_equal((1 - got.transmittance) * 2**12, counts)


@pytest.mark.parametrize("order", ["as_is", "reversed", "shuffled", "centroid", "sorted", "back_to_front"])
@pytest.mark.parametrize("technique", ["alpha_compositing", "mlab", "k_buffer", "z3", "mlab_buckets", "mlcb"])
def test_orders_of_primitives_are_those_of_the_cpu(technique: str, order: str) -> None:
    scene = SCENES["blades" if technique == "alpha_compositing" else "squares"]
    params = {"submission_order": order, "seed": 3}
    got = oitlab.gpu.render(scene, technique, params, path="compute")
    expected = oitlab.render(scene, technique, params)
    assert np.abs(got.color - expected.color).max() <= tolerance(scene, expected)


@pytest.mark.parametrize("technique", LAYERED)
def test_any_number_of_layers_is_kept(technique: str) -> None:
    least = {"avsm": 2, "adaptive_transparency": 2}
    for layers in (least.get(technique, 1), 3, 5, 32):
        agree(SCENES["squares"], technique, PARAMS.get(technique, {}) | {"layers": layers})


@pytest.mark.parametrize("layout", ["listing3", "listing4", "monochrome"])
@pytest.mark.parametrize("weight", ["mb7", "inv_pow"])
def test_every_layout_has_registers(layout: str, weight: str) -> None:
    agree(SCENES["opaque"], "wboit", {"layout": layout, "weight": weight})
    agree(SCENES["opaque"], "phenomenological", {"transmission": (0.9, 0.5, 0.0)})


def test_hundreds_of_primitives_in_a_tile_come_in_the_order_of_submission() -> None:
    """More than a chunk has room for, over images of parts of tiles and of bins."""
    rng = np.random.default_rng(4)
    scene = scene_of(mesh_of(around(rng, 3000, 2.0, 1.5), rng))
    for size in ((1, 1), (1, 300), (517, 3), (9, 8), (65, 129), (1100, 5)):
        sized = scene.replace(width=size[0], height=size[1])
        agree(sized, "alpha_compositing")
    assert len(np.unique(oitlab.capture(scene.replace(width=8, height=8)).primitive)) > 3 * 256


def test_large_images_are_drawn_in_parts() -> None:
    """Bins are of 64 pixels, of 128 where those would be too many, and in parts where these are."""
    rng = np.random.default_rng(8)
    scene = scene_of(mesh_of(around(rng, 40, 2.0, 1.0), rng))
    for size in ({"width": 1500, "height": 1500}, {"width": 4100, "height": 1100}):
        agree(scene.replace(**size), "weighted_sum")


EDGES = [
    # corners and edges on pixel centres, horizontal and vertical, of both windings
    [(0.5, 0.5), (8.5, 0.5), (0.5, 8.5)],
    [(8.5, 0.5), (0.5, 0.5), (0.5, 8.5)],
    [(8.5, 8.5), (0.5, 8.5), (8.5, 0.5)],
    [(16.5, 16.5), (24.5, 20.5), (16.5, 24.5)],
    [(32.5, 4.5), (40.5, 4.5), (36.5, 12.5)],
    [(32.5, 20.5), (40.5, 20.5), (36.5, 12.5)],
    # nothing, and hardly anything
    [(10.5, 30.5), (20.5, 30.5), (30.5, 30.5)],
    [(10.5, 40.5), (20.5, 40.505), (30.5, 40.51)],
]


def test_edges_belong_to_one_side() -> None:
    camera = oitlab.Camera(
        eye=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), ortho_height=48.0, near=0.5, far=12.0
    )
    corners = np.array([[(x - 32, 24 - y, 0.0) for x, y in triangle] for triangle in EDGES])
    mesh = oitlab.Mesh(
        corners.reshape(-1, 3), np.arange(3 * len(EDGES)).reshape(-1, 3), color=(1, 1, 1, 2.0**-12)
    )
    scene = scene_of(mesh, camera=camera).replace(background=(0, 0, 0))
    got = oitlab.gpu.render(scene, "weighted_sum", path="compute")
    counts = np.diff(oitlab.capture(scene).offsets).reshape(48, 64)
    np.testing.assert_array_equal(got.color[..., 0] * 2**12, counts)
    assert counts.sum() > 100


def test_calls_repeat_to_the_bit_and_say_how_long_they_took() -> None:
    scene = SCENES["soup"]
    first, again = (oitlab.gpu.render(scene, "k_buffer", path="compute") for _ in range(2))
    np.testing.assert_array_equal(first.color, again.color)
    assert first.stats.raster_ms > 0
    assert first.stats.backend == "gpu"


@pytest.mark.parametrize(
    ("technique", "params", "message"),
    [
        (
            "depth_peeling",
            {"color_format": "f16"},
            'color_format="f16", which registers are not in, has no form',
        ),
        ("wboit", {"format": "f16"}, 'accumulation_format="f16", which registers are not in, has no form'),
        (
            "opacity_shadow_maps",
            {"bins": 1024},
            "what keeps 1025 numbers of a pixel, more than 1024, has no form",
        ),
    ],
)
def test_what_registers_are_not_is_refused(technique: str, params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        oitlab.gpu.render(SCENES["blades"], technique, params, path="compute")


def test_paths_and_scenes_that_are_none_are_refused() -> None:
    known = '"hardware", "compute", "samples", "linked_lists"'
    with pytest.raises(ValueError, match=re.escape(f'path: "tiles"; known: {known}')):
        oitlab.gpu.render(SCENES["blades"], "wboit", path="tiles")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="scene must be a Scene, got int"):
        oitlab.gpu.render(3, "wboit")  # type: ignore[arg-type]


SMALL_BUFFERS = """
import numpy as np, oitlab
def both(scene):
    return [oitlab.gpu.render(scene, "weighted_sum", path=path).color for path in ("hardware", "compute")]
pane = [((-99, -99, 0), (99, -99, 0), (0, 99, 0))]
def panes(count):
    faces = np.arange(3 * count).reshape(-1, 3)
    mesh = oitlab.Mesh(np.reshape(pane * count, (-1, 3)), faces, color=(1, 1, 1, 0.125))
    return oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=40, height=100)
# 5 x 8 tiles in the first row of bins, 5 x 5 in the second: 4096 entries fit, those of both rows do not
np.testing.assert_allclose(*both(panes(70)), rtol=0, atol=1e-5)
in_a_row = "primitives in the tiles of a row"
in_rows = "the 400 primitives that reach into the 64 rows from 0 on"
for count, words in ((120, in_a_row), (400, in_rows)):
    try:
        both(panes(count))
    except MemoryError as problem:
        assert words in str(problem) and 'path="hardware"' in str(problem), problem
    else:
        raise SystemExit(f"{count} panes were drawn")
# 8 rows of 40 pixels under 70 panes have 22,400 fragments, and a buffer 1024
try:
    oitlab.gpu.render(panes(70), "deep_shadow_maps", path="compute")
except MemoryError as problem:
    assert "the 22400 fragments of rows 0 to 7" in str(problem), problem
else:
    raise SystemExit("70 panes were listed")
# a buffer has 146 of these primitives, each of the four rows of bins fewer
rng = np.random.default_rng(8)
centers = rng.uniform((-0.4, -2, -1), (0.4, 2, 1), (330, 1, 3))
corners = centers + rng.uniform(-0.2, 0.2, (330, 3, 3))
small = oitlab.Mesh(corners.reshape(-1, 3), np.arange(990).reshape(-1, 3), face_colors=rng.random((330, 4)))
flat = [(-9, -9, 0), (9, -9, 0), (0, -8, 0)]
few = oitlab.Mesh(flat, [(0, 1, 2)], color=(0, 0, 1, 1), alpha_mode="opaque")
scene = oitlab.Scene([small, few], camera=oitlab.Camera(eye=(0, 0, 5)), width=40, height=210)
assert len(np.unique(oitlab.capture(scene).primitive)) > 146
for technique, params in (
    ("weighted_sum", {}),  # targets
    ("alpha_compositing", {}),  # registers
    ("alpha_compositing", {"submission_order": "reversed"}),
    ("painter", {}),
    ("mlab", {"layers": 2, "submission_order": "shuffled", "seed": 3}),
    ("a_buffer", {}),
    ("a_buffer", {"overflow": "drop", "capacity": 2}),
    ("phenomenological", {"transmission": (0.9, 0.5, 0.0)}),  # transmittance per channel
    ("wboit", {"weight": "z - 1.5"}),  # some are no weights, which are counted
    ("deep_shadow_maps", {}),  # lists
    ("continuum", {"memory": "unbounded", "merge": "none", "submission_order": "shuffled", "seed": 3}),
):
    expected = oitlab.render(scene, technique, params)
    got = oitlab.gpu.render(scene, technique, params, path="compute")
    for image in ("color", "transmittance"):
        pair = [getattr(frame, image) for frame in (got, expected)]
        np.testing.assert_allclose(*pair, rtol=0, atol=1e-4, err_msg=technique)
    for name in ("fragments", "depth_complexity_max", "dropped", "invalid_weights"):
        assert getattr(got.stats, name) == getattr(expected.stats, name), (technique, name)
"""


def test_what_does_not_fit_into_buffers_is_drawn_in_parts_or_refused() -> None:
    done = with_environment(SMALL_BUFFERS, OITLAB_GPU_BUFFER_BYTES="16384")
    assert done.returncode == 0, done.stderr


def test_what_does_nothing_is_shown_to_whom_it_is_on_the_cpu() -> None:
    rng = np.random.default_rng(1)
    colors = rng.random((40, 4))
    colors[::2, 3] = 0
    corners = around(rng, 40, 1.0, 2.0)
    mesh = oitlab.Mesh(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3), face_colors=colors)
    scene = scene_of(mesh, camera=PERSPECTIVE)
    for technique in ("weighted_average", "blended_oit", "k_buffer", "multilayer_depth_peeling"):
        got = agree(scene, technique)
        expected = oitlab.render(scene, technique)
        limit = (expected.stats.depth_complexity_max + ROUNDINGS) * 2 * F32
        np.testing.assert_allclose(got.color, expected.color, rtol=0, atol=limit)


def test_what_overflows_can_still_be_hidden() -> None:
    """On this path also by alpha compositing, whose blend unit multiplies infinity by nothing."""
    pane = np.array([(-3.0, -2, 0), (3, -2, 0), (0, 4, 0)])
    glow = [
        oitlab.Mesh(pane - (0, 0, z), [(0, 1, 2)], color=(0, 0, 0, 0), emission=(3e38, 3e38, 3e38))
        for z in (2, 1, 0.5)
    ]
    wall = oitlab.Mesh(pane, [(0, 1, 2)], color=(0.5, 0.5, 0.5, 1.0))
    glass = oitlab.Mesh(pane - (0, 0, -1), [(0, 1, 2)], color=(0.1, 0.2, 0.3, 0.5))
    scene = scene_of(*glow, wall, glass)
    expected = oitlab.render(scene, "a_buffer").color
    for technique in ("alpha_compositing", "mlab", "multilayer_depth_peeling"):
        got = oitlab.gpu.render(scene, technique, path="compute").color
        np.testing.assert_allclose(got[24, 32], expected[24, 32], rtol=1e-6)
    for technique, params in (
        ("mlab", {"layers": 1}),
        ("depth_peeling", {}),
        ("dual_depth_peeling", {}),
        ("dual_depth_peeling", {"passes": 9}),
    ):
        got = oitlab.render(scene, technique, params, backend="gpu").color
        np.testing.assert_allclose(got[24, 32], expected[24, 32], rtol=1e-6)


def test_loops_that_a_driver_ends_are_an_error() -> None:
    corners = [((-9, -9, 0), (9, -9, 0), (0, 9, 0))] * 30
    mesh = oitlab.Mesh(np.reshape(corners, (-1, 3)), np.arange(90).reshape(-1, 3), color=(1, 1, 1, 0.5))
    scene = oitlab.Scene([mesh], camera=oitlab.Camera(eye=(0, 0, 5)), width=4, height=4)
    turns = "for (var i = 0; i < 4000; i++) { x += 0.5 * z; }"
    loop = f"fn weight(z: f32) -> f32 {{ var x = 0.0; {turns} return x; }}"
    expected = oitlab.render(scene, "wboit", {"weight": loop})
    problem = ""
    try:
        got = oitlab.gpu.render(scene, "wboit", {"weight": loop}, path="compute")
    except RuntimeError as error:
        problem = str(error)
    if problem:
        assert "ends loops before they are done" in problem
    else:  # a device without that limit
        assert np.abs(got.color - expected.color).max() <= 1e-5


def test_an_unknown_path_is_refused() -> None:
    with pytest.raises(ValueError, match="path: None; known:"):
        oitlab.gpu.render(SCENES["blades"], "wboit", path=None)  # type: ignore[arg-type]
