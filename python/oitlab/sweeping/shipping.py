"""Tasks on their way to the workers of an executor, and rows on their way back.

Everything travels as bytes of cloudpickle, so that functions of notebooks arrive, too. A scene is written
to a file once; a worker that does not see the file (on another machine) says so and is sent the scene itself.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import tempfile
from collections import Counter, OrderedDict
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from threading import Lock
from typing import Any

from .._custom_shipping import another_version
from .._fingerprint import fingerprint
from .custom import receive, shippable
from .work import Package, Row, Task, VariantFailed

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
        Pickle of techniques, task, the scene's file and fingerprints.
    scene : bytes, optional
        The scene itself.

    Returns
    -------
    bytes or None
        Pickle of (key, row) pairs and of what failed, if anything; None if the scene is needed.

    Raises
    ------
    RuntimeError
        Functions that came by name are not here what they are there.
    """
    techniques, task, path, prints = pickle.loads(message)
    package = _package(task.package, path, scene)
    if package is None:
        return None
    receive(techniques)
    functions = {**functions_of(task), **functions_of_reference(package)}
    for what, value in functions.items():  # before they run, which may change what they hold
        if fingerprint(value) != prints[what]:
            raise RuntimeError(another_version(what, value))
    rows: list[tuple[str, Row]] = []
    failed = None
    try:
        rows.extend(task.rows(package))
    except VariantFailed as error:
        failed = error, _portable(error.__cause__)
    return pickle.dumps((rows, failed))


def _portable(error: BaseException | None) -> BaseException | None:
    """Give an error as it can be pickled: some cannot, and some cannot be made again."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def functions_of(task: Task) -> dict[str, Any]:
    """Give the user's functions in a task's params and metrics, by what they are."""
    functions = {}
    for index, variant in enumerate(task.variants):
        for name, value in variant.params.items():
            if callable(value):
                functions[f"{variant.technique}'s {name!r} (variant {index})"] = value
    return functions | {f"metric {name!r}": value for name, value in task.measure.functions.items()}


def functions_of_reference(package: Package) -> dict[str, Any]:
    """Give the user's functions in a reference's params."""
    params = (package.reference[1] or {}) if isinstance(package.reference, tuple) else {}
    return {f"the reference's {name!r}": value for name, value in params.items() if callable(value)}


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
) -> Generator[list[tuple[str, Row]], None, None]:
    """Run tasks and give each one's rows as it finishes.

    When the generator is closed, tasks that have not begun are cancelled.
    """
    with _shared_files(packages) as paths:
        messages = {
            index: _message(task, packages[task.package], paths[task.package])
            for index, task in enumerate(tasks)
        }
        pending: dict[Future[bytes | None], int] = {}
        left = Counter(task.package for task in tasks)
        try:
            for index, message in messages.items():
                pending[executor.submit(run_shipped, message)] = index
            while pending:
                finished, _ = wait(pending, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
                failed: BaseException | None = None
                for future in sorted(finished, key=pending.__getitem__):
                    index = pending.pop(future)
                    if future.exception() is not None:
                        failed = future.exception()
                        continue
                    rows = future.result()
                    if rows is None:
                        scene = Path(paths[tasks[index].package]).read_bytes()
                        pending[executor.submit(run_shipped, messages[index], scene)] = index
                        continue
                    left[tasks[index].package] -= 1
                    if not left[tasks[index].package]:
                        packages[tasks[index].package].forget()
                    done, problem = pickle.loads(rows)
                    yield done
                    if problem is not None and failed is None:
                        failed, failed.__cause__ = problem
                if failed is not None:  # after what has been finished besides
                    raise failed
        finally:
            for future in pending:
                future.cancel()


def _message(task: Task, package: Package, path: str) -> bytes:
    import cloudpickle

    reference = [package.reference[0]] if isinstance(package.reference, tuple) else []
    own = shippable([*(variant.technique for variant in task.variants), *reference])
    functions = {**functions_of(task), **functions_of_reference(package)}
    prints = {what: fingerprint(value) for what, value in functions.items()}
    message: bytes = cloudpickle.dumps((own, task, path, prints))
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
