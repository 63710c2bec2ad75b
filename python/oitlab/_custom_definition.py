"""What a technique of one's own is once it is registered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from . import _oitlab
from ._custom_calls import Call
from ._custom_params import ORDER, SEED, Param, resolved, table
from ._fingerprint import fingerprint
from .registry import Cost, TechniqueInfo, techniques

Amount = float | Callable[[Mapping[str, Any], float, int], float]
"""A number, or a function of (params, depth_complexity_mean, depth_complexity_max) that gives it."""

PROMISES = (
    "order_independent",
    "unbiased",
    "consistent",
    "exact_for_one",
    "exact_for_one_color",
    "exact_coverage",
)
AXES = ("memory", "insertion", "merge", "normalize", "opacity")
UNSAID = "not stated"


@dataclass(frozen=True, eq=False)
class Definition:
    """A technique of one's own as it was registered."""

    id: str
    name: str
    function: Callable[..., Any]
    params: Mapping[str, Param]
    order: str
    transmittance: Callable[..., Any] | None
    colored: bool
    promises: Mapping[str, bool]
    geometry_passes: Amount | None
    bytes_per_pixel: Amount | None
    citation: tuple[str, ...]
    doc: str
    axes: Mapping[str, str]

    def resolved(self, params: Mapping[str, Any] | None) -> dict[str, Any]:
        """Check params and complete them."""
        return resolved(self.id, self.params, params)

    def bound(self, params: Mapping[str, Any]) -> _oitlab.CustomTechnique:
        """Give the technique to the core; `params` are resolved."""
        self.cost(params, 1.0, 1)  # what it says wrong of itself is refused before any work starts
        acts = {**params} if self._is_random or params[ORDER] == "shuffled" else {**params, SEED: None}
        own = {name: params[name] for name in self.params}
        call = Call(self.id, self.function, own, self.colored)
        curve = Call(self.id, self.transmittance, own, self.colored) if self.transmittance else None
        return _oitlab.CustomTechnique(
            self.id,
            f"{id(self)} {acts!r}",
            params[ORDER],
            params[SEED],
            self.order == "sorted",
            self.colored,
            [self.promises[name] for name in PROMISES],
            call.resolve,
            curve.transmittance if curve else None,
        )

    @property
    def _is_random(self) -> bool:
        return SEED in self.params

    def cost(self, params: Mapping[str, Any], mean: float, largest: int) -> Cost:
        """Give what the author says that it costs, NaN where that is nothing; `params` are resolved."""
        return Cost(
            self._amount("geometry_passes", params, mean, largest),
            self._amount("bytes_per_pixel", params, mean, largest),
        )

    def _amount(self, name: str, params: Mapping[str, Any], mean: float, largest: int) -> float:
        given = getattr(self, name)
        amount = self._called(name, params, mean, largest) if callable(given) else given
        if amount is None:
            return math.nan
        try:
            number = float(amount)
        except (TypeError, ValueError):
            number = -1.0
        if not 0.0 <= number < math.inf:
            raise ValueError(f"{self.id}: {name} is {amount!r}, not a finite number >= 0")
        return number

    def _called(self, name: str, params: Mapping[str, Any], mean: float, largest: int) -> Any:
        try:
            return getattr(self, name)(MappingProxyType(dict(params)), mean, largest)
        except Exception as error:
            raise ValueError(
                f"{self.id}: {name}, called with params of the names {', '.join(params)}, the mean and the "
                f"largest number of fragments, raised {type(error).__name__}: {error}"
            ) from error

    def fingerprint(self) -> str:
        """Hash what decides the image."""
        names = (self.id, self.order, self.colored, sorted(self.promises.items()))
        params = {
            name: (param.default, param.min, param.max, param.choices) for name, param in self.params.items()
        }
        return fingerprint(self.function, self.transmittance, params, *names)

    def entry(self) -> TechniqueInfo:
        """Describe it as the registry does."""
        return TechniqueInfo(
            id=self.id,
            name=self.name,
            aliases=(),
            citation=self.citation,
            doc=self.doc,
            axes=MappingProxyType(dict(self.axes)),
            properties=MappingProxyType({**self.promises, "colored_transmittance": self.colored}),
            params=table(self.params),
            backends=("cpu",),
            geometry_passes=_amount_text(self.geometry_passes),
            bytes_per_pixel=_amount_text(self.bytes_per_pixel),
            definition=self,
        )


def _amount_text(amount: Amount | None) -> str:
    if amount is None:
        return UNSAID
    return "by params" if callable(amount) else f"{amount:g}"


def definition_of(id: str) -> Definition:
    """Find a technique of one's own; ValueError where there is none of that id."""
    entry = techniques().get(id)
    if entry is None or entry.definition is None:
        mine = ", ".join(entry.id for entry in techniques() if entry.custom) or "there are none"
        problem = "is built in" if entry else "is not registered"
        raise ValueError(f"technique {id!r} {problem}; custom techniques: {mine}")
    return entry.definition
