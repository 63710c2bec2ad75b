"""What a column of a sweep is called on an axis, with its unit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..registry import techniques

if TYPE_CHECKING:
    import pandas as pd

LABELS = {
    "mse": "MSE (linear RGB, squared)",
    "rmse": "RMSE (linear RGB, 1 = white)",
    "psnr": "PSNR (dB)",
    "max_error": "largest error (linear RGB, 1 = white)",
    "mse_255": "MSE (linear RGB on 0 to 255, squared)",
    "bad_pixels": "bad pixels (share of the image)",
    "delta_e_2000": "mean CIEDE2000 (ΔE, 1 = just noticeable)",
    "delta_e_itp": "mean ΔE ITP (1 = just noticeable)",
    "flip": "mean FLIP (0 to 1)",
    "factor": "MSE of wboit / MSE (ratio)",
    "resolve_ms": "time to resolve (ms)",
    "raster_ms": "time to rasterise (ms)",
    "raster_share_ms": "time to rasterise, shared (ms)",
    "total_ms": "time in all (ms)",
    "bytes_per_pixel": "memory (bytes per pixel)",
    "bytes_per_pixel_measured": "memory, measured (bytes per pixel)",
    "geometry_passes": "geometry passes (number)",
    "fragments": "fragments (number)",
    "dropped": "dropped fragments (number)",
    "skipped": "skipped work (number)",
    "depth_complexity_mean": "fragments per pixel (mean)",
    "depth_complexity_max": "fragments per pixel (largest)",
    "width": "width (pixels)",
    "height": "height (pixels)",
    "threads": "threads (number)",
    "repeats": "repeats (number)",
}
"""Measured columns; params get theirs from the registry."""

DEPTHS = {"weight_shift", "near", "far", "front_threshold", "opaque_threshold", "thickness", "sigma"}
"""Params that are lengths along the view axis, in the scene's unit."""
ROUNDING = {"mse": 1e-14, "rmse": 1e-7, "max_error": 1e-7, "mse_255": 65025e-14}
"""Errors from here on down are the rounding of float32, and would take most of a logarithmic axis."""
HIGHER_IS_BETTER = {"psnr", "factor"}


def param_types() -> dict[str, str]:
    """Every technique's params, and what Python type each has; asked each time, since techniques may come."""
    return {param.name: param.type for entry in techniques() for param in entry.params}


def label(column: str) -> str:
    """Name a column on an axis.

    Examples
    --------
    >>> label("total_ms"), label("bins"), label("weight_shift"), label("weight_k"), label("mine")
    ('time in all (ms)', 'bins (number)', 'weight_shift (scene units)', 'weight_k (dimensionless)', 'mine')
    """
    if column in LABELS:
        return LABELS[column]
    kind = param_types().get(column)
    if column in DEPTHS:
        return f"{column} (scene units)"
    unit = {"int": " (number)", "float": " (dimensionless)"}.get(kind or "", "")
    return column + unit


def identity(table: pd.DataFrame) -> list[str]:
    """Give the columns that say what was rendered, not what came out: scene, technique, params and the like.

    A table that lists them itself in `attrs["keys"]`, as those of `oitlab.sweep` do, is believed, too.

    Examples
    --------
    >>> import pandas as pd
    >>> identity(pd.DataFrame(columns=["scene", "technique", "weight", "weight.k", "seed", "mse"]))
    ['scene', 'technique', 'weight', 'weight.k', 'seed']
    """
    known = {"scene", "technique", "backend", "seed", *param_types()}
    keys = set(map(str, table.attrs.get("keys", ())))
    return [n for n in map(str, table.columns) if n in keys or n in known or n.partition(".")[0] in known]
