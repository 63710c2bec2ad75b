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

from . import custom, gpu, scenes
from ._oitlab import __version__
from .custom import Batch, Param, technique, unregister
from .diagnostics import Diagnostics
from .exr import read_exr, write_exr
from .fragments import Fragments
from .frame import Frame, Stats
from .inspection import Transmittance, order_sensitivity, transmittance
from .loading import LoadWarning, TextureWarning, load
from .metrics import compare, error_map
from .png import write_png
from .registry import Cost, ParamInfo, TechniqueInfo, techniques
from .rendering import WeightWarning, capture, render, render_many
from .scene import Camera, Mesh, Scene
from .splitting import ErrorPart, ErrorSplit, error_split
from .stress_lab import stress, stress_cases

if _TYPE_CHECKING:
    from . import plot
    from .sweeping import SweepFailed, SweepInterrupted, read_study, sweep, to_xarray

__all__ = [
    "Batch",
    "Camera",
    "Cost",
    "Diagnostics",
    "ErrorPart",
    "ErrorSplit",
    "Fragments",
    "Frame",
    "LoadWarning",
    "Mesh",
    "Param",
    "ParamInfo",
    "Scene",
    "Stats",
    "SweepFailed",
    "SweepInterrupted",
    "TechniqueInfo",
    "TextureWarning",
    "Transmittance",
    "WeightWarning",
    "__version__",
    "capture",
    "compare",
    "custom",
    "error_map",
    "error_split",
    "gpu",
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
    "technique",
    "techniques",
    "to_xarray",
    "transmittance",
    "unregister",
    "write_exr",
    "write_png",
]

_SWEEPING = ("SweepFailed", "SweepInterrupted", "read_study", "sweep", "to_xarray")


def __getattr__(name: str) -> _Any:
    # what takes longer to import than all the rest: matplotlib; a store, executors and what they bring
    if name == "plot" or name in _SWEEPING:
        from importlib import import_module

        return (
            import_module(".plot", __name__)
            if name == "plot"
            else getattr(import_module(".sweeping", __name__), name)
        )
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
