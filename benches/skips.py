"""What a scene does not need should not be paid for: times relative to the same smoke filling the image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from harness import Run, markdown_table, scene, three_digits, timed

import oitlab
from oitlab.rendering import Variant

TECHNIQUES = ("wboit", "lwboit", "a_buffer")
SHARE = 0.05
FURTHER: dict[str, tuple[Variant, ...]] = {
    "another weight": tuple(("wboit", {"weight": weight}) for weight in ("mb8", "mb9", "mb10")),
    "another blended technique": ("weighted_sum", "weighted_average", "blended_oit"),
    "the same again": ("wboit",) * 3,
}
"""What `render_many` is asked for beside wboit."""
LISTS: tuple[Variant, ...] = ("mlab", "k_buffer", "hybrid_transparency", "a_buffer")
"""Techniques that share lists and their sorting."""


def scenes(run: Run) -> dict[str, oitlab.Scene]:
    """The full scene, and what can be skipped in turn."""
    full = scene("smoke", run)
    (mesh,) = full.meshes
    behind = mesh.vertices[:, 2].min()
    wide = full.camera.replace(near=0.5)
    wall = _sheet(full, depth=0.99, alpha_mode="opaque")
    layer = _sheet(full, depth=float(full.camera.eye[2] - behind), alpha_mode="blend")
    return {
        "full": full,
        "empty": full.replace(meshes=[]),
        "5 % transparent": full.replace(meshes=[_rebuilt(mesh, _shrunk(full))]),
        "hidden behind a wall": full.replace(meshes=[mesh, wall], camera=wide),
        "single layer": full.replace(meshes=[layer], camera=wide),
        "uniform colour": full.replace(meshes=[_rebuilt(mesh, color=(0.6, 0.4, 0.2, 0.1))]),
        "lit (lambert)": full.replace(meshes=[_rebuilt(mesh, shading="lambert")]),
    }


def _rebuilt(
    mesh: oitlab.Mesh, vertices: Any = None, color: Any = None, shading: str = "unlit"
) -> oitlab.Mesh:
    colors = mesh.colors if color is None else np.tile(np.float32(color), (len(mesh.faces), 1))
    where = mesh.vertices if vertices is None else vertices
    return oitlab.Mesh(where, mesh.faces, face_colors=colors, shading=shading)


def _shrunk(full: oitlab.Scene) -> Any:
    """The same layers clustered around the image's centre, in about 5 % of its fragments."""
    vertices = full.meshes[0].vertices.copy()
    vertices[:, :2] *= np.sqrt(SHARE)
    return vertices


def _sheet(full: oitlab.Scene, depth: float, alpha_mode: Any) -> oitlab.Mesh:
    """A camera-facing rectangle over the whole image; `depth` units before the eye."""
    half_height = 1.01 * depth * np.tan(np.radians(full.camera.fov_y / 2))
    half_width = half_height * full.width / full.height
    x, y = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]).T
    corners = np.column_stack([half_width * x, half_height * y, np.full(4, full.camera.eye[2] - depth)])
    colors = [(0.5, 0.5, 0.5, 0.5)] * 2
    return oitlab.Mesh(corners, [(0, 1, 2), (0, 2, 3)], face_colors=colors, alpha_mode=alpha_mode)


def extra_variants(run: Run) -> dict[str, Any]:
    """Cost of each further variant of `render_many` as a share of one wboit render, and what lists share."""
    found = {}
    for name in ("smoke", "soup", "shells"):
        what = scene(name, run)
        calls: dict[str, Callable[[], Any]] = {"wboit": lambda w=what: oitlab.render(w, "wboit")}
        for kind, more in FURTHER.items():
            calls[kind] = lambda w=what, m=more: oitlab.render_many(w, ["wboit", *m])
        calls["lists together"] = lambda w=what: oitlab.render_many(w, LISTS)
        for technique in LISTS:
            calls[f"{technique} alone"] = lambda w=what, t=technique: oitlab.render(w, t)
        times = {call: row["median_ms"] for call, row in timed(calls, run.repeats).items()}
        one = times["wboit"]
        alone = sum(times[f"{technique} alone"] for technique in LISTS)
        found[name] = {
            "wboit_ms": one,
            "share_per_variant": {k: (times[k] - one) / len(more) / one for k, more in FURTHER.items()},
            "lists_together_over_alone": times["lists together"] / alone,
        }
    return found


def main(run: Run) -> None:
    """Measure, and write skips.json and skips.md."""
    results: dict[str, Any] = {}
    for name, what in scenes(run).items():
        calls = {
            f"{t} {'skip' if skip else 'full work'}": lambda w=what, t=t, s=skip: oitlab.render(w, t, skip=s)
            for t in TECHNIQUES
            for skip in (True, False)
        }
        stats = oitlab.render(what, "a_buffer").stats
        results[name] = {"fragments": stats.fragments, "threads": stats.threads, "skipped": stats.skipped,
                         "times": timed(calls, run.repeats)}  # fmt: skip
    variants = extra_variants(run)
    run.save("skips", {"scenes": results, "extra_variants": variants}, tables(results, variants))


def tables(results: dict[str, Any], variants: dict[str, Any]) -> str:
    """Times as shares of the full scene's, and the cost of further variants."""
    rows = []
    for name, row in results.items():
        cells = [name, f"{row['fragments']:,}"]
        for t in TECHNIQUES:
            full = results["full"]["times"][f"{t} skip"]["median_ms"]
            with_skip, without = (row["times"][f"{t} {how}"]["median_ms"] for how in ("skip", "full work"))
            cells.append(f"{three_digits(with_skip)} ({with_skip / full:.0%}; {without / full:.0%})")
        rows.append(cells)
    shares = [
        [name, three_digits(row["wboit_ms"]), *(f"{row['share_per_variant'][kind]:.0%}" for kind in FURTHER),
         f"{row['lists_together_over_alone']:.0%}"] for name, row in variants.items()
    ]  # fmt: skip
    return "\n\n".join(
        [
            "Milliseconds; in brackets the share of the full scene's time, then the same with skip=False.",
            markdown_table(["scene", "fragments", *TECHNIQUES], rows),
            "What each further variant of `render_many` costs beside wboit, as a share of one wboit; then "
            f"the time of {', '.join(map(str, LISTS))} in one call over the sum of their own.",
            markdown_table(["scene", "wboit ms", *FURTHER, "lists"], shares),
        ]
    )
