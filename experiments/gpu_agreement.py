"""How far the GPU backend is from the CPU backend, which is the definition: every technique with a form.

Coverage is compared fragment by fragment: the same primitives in the same pixels in the same order, and
their depths. Images are compared by their largest difference; what single precision explains is the bound
of the tests, 2 (n + 16) 2^-24 for n fragments in the deepest pixel. For targets of 16 and 8 bits the CPU's
images are those of its emulation; the share of channels that are one unit in the last place of the format
off at most is given, since drivers round halves and normalised numbers each in their own way.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from _study import CHECKOUT, Study, markdown_table, stop

import oitlab

SCENES = ("squares", "soup", "shells", "smoke", "blades")
MESHES = {"dragon": "scans/stanford_dragon_res2.ply", "engine": "cad/2CylinderEngine.glb"}
OPACITY = 0.35
SINGLE: dict[str, dict[str, Any]] = {"avsm": {"nodes_format": "f32"}}
"""Params under which the CPU keeps the numbers in single precision that decide what is merged."""
FORMATS = {"f16": 2.0**-11, "unorm8": 1 / 255, "unorm16": 1 / 65535}
"""A unit in the last place: of a number of halves relative to it, of a normalised one on its own."""
ROUNDINGS = 16
F32 = 2.0**-24


def main() -> None:
    """Compare, and write the tables."""
    study = Study.from_command_line("gpu_agreement", __doc__)
    try:
        info = oitlab.gpu.info()
    except RuntimeError as error:
        stop(str(error))
    size = (96, 54) if study.quick else (320, 180)
    sources = list(_sources(*size))
    coverage = {name: _coverage(source) for name, source in sources if isinstance(source, oitlab.Scene)}
    techniques = {
        entry.id: {name: _images(source, entry.id) for name, source in sources}
        for entry in oitlab.techniques()
        if entry.id in info.techniques
    }
    formats = _formats(sources)
    device = f"{info.adapter} ({info.kind}, {info.interface}; {info.driver} {info.driver_info})"
    results = {"device": device, "coverage": coverage, "techniques": techniques, "formats": formats}
    study.save({"size": size, **results}, _markdown(results))


def _sources(width: int, height: int) -> Iterator[tuple[str, oitlab.Scene | oitlab.Fragments]]:
    for name in SCENES:
        yield name, oitlab.scenes.SCENES[name](width=width, height=height)
    folder = Path(os.environ.get("OITLAB_DATA", CHECKOUT.parent / "shared" / "data"))
    for name, file in MESHES.items():
        if (folder / file).is_file():
            yield name, oitlab.load(folder / file, opacity=OPACITY, width=width, height=height)
    yield "random lists", _random_lists(width, height)


def _random_lists(width: int, height: int) -> oitlab.Fragments:
    """Make lists of up to 40 fragments, a sixth of them of one depth, over an image."""
    rng = np.random.default_rng(11)
    counts = rng.integers(0, 41, width * height)
    n = int(counts.sum())
    alpha = rng.random(n) ** 2
    depth = rng.uniform(1.0, 20.0, n)
    depth[rng.random(n) < 1 / 6] = 5.0
    return oitlab.Fragments(
        width=width,
        height=height,
        offsets=np.concatenate([[0], np.cumsum(counts)]),
        depth=depth.astype(np.float32),
        color=(rng.random((n, 3)) * alpha[:, None]).astype(np.float32),
        alpha=alpha.astype(np.float32),
        primitive=rng.permutation(n).astype(np.uint32),
        background=rng.random((height, width, 3)).astype(np.float32),
    )


def _coverage(scene: oitlab.Scene) -> dict[str, Any]:
    ours, theirs = oitlab.capture(scene), oitlab.gpu.capture(scene)
    same = np.array_equal(ours.offsets, theirs.offsets) and np.array_equal(ours.primitive, theirs.primitive)
    if not same:
        return {"fragments": len(ours), "same": False}
    steps = np.abs(ours.depth - theirs.depth) / np.spacing(ours.depth)
    return {
        "fragments": len(ours),
        "same": True,
        "depths_equal": float((steps == 0).mean()) if len(ours) else 1.0,
        "depths_off_ulp": float(steps.max(initial=0.0)),
    }


def _images(source: oitlab.Scene | oitlab.Fragments, technique: str) -> dict[str, float]:
    params = SINGLE.get(technique, {})
    gpu, cpu = (oitlab.render(source, technique, params, backend=b) for b in ("gpu", "cpu"))
    off = np.abs(gpu.color - cpu.color).max(axis=-1)
    scale = max(1.0, float(np.abs(cpu.color).max()))
    bound = 2 * (cpu.stats.depth_complexity_max + ROUNDINGS) * F32 * scale
    return {
        "largest": float(off.max()),
        "transmittance": float(np.abs(gpu.transmittance - cpu.transmittance).max()),
        "bound": bound,
        "beyond": float((off > bound).mean()),
    }


def _formats(sources: list[tuple[str, Any]]) -> dict[str, dict[str, Any]]:
    """Techniques that blend, in the formats that the device has."""
    found: dict[str, dict[str, Any]] = {}
    for technique in ("alpha_compositing", "weighted_sum", "weighted_average", "blended_oit", "wboit"):
        for name, unit in FORMATS.items():
            try:
                shares = [_within_a_unit(source, technique, name, unit) for _, source in sources]
            except ValueError:  # it does not sum, or not blend, in this format
                continue
            found.setdefault(technique, {})[name] = dict(zip([n for n, _ in sources], shares, strict=True))
    return found


def _within_a_unit(source: Any, technique: str, name: str, unit: float) -> float:
    gpu, cpu = (oitlab.render(source, technique, {"format": name}, backend=b) for b in ("gpu", "cpu"))
    scale = np.maximum(np.abs(cpu.color), 2.0**-14) if name == "f16" else 1.0
    within = np.abs(gpu.color - cpu.color) <= unit * scale
    return float(within.mean())


def _markdown(results: dict[str, Any]) -> str:
    names = list(next(iter(results["techniques"].values())))
    rows = [
        [name, f"{row['fragments']:,}", "yes" if row["same"] else "**no**",
         f"{100 * row.get('depths_equal', 0):.3f} %", f"{row.get('depths_off_ulp', float('nan')):.0f}"]
        for name, row in results["coverage"].items()
    ]  # fmt: skip
    coverage = markdown_table(
        ["scene", "fragments", "same pixels and primitives", "same depth", "ulp off"], rows
    )

    def cell(row: dict[str, float]) -> str:
        text = f"{row['largest']:.0e}"
        return f"**{text}** ({100 * row['beyond']:.2g} %)" if row["beyond"] > 0 else text

    images = markdown_table(
        ["technique", *names],
        [[t, *(cell(found[n]) for n in names)] for t, found in results["techniques"].items()],
    )
    parts = [
        f"Device: {results['device']}.",
        "Coverage, fragment by fragment.",
        coverage,
        "Largest difference of a channel from the CPU backend. Bold: beyond what single precision "
        "explains of the sums, with the share of pixels that are.",
        images,
    ]
    if results["formats"]:
        formats = [
            [f"{t} {f}", *(f"{100 * shares[n]:.1f} %" for n in names)]
            for t, found in results["formats"].items()
            for f, shares in found.items()
        ]
        parts += [
            "Channels that are within a unit in the last place of the CPU's emulation of the format.",
            markdown_table(["technique, format", *names], formats),
        ]
    return "\n\n".join(parts)


if __name__ == "__main__":
    main()
