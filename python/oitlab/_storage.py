"""The storage formats that a technique can be asked for, as params."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from .registry import ParamInfo, TechniqueInfo

_WIDEST = "f64"
_BESIDE = "f16"
"""What targets that cannot have a format of 8 or 16 bits are in beside those that can."""


def choices(param: ParamInfo) -> tuple[str, ...]:
    """Give the texts that a parameter can be."""
    return tuple(re.findall(r'"([^"]*)"', param.range))


def format_params(entry: TechniqueInfo) -> dict[str, tuple[str, ...]]:
    """Name the parameters that choose formats, `format` first, with the formats that each can be."""
    named = (param for param in entry.params if param.name == "format" or param.name.endswith("_format"))
    return {param.name: choices(param) for param in named}


def in_f64(entry: TechniqueInfo, params: Mapping[str, Any]) -> dict[str, Any] | None:
    """Give the params of the same algorithm without storage error; None where formats cannot be chosen."""
    names = format_params(entry)
    if _WIDEST not in names.get("format", ()):
        return None
    return {**{name: value for name, value in params.items() if name not in names}, "format": _WIDEST}


def stored_in(entry: TechniqueInfo, params: Mapping[str, Any], format: str) -> dict[str, Any] | None:
    """Give the params that store all in `format`, or, where not every target can be in it, those that can.

    The others are in f16 then. None where no target can; "f32" is what every technique is in by itself.
    """
    names = format_params(entry)
    if format == "f32" and "format" not in names:
        return dict(params)
    if format in names.get("format", ()):
        return {**params, "format": format}
    if _BESIDE not in names.get("format", ()):
        return None
    beside = {**params, "format": _BESIDE}
    able = {name: format for name, known in names.items() if format in known}
    there = {name: format for name in able if _is_there(entry, beside, name)}
    return {**beside, **there} if there else None


def _is_there(entry: TechniqueInfo, params: dict[str, Any], name: str) -> bool:
    """Tell whether there is such a target under these params: a wider format then takes more bytes."""

    def bytes_of(params: dict[str, Any]) -> float:
        return entry.cost(params, depth_complexity_mean=2.0, depth_complexity_max=4).bytes_per_pixel

    return bytes_of({**params, name: _WIDEST}) != bytes_of(params)


def described(entry: TechniqueInfo, params: Mapping[str, Any]) -> str:
    """Say which formats are chosen: "f16, revealage unorm8"."""
    names = format_params(entry)
    parts = [str(params.get("format", "f32"))]
    parts += [
        f"{name.removesuffix('_format')} {params[name]}"
        for name in names
        if name != "format" and name in params
    ]
    return ", ".join(parts)


def accepted(entry: TechniqueInfo, params: Mapping[str, Any]) -> dict[str, Any]:
    """Give those of `params` that the technique takes with that value."""
    known = {param.name: param for param in entry.params}

    def takes(name: str, value: Any) -> bool:
        return name in known and (not isinstance(value, str) or value in choices(known[name]))

    return {name: value for name, value in params.items() if takes(name, value)}
