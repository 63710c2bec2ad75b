"""lwboit with shared absorbance against the published variants, at equal bins: images, plateau and seams.

FEE21 [Friederichs2021] fades a fragment's coverage over neighbouring bins (section 3.2) and repairs the
total afterwards (3.3). The bells do not sum to one, so the total is wrong, and the repair restores the
total alone. `partition="absorbance"` divides the fragment's absorbance in shares that sum to one. Here
both are measured on images: RMSE of linear RGB against bins on the procedural scenes, and the seams
where bin edges cut slanted quads (FEE21, Figures 3, 4 and 7).

A seam is a jump of the *error* between two neighbouring pixels between which the exact image does not change.
It is given as a share of the largest jump of the exact image itself between neighbours in a row.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _study import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SKY,
    Study,
    markdown_table,
    plot_style,
    show_image,
    srgb,
    three_digits,
)
from numpy.typing import NDArray

import oitlab

PLAIN = {"smooth": False, "normalize": False, "shape": False}
SHARED = {"partition": "absorbance"}
VARIANTS: dict[str, dict[str, Any]] = {
    "naive": PLAIN,
    "smooth": {**PLAIN, "smooth": True},
    "smooth, normalised": {**PLAIN, "smooth": True, "normalize": True},
    "SND (all of FEE21)": {},
    "naive, shaped": {"smooth": False},
    "absorbance": {**SHARED, "shape": False},
    "absorbance, shaped": SHARED,
}
PUBLISHED = tuple(VARIANTS)[:4]
STYLES: dict[str, tuple[str, str]] = dict(
    zip(
        VARIANTS,
        ((ORANGE, "-"), (SKY, "-"), (GREEN, "-"), (GREEN, "--"), (ORANGE, "--"), (BLACK, "-"), (BLACK, "--")),
        strict=True,
    )
)
SCENES = ("squares", "soup", "shells", "smoke", "blades")
SMALL = {
    "squares": {"count": 24},
    "soup": {"count": 400},
    "shells": {"count": 4, "subdivisions": 2},
    "smoke": {"count": 40},
    "blades": {"count": 40},
}
ALPHA_RANGE = (0.05, 0.95)
FLAT = 1e-6
"""Neighbouring pixels of the exact image are equal when no channel differs by more."""


def main() -> None:
    """Measure, plot, and print the tables."""
    study = Study.from_command_line("lwboit_partition", __doc__)
    bins = [2**k for k in ((0, 3, 6) if study.quick else range(10))]
    size = (48, 27) if study.quick else (320, 180)
    convergence = _convergence(bins, size, study.quick)
    slanted_size = (96, 54) if study.quick else (960, 540)
    seams = [_seams(name, slanted_size, bins) for name in SLANTED]
    plot_style()
    study.save_figure(_convergence_plot(convergence), "convergence.png")
    study.save_figure(_seam_plot(seams), "seams.png")
    study.save_figure(_scanlines(slanted_size), "scanline.png")
    study.save_figure(_strip(slanted_size), "strip.png")
    sizes = {"convergence_size": size, "slanted_size": slanted_size}
    study.save(
        {"bins": bins, **sizes, "convergence": convergence, "seams": seams}, _markdown(convergence, seams)
    )


def with_random_alpha(scene: oitlab.Scene) -> oitlab.Scene:
    """Give every object of one colour an alpha of its own, uniform in `ALPHA_RANGE`."""
    (mesh,) = scene.meshes
    colors, owner = np.unique(mesh.colors, axis=0, return_inverse=True)
    colors[:, 3] = np.random.default_rng(1).uniform(*ALPHA_RANGE, len(colors))
    changed = oitlab.Mesh(mesh.vertices, mesh.faces, face_colors=colors[owner.reshape(-1)])
    return scene.replace(meshes=[changed])


def slanted(
    size: tuple[int, int], tilts: tuple[float, float, float], spacing: float, alpha: float = 0.7
) -> oitlab.Scene:
    """Three large quads one behind the other, each turned about the vertical axis by its tilt in degrees."""
    hues = ((0.85, 0.12, 0.08), (0.1, 0.55, 0.15), (0.1, 0.2, 0.8))
    corner = np.array([(-1.0, -0.62, 0.0), (1.0, -0.62, 0.0), (1.0, 0.62, 0.0), (-1.0, 0.62, 0.0)])
    vertices = []
    for place, tilt in zip((1, 0, -1), np.radians(tilts), strict=True):
        turn = np.array([(np.cos(tilt), 0, np.sin(tilt)), (0, 1, 0), (-np.sin(tilt), 0, np.cos(tilt))])
        vertices.append(corner @ turn.T + place * np.array([-0.25, 0.12, spacing]))
    points = np.concatenate(vertices)
    faces = np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(3)[:, None, None]
    colors = np.repeat([(*hue, alpha) for hue in hues], 2, axis=0)
    camera = oitlab.Camera(eye=(0, 0, 4), ortho_height=1.7).tightened(points)
    mesh = oitlab.Mesh(points, faces.reshape(-1, 3), face_colors=colors)
    return oitlab.Scene([mesh], camera=camera, width=size[0], height=size[1])


SLANTED: dict[str, tuple[tuple[float, float, float], float]] = {
    "one tilt": ((40.0, 40.0, 40.0), 0.45),
    "three tilts": ((25.0, 10.0, -15.0), 0.5),
    "crossing": ((40.0, 20.0, -35.0), 0.45),
}
"""Tilts and spacing: FEE21's Figure 7, where shaping removes all seams; the general case; crossing quads."""


def _convergence(bins: list[int], size: tuple[int, int], quick: bool) -> list[dict[str, Any]]:
    found = []
    for name in SCENES:
        counts = SMALL[name] if quick else {}
        scene = oitlab.scenes.SCENES[name](width=size[0], height=size[1], **counts)
        for alphas, source in (("the scene's", scene), ("random", with_random_alpha(scene))):
            found.append({"scene": name, "alphas": alphas, **_errors(source, bins)})
    return found


def _errors(scene: oitlab.Scene, bins: list[int]) -> dict[str, Any]:
    kept = oitlab.capture(scene)
    exact = oitlab.render(kept, "a_buffer")

    def rmse(technique: str, params: dict[str, Any]) -> float:
        frame = oitlab.render(kept, technique, params)
        return oitlab.compare(frame, exact, metrics="rmse")["rmse"]

    return {
        "depth_complexity_mean": exact.stats.depth_complexity_mean,
        "depth_complexity_max": exact.stats.depth_complexity_max,
        "painter": rmse("painter", {}),
        "wboit": rmse("wboit", {}),
        "rmse": {
            name: [rmse("lwboit", {**params, "bins": count}) for count in bins]
            for name, params in VARIANTS.items()
        },
    }


def _seams(name: str, size: tuple[int, int], bins: list[int]) -> dict[str, Any]:
    kept = oitlab.capture(slanted(size, *SLANTED[name]))
    exact = oitlab.render(kept, "a_buffer")
    contrast = float(_jumps(exact.color).max())
    result: dict[str, Any] = {"scene": name, "contrast": contrast, "seam": {}, "rmse": {}}
    for variant, params in VARIANTS.items():
        frames = oitlab.render_many(kept, [("lwboit", {**params, "bins": count}) for count in bins])
        result["seam"][variant] = [_largest_seam(frame, exact) / contrast for frame in frames]
        result["rmse"][variant] = [oitlab.compare(frame, exact, metrics="rmse")["rmse"] for frame in frames]
    return result


def _jumps(color: NDArray[Any]) -> NDArray[Any]:
    """(H, W - 1) largest channel difference of each pixel to the one on its right."""
    return np.abs(np.diff(color.astype(np.float64), axis=1)).max(axis=2)


def _largest_seam(frame: oitlab.Frame, exact: oitlab.Frame) -> float:
    flat = _jumps(exact.color) <= FLAT
    return float(_jumps(frame.color - exact.color)[flat].max())


def _convergence_plot(convergence: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(2, len(SCENES), figsize=(11, 4.6), sharex=True)
    for number, entry in enumerate(convergence):
        place = axes[number % 2, number // 2]
        _lines(place, entry["rmse"])
        place.axhline(entry["painter"], color=GREY, lw=1, ls=":", label="painter")
        alphas = "random alphas" if entry["alphas"] == "random" else "its own alphas"
        place.set(title=f"{entry['scene']}, {alphas}")
        values = [value for line in entry["rmse"].values() for value in line if value > 1e-7]
        place.set_ylim(*(10.0 ** np.array([np.floor(np.log10(min(values))), np.ceil(np.log10(max(values)))])))
    for row in axes:
        row[0].set_ylabel("RMSE, linear RGB (1 = white)")
    for place in axes[-1]:
        place.set_xlabel("bins")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(VARIANTS) + 1
    )
    return figure


def _lines(place: Any, lines: dict[str, list[float]]) -> None:
    for variant, values in lines.items():
        count = len(values)
        bins = [2**k for k in range(count)] if count > 3 else [1, 8, 64]
        color, style = STYLES[variant]
        place.plot(bins, values, style, color=color, marker="o", ms=2.5, label=variant)
    place.set(xscale="log", yscale="log")
    place.set_xticks([1, 8, 64, 512], ["1", "8", "64", "512"])
    place.minorticks_off()


def _seam_plot(seams: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(2, len(seams), figsize=(8.4, 5.2), sharex=True, sharey="row")
    for column, entry in zip(axes.T, seams, strict=True):
        _lines(column[0], {name: np.maximum(values, 1e-7) for name, values in entry["seam"].items()})
        _lines(column[1], {name: np.maximum(values, 1e-7) for name, values in entry["rmse"].items()})
        column[0].set_title(entry["scene"])
        column[1].set_xlabel("bins")
    axes[0, 0].set_ylabel("largest seam / largest exact edge")
    axes[1, 0].set_ylabel("RMSE, linear RGB (1 = white)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _scanlines(size: tuple[int, int], bins: int = 8) -> Any:
    """Error along the middle row, green channel: steps are seams, slopes are not."""
    kept = oitlab.capture(slanted(size, *SLANTED["three tilts"]))
    exact = oitlab.render(kept, "a_buffer").color[size[1] // 2].astype(np.float64)
    shown = (
        "naive",
        "smooth",
        "smooth, normalised",
        "SND (all of FEE21)",
        "absorbance",
        "absorbance, shaped",
    )
    figure, axes = plt.subplots(len(shown), 1, figsize=(7.4, 5.6), sharex=True, sharey=True)
    for place, variant in zip(axes, shown, strict=True):
        frame = oitlab.render(kept, "lwboit", {**VARIANTS[variant], "bins": bins})
        error = frame.color[size[1] // 2] - exact
        for channel, color in enumerate((RED, GREEN, BLUE)):
            place.plot(error[:, channel], color=color, lw=0.9, label=("red", "green", "blue")[channel])
        place.set_title(variant, loc="left", pad=2)
    axes[-1].set_xlabel(f"pixel along the middle row ({bins} bins)")
    figure.supylabel("error, linear RGB", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _strip(size: tuple[int, int], bins: int = 8) -> Any:
    """Images, insets where bin edges cut all three quads, and error maps on one scale."""
    kept = oitlab.capture(slanted(size, *SLANTED["three tilts"]))
    exact = oitlab.render(kept, "a_buffer")
    shown = (
        "naive",
        "smooth",
        "smooth, normalised",
        "SND (all of FEE21)",
        "absorbance",
        "absorbance, shaped",
    )
    frames = {name: oitlab.render(kept, "lwboit", {**VARIANTS[name], "bins": bins}) for name in shown}
    maps = {name: oitlab.error_map(frame, exact, "absolute") for name, frame in frames.items()}
    highest = max(float(found.max()) for found in maps.values())
    left, top, right, bottom = _window(frames["naive"], exact)
    figure, axes = plt.subplots(3, len(shown) + 1, figsize=(11, 3.2))
    for column, name in zip(axes.T, ("exact", *shown), strict=True):
        image = srgb(frames[name].color if name in frames else exact.color)
        show_image(column[0], image, name)
        frame = plt.Rectangle((left, top), right - left, bottom - top, fill=False, ec=BLACK, lw=0.8)
        column[0].add_patch(frame)
        show_image(column[1], image[top:bottom, left:right])
        if name in maps:
            drawn = show_image(column[2], maps[name], cmap="inferno", vmin=0, vmax=highest)
        else:
            column[2].set_visible(False)
    figure.colorbar(drawn, ax=axes[2, -1], fraction=0.05, pad=0.03, label="|error|, linear")
    return figure


def _window(naive: oitlab.Frame, exact: oitlab.Frame) -> tuple[int, int, int, int]:
    """Inset around the naive variant's largest seam in the middle row, a quarter of the image wide."""
    height, width = exact.color.shape[:2]
    row = slice(height // 2, height // 2 + 1)
    seams = _jumps((naive.color - exact.color)[row]) * (_jumps(exact.color[row]) <= FLAT)
    left = int(np.clip(seams.argmax() - width // 8, 0, 3 * width // 4))
    return (left, 3 * height // 8, left + width // 4, 5 * height // 8)


def _markdown(convergence: list[dict[str, Any]], seams: list[dict[str, Any]]) -> str:
    count = len(next(iter(convergence[0]["rmse"].values())))
    shown = {"8": 3, "64": 6, "512": 9} if count > 3 else {"8": 1, "64": 2}
    parts = []
    for bins, place in shown.items():
        rows = [
            [f"{entry['scene']}, {entry['alphas']}", three_digits(entry["painter"]),
             *_marked([entry["rmse"][name][place] for name in VARIANTS])]
            for entry in convergence
        ]  # fmt: skip
        parts.append(f"RMSE at {bins} bins, the best lwboit in bold:")
        parts.append(markdown_table(["scene, alphas", "painter", *VARIANTS], rows))
    rows = [
        [f"{entry['scene']}, {bins} bins", *_marked([entry["seam"][name][place] for name in VARIANTS])]
        for entry in seams
        for bins, place in shown.items()
    ]
    parts.append("Largest seam, as a share of the largest edge of the exact image:")
    parts.append(markdown_table(["slanted quads", *VARIANTS], rows))
    rows = [
        [f"{entry['scene']}, {bins} bins", *_marked([entry["rmse"][name][place] for name in VARIANTS])]
        for entry in seams
        for bins, place in shown.items()
    ]
    parts.append("RMSE on the slanted quads:")
    parts.append(markdown_table(["slanted quads", *VARIANTS], rows))
    return "\n\n".join(parts)


def _marked(values: list[float]) -> list[str]:
    best = min(values)
    return [f"**{three_digits(v)}**" if v <= best else three_digits(v) for v in values]


if __name__ == "__main__":
    main()
