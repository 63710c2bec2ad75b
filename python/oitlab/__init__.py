"""oitlab: the lab bench for order-independent transparency.

A scene goes in; the exact image, any technique's image, its error, its time and its memory come out, as NumPy
arrays.

Colours are linear RGB (Rec. 709 primaries, D65); alpha is straight where you give it and premultiplied inside
fragments. Images are (H, W, 3), row 0 on top. Wrong input raises ValueError (OSError for files) naming the
culprit.

Examples
--------
>>> import oitlab
>>> scene = oitlab.scenes.squares(width=64, height=36)
>>> exact = oitlab.render(scene, "a_buffer")
>>> approximate = oitlab.render(scene, "wboit", {"weight": "mb7"})
>>> oitlab.compare(approximate, exact)["rmse"] > 0
True
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from . import scenes
from ._oitlab import __version__
from .diagnostics import Diagnostics
from .exr import read_exr, write_exr
from .fragments import Fragments
from .frame import Frame, Stats
from .inspection import Transmittance, order_sensitivity, transmittance
from .loading import LoadWarning, TextureWarning, load
from .metrics import compare, error_map
from .png import write_png
from .registry import Cost, ParamInfo, TechniqueInfo, techniques
from .rendering import capture, render, render_many
from .scene import Camera, Mesh, Scene
from .splitting import ErrorPart, ErrorSplit, error_split
from .stress_lab import stress, stress_cases
from .sweeping import SweepFailed, SweepInterrupted, read_study, sweep, to_xarray

if _TYPE_CHECKING:
    from . import plot

__all__ = [
    "Camera",
    "Cost",
    "Diagnostics",
    "ErrorPart",
    "ErrorSplit",
    "Fragments",
    "Frame",
    "LoadWarning",
    "Mesh",
    "ParamInfo",
    "Scene",
    "Stats",
    "SweepFailed",
    "SweepInterrupted",
    "TechniqueInfo",
    "TextureWarning",
    "Transmittance",
    "__version__",
    "capture",
    "compare",
    "error_map",
    "error_split",
    "load",
    "order_sensitivity",
    "plot",
    "read_exr",
    "read_study",
    "render",
    "render_many",
    "scenes",
    "stress",
    "stress_cases",
    "sweep",
    "techniques",
    "to_xarray",
    "transmittance",
    "write_exr",
    "write_png",
]


def __getattr__(name: str) -> _Any:
    if name == "plot":  # matplotlib takes longer to import than all the rest
        from importlib import import_module

        return import_module(".plot", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
