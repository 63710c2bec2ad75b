"""Arguments of the wrong kind: a ValueError that names the argument, what was given and what is allowed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import oitlab
from oitlab.scenes import SCENES

POINTS = [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]
MASKED = np.ma.masked_greater(np.array(POINTS, float), 0.5)
ONE_PIXEL: dict[str, Any] = {
    "width": 1,
    "height": 1,
    "offsets": [0, 1],
    "depth": [1.0],
    "color": [(0.5, 0, 0)],
    "alpha": [0.5],
    "background": (0, 0, 0),
}


def mesh(vertices: Any = POINTS, **keywords: Any) -> oitlab.Mesh:
    return oitlab.Mesh(vertices, [(0, 1, 2)], **keywords)


def scene(meshes: Any = (), **keywords: Any) -> oitlab.Scene:
    return oitlab.Scene(meshes, **{"camera": oitlab.Camera(), "width": 4, "height": 3, **keywords})


def render(*arguments: Any, **keywords: Any) -> oitlab.Frame:
    return oitlab.render(scene(), *(arguments or ("wboit",)), **keywords)


def many(variants: Any) -> list[oitlab.Frame]:
    return oitlab.render_many(scene(), variants)


def fragments(**changes: Any) -> oitlab.Fragments:
    return oitlab.Fragments(**{**ONE_PIXEL, **changes})


def curve(technique: Any = "a_buffer", **keywords: Any) -> oitlab.Transmittance:
    return oitlab.transmittance(fragments(), technique, **{"pixel": (0, 0), **keywords})


def sensitivity(**keywords: Any) -> Any:
    return oitlab.order_sensitivity(fragments(), "a_buffer", **keywords)


CASES: list[tuple[Callable[[], Any], str]] = [
    (lambda: mesh(alpha_mode=None), "alpha_mode must be one of 'blend', 'opaque', 'mask', got None"),
    (lambda: mesh(alpha_mode="glass"), "alpha_mode must be one of 'blend', 'opaque', 'mask', got 'glass'"),
    (lambda: mesh(shading=1), "shading must be one of 'unlit', 'lambert', got 1"),
    (lambda: mesh(shading=["unlit"]), "shading must be one of"),
    (lambda: mesh(double_sided="no"), "double_sided must be True or False, got 'no'"),
    (lambda: mesh(double_sided=None), "double_sided must be True or False, got None"),
    (lambda: mesh(MASKED), "vertices has masked values"),
    (lambda: mesh(list(MASKED)), "vertices has masked values"),
    (lambda: mesh(opacity=np.ma.masked), "opacity must be a number, got masked"),
    (lambda: scene(None), "meshes must be an iterable of Mesh, got NoneType"),
    (lambda: scene(mesh()), "meshes must be an iterable of Mesh, got Mesh"),
    (lambda: scene(width=True), "width must be an integer, got True"),
    (lambda: scene(height=False), "height must be an integer, got False"),
    (lambda: scene(width=2**63), r"width must be less than 2\*\*63, got 9223372036854775808"),
    (lambda: scene(width=2**62), "width"),
    (lambda: scene(width=np.float64(4)), "width must be an integer"),
    (lambda: fragments(height=2**64), "height must be less than"),
    (lambda: fragments(width="wide"), "width must be an integer, got 'wide'"),
    (lambda: fragments(background=[[0], [0, 1]]), "background is not a regular array"),
    (lambda: fragments(depth=np.ma.array([1.0], mask=True)), "depth has masked values"),
    (lambda: render(threads=2**63), "threads must be less than"),
    (lambda: render(threads=True), "threads must be an integer, got True"),
    (lambda: render(skip="no"), "skip must be True or False, got 'no'"),
    (lambda: render(diagnostics=None), "diagnostics must be True or False, got None"),
    (lambda: render(dtype=None), "dtype must be 'float32' or 'float64', got None"),
    (lambda: render("wboit", {3: 4}), "params of 'wboit' must have names for keys, got 3"),
    (lambda: many(None), r"variants must be an iterable of ids or \(id, params\), got None"),
    (lambda: many("wboit"), "variants must be an iterable .*, got 'wboit'"),
    (lambda: many([None]), "a variant is a technique id"),
    (lambda: oitlab.capture(scene(), threads=2**70), "threads must be less than"),
    (lambda: curve(None), "named by its id, got None"),
    (lambda: curve(params={None: 1}), "params of 'a_buffer' must have names for keys, got None"),
    (lambda: curve(pixel=None), r"pixel must be a pair \(x, y\), got None"),
    (lambda: curve(pixel=(0, 0.5)), "pixel y must be an integer, got 0.5"),
    (lambda: curve(pixel=(2**70, 0)), "pixel: .* is not in the image of 1 x 1"),
    (lambda: sensitivity(n=2**63), "n must be less than"),
    (lambda: sensitivity(seed=2**64), r"seed must be less than 2\*\*64"),
]


@pytest.mark.parametrize(("call", "message"), CASES, ids=range(len(CASES)))
def test_wrong_kinds_are_refused_by_name(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


WRONG: list[dict[str, Any]] = [{"seed": "one"}, {"seed": None}, {"alpha": "half"}, {"width": True}]


@pytest.mark.parametrize(
    ("name", "change"),
    # smoke chooses its alphas itself
    [(name, change) for name in SCENES for change in WRONG if (name, *change) != ("smoke", "alpha")],
)
def test_wrong_arguments_of_scenes(name: str, change: dict[str, Any]) -> None:
    small = {"segments": 8} if name == "torus_knot" else {"count": 2}
    with pytest.raises(ValueError, match=next(iter(change))):
        SCENES[name](**{"width": 4, "height": 3, **small, **change})


def test_numpys_scalars_are_of_the_right_kind() -> None:
    given = scene([mesh(double_sided=np.True_)], width=np.int64(4))
    assert given == scene([mesh()])
    assert oitlab.render(given, "wboit", skip=np.False_, threads=np.uint8(1)).stats.threads == 1
    np.testing.assert_array_equal(sensitivity(n=2, seed=2**64 - 1), [[0.0]])


def test_a_mask_that_masks_nothing_is_let_pass() -> None:
    assert mesh(np.ma.array(POINTS, float)) == mesh()
