"""Frames on disk: one multi-part OpenEXR file each.

| part | channels | type | content |
|---|---|---|---|
| `image` | R G B | float or half | `Frame.color`, linear, Rec. 709 primaries, D65 |
| `transmittance` | Y, or R G B | float or half | `Frame.transmittance` |
| `depth` | Z | float | `Frame.first_depth`, +inf where nothing was hit |
| `fragments` | count | uint | `Frame.fragment_count` |
| `error` | Y | float | the error map, when one was given |

The `image` part carries string attributes: `oitlab:version`, `oitlab:technique`, `oitlab:scene_hash`,
`oitlab:params`, `oitlab:inactive_params` and `oitlab:stats` (all JSON), `oitlab:parts` (the names of all
parts, by which a file that lost its tail is recognised) and, with an error map,
`oitlab:error_metric`. Every part carries the `chromaticities` of Rec. 709. Compression is ZIP,
which is lossless.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
from collections.abc import Iterator
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._atomic import replacing
from ._convert import flag
from ._image import ImageLike, as_image, as_numbers, refuse_non_finite
from ._oitlab import __version__
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
        No `Frame`; a non-finite value, or one too large for the stored type (the message names the first
        bad pixel); a shape that does not fit; params that JSON cannot hold; `reference` and `error` together.
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
    if not isinstance(frame, Frame):
        raise ValueError(f"frame must be a Frame, got {type(frame).__name__}")
    if not isinstance(error_metric, str):
        raise ValueError(f"error_metric must be a name, got {error_metric!r}")
    if reference is not None and error is not None:
        raise ValueError("reference, error: give one of them, not both")
    if reference is not None:
        error = error_map(frame, reference, error_metric)  # type: ignore[arg-type]  # checked there
    pixels = _part_pixels(frame, error, flag(half, "half"))
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
        map too, None where the file has none. Parameters are what JSON keeps of them, sequences tuples: those
        of a rendered frame come back equal.

    Raises
    ------
    OSError
        No such file, not an EXR file, truncated or damaged.
    ValueError
        A valid EXR file that `write_exr` did not write, or whose statistics another version of it defined.

    Examples
    --------
    >>> read_exr("missing.exr")
    Traceback (most recent call last):
        ...
    FileNotFoundError: [Errno 2] No such file or directory: 'missing.exr'
    """
    with_error = flag(error, "error")
    attributes = _checked_attributes(path)
    with _damage_named(path, "truncated or damaged"):
        parts = _decoded(path)
        _check_parts(parts, json.loads(_text(attributes, "parts")))
        frame = Frame(
            color=_floats(parts["image"]),
            transmittance=_floats(parts["transmittance"]),
            technique=_text(attributes, "technique"),
            params=_tuples(dict(json.loads(_text(attributes, "params")))),
            inactive_params=_inactive_params(attributes),
            scene_hash=_text(attributes, "scene_hash"),
            stats=Stats(**json.loads(_text(attributes, "stats"))),
            first_depth=_floats(parts["depth"]),
            fragment_count=np.ascontiguousarray(parts["fragments"], dtype=np.uint32),
        )
    return (frame, _floats(parts["error"]) if "error" in parts else None) if with_error else frame


def _part_pixels(frame: Frame, error: ArrayLike | None, half: bool) -> dict[str, NDArray[Any]]:
    """Give the contiguous arrays of the parts, checked, in the types that are stored."""
    color = as_image(frame, "color")
    if color.size == 0:
        raise ValueError(f"color: an image of shape {color.shape} has no pixels to write")
    precision = np.float16 if half else np.float32
    pixels = {
        "image": _stored(color, "color", precision),
        "transmittance": _stored(frame.transmittance, "transmittance", precision),
        "depth": _stored(frame.first_depth, "first_depth", np.float32, infinity=True),
        "fragments": np.ascontiguousarray(frame.fragment_count, dtype=np.uint32),
    }
    if error is not None:
        pixels["error"] = _stored(error, "error", np.float32)
    _check_shapes(pixels)
    return pixels


def _check_shapes(pixels: dict[str, NDArray[Any]]) -> None:
    color = pixels["image"]
    for name, array in pixels.items():
        colored = array.ndim == 3 and array.shape[2] == 3 and name == "transmittance"
        if array.shape[:2] != color.shape[:2] or not (array.ndim == 2 or colored or name == "image"):
            raise ValueError(f"{name}: shape {array.shape} does not fit an image of shape {color.shape}")


def _stored(
    value: ArrayLike, name: str, dtype: type[np.floating[Any]], *, infinity: bool = False
) -> NDArray[Any]:
    array = as_numbers(value, name)
    refuse_non_finite(array, name, infinity=infinity)
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(array, dtype=dtype)
    overflow = f"{name} as {np.dtype(dtype).name}"
    refuse_non_finite(stored, overflow, infinity=infinity)
    return stored


def _attributes(frame: Frame, parts: list[str], error_metric: str) -> dict[str, str]:
    attributes = {
        "software": f"oitlab {__version__}",
        "oitlab:version": __version__,
        "oitlab:technique": frame.technique,
        "oitlab:scene_hash": frame.scene_hash,
        "oitlab:params": json.dumps(frame.params, default=_plain),
        "oitlab:inactive_params": json.dumps(sorted(frame.inactive_params)),
        "oitlab:stats": json.dumps(dataclasses.asdict(frame.stats), default=_plain),
        "oitlab:parts": json.dumps(parts),
    }
    return attributes | ({"oitlab:error_metric": error_metric} if "error" in parts else {})


def _plain(value: object) -> object:
    """Give JSON the Python form of NumPy's scalars and arrays; of functions, what they are called."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if callable(value):
        return repr(value)
    raise ValueError(f"params: cannot store {value!r} of type {type(value).__name__} in an EXR attribute")


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
    """Give the attributes of a file that is ours and of a version whose statistics are ours."""
    with _damage_named(path, "not a readable EXR file"):
        headers: list[dict[str, Any]] = [part.header for part in _parts(path, header_only=True)]
    ours = (header for header in headers if any(str(name).startswith("oitlab:") for name in header))
    attributes = next(ours, None)
    if attributes is None:
        raise ValueError(f"{os.fspath(path)}: not a file that oitlab.write_exr wrote")
    with _damage_named(path, "truncated or damaged"):
        version, stats = _text(attributes, "version"), json.loads(_text(attributes, "stats"))
    if version != __version__ and set(stats) != {field.name for field in dataclasses.fields(Stats)}:
        raise ValueError(f"{os.fspath(path)}: written by oitlab {version}, whose statistics differ")
    return attributes


def _text(attributes: dict[str, Any], name: str) -> str:
    value = attributes.get(f"oitlab:{name}")
    if not isinstance(value, str):
        raise ValueError(f"its attribute oitlab:{name} is {'lost' if value is None else 'no text'}")
    return value


def _inactive_params(attributes: dict[str, Any]) -> frozenset[str]:
    """Give the params without effect; none where the file is older than their names."""
    if "oitlab:inactive_params" not in attributes:
        return frozenset()
    return frozenset(map(str, json.loads(_text(attributes, "inactive_params"))))


def _tuples(value: Any) -> Any:
    """Turn the lists of JSON into the tuples that params hold."""
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    return {key: _tuples(item) for key, item in value.items()} if isinstance(value, dict) else value


def _check_parts(parts: dict[str, NDArray[Any]], announced: list[str]) -> None:
    lost = {"image", "transmittance", "depth", "fragments", *announced}.difference(parts)
    if lost:
        raise ValueError(f"lost its {', '.join(sorted(lost))}")
    for name, array in parts.items():
        if array.dtype.kind != ("u" if name == "fragments" else "f"):
            raise ValueError(f"{name} holds {array.dtype}")
    if parts["image"].ndim != 3 or parts["image"].shape[2] != 3:
        raise ValueError(f"image has shape {parts['image'].shape}")
    _check_shapes(parts)


def _decoded(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Give each part's only array, by part name."""
    parts = _parts(path, header_only=False)
    return {part.name(): np.asarray(next(iter(part.channels.values())).pixels) for part in parts}


def _parts(path: str | os.PathLike[str], *, header_only: bool) -> list[Any]:
    import OpenEXR

    with open(path, "rb"):  # Python's own errors for a missing or unreadable file
        pass
    return list(OpenEXR.File(os.fspath(path), header_only=header_only).parts)


@contextlib.contextmanager
def _damage_named(path: str | os.PathLike[str], verdict: str) -> Iterator[None]:
    """Turn whatever a broken file makes OpenEXR, JSON and NumPy raise into an OSError that names it."""
    try:
        yield
    except (RuntimeError, ValueError, TypeError, LookupError, AttributeError, StopIteration) as error:
        raise OSError(f"{os.fspath(path)}: {verdict}: {error or type(error).__name__}") from error


def _floats(array: NDArray[Any]) -> NDArray[np.float32]:
    return np.array(array, dtype=np.float32, order="C")
