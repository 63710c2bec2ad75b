"""The arguments of the command line that say what is drawn, and how large."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .scene import Scene

PREFIX = "scene:"
"""Of the names of procedural scenes."""


def add_scene(command: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the scene, or several, with what changes it."""
    what = "mesh files" if several else "a mesh file"
    command.add_argument(
        "scene",
        metavar="FILE",
        nargs="+" if several else None,
        help=f"{what}, or scene:NAME (squares, soup, ...)",
    )
    command.add_argument(
        "--opacity", type=float, metavar="ALPHA", help="replace every alpha of the file, in [0, 1]"
    )
    command.add_argument("--seed", type=int, metavar="N", help="of a procedural scene")
    command.add_argument("--background", type=float, nargs=3, metavar=("R", "G", "B"), help="linear")
    add_size(command)


def add_size(command: argparse.ArgumentParser) -> None:
    """Add the image's size and the number of threads."""
    command.add_argument("--width", type=int, default=1280, metavar="PIXELS")
    command.add_argument("--height", type=int, default=720, metavar="PIXELS")
    command.add_argument("--threads", type=int, metavar="N", help="default: all")


def scene_of(options: argparse.Namespace, name: str | None = None) -> Scene:
    """Make the scene of the options, or one of several by its name.

    Raises
    ------
    ValueError
        An unknown procedural scene, or options that do not go with it.
    OSError
        A file that cannot be read.
    """
    name = options.scene if name is None else name
    changes: dict[str, Any] = {"width": options.width, "height": options.height}
    if options.background is not None:
        changes["background"] = tuple(options.background)
    if not name.startswith(PREFIX):
        if options.seed is not None:
            raise ValueError("--seed: only for procedural scenes")
        from .loading import load

        return load(name, opacity=options.opacity, **changes)
    if options.opacity is not None:
        raise ValueError("--opacity: only for mesh files, a procedural scene has its own alphas")
    make = _procedural(name.removeprefix(PREFIX))
    return make(seed=options.seed or 0).replace(**changes)


def _procedural(name: str) -> Callable[..., Scene]:
    from .scenes import SCENES

    if name not in SCENES:
        raise ValueError(f"unknown scene {name!r}; known: {', '.join(SCENES)}")
    return SCENES[name]
