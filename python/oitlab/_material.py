"""A loaded material: the part of it that this renderer uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .mesh import AlphaMode

Rgba = tuple[float, float, float, float]

DEFAULT_COLOR: Rgba = (0.6, 0.6, 0.6, 1.0)
"""Linear RGBA of surfaces whose file gives no colour, except glTF's, which are white by its specification."""
TRIMESH_DEFAULT = [102, 102, 102, 255]


@dataclass(frozen=True)
class Material:
    """Straight linear RGBA and how to use it."""

    name: str
    color: Rgba = DEFAULT_COLOR
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    double_sided: bool = True
    unlit: bool = False
    textured: bool = False


def srgb_to_linear(encoded: ArrayLike) -> NDArray[np.float64]:
    """Linear RGB of sRGB-encoded values in [0, 1] (IEC 61966-2-1); an alpha column stays as it is."""
    value = np.array(encoded, dtype=np.float64)
    rgb = value[..., :3]
    value[..., :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4)
    return value


def bytes_to_linear(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Straight linear RGBA of trimesh's 8-bit colours, which are sRGB by habit."""
    return srgb_to_linear(np.asarray(colors, dtype=np.float64) / 255)


def from_trimesh(material: Any) -> Material:
    """Read the material of any format but glTF: MTL entries, and whatever else has a colour."""
    name = str(getattr(material, "name", None) or "material")
    kwargs = getattr(material, "kwargs", None) or {}
    color = _base_color(material, kwargs, name)
    alpha = _mtl_alpha(kwargs, name)
    if alpha is not None:
        color = (*color[:3], alpha)
    glow = _floats(kwargs.get("ke", (0.0, 0.0, 0.0)), name, "Ke")
    images = [getattr(material, name, None) for name in ("image", "baseColorTexture", "emissiveTexture")]
    return Material(
        name=name,
        color=color,
        alpha_mode="opaque" if color[3] == 1.0 else "blend",
        emission=(glow[0], glow[1], glow[2]) if len(glow) == 3 else (0.0, 0.0, 0.0),
        textured=any(map(_is_from_file, images)) or "map_d" in kwargs,
    )


def _is_from_file(image: Any) -> bool:
    """Tell a texture from the picture that trimesh invents for coordinates without one."""
    return image is not None and image.format is not None


def _base_color(material: Any, kwargs: dict[str, Any], name: str) -> Rgba:
    if "kd" in kwargs:
        diffuse = _floats(kwargs["kd"], name, "Kd")
        if len(diffuse) == 3:
            red, green, blue = srgb_to_linear(diffuse).tolist()
            return (red, green, blue, 1.0)
    main = getattr(material, "baseColorFactor", None)
    if main is None:
        main = getattr(material, "main_color", None)
    if main is None or np.shape(main) != (4,) or np.asarray(main).tolist() == TRIMESH_DEFAULT:
        return DEFAULT_COLOR
    red, green, blue, alpha = bytes_to_linear(np.asarray(main)).tolist()
    return (red, green, blue, alpha)


def _mtl_alpha(kwargs: dict[str, Any], name: str) -> float | None:
    """MTL's opacity `d`, or the transparency `Tr` = 1 - d where `d` is absent."""
    if "d" in kwargs:
        return _floats(kwargs["d"][-1:], name, "d")[0]
    if "tr" in kwargs:
        return 1.0 - _floats(kwargs["tr"][-1:], name, "Tr")[0]
    return None


def _floats(values: Any, name: str, key: str) -> list[float]:
    try:
        return [float(value) for value in np.atleast_1d(values).tolist()]
    except ValueError as error:
        raise ValueError(f"material {name!r}: {key} is not a number: {error}") from error
