"""The one place that knows how a user's own techniques travel to other processes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .. import custom
from .._fingerprint import examined
from ..registry import techniques


def technique_fingerprint(technique: str) -> str | None:
    """Content digest of a user's own technique; None for those of the core, which its version tells apart."""
    entry = techniques().get(technique)
    if entry is None or entry.definition is None:
        return None
    apart = f"@{id(entry.definition):x}" if unseen_of(technique) else ""
    return f"{entry.definition.fingerprint()}{apart}"


def unseen_of(technique: str) -> tuple[str, ...]:
    """Tell what the fingerprint of a technique does not see."""
    entry = techniques().get(technique)
    if entry is None or entry.definition is None:
        return ()
    return examined(entry.definition.function, entry.definition.transmittance).unseen


def shippable(names: Iterable[str]) -> list[Any]:
    """Give what a worker needs to know of the techniques among `names` that are the user's own."""
    own = [name for name in dict.fromkeys(names) if technique_fingerprint(name)]
    return [custom.shippable(name) for name in own]


def receive(shipped: Iterable[Any]) -> None:
    """Register in this process what `shippable` gave in another."""
    for item in shipped:
        custom.receive(item)
