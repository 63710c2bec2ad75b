"""How techniques of one's own travel to other processes."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from typing import Any

from ._custom_definition import Definition, definition_of
from .registry import register_entry, techniques


@dataclass(frozen=True, slots=True)
class Shipment:
    """A technique of one's own on its way to another process; pickle it, and `receive` it there."""

    id: str
    fingerprint: str
    """As `TechniqueInfo.fingerprint` where it came from."""
    payload: bytes = field(repr=False)


def shippable(technique_id: str) -> Shipment:
    """Pack a technique of one's own for another process.

    What can be imported there is sent by name, everything else (functions of `__main__`, of notebooks, and
    local ones) with its code and what it refers to, by cloudpickle.

    Parameters
    ----------
    technique_id : str
        Under which it is registered.

    Returns
    -------
    Shipment
        An object that any pickler takes.

    Raises
    ------
    ValueError
        No custom technique has this id, or it refers to something that cannot be pickled, such as a lock.

    Examples
    --------
    >>> import oitlab, pickle
    >>> with oitlab.custom.temporary():
    ...     _ = oitlab.technique(lambda batch: (batch.background, batch.alpha), id="mine")
    ...     box = pickle.dumps(oitlab.custom.shippable("mine"))
    >>> with oitlab.custom.temporary():
    ...     oitlab.custom.receive(pickle.loads(box))
    ...     print("mine" in oitlab.techniques())
    'mine'
    True
    """
    import cloudpickle  # type: ignore[import-untyped, unused-ignore]

    definition = definition_of(technique_id)
    try:
        payload = cloudpickle.dumps(definition)
    except Exception as error:  # whatever the objects that it refers to raise
        raise ValueError(f"technique {technique_id!r} cannot be sent to another process: {error}") from error
    return Shipment(definition.id, definition.fingerprint(), payload)


_received: dict[str, tuple[Shipment, Definition]] = {}
"""By id, what was received last, so that the many tasks of a worker unpack it once."""


def receive(shipment: Shipment) -> str:
    """Register what `shippable` packed; what is registered already under its id is replaced.

    Parameters
    ----------
    shipment : Shipment
        From a process that is trusted: like every pickle it can run any code.

    Returns
    -------
    str
        The technique's id.

    Raises
    ------
    ValueError
        Not a shipment.
    RuntimeError
        What the shipment names is something else here, as in a worker that imported a module before it was
        edited.
    """
    if not isinstance(shipment, Shipment):
        raise ValueError(f"shipment must come from oitlab.custom.shippable, got {shipment!r}")
    before, definition = _received.get(shipment.id, (None, None))
    if definition is None or before != shipment:
        definition = pickle.loads(shipment.payload)
        if definition.fingerprint() != shipment.fingerprint:
            raise RuntimeError(another_version(f"technique {shipment.id!r}", definition.function))
        _received[shipment.id] = (shipment, definition)
    entry = techniques().get(shipment.id)
    if entry is None or entry.definition is not definition:
        register_entry(definition.entry())
    return shipment.id


def another_version(what: str, value: Any) -> str:
    """Say that this process has another state of the code of something that was sent to it by name."""
    module = getattr(value, "__module__", None) or type(value).__module__
    return (
        f"{what}: the worker has another version of module {module!r} (or of what it uses, or of Python) "
        "than the process that sent it: restart the workers, or that process where it has the older one"
    )
