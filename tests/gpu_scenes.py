"""The device, if there is one, and scenes on which backends are compared."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import oitlab
from backends import DEVICE as DEVICE
from backends import F32 as F32
from backends import WHY_NOT as WHY_NOT

SIZE = {"width": 64, "height": 48}

# Sums and products of n fragments are rounded n times; sixteen more roundings are those of weights, the
# resolve and its division. Errors are relative to the largest colour, which is the sums' scale.
ROUNDINGS = 16
# Depths agree to the bit but for one in thousands, which is one unit in its last place off: two f32 hold 40
# digits of the depth function, of which 24 are kept.
SHARE_OF_EQUAL_DEPTHS = 0.999
# A pixel that the snapped outline of a clipped triangle covers may lie a hair outside the triangle, where CPU
# and GPU keep within its rim each in its own way.
CLIPPED_DEPTH = 1e-4
# Weights of corners are linear functions in f32.
VARYING_COLOR = 2e-5


def mesh_of(corners: Any, rng: np.random.Generator, **material: Any) -> oitlab.Mesh:
    """Make unconnected triangles of (n, 3, 3) corners, each with a colour of its own."""
    corners = np.asarray(corners, np.float64)
    colors = rng.random((len(corners), 4)) * (1, 1, 1, 0.9)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return oitlab.Mesh(corners.reshape(-1, 3), faces, face_colors=colors, **material)


def smooth(corners: Any, rng: np.random.Generator, **material: Any) -> oitlab.Mesh:
    """Make triangles whose colours vary from corner to corner."""
    vertices = np.asarray(corners, np.float64).reshape(-1, 3)
    colors = rng.random((len(vertices), 4))
    return oitlab.Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), vertex_colors=colors, **material)


def around(rng: np.random.Generator, count: int, spread: float, size: float) -> Any:
    return rng.uniform(-spread, spread, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))


PERSPECTIVE = oitlab.Camera(eye=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), fov_y=50.0, near=0.5, far=12.0)
ORTHOGRAPHIC = oitlab.Camera(
    eye=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), ortho_height=4.0, near=0.5, far=12.0
)


def scene_of(*meshes: oitlab.Mesh, camera: oitlab.Camera = PERSPECTIVE, **size: int) -> oitlab.Scene:
    return oitlab.Scene(list(meshes), camera=camera, background=(0.2, 0.3, 0.1), **(SIZE | size))


def scenes() -> Iterator[tuple[str, oitlab.Scene]]:
    yield "squares", oitlab.scenes.squares(**SIZE)
    yield "smoke", oitlab.scenes.smoke(**SIZE, count=120)
    yield "soup", oitlab.scenes.soup(**SIZE, count=4000)
    yield "blades", oitlab.scenes.blades(**SIZE, count=120)
    yield "shells", oitlab.scenes.shells(**SIZE, subdivisions=3)
    yield "torus_knot", oitlab.scenes.torus_knot(**SIZE, segments=80, sides=12)
    rng = np.random.default_rng(7)
    yield "random", scene_of(mesh_of(around(rng, 300, 2.0, 1.0), rng))
    yield "orthographic", scene_of(mesh_of(around(rng, 300, 2.0, 1.0), rng), camera=ORTHOGRAPHIC)
    # three corners all but on a line
    slivers = around(rng, 400, 2.0, 1.5)
    slivers[:, 2] = slivers[:, 0] * 0.4 + slivers[:, 1] * 0.6 + rng.uniform(-0.01, 0.01, (400, 3))
    yield "slivers", scene_of(mesh_of(slivers, rng))
    # through the near plane and behind the eye, and far beyond the guard band
    yield "near plane", scene_of(mesh_of(around(rng, 120, 2.0, 8.0), rng))
    huge = around(rng, 60, 2.0, 2.0)
    huge[:, 1] *= (3e5, 2e4, 1)
    yield "guard band", scene_of(mesh_of(huge, rng), camera=ORTHOGRAPHIC)
    # within f32's digits, but beyond the viewport
    wide = around(rng, 60, 2.0, 2.0)
    wide[:, 1] *= (30, 20, 1)
    yield "wide", scene_of(mesh_of(wide, rng))
    yield "smooth", scene_of(smooth(around(rng, 80, 1.5, 1.5), rng))
    yield "clipped and smooth", scene_of(smooth(around(rng, 80, 2.0, 8.0), rng))
    masked = smooth(around(rng, 60, 1.5, 1.5), rng, alpha_mode="mask", alpha_cutoff=0.4)
    yield "masked", scene_of(masked, smooth(around(rng, 60, 1.5, 1.5), rng, shading="lambert"))
    solid = mesh_of(around(rng, 30, 1.0, 1.5), rng, alpha_mode="opaque", shading="lambert")
    yield "opaque", scene_of(solid, masked, mesh_of(around(rng, 200, 2.0, 1.0), rng))
    yield "empty", scene_of()


PARAMS: dict[str, dict[str, Any]] = {"avsm": {"nodes_format": "f32"}}
"""What techniques need besides their defaults to have a form."""

# Moments are solved for in single precision, which amplifies the rounding of their sums where depths all but
# coincide: a tenth of what M18's implementations differ by for nearly all pixels, and a fifth of it at worst.
CONFORMS = {"mboit_power": (2e-4, 2e-2), "mboit_trig": (2e-4, 2e-2)}
# Shares of pixels where rounding does not change what a technique decides: which of two centres is nearer,
# whether a vertex lies within eps, how many samples an alpha covers that the device has interpolated.
DECIDING = {
    "density_clustering": 0.99,
    "deep_shadow_maps": 0.99,
    "screen_door": 0.999,
    "slab": 0.999,
    "stochastic_transparency": 0.999,
}

SCENES = dict(scenes()) if DEVICE else {}
CLIPPED = ("near plane", "guard band", "clipped and smooth")


def tolerance(scene: oitlab.Scene, expected: oitlab.Frame) -> float:
    """Bound the rounding of f32 sums over the deepest pixel."""
    scale = max(1.0, float(np.abs(expected.color).max()))
    return (expected.stats.depth_complexity_max + ROUNDINGS) * 2 * F32 * scale
