"""What went wrong with each pixel's numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

MEANING = MappingProxyType(
    {
        "overflow": "fragments whose blend or node made a number infinite",
        "underflow": "fragments that left a number other than 0 subnormal, or flushed it to 0",
        "stagnation": "fragments that a stored number took no notice of, because it was too large for them",
        "saturation": "fragments whose blend or node met the end of a format that has no infinity",
        "cancellation": "bits lost by subtracting numbers about as large, at most those that the format has",
        "non_finite": "stored numbers that were infinite or NaN when read, as the largest number",
        "hankel_failures": "1 where the moments' matrix was not positive definite with the bias asked for",
        "bias_retries": "how often the moments' bias had to be raised, tenfold each time",
        "clamped_ringing": "fragments at whose depth T(z) of a series or of moments left [0, 1] or rose",
    }
)
"""Every kind of diagnostic, and what its numbers count."""


class Diagnostics(Mapping[str, NDArray[Any]]):
    """Images of what went wrong, by kind; a technique has the kinds that can befall it.

    Parameters
    ----------
    images : mapping of str to (H, W) array
        uint32 counts, or float32 bits for `cancellation`; none where nothing was asked for.
    technique : str
        Whose they are, for messages.
    asked : bool
        Whether the frame was rendered with `diagnostics=True`.

    Raises
    ------
    KeyError
        On access to a kind that is not there; it names those that are.

    Examples
    --------
    >>> import oitlab
    >>> stack = oitlab.Fragments(width=1, height=1, offsets=[0, 22], depth=[0.1] * 22, alpha=[1.0] * 22,
    ...     color=[(1.0, 1.0, 1.0)] * 22, background=(0, 0, 0))
    >>> frame = oitlab.render(stack, "wboit", {"format": "f16"}, diagnostics=True)
    >>> frame.diagnostics["overflow"].tolist(), frame.diagnostics["non_finite"].tolist()
    ([[1]], [[4]])
    >>> frame.stats.diagnostics["overflow"]
    1
    """

    __slots__ = ("_asked", "_images", "_technique")

    def __init__(self, images: Mapping[str, NDArray[Any]], technique: str, *, asked: bool = True) -> None:
        self._images = dict(images)
        self._technique = technique
        self._asked = asked

    def __getitem__(self, kind: str) -> NDArray[Any]:
        if kind in self._images:
            return self._images[kind]
        if not self._asked:
            raise KeyError(f"{kind!r}: the frame was rendered without diagnostics=True")
        there = ", ".join(self._images) or "none"
        raise KeyError(f"{self._technique!r} has no diagnostic {kind!r}; it has: {there}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)

    @property
    def pixels(self) -> dict[str, int]:
        """How many pixels each kind befell: those with a count, or with at least one bit lost."""
        return {kind: int(np.count_nonzero(image >= 1)) for kind, image in self._images.items()}

    def __repr__(self) -> str:
        inside = ", ".join(f"{kind}: {count} pixels" for kind, count in self.pixels.items())
        return f"Diagnostics({inside or ('none' if self._asked else 'not asked for')})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._images, self._technique, self._asked)


def _rebuild(images: Mapping[str, NDArray[Any]], technique: str, asked: bool) -> Diagnostics:
    return Diagnostics(images, technique, asked=asked)
