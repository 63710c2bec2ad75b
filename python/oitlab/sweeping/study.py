"""Finished rows in a file: an SQLite database that survives its writer, whatever kills it.

The journal is a write-ahead log and every commit is flushed to disk, so that a committed row outlives
`kill -9` and, where the disk keeps its word about flushing, a loss of power. One process at a time writes;
others wait their turn. Readers never wait.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .table import from_rows
from .work import Row

if TYPE_CHECKING:
    import pandas as pd

APPLICATION_ID = 0x4F495453
"""Of the database's header: "OITS"."""
VERSION = 2
"""Of the schema, in the database's header. 1: without `invalid_weights`."""
BUSY_SECONDS = 60.0
"""How long a writer waits for another."""

_JSON = ("params", "metrics", "skipped", "versions")
_COLUMNS = {
    "scene": "TEXT", "scene_hash": "TEXT", "technique": "TEXT", "seed": "INTEGER",
    "params": "TEXT", "metrics": "TEXT",
    "resolve_ms": "REAL", "resolve_ms_spread": "REAL", "raster_ms": "REAL", "raster_ms_spread": "REAL",
    "total_ms": "REAL", "total_ms_spread": "REAL", "raster_share_ms": "REAL",
    "repeats": "INTEGER", "shared_with": "INTEGER", "executor": "TEXT", "threads": "INTEGER",
    "backend": "TEXT", "width": "INTEGER", "height": "INTEGER",
    "fragments": "INTEGER", "depth_complexity_mean": "REAL", "depth_complexity_max": "INTEGER",
    "geometry_passes": "REAL", "bytes_per_pixel": "REAL", "bytes_per_pixel_measured": "REAL",
    "dropped": "INTEGER", "invalid_weights": "INTEGER", "skipped": "TEXT", "versions": "TEXT",
}  # fmt: skip
"""Of the table `finished`; those in `_JSON` hold JSON objects."""

_SCHEMA = f"""
CREATE TABLE finished (
    key TEXT NOT NULL,
    {", ".join(f"{name} {kind}" for name, kind in _COLUMNS.items())},
    PRIMARY KEY (key, scene)
)
"""
_INSERT = f"INSERT OR IGNORE INTO finished (key, {', '.join(_COLUMNS)}) VALUES (?{', ?' * len(_COLUMNS)})"
_SELECT = f"SELECT key, {', '.join(_COLUMNS)} FROM finished"
_SELECT_1 = _SELECT.replace("invalid_weights", "NULL")
_MIGRATE_1 = "ALTER TABLE finished ADD COLUMN invalid_weights INTEGER"


class Study:
    """A study that is written.

    Parameters
    ----------
    path : path-like
        Made when absent; its folder must exist.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
    ValueError
        The file is something else, or was written by a newer oitlab.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = _checked_path(path)
        if not self.path.parent.is_dir():
            raise FileNotFoundError(f"store: the folder {self.path.parent} does not exist")
        with _named(self.path):
            self._connection = sqlite3.connect(self.path, timeout=BUSY_SECONDS, isolation_level=None)
            try:
                self._open()
            except BaseException:
                self._connection.close()
                raise

    def _open(self) -> None:
        if not _is_study(self._connection, self.path, blank_will_do=True):
            self._log_ahead()
            self._create()
        self._migrate()
        self._log_ahead()
        self._connection.execute("PRAGMA synchronous = FULL")

    def _log_ahead(self) -> None:
        """Change to a write-ahead log, which SQLite refuses at once, not in time, while others write."""
        end = time.monotonic() + BUSY_SECONDS
        while True:
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                return
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > end:
                    raise
            time.sleep(0.01)

    def _create(self) -> None:
        with self._transaction():
            if _is_study(self._connection, self.path, blank_will_do=True):  # another sweep was faster
                return
            self._connection.execute(_SCHEMA)
            self._connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            self._connection.execute(f"PRAGMA user_version = {VERSION}")

    def _migrate(self) -> None:
        """Bring a study of an older oitlab to this schema; its rows have no value in new columns."""
        if _version(self._connection) == VERSION:
            return
        with self._transaction():
            if _version(self._connection) == 1:  # no other sweep was faster
                self._connection.execute(_MIGRATE_1)
                self._connection.execute(f"PRAGMA user_version = {VERSION}")

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self._connection.execute("ROLLBACK")
            raise
        self._connection.execute("COMMIT")

    def add(self, rows: Iterable[tuple[str, Row]]) -> None:
        """Write (content key, row) pairs in one transaction; those that are there stay as they are."""
        with _named(self.path), self._transaction():
            self._connection.executemany(_INSERT, [(key, *_cells(row)) for key, row in rows])

    def find(self, key: str) -> list[Row]:
        """Rows with a content key: one for every name that its scene was given."""
        with _named(self.path):
            found = self._connection.execute(f"{_SELECT} WHERE key = ? ORDER BY rowid", (key,)).fetchall()
        return [_row(cells) for _, *cells in found]

    def close(self) -> None:
        """Close the file."""
        self._connection.close()


def read_study(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Rows of a study so far, in the order in which they were finished; a sweep may be writing it meanwhile.

    Parameters
    ----------
    path : path-like
        What `oitlab.sweep` was given as `store`.

    Returns
    -------
    pandas.DataFrame
        Columns as `oitlab.sweep` has them.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
    ValueError
        The file is no study, or was written by a newer oitlab.

    Examples
    --------
    >>> import oitlab, pathlib, tempfile
    >>> scene = oitlab.scenes.blades(width=32, height=18, count=20)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = pathlib.Path(folder, "study.sqlite")
    ...     table = oitlab.sweep(scene, {"wboit": {"weight": ["mb7", "mb9"]}}, store=store, progress=False)
    ...     bool((oitlab.read_study(store)["mse"] == table["mse"]).all())
    True
    """
    checked = _checked_path(path)
    if not checked.exists():
        raise FileNotFoundError(f"no study {os.fspath(path)!r}")
    with _named(checked), closing(_open_to_read(checked)) as connection:
        if not _is_study(connection, checked, blank_will_do=True):  # a sweep is just beginning
            return from_rows([])
        select = _SELECT_1 if _version(connection) == 1 else _SELECT
        found = connection.execute(f"{select} ORDER BY rowid").fetchall()
    return from_rows([_row(cells) for _, *cells in found])


def _open_to_read(path: Path) -> sqlite3.Connection:
    """Open without writing; a study may be tidied up by its last reader, other files are not touched."""
    uri = path.absolute().as_uri()
    if _has_our_header(path) and os.access(path, os.W_OK) and os.access(path.parent, os.W_OK):
        connection = sqlite3.connect(f"{uri}?mode=rw", uri=True, timeout=BUSY_SECONDS)
        connection.execute("PRAGMA query_only = ON")
        return connection
    connection = sqlite3.connect(f"{uri}?mode=ro", uri=True, timeout=BUSY_SECONDS)
    try:
        connection.execute("PRAGMA schema_version").fetchone()
    except sqlite3.OperationalError:
        # a log wants a file beside it, which a folder that cannot be written to does not take
        connection.close()
        if path.with_name(f"{path.name}-wal").exists():
            raise
        connection = sqlite3.connect(f"{uri}?mode=ro&immutable=1", uri=True)
    return connection


def _has_our_header(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(72)[68:] == APPLICATION_ID.to_bytes(4, "big")


def _checked_path(path: str | os.PathLike[str]) -> Path:
    if not isinstance(path, str | os.PathLike) or not os.fspath(path):
        raise ValueError(f"store must be the path of a file, got {path!r}")
    if os.fspath(path) == ":memory:":
        raise ValueError("store ':memory:' would be lost with the sweep; leave store out, or name a file")
    checked = Path(path)
    if checked.is_dir():
        raise IsADirectoryError(f"store: {os.fspath(path)!r} is a folder")
    return checked


def _is_study(connection: sqlite3.Connection, path: Path, *, blank_will_do: bool) -> bool:
    """Whether it is one; False for a database without anything in it, an error for anything else."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    version = _version(connection)
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if application == APPLICATION_ID and tables:
        if version > VERSION:
            raise ValueError(f"{path} was written by a newer oitlab: version {version}, known: {VERSION}")
        return True
    if blank_will_do and not tables and application in (0, APPLICATION_ID):
        return False
    raise ValueError(f"{path} is a database of something else, not a study of oitlab.sweep")


def _version(connection: sqlite3.Connection) -> int:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors of SQLite as oitlab's, with the file's name."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise OSError(f"{path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise ValueError(f"{path} is no study of oitlab.sweep, or is damaged: {error}") from error


def _cells(row: Row) -> Iterator[Any]:
    numbers = {name: value if math.isfinite(value) else repr(value) for name, value in row["metrics"].items()}
    strict = {**row, "metrics": numbers}  # JSON has no infinity, and SQLite's functions want JSON
    for name in _COLUMNS:
        yield json.dumps(strict[name], default=repr, allow_nan=False) if name in _JSON else row[name]


def _row(cells: Iterable[Any]) -> Row:
    row = dict(zip(_COLUMNS, cells, strict=True))
    for name in _JSON:
        row[name] = json.loads(row[name])
    params = row["params"].items()
    row["params"] = {name: tuple(value) if isinstance(value, list) else value for name, value in params}
    row["metrics"] = {name: float(value) for name, value in row["metrics"].items()}
    return row


def named_row(row: Mapping[str, Any], scene: str) -> Row:
    """Give a row the name of its scene."""
    return {**row, "scene": scene}
