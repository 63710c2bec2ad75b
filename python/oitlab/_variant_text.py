"""Techniques and params as they are written on the command line."""

from __future__ import annotations

import contextlib
import json
from typing import Any


def parse_variant(text: str) -> tuple[str, dict[str, Any]]:
    """Read one item of `--techniques`: an id, then parameters after colons; sequences in brackets.

    Parameters
    ----------
    text : str
        Such as "lwboit:bins=64:range=[1,2]".

    Returns
    -------
    tuple of str and dict

    Raises
    ------
    ValueError
        A parameter without "=".

    Examples
    --------
    >>> parse_variant("lwboit:bins=64:bin_function=tent")
    ('lwboit', {'bins': 64, 'bin_function': 'tent'})
    >>> parse_variant("wboit:weight=fn weight(z: f32) -> f32 { return exp(-z); }")
    ('wboit', {'weight': 'fn weight(z: f32) -> f32 { return exp(-z); }'})
    """
    technique, *settings = split_outside(text, ":")
    return technique.strip(), dict(map(parse_param, settings))


def parse_param(text: str) -> tuple[str, Any]:
    """Read "name=value": a JSON number, true, false or null; several as "[1,2]" or "1,2"; else text.

    Raises
    ------
    ValueError
        No "=" or no name.

    Examples
    --------
    >>> parse_param("bins=64"), parse_param("smooth=false"), parse_param("weight=mb7")
    (('bins', 64), ('smooth', False), ('weight', 'mb7'))
    >>> parse_param("range=[1,2.5]"), parse_param("range=1,2.5")
    (('range', (1, 2.5)), ('range', (1, 2.5)))
    """
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise ValueError(f"parameter {text!r}: expected name=value")
    return name.strip(), parse_value(value.strip())


def parse_values(text: str) -> tuple[str, list[Any]]:
    """Read one param of `--grid`: its values between commas, each as `parse_param` reads it.

    Raises
    ------
    ValueError
        No "=" or no name.

    Examples
    --------
    >>> parse_values("bins=8,16"), parse_values("range=pixel,[1,2]"), parse_values("weight=mb7")
    (('bins', [8, 16]), ('range', ['pixel', (1, 2)]), ('weight', ['mb7']))
    """
    name, equals, values = text.partition("=")
    if not equals or not name.strip():
        raise ValueError(f"parameter {text!r}: expected name=value,value,...")
    return name.strip(), [parse_value(value.strip()) for value in split_variants(values)]


def parse_value(text: str) -> Any:
    """Read a JSON scalar, or a tuple of them with or without brackets; anything else stays text."""
    for candidate in (text, f"[{text}]"):
        with contextlib.suppress(json.JSONDecodeError):
            parsed = json.loads(candidate)
            if isinstance(parsed, list) and parsed and not any(map(_is_nested, parsed)):
                return tuple(parsed)
            if not isinstance(parsed, list | dict | str):
                return parsed
    return text


def _is_nested(item: Any) -> bool:
    return isinstance(item, list | dict | str)


def split_variants(text: str) -> list[str]:
    """Split the list of `--techniques` at the commas outside brackets.

    Examples
    --------
    >>> split_variants("wboit,opacity_shadow_maps:range=[1,2]:bins=8")
    ['wboit', 'opacity_shadow_maps:range=[1,2]:bins=8']
    >>> split_variants("a_buffer,wboit:weight=max(a, 0.1) / z")
    ['a_buffer', 'wboit:weight=max(a, 0.1) / z']
    """
    return split_outside(text, ",")


def split_outside(text: str, mark: str) -> list[str]:
    """Split at a mark outside all kinds of brackets that close."""
    opened: list[int] = []
    inside: set[int] = set()
    for place, character in enumerate(text):
        if character in "([{":
            opened.append(place)
        elif character in ")]}" and opened:
            inside.update(range(opened.pop(), place))
    cuts = [place for place, character in enumerate(text) if character == mark and place not in inside]
    return [
        text[first:last]
        for first, last in zip([0, *(cut + 1 for cut in cuts)], [*cuts, len(text)], strict=True)
    ]
