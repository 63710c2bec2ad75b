"""Techniques and weights as they are given to plots: named, or named by themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..rendering import Variant, checked_variant
from ._table import text


def named_variants(value: Any, argument: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """Give label to (technique, params), from one variant, several, or a mapping of labels to variants.

    Examples
    --------
    >>> named_variants(["wboit", ("lwboit", {"bins": 8})], "techniques")
    {'wboit': ('wboit', {}), 'lwboit bins=8': ('lwboit', {'bins': 8})}
    """
    if isinstance(value, Mapping):
        given = [(str(label), checked_variant(variant)) for label, variant in value.items()]
    else:
        several = [value] if _is_one(value) else value
        if isinstance(several, str) or not isinstance(several, Sequence):
            raise ValueError(
                f"{argument} must be a technique, several, or a mapping of labels to them, got {value!r}"
            )
        given = [(name_of(*checked_variant(v)), checked_variant(v)) for v in several]
    if not given:
        raise ValueError(f"{argument} is empty")
    labels = [label for label, _ in given]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"{argument} has {label!r} twice")
    return dict(given)


def _is_one(value: Any) -> bool:
    if isinstance(value, str):
        return True
    return isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], Mapping | None)


def name_of(technique: str, params: Mapping[str, Any]) -> str:
    """Name a variant by what was set.

    Examples
    --------
    >>> name_of("lwboit", {"bins": 64, "smooth": False})
    'lwboit bins=64 smooth=false'
    """
    return " ".join([technique, *(f"{key}={value_name(value)}" for key, value in params.items())])


def value_name(value: Any) -> str:
    """Show a param's value in a legend: a function by its name, a long text by its beginning."""
    if callable(value):
        return str(getattr(value, "__name__", type(value).__name__))
    shown = " ".join(text(value).split())
    return shown if len(shown) <= 32 else shown[:31] + "…"


__all__ = ["Variant", "name_of", "named_variants", "value_name"]
