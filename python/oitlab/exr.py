"""Frames on disk: one multi-part OpenEXR file each.

| part | channels | type | content |
|---|---|---|---|
| `image` | R G B | float or half | `Frame.color`, linear, Rec. 709 primaries, D65 |
| `transmittance` | Y, or R G B | float or half | `Frame.transmittance` |
| `depth` | Z | float | `Frame.first_depth`, +inf where nothing was hit |
| `fragments` | count | uint | `Frame.fragment_count` |
| `error` | Y | float | the error map, when one was given |

The `image` part carries string attributes: `oitlab:version`, `oitlab:technique`, `oitlab:scene_hash`,
`oitlab:params` and `oitlab:stats` (both JSON), `oitlab:parts` (the names of all parts, by which a file that
lost its tail is recognised) and, with an error map, `oitlab:error_metric`. Every part carries the
`chromaticities` of Rec. 709. Compression is ZIP, which is lossless.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._atomic import replacing
from ._image import ImageLike, as_image, refuse_non_finite
from .frame import Frame, Stats
from .metrics import error_map

__all__ = ["read_exr", "write_exr"]

_REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x and y of red, green, blue and white [ITU2015]."""


def write_exr(
    path: str | os.PathLike[str],
    frame: Frame,
    *,
    reference: ImageLike | None = None,
    error: ArrayLike | None = None,
    error_metric: str = "squared",
    half: bool = False,
) -> None:
    """Write a frame with its provenance as one multi-part EXR file.

    float32 frames are kept bit for bit. float64 frames are rounded to float32, EXR's widest type. The
    file is written beside its place and renamed into it, so that a crash leaves the old file whole.

    Parameters
    ----------
    path : path-like
        The file to write; its folder must exist.
    frame : Frame
        Any `Frame`. `first_depth` may be +inf, everything else must be finite.
    reference : Frame or (H, W, 3) array-like, optional
        A `Frame` or (H, W, 3) linear RGB; the file then holds
        `error_map(frame, reference, error_metric)` too.
    error : (H, W) array-like, optional
        Instead of `reference`: an (H, W) map to store, rounded to float32.
    error_metric : str
        What the error map measures: one of `error_map`'s metrics with `reference`, any name
        with `error`.
    half : bool
        Store image and transmittance as 16-bit floats (11 significant bits, largest value 65,504).
        Depth, counts and errors stay 32 bits wide.

    Raises
    ------
    ValueError
        A non-finite value, or one too large for the stored type (the message names the first
        bad pixel); a shape that does not fit; `reference` and `error` together.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import oitlab
    >>> triangle = oitlab.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], color=(1, 0, 0, 0.5))
    >>> camera = oitlab.Camera(eye=(0, 0, 5), target=(0, 0, 0))
    >>> frame = oitlab.render(oitlab.Scene([triangle], camera=camera, width=8, height=4), "wboit")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "out.exr")
    ...     write_exr(file, frame)
    ...     back = read_exr(file)
    >>> back.technique, bool((back.color == frame.color).all())
    ('wboit', True)
    """
    if reference is not None and error is not None:
        raise ValueError("reference, error: give one of them, not both")
    if reference is not None:
        error = error_map(frame, reference, error_metric)  # type: ignore[arg-type]  # checked there
    pixels = _part_pixels(frame, error, half)
    content = _encoded(pixels, _attributes(frame, list(pixels), error_metric))
    with replacing(path) as temporary, open(temporary, "xb") as file:
        file.write(content)


@overload
def read_exr(path: str | os.PathLike[str], *, error: Literal[False] = False) -> Frame: ...
@overload
def read_exr(
    path: str | os.PathLike[str], *, error: Literal[True]
) -> tuple[Frame, NDArray[np.float32] | None]: ...
def read_exr(
    path: str | os.PathLike[str], *, error: bool = False
) -> Frame | tuple[Frame, NDArray[np.float32] | None]:
    """Read a frame that `write_exr` wrote.

    Parameters
    ----------
    path : path-like
        The file.
    error : bool
        Give the error map as well.

    Returns
    -------
    Frame, or tuple of Frame and (H, W) float32 array or None
        The frame, its arrays float32 (halves are widened, which is exact) and uint32. With `error` its error
        map too, None where the file has none. Parameters and statistics are what JSON keeps of them: a
        tuple comes back as a list.

    Raises
    ------
    OSError
        No such file, not an EXR file, truncated or damaged.
    ValueError
        A valid EXR file that `write_exr` did not write.

    Examples
    --------
    >>> read_exr("missing.exr")
    Traceback (most recent call last):
        ...
    FileNotFoundError: [Errno 2] No such file or directory: 'missing.exr'
    """
    attributes = _checked_attributes(path)
    parts = _decoded(path)
    lost = [name for name in json.loads(attributes["oitlab:parts"]) if name not in parts]
    if lost:
        raise OSError(f"{os.fspath(path)}: truncated or damaged, lost its {', '.join(lost)}")
    frame = Frame(
        color=_floats(parts["image"]),
        transmittance=_floats(parts["transmittance"]),
        technique=attributes["oitlab:technique"],
        params=json.loads(attributes["oitlab:params"]),
        scene_hash=attributes["oitlab:scene_hash"],
        stats=_stats(path, attributes),
        first_depth=_floats(parts["depth"]),
        fragment_count=np.ascontiguousarray(parts["fragments"], dtype=np.uint32),
    )
    return (frame, _floats(parts["error"]) if "error" in parts else None) if error else frame


def _part_pixels(frame: Frame, error: ArrayLike | None, half: bool) -> dict[str, NDArray[Any]]:
    """Give the contiguous arrays of the parts, checked, in the types that are stored."""
    color = as_image(frame, "color")
    if color.size == 0:
        raise ValueError(f"color: an image of shape {color.shape} has no pixels to write")
    size = color.shape[:2]
    precision = np.float16 if half else np.float32
    pixels = {
        "image": _stored(color, "color", precision),
        "transmittance": _stored(frame.transmittance, "transmittance", precision),
        "depth": _stored(frame.first_depth, "first_depth", np.float32, infinity=True),
        "fragments": np.ascontiguousarray(frame.fragment_count, dtype=np.uint32),
    }
    if error is not None:
        pixels["error"] = _stored(np.asarray(error), "error", np.float32)
    for name, array in pixels.items():
        colored = array.ndim == 3 and array.shape[2] == 3 and name == "transmittance"
        if array.shape[:2] != size or not (array.ndim == 2 or colored or name == "image"):
            raise ValueError(f"{name}: shape {array.shape} does not fit an image of shape {color.shape}")
    return pixels


def _stored(
    array: NDArray[Any], name: str, dtype: type[np.floating[Any]], *, infinity: bool = False
) -> NDArray[Any]:
    refuse_non_finite(array, name, infinity=infinity)
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(array, dtype=dtype)
    overflow = f"{name} as {np.dtype(dtype).name}"
    refuse_non_finite(stored, overflow, infinity=infinity)
    return stored


def _attributes(frame: Frame, parts: list[str], error_metric: str) -> dict[str, str]:
    from ._oitlab import __version__

    attributes = {
        "software": f"oitlab {__version__}",
        "oitlab:version": __version__,
        "oitlab:technique": frame.technique,
        "oitlab:scene_hash": frame.scene_hash,
        "oitlab:params": json.dumps(frame.params, default=_plain),
        "oitlab:stats": json.dumps(dataclasses.asdict(frame.stats), default=_plain),
        "oitlab:parts": json.dumps(parts),
    }
    return attributes | ({"oitlab:error_metric": error_metric} if "error" in parts else {})


def _plain(value: object) -> object:
    """Give JSON the Python form of NumPy's scalars and arrays."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"cannot store {value!r} of type {type(value).__name__} in an EXR attribute")


def _encoded(pixels: dict[str, NDArray[Any]], attributes: dict[str, str]) -> bytes:
    import OpenEXR

    names = {"depth": "Z", "fragments": "count"}
    parts = []
    for name, array in pixels.items():
        header = {
            "type": OpenEXR.scanlineimage,
            "compression": OpenEXR.ZIP_COMPRESSION,
            "chromaticities": _REC_709,
        }
        header |= attributes if name == "image" else {}
        channel = "RGB" if array.ndim == 3 else names.get(name, "Y")
        parts.append(OpenEXR.Part(header, {channel: array}, name))
    stream = io.BytesIO()
    OpenEXR.File(parts).write(stream)
    return stream.getvalue()


def _checked_attributes(path: str | os.PathLike[str]) -> dict[str, Any]:
    headers = [part.header for part in _parts(path, header_only=True)]
    attributes: dict[str, Any] = next((h for h in headers if "oitlab:technique" in h), {})
    if not attributes:
        raise ValueError(f"{os.fspath(path)}: not a file that oitlab.write_exr wrote")
    return attributes


def _stats(path: str | os.PathLike[str], attributes: dict[str, Any]) -> Stats:
    try:
        return Stats(**json.loads(attributes["oitlab:stats"]))
    except TypeError as error:
        version = attributes.get("oitlab:version")
        raise ValueError(
            f"{os.fspath(path)}: written by oitlab {version}, whose statistics differ"
        ) from error


def _decoded(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Give each part's only array, by part name."""
    parts = _parts(path, header_only=False)
    return {part.name(): np.asarray(next(iter(part.channels.values())).pixels) for part in parts}


def _parts(path: str | os.PathLike[str], *, header_only: bool) -> list[Any]:
    import OpenEXR

    with open(path, "rb"):  # Python's own errors for a missing or unreadable file
        pass
    try:
        return list(OpenEXR.File(os.fspath(path), header_only=header_only).parts)
    except RuntimeError as error:
        raise OSError(f"{os.fspath(path)}: not a readable EXR file: {error}") from error


def _floats(array: NDArray[Any]) -> NDArray[np.float32]:
    return np.array(array, dtype=np.float32, order="C")
