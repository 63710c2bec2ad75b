"""What a user's functions must be fit for: to be told apart in a store, and to travel to a worker."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from .._fingerprint import examined
from .custom import shippable, unseen_of
from .grid import Request
from .metrics import Measure
from .work import Package


def check(
    requests: Iterable[Request], packages: Iterable[Package], measure: Measure, *, travels: bool
) -> None:
    """Refuse functions of which rows cannot be told by content, or that cannot be sent to a worker.

    Parameters
    ----------
    requests, packages, measure
        What has functions.
    travels : bool
        Whether there is an executor, rather than a store alone.

    Raises
    ------
    ValueError
        Which one it is, and why.
    """
    references = [p.reference for p in packages if isinstance(p.reference, tuple)]
    everything = [*requests, *((technique, params or {}) for technique, params in references)]
    techniques = list(dict.fromkeys(technique for technique, _ in everything))
    for technique in techniques:
        _check_seen(f"technique {technique!r}", unseen_of(technique))
    for what, value in _functions(everything, measure):
        _check_seen(what, examined(value).unseen)
        if travels:
            _check_travels(what, value)
    if travels:
        shippable(techniques)


def _functions(requests: Iterable[Request], measure: Measure) -> Iterator[tuple[str, Any]]:
    found = {
        (technique, name, id(value)): value
        for technique, params in requests
        for name, value in params.items()
        if callable(value)
    }
    yield from ((f"{technique}'s {name!r}", value) for (technique, name, _), value in found.items())
    yield from ((f"metric {name!r}", value) for name, value in measure.functions.items())


def _check_seen(what: str, unseen: tuple[str, ...]) -> None:
    if unseen:
        raise ValueError(
            f"{what} has a {unseen[0]} in it, whose code and data cannot be seen: in a store or a worker, "
            "rows of a different one would be taken for its own. Use functions and classes in Python "
            "instead, or sweep without store and executor"
        )


def _check_travels(what: str, value: Any) -> None:
    import cloudpickle

    try:
        cloudpickle.dumps(value)
    except Exception as error:  # whatever the objects that it refers to raise
        raise ValueError(f"{what} cannot be sent to a worker: {error}") from error
