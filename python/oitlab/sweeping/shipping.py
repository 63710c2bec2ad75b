"""Tasks on their way to the workers of an executor, and rows on their way back.

Everything travels as bytes of cloudpickle, so that functions of notebooks arrive, too. A scene is written
to a file once; a worker that does not see the file (on another machine) says so and is sent the scene itself.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import tempfile
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from threading import Lock

from .custom import receive, shippable
from .work import Package, Row, Task

KEPT = 4
"""Scenes that a worker keeps."""
_POLL_SECONDS = 0.5

_lock = Lock()
_kept: OrderedDict[str, Package] = OrderedDict()
_own: dict[str, Package] = {}
"""Of sweeps that run in this very process, whose threads may be the workers."""


def _forget() -> None:
    """In a forked process, whose parent may have held the lock."""
    global _lock
    _lock = Lock()
    _own.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def run_shipped(message: bytes, scene: bytes | None = None) -> bytes | None:
    """Run a task in a worker.

    Parameters
    ----------
    message : bytes
        Pickle of techniques, task and the scene's file.
    scene : bytes, optional
        The scene itself.

    Returns
    -------
    bytes or None
        Pickle of (key, row) pairs; None if the scene is needed.
    """
    techniques, task, path = pickle.loads(message)
    package = _package(task.package, path, scene)
    if package is None:
        return None
    receive(techniques)
    return pickle.dumps(list(task.rows(package)))


def _package(key: str, path: str, scene: bytes | None) -> Package | None:
    with _lock:
        package = _own.get(key) or _kept.get(key)
        if package is None:
            data = scene
            if data is None:
                with contextlib.suppress(OSError):
                    data = Path(path).read_bytes()
            if data is None:
                return None
            package = pickle.loads(data)
            _kept[key] = package
        if key in _kept:
            _kept.move_to_end(key)
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
        return package


def completed(
    executor: Executor, tasks: list[Task], packages: Mapping[str, Package]
) -> Iterator[list[tuple[str, Row]]]:
    """Run tasks and give each one's rows as it finishes.

    When the generator is closed, tasks that have not begun are cancelled.
    """
    with _shared_files(packages) as paths:
        messages = {index: _message(task, paths[task.package]) for index, task in enumerate(tasks)}
        pending: dict[Future[bytes | None], int] = {}
        try:
            for index, message in messages.items():
                pending[executor.submit(run_shipped, message)] = index
            while pending:
                finished, _ = wait(pending, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
                failed: BaseException | None = None
                for future in finished:
                    index = pending.pop(future)
                    if future.exception() is not None:
                        failed = future.exception()
                        continue
                    rows = future.result()
                    if rows is None:
                        scene = Path(paths[tasks[index].package]).read_bytes()
                        pending[executor.submit(run_shipped, messages[index], scene)] = index
                    else:
                        yield pickle.loads(rows)
                if failed is not None:  # after what has been finished besides
                    raise failed
        finally:
            for future in pending:
                future.cancel()


def _message(task: Task, path: str) -> bytes:
    import cloudpickle

    own = shippable(variant.technique for variant in task.variants)
    message: bytes = cloudpickle.dumps((own, task, path))
    return message


@contextlib.contextmanager
def _shared_files(packages: Mapping[str, Package]) -> Iterator[dict[str, str]]:
    import cloudpickle

    with tempfile.TemporaryDirectory(prefix="oitlab-sweep-", ignore_cleanup_errors=True) as folder:
        paths = {key: str(Path(folder, f"{key}.pickle")) for key in packages}
        for key, package in packages.items():
            Path(paths[key]).write_bytes(cloudpickle.dumps(package, protocol=pickle.HIGHEST_PROTOCOL))
        with _lock:
            _own.update(packages)
        try:
            yield paths
        finally:
            with _lock:
                for key in packages:
                    _own.pop(key, None)
