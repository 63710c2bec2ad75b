"""The techniques that there are, as data: those of the compiled core, and those that users registered."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from itertools import zip_longest
from textwrap import wrap
from threading import Lock
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

from . import _oitlab
from ._convert import count, scalar
from ._convert import params as python_params

if TYPE_CHECKING:
    from ._custom_definition import Definition


@dataclass(frozen=True)
class ParamInfo:
    """One parameter of a technique."""

    name: str
    type: str
    range: str
    default: Any
    doc: str


@dataclass(frozen=True)
class Cost:
    """What a streaming GPU implementation of a technique would need."""

    geometry_passes: float
    """Times the transparent geometry is drawn."""
    bytes_per_pixel: float
    """The technique's own state; the image itself and opaque depth not counted."""


@dataclass(frozen=True)
class TechniqueInfo:
    """One technique: what it is, where it comes from, and what it takes."""

    id: str
    name: str
    aliases: tuple[str, ...]
    citation: tuple[str, ...]
    """Keys into `references.bib`."""
    doc: str
    axes: Mapping[str, str]
    """Its choices on the continuum: memory, insertion, merge, normalize, opacity."""
    properties: Mapping[str, Any]
    """What its image guarantees under default params: order_independent, unbiased, consistent, ...

    "Order independent" is meant up to the rounding of float32 sums, which moments of near-coincident depths
    (`mboit_power`, `mboit_trig`) can amplify into something visible.
    """
    params: tuple[ParamInfo, ...]
    backends: tuple[str, ...]
    geometry_passes: str
    """Geometry passes of a streaming GPU implementation; may depend on params, hence text."""
    bytes_per_pixel: str
    definition: Definition | None = field(default=None, repr=False, compare=False)
    """How it was registered, if not by oitlab itself."""

    @property
    def custom(self) -> bool:
        """Whether somebody registered it with `oitlab.technique`."""
        return self.definition is not None

    @property
    def fingerprint(self) -> str | None:
        """Hash of what a technique of one's own computes; None for a built-in one.

        The same in every process, and after the function is defined again as it was; another one when its
        code, what it closes over or a global that it names changes, or under another version of Python. It
        cannot see what is reached through an attribute of a module, files, or what cannot be pickled.

        Examples
        --------
        >>> import oitlab
        >>> def shares(k):
        ...     return lambda batch: (batch.background, batch.alpha ** k)
        >>> with oitlab.custom.temporary():
        ...     _ = oitlab.technique(shares(2), id="mine")
        ...     squares = oitlab.techniques()["mine"].fingerprint
        ...     _ = oitlab.technique(shares(3), id="mine")
        ...     squares == oitlab.techniques()["mine"].fingerprint
        False
        """
        return None if self.definition is None else self.definition.fingerprint()

    def cost(
        self,
        params: Mapping[str, Any] | None = None,
        *,
        depth_complexity_mean: float,
        depth_complexity_max: int,
    ) -> Cost:
        """Geometry passes and bytes per pixel under these params, as `Frame.stats` has them after a render.

        Parameters
        ----------
        params : mapping, optional
            The technique's parameters; those left out take their defaults.
        depth_complexity_mean : float >= 0
            Fragments per pixel, empty pixels included: lists of all fragments grow with it.
        depth_complexity_max : int >= depth_complexity_mean
            Fragments of the deepest pixel: peeling that goes to the end draws as often.

        Returns
        -------
        Cost

        Raises
        ------
        ValueError
            Numbers out of range, or params that `oitlab.render` would refuse.

        Examples
        --------
        >>> lwboit = techniques()["lwboit"]
        >>> lwboit.cost({"bins": 64}, depth_complexity_mean=2.5, depth_complexity_max=32)
        Cost(geometry_passes=..., bytes_per_pixel=...)
        >>> mlab = techniques()["mlab"]
        >>> [mlab.cost({"layers": k}, depth_complexity_mean=2.5, depth_complexity_max=32).bytes_per_pixel
        ...     for k in (4, 8)]
        [80.0, 160.0]
        """
        mean = scalar(depth_complexity_mean, "depth_complexity_mean")
        largest = count(depth_complexity_max, "depth_complexity_max", bits=32)
        if self.definition is not None:
            return self._custom_cost(self.definition, params, mean, largest)
        return Cost(*_oitlab.cost(self.id, python_params(params, self.id), mean, largest))

    @staticmethod
    def _custom_cost(
        definition: Definition, params: Mapping[str, Any] | None, mean: float, largest: int
    ) -> Cost:
        if not 0.0 <= mean <= largest:
            raise ValueError(
                f"depth_complexity_mean: {mean} is not a number from 0 to depth_complexity_max = {largest}"
            )
        return definition.cost(definition.resolved(params), mean, largest)

    def __str__(self) -> str:
        lines = [f"{self.id}: {self.name} [{', '.join(self.citation)}]", "", self.doc.strip()]
        if self.params:
            rows = [(p.name, p.type, p.range, repr(p.default), p.doc) for p in self.params]
            lines += ["", _text_table(("param", "type", "range", "default", "meaning"), rows)]
        return "\n".join(lines)


@dataclass(frozen=True)
class TextTable:
    """Rows of text that print as a plain-text table, and as HTML in notebooks."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        return _text_table(self.columns, self.rows)

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(column)}</th>" for column in self.columns)
        lines = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows)
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


class TechniqueTable(Sequence[TechniqueInfo]):
    """All techniques, in the registry's order; index by position, id or alias.

    Prints as a plain-text table, and as HTML in notebooks.

    Examples
    --------
    >>> techniques()["over"].id
    'a_buffer'
    >>> "wboit" in techniques().ids
    True
    """

    __slots__ = ("_by_name", "_entries")

    def __init__(self, entries: Iterable[TechniqueInfo]) -> None:
        self._entries = tuple(entries)
        names = [(name, entry) for entry in self._entries for name in (entry.id, *entry.aliases)]
        self._by_name = dict(reversed(names))  # the first of a name counts

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids, in order."""
        return tuple(entry.id for entry in self._entries)

    @overload
    def __getitem__(self, key: int | str) -> TechniqueInfo: ...
    @overload
    def __getitem__(self, key: slice) -> TechniqueTable: ...
    def __getitem__(self, key: int | str | slice) -> TechniqueInfo | TechniqueTable:
        if isinstance(key, slice):
            return TechniqueTable(self._entries[key])
        if isinstance(key, int):
            return self._entries[key]
        entry = self.get(key)
        if entry is None:
            raise KeyError(f"unknown technique {key!r}; known: {', '.join(self.ids)}")
        return entry

    def get(self, key: str) -> TechniqueInfo | None:
        """Find a technique by id or alias; None when there is none."""
        return self._by_name.get(key)

    def __contains__(self, item: object) -> bool:
        return self.get(item) is not None if isinstance(item, str) else item in self._entries

    def __iter__(self) -> Iterator[TechniqueInfo]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __eq__(self, other: object) -> bool:
        return self._entries == other._entries if isinstance(other, TechniqueTable) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.ids)

    def axes_table(self) -> TextTable:
        """Lay out each technique's choices on the axes of Wyman's Table 1 [Wyman2016], and what it promises.

        The promises are those under default params: that the image does not depend on submission order, that
        its expectation is the exact image, that its error vanishes as the technique's size grows.

        Returns
        -------
        TextTable

        Examples
        --------
        >>> print(techniques()[:1].axes_table())
        id        memory  insertion  merge       normalize  alpha/coverage  order-free  unbiased  consistent
        --------  ------  ---------  ----------  ---------  --------------  ----------  --------  ----------
        a_buffer  none    always     no merging  no         either          yes         yes       yes
        """
        return TextTable(_AXES_COLUMNS, tuple(map(_axes_row, self._entries)))

    def _table(self) -> TextTable:
        return TextTable(_COLUMNS, tuple(map(_row, self._entries)))

    def __str__(self) -> str:
        return str(self._table())

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return self._table()._repr_html_()


def techniques() -> TechniqueTable:
    """Every technique that can be rendered: oitlab's own, then those registered with `oitlab.technique`.

    Examples
    --------
    >>> [param.name for param in techniques()["lwboit"].params if param.name == "bins"]
    ['bins']
    """
    return _registered or _built_in()


@cache
def _built_in() -> TechniqueTable:
    return TechniqueTable(_entry(raw) for raw in _oitlab.techniques())


_registered: TechniqueTable | None = None
"""The whole table, once users added to it; replaced as a whole, so that who reads it needs no lock."""
_changes = Lock()


def register_entry(entry: TechniqueInfo) -> None:
    """Add a technique that is not the core's; one of the same id is replaced where it stands.

    Raises
    ------
    ValueError
        A built-in technique has that id or alias.
    """
    global _registered
    taken = _built_in().get(entry.id)
    if taken is not None:
        raise ValueError(f"id: {entry.id!r} is taken by the built-in technique {taken.id!r}")
    with _changes:
        entries = {other.id: other for other in techniques()}
        _registered = TechniqueTable({**entries, entry.id: entry}.values())


def unregister_entry(id: str) -> None:
    """Take out what `register_entry` added; nothing where there is nothing."""
    global _registered
    with _changes:
        kept = [entry for entry in techniques() if not (entry.custom and entry.id == id)]
        _registered = TechniqueTable(kept) if any(entry.custom for entry in kept) else None


CELL_WIDTH = 23
_COLUMNS = ("id", "name", "params", "passes", "bytes/pixel", "backends", "source")


_AXES = ("memory", "insertion", "merge", "normalize", "opacity")
_PROMISES = {"order-free": "order_independent", "unbiased": "unbiased", "consistent": "consistent"}
_AXES_COLUMNS = ("id", *_AXES[:-1], "alpha/coverage", *_PROMISES)


def _axes_row(entry: TechniqueInfo) -> tuple[str, ...]:
    promises = ("yes" if entry.properties[name] else "no" for name in _PROMISES.values())
    return (entry.id, *(entry.axes[axis] for axis in _AXES), *promises)


def _row(entry: TechniqueInfo) -> tuple[str, ...]:
    return (
        entry.id,
        entry.name,
        " ".join(param.name for param in entry.params),
        entry.geometry_passes,
        entry.bytes_per_pixel,
        " ".join(entry.backends),
        " ".join(entry.citation),
    )


def _text_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Align cells, each wrapped to `CELL_WIDTH`."""
    wrapped = [[wrap(cell, CELL_WIDTH, break_long_words=False) for cell in row] for row in rows]
    lines = [list(line) for row in wrapped for line in zip_longest(*row, fillvalue="")]
    widths = [max(map(len, cells)) for cells in zip(columns, *lines, strict=True)]
    table = [columns, ["-" * width for width in widths], *lines]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    )


def _entry(raw: Mapping[str, Any]) -> TechniqueInfo:
    return TechniqueInfo(
        id=raw["id"],
        name=raw["name"],
        aliases=tuple(raw["aliases"]),
        citation=tuple(raw["citation"]),
        doc=raw["doc"],
        axes=MappingProxyType(dict(raw["axes"])),
        properties=MappingProxyType(dict(raw["properties"])),
        params=tuple(ParamInfo(**param) for param in raw["params"]),
        backends=tuple(raw["backends"]),
        geometry_passes=raw["geometry_passes"],
        bytes_per_pixel=raw["bytes_per_pixel"],
    )
