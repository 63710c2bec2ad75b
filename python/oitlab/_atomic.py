"""Files that are replaced whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import time
from collections.abc import Iterator
from pathlib import Path

_NAME_BYTES = 200
_STALE_SECONDS = 24 * 3600.0


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes `path`'s place, on failure it is removed.

    The temporary file lies in the same folder, so that the final rename never crosses a file system, and
    is flushed to disk before the rename: a crash at any moment leaves the old file or the new one. A writer
    that is killed leaves its temporary file `.NAME.<12 hex digits>.tmp` behind; the next one for the same
    target removes those that are a day old. A symbolic link stays a link, its target is replaced.

    Parameters
    ----------
    path : path-like
        The file to write. Its folder must exist.

    Yields
    ------
    Path
        A path that does not exist yet. The body creates it.

    Raises
    ------
    FileNotFoundError
        The folder does not exist.
    IsADirectoryError
        `path` is a folder.
    OSError
        The body's own errors and those of the disk.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     target = pathlib.Path(folder, "a.txt")
    ...     with replacing(target) as temporary:
    ...         _ = temporary.write_text("whole")
    ...     target.read_text()
    'whole'
    """
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(
            f"cannot write {os.fspath(path)!r}: the folder {target.parent} does not exist"
        )
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {os.fspath(path)!r}: it is a folder")
    stem = f".{_shortened(target.name)}"
    temporary = target.with_name(f"{stem}.{secrets.token_hex(6)}.tmp")
    _remove_stale(target.parent, re.compile(re.escape(stem) + r"\.[0-9a-f]{12}\.tmp"))
    try:
        yield temporary
        _flush(temporary)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)
    _flush_folder(target.parent)


def _shortened(name: str) -> str:
    """Cut a name where its temporary file's name would exceed the 255 bytes that file systems take."""
    return name.encode(errors="surrogateescape")[:_NAME_BYTES].decode(errors="ignore")


def _remove_stale(folder: Path, pattern: re.Pattern[str]) -> None:
    """Remove what killed writers left; a file that cannot be removed is none of this writer's troubles."""
    oldest = time.time() - _STALE_SECONDS
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if pattern.fullmatch(entry.name) and entry.stat(follow_symlinks=False).st_mtime < oldest:
                os.unlink(entry.path)


def _flush(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    """Make the rename itself durable where the system lets a folder be opened (not on Windows)."""
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
