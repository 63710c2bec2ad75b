"""Techniques of your own: a Python function over the fragments of many pixels, registered beside the others.

The function is called with a `Batch` of pixels and its params, and gives a colour and the background's share
for each pixel. It is then a technique like any other: in `oitlab.techniques()`, `render`, `render_many`,
`transmittance`, `order_sensitivity`, `stress` and on the command line, where
`oitlab --import FILE.py compare ...` runs the file that registers it. `error_split` takes it if it has a
parameter `format` that can be "f64".

Examples
--------
Nearest fragment first, each over what is behind it, one layer of all pixels at a time:

>>> import numpy as np, oitlab
>>> @oitlab.technique
... def layered(batch, *, layers: int = 99):
...     '''The first fragments of each pixel, the rest dropped.'''
...     color, share = np.zeros((len(batch), 3)), np.ones(len(batch))
...     for k in range(min(layers, batch.counts.max())):
...         pixels = np.flatnonzero(batch.counts > k)
...         place = batch.offsets[pixels] + k
...         color[pixels] += share[pixels, np.newaxis] * batch.color[place]
...         share[pixels] *= 1 - batch.alpha[place].astype(float)
...     dropped = np.maximum(batch.counts - layers, 0)
...     return color + share[:, np.newaxis] * batch.background, share, dropped
>>> scene = oitlab.scenes.blades(width=64, height=36, count=60)
>>> exact, all_of_them, two = oitlab.render_many(scene, ["a_buffer", "layered", ("layered", {"layers": 2})])
>>> oitlab.compare(all_of_them, exact)["max_error"] < 1e-6, oitlab.compare(two, exact)["max_error"] > 0.01
(True, True)
>>> two.params["layers"], two.stats.dropped > 0
(2, True)
>>> oitlab.unregister("layered")
"""

from __future__ import annotations

import atexit
import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, TypeVar, overload

from . import _oitlab
from ._custom_calls import Batch
from ._custom_definition import AXES, UNSAID, Amount, Definition, definition_of
from ._custom_params import Param, check_callable, declared
from ._custom_shipping import Shipment, receive, shippable
from .registry import register_entry, techniques, unregister_entry

__all__ = ["Batch", "Param", "Shipment", "receive", "shippable", "technique", "temporary", "unregister"]

# a worker in the middle of a technique, as Ctrl-C leaves it, must not find the interpreter gone
atexit.register(_oitlab.settle)

_Function = TypeVar("_Function", bound=Callable[..., Any])


@overload
def technique(function: _Function, /) -> _Function: ...
@overload
def technique(
    function: None = None,
    /,
    *,
    params: Mapping[str, Any] | None = ...,
    id: str | None = ...,
    name: str | None = ...,
    doc: str | None = ...,
    citation: Iterable[str] = ...,
    order: Literal["sorted", "submission"] = ...,
    transmittance: Callable[..., Any] | None = ...,
    colored_transmittance: bool = ...,
    order_independent: bool | None = ...,
    unbiased: bool = ...,
    consistent: bool = ...,
    exact_for_one: bool = ...,
    exact_for_one_color: bool = ...,
    exact_coverage: bool = ...,
    geometry_passes: Amount | None = ...,
    bytes_per_pixel: Amount | None = ...,
    axes: Mapping[str, str] | None = ...,
) -> Callable[[_Function], _Function]: ...
def technique(
    function: Callable[..., Any] | None = None,
    /,
    *,
    params: Mapping[str, Any] | None = None,
    id: str | None = None,
    name: str | None = None,
    doc: str | None = None,
    citation: Iterable[str] = (),
    order: Literal["sorted", "submission"] = "sorted",
    transmittance: Callable[..., Any] | None = None,
    colored_transmittance: bool = False,
    order_independent: bool | None = None,
    unbiased: bool = False,
    consistent: bool = False,
    exact_for_one: bool = False,
    exact_for_one_color: bool = False,
    exact_coverage: bool = False,
    geometry_passes: Amount | None = None,
    bytes_per_pixel: Amount | None = None,
    axes: Mapping[str, str] | None = None,
) -> Any:
    """Register a function as a technique; a decorator, with or without arguments.

    The function is called as `function(batch, **params)` with a `Batch` of P pixels and gives

    - color, (P, 3) float: linear RGB, the background included, finite;
    - transmittance, (P,) float in [0, 1]: the background's share; (P, 3) with `colored_transmittance`;
    - optionally dropped, (P,) int: fragments that the technique had no room for, for `Frame.stats`; at most
      as many as the pixel has.

    It is called once for a screen tile or some 4096 pixels of captured fragments (fewer where they are deep),
    from the renderer's threads, one at a time since Python's lock is held; numba functions may release it
    (`nogil=True`). A pixel must not depend on what else is in the batch. Random numbers are best a hash of
    `batch.pixel`, `batch.primitive` and `seed`. Exceptions reach the caller of `render`; rendering from
    within the function is refused. A second function under the same id, as from a notebook cell that is run
    again, takes the place of the first.

    Parameters
    ----------
    function : callable
        What is registered, and given back as it is.
    params : mapping of str to default or `Param`, optional
        Its parameters, handed over as keywords; left out, its keyword-only arguments with their defaults. One
        that is called `seed` is the one that every technique has. Names of columns that the tables of
        `oitlab.sweep` have anyway, such as `mse` or `width`, are taken.
    id : str, optional
        The name to render it by; the function's own when absent.
    name, doc : str, optional
        For tables; from the id and the docstring when absent.
    citation : iterable of str
        Keys of its sources.
    order : {"sorted", "submission"}
        How a pixel's fragments come: nearest first by (depth, primitive), or as they were submitted, which
        the parameter `submission_order` can change.
    transmittance : callable, optional
        `transmittance(batch, depths, **params)`, for `oitlab.transmittance`: with a batch of one pixel and
        (D,) float32 depths it gives (D,) floats in [0, 1], the share that is let through in front of each.
    colored_transmittance : bool
        Whether the background's share may differ between channels.
    order_independent, unbiased, consistent, exact_for_one, exact_for_one_color, exact_coverage : bool
        What the image promises, as in `TechniqueInfo.properties`. `order_independent` is that of sorted
        fragments when absent. Pixels of one fragment are composited without a call where `exact_for_one` is
        promised and `skip` is on.
    geometry_passes, bytes_per_pixel : float or callable, optional
        What a streaming GPU implementation would need, or a function of (params, depth_complexity_mean,
        depth_complexity_max); NaN in `Frame.stats` when absent.
    axes : mapping, optional
        Its place on the axes memory, insertion, merge, normalize and opacity of Wyman's Table 1.

    Returns
    -------
    callable
        The function itself, or a decorator.

    Raises
    ------
    ValueError
        An id that a built-in technique has or that is no name; params that the function does not take or that
        are not bools, numbers, text or tuples of them; an argument of the function that has a default but is
        not keyword-only; any other argument that is not as above.

    Examples
    --------
    With numba, whose functions take the batch's arrays. A kernel goes from pixel to pixel:

    >>> import numba, numpy as np, oitlab
    >>> @numba.njit(nogil=True)
    ... def front_to_back(offsets, depth, color, alpha, background, out):
    ...     for p in range(len(offsets) - 1):
    ...         share = 1.0
    ...         for i in range(offsets[p], offsets[p + 1]):
    ...             for c in range(3):
    ...                 out[p, c] += share * color[i, c]
    ...             share *= 1.0 - alpha[i]
    ...         for c in range(3):
    ...             out[p, c] += share * background[p, c]
    ...         out[p, 3] = share
    >>> @oitlab.technique(citation=["Porter1984"], exact_for_one=True, bytes_per_pixel=16, geometry_passes=1)
    ... def numba_over(batch):
    ...     out = np.zeros((len(batch), 4))
    ...     front_to_back(batch.offsets, batch.depth, batch.color, batch.alpha, batch.background, out)
    ...     return out[:, :3], out[:, 3]
    >>> scene = oitlab.scenes.squares(width=32, height=18)
    >>> exact, mine = oitlab.render_many(scene, ["a_buffer", "numba_over"])
    >>> oitlab.compare(mine, exact)["max_error"] < 1e-6
    True
    >>> oitlab.unregister("numba_over")
    """
    given: dict[str, Any] = {
        "params": params,
        "id": id,
        "name": name,
        "doc": doc,
        "citation": citation,
        "order": order,
        "transmittance": transmittance,
        "colored_transmittance": colored_transmittance,
        "geometry_passes": geometry_passes,
        "bytes_per_pixel": bytes_per_pixel,
        "axes": axes,
        "order_independent": order_independent,
        "unbiased": unbiased,
        "consistent": consistent,
        "exact_for_one": exact_for_one,
        "exact_for_one_color": exact_for_one_color,
        "exact_coverage": exact_coverage,
    }

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        register_entry(_defined(function, **given).entry())
        return function

    return register if function is None else register(function)


def _defined(
    function: Callable[..., Any],
    *,
    params: Mapping[str, Any] | None,
    id: str | None,
    name: str | None,
    doc: str | None,
    citation: Iterable[str],
    order: str,
    transmittance: Callable[..., Any] | None,
    colored_transmittance: bool,
    geometry_passes: Amount | None,
    bytes_per_pixel: Amount | None,
    axes: Mapping[str, str] | None,
    order_independent: bool | None,
    **promises: bool,
) -> Definition:
    """Check what `technique` was given."""
    if not callable(function):
        raise ValueError(f"a technique is a function, got {function!r}")
    chosen = getattr(function, "__name__", None) if id is None else id
    if not isinstance(chosen, str) or not chosen.isidentifier():
        raise ValueError(f"id must be a name of letters, digits and underscores, got {chosen!r}")
    if order not in ("sorted", "submission"):
        raise ValueError(f"{chosen}: order must be 'sorted' or 'submission', got {order!r}")
    own = _with_id(chosen, lambda: declared(function, params))
    _with_id(chosen, lambda: check_callable(function, "the function", ("batch",), own))
    if transmittance is not None:
        _with_id(chosen, lambda: check_callable(transmittance, "transmittance", ("batch", "depths"), own))
    promised = {"order_independent": order == "sorted" if order_independent is None else order_independent}
    for key, value in {**promised, **promises, "colored_transmittance": colored_transmittance}.items():
        if not isinstance(value, bool):
            raise ValueError(f"{chosen}: {key} must be True or False, got {value!r}")
    for key, amount in {"geometry_passes": geometry_passes, "bytes_per_pixel": bytes_per_pixel}.items():
        _check_amount(chosen, key, amount)
    return Definition(
        id=chosen,
        name=_text(chosen, "name", chosen.replace("_", " ") if name is None else name),
        function=function,
        params=own,
        order=order,
        transmittance=transmittance,
        colored=colored_transmittance,
        promises={**promised, **promises},
        geometry_passes=geometry_passes,
        bytes_per_pixel=bytes_per_pixel,
        citation=_citation(chosen, citation),
        doc=_text(chosen, "doc", _docstring(function) if doc is None else doc),
        axes=_all_axes(chosen, axes),
    )


_T = TypeVar("_T")


def _with_id(technique: str, check: Callable[[], _T]) -> _T:
    """Run a check and say in its error whose fault it is."""
    try:
        return check()
    except ValueError as error:
        raise ValueError(f"{technique}: {error}") from None


def _docstring(function: Callable[..., Any]) -> str:
    """Give a function's docstring, but not that of the class of a callable object, such as `partial`'s."""
    inherited = function.__doc__ is type(function).__doc__
    return "" if inherited else inspect.getdoc(function) or ""


def _text(technique: str, key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{technique}: {key} must be text, got {value!r}")
    return value


def _check_amount(technique: str, key: str, amount: Any) -> None:
    if amount is None or callable(amount):
        return
    if isinstance(amount, bool) or not isinstance(amount, int | float) or not 0 <= amount < math.inf:
        raise ValueError(f"{technique}: {key} must be a finite number >= 0 or a function, got {amount!r}")


def _citation(technique: str, given: Any) -> tuple[str, ...]:
    keys = (given,) if isinstance(given, str) or not isinstance(given, Iterable) else tuple(given)
    if isinstance(given, str) or not all(isinstance(key, str) for key in keys):
        raise ValueError(f"{technique}: citation must be a sequence of keys, got {given!r}")
    return keys


def _all_axes(technique: str, given: Mapping[str, str] | None) -> dict[str, str]:
    if given is not None and not isinstance(given, Mapping):
        raise ValueError(f"{technique}: axes must be a mapping, got {given!r}")
    for axis, value in (given or {}).items():
        if axis not in AXES:
            raise ValueError(f"{technique}: unknown axis {axis!r}; the axes are {', '.join(AXES)}")
        _text(technique, f"axes[{axis!r}]", value)
    return {axis: (given or {}).get(axis, UNSAID) for axis in AXES}


def unregister(id: str) -> None:
    """Take a technique of one's own out of the registry.

    Raises
    ------
    ValueError
        There is none of that id, or it is a built-in one.

    Examples
    --------
    >>> import oitlab
    >>> @oitlab.technique
    ... def mine(batch):
    ...     return batch.background, batch.alpha[batch.offsets[:-1]]
    >>> "mine" in oitlab.techniques()
    True
    >>> oitlab.unregister("mine")
    >>> "mine" in oitlab.techniques()
    False
    """
    unregister_entry(definition_of(id).id)


@contextmanager
def temporary() -> Iterator[None]:
    """Undo, at the end of a `with` block, all that was registered, replaced and unregistered in it.

    Examples
    --------
    >>> import oitlab
    >>> with oitlab.custom.temporary():
    ...     _ = oitlab.technique(lambda batch: (batch.background, batch.alpha), id="mine")
    ...     print("mine" in oitlab.techniques())
    True
    >>> "mine" in oitlab.techniques()
    False
    """
    before = [entry for entry in techniques() if entry.custom]
    try:
        yield
    finally:
        for entry in [entry for entry in techniques() if entry.custom]:
            unregister_entry(entry.id)
        for entry in before:
            register_entry(entry)
