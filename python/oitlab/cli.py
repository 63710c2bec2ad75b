"""The command line: `oitlab render`, `compare`, `techniques`, `demo`, `stress` and `sweep`.

A scene is a mesh file or `scene:NAME`, one of the procedural scenes of `oitlab.scenes`. Every error is one
line on stderr and exit status 2.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from . import _stress_command, _sweep_command
from ._scene_option import PREFIX, add_scene, add_size, scene_of
from ._variant_text import parse_param, parse_variant, split_variants

if TYPE_CHECKING:
    from .frame import Frame
    from .report import Comparison
    from .scene import Scene

__all__ = ["main", "parse_param", "parse_variant", "split_variants"]

_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; `sys.argv[1:]` when absent.

    Returns
    -------
    int
        0 on success, 2 after an error (printed on stderr), 130 after Ctrl-C.

    Examples
    --------
    >>> main(["techniques", "--ids"])
    a_buffer
    ...
    0
    """
    options = _parser().parse_args(arguments)
    try:
        with _plain_warnings():
            for name in options.imports:
                _import(name)
            options.run(options)
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output went away: `oitlab techniques | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ValueError, OSError, ImportError, MemoryError, RuntimeError) as error:
        print(f"oitlab: error: {str(error) or type(error).__name__}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("oitlab: interrupted", file=sys.stderr)
        return _INTERRUPTED
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="oitlab", description="The lab bench for order-independent transparency."
    )
    parser.add_argument(
        "--import",
        dest="imports",
        action="append",
        default=[],
        metavar="FILE.py|MODULE",
        help="run this first: it registers techniques of your own; repeatable",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_render(commands)
    _add_compare(commands)
    _add_techniques(commands)
    _add_demo(commands)
    _stress_command.add(commands)
    _sweep_command.add(commands)
    return parser


def _import(name: str) -> None:
    """Import a module, or a file by its path."""
    if not name.endswith(".py"):
        importlib.import_module(name)
        return
    path = Path(name).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"--import: no file {name}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"--import: {name} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


def _add_render(commands: Any) -> None:
    command = commands.add_parser("render", help="render a scene with one technique")
    add_scene(command)
    command.add_argument(
        "--technique", default="a_buffer", metavar="ID", help="default: a_buffer, the exact image"
    )
    command.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="repeatable; several numbers as in range=1,2",
    )
    command.add_argument("-o", "--output", type=Path, metavar="FILE", help="write FILE.exr or FILE.png")
    command.add_argument(
        "--png", nargs="?", const="", metavar="FILE", help="also a PNG, by default beside the output"
    )
    command.add_argument(
        "--exposure", type=float, default=0.0, metavar="STOPS", help="of the PNG; default: 0"
    )
    command.add_argument("--half", action="store_true", help="16-bit floats in the EXR")
    command.add_argument(
        "--reference", metavar="ID", help="measure against this technique, keep the error map"
    )
    _add_backend(command)
    command.set_defaults(run=_render)


def _add_compare(commands: Any) -> None:
    command = commands.add_parser("compare", help="compare techniques with the exact image")
    add_scene(command)
    command.add_argument(
        "--techniques",
        metavar="A,B,...",
        help="ids, with parameters as in lwboit:bins=64:range=[1,2]; default: all that the backend has",
    )
    command.add_argument("--reference", default="a_buffer", metavar="ID", help="default: a_buffer")
    command.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="write EXR, contact sheet and CSV there"
    )
    _add_backend(command)
    command.set_defaults(run=_compare)


def _add_backend(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--backend", choices=("cpu", "gpu"), default="cpu", help="default: cpu; references are rendered on it"
    )


def _add_techniques(commands: Any) -> None:
    command = commands.add_parser("techniques", help="list the techniques, or describe some")
    command.add_argument("ids", nargs="*", metavar="ID", help="describe these")
    command.add_argument("--ids", dest="only_ids", action="store_true", help="print nothing but the ids")
    command.add_argument(
        "--axes",
        action="store_true",
        help="show their places on the axes of Wyman's Table 1, and what they promise",
    )
    command.set_defaults(run=_techniques)


def _add_demo(commands: Any) -> None:
    command = commands.add_parser("demo", help="compare all techniques on three scenes")
    command.add_argument(
        "-o", "--output", type=Path, default=Path("out/demo"), metavar="FOLDER", help="default: out/demo"
    )
    add_size(command)
    _add_backend(command)
    command.set_defaults(run=_demo)


def _render(options: argparse.Namespace) -> None:
    from .metrics import compare
    from .rendering import check_variants, render_many

    targets = _targets(options)
    params = dict(map(parse_param, options.param))
    scene = scene_of(options)
    wanted = [(options.technique, params)]
    references: list[tuple[str, dict[str, Any]]] = [(options.reference, {})] if options.reference else []
    if options.backend == "cpu":
        frame, *exact = render_many(scene, wanted + references, threads=options.threads)
    else:
        check_variants(scene, references)
        (frame,) = render_many(scene, wanted, backend=options.backend, threads=options.threads)
        exact = render_many(scene, references, threads=options.threads)
    for target in targets:
        _write(target, frame, exact[0] if exact else None, options)
    stats = frame.stats
    print(f"{frame.technique}: raster {stats.raster_ms:.1f} ms, resolve {stats.resolve_ms:.1f} ms")
    for name, value in (compare(frame, exact[0]) if exact else {}).items():
        print(f"{name}: {value:.6g}")


def _targets(options: argparse.Namespace) -> list[Path]:
    """Give the files to write, refused before anything is rendered if they cannot be."""
    targets = [options.output] if options.output else []
    if options.png is not None:
        if not options.png and not options.output:
            raise ValueError("--png: name its file, or give --output")
        targets.append(Path(options.png) if options.png else options.output.with_suffix(".png"))
    if not targets:
        raise ValueError("nothing to write: give --output FILE.exr or --png FILE.png")
    for index, target in enumerate(targets):
        allowed = (".exr", ".png") if index == 0 and options.output else (".png",)
        if target.suffix.lower() not in allowed:
            raise ValueError(f"{target}: expected a name that ends in {' or '.join(allowed)}")
        if not target.parent.is_dir():
            raise FileNotFoundError(f"{target}: the folder {target.parent} does not exist")
    return list(dict.fromkeys(targets))


def _write(target: Path, frame: Frame, exact: Frame | None, options: argparse.Namespace) -> None:
    from .exr import write_exr
    from .png import write_png

    if target.suffix.lower() == ".exr":
        write_exr(target, frame, reference=exact, half=options.half)
    else:
        write_png(target, frame, exposure=options.exposure)
    print(f"wrote {target}")


def _compare(options: argparse.Namespace) -> None:
    names = options.techniques
    every = _all_techniques(options.backend)
    variants = every if names is None else [parse_variant(text) for text in split_variants(names)]
    scene = scene_of(options)
    title = Path(options.scene.removeprefix(PREFIX)).name
    comparison = _measured(scene, variants, title, options.threads, options.reference, options.backend)
    _print_table(comparison, title)
    if options.output:
        _write_folder(options.output, comparison, Path(title).stem, title)


def _techniques(options: argparse.Namespace) -> None:
    from .registry import TechniqueTable, techniques

    table = techniques()
    for name in options.ids:
        if name not in table:
            raise ValueError(f"unknown technique {name!r}; known: {', '.join(table.ids)}")
    chosen = TechniqueTable(table[name] for name in options.ids) if options.ids else table
    if options.only_ids:
        print("\n".join(chosen.ids))
    elif options.axes:
        print(chosen.axes_table())
    elif options.ids:
        print("\n\n".join(map(str, chosen)))
    else:
        print(table)


def _demo(options: argparse.Namespace) -> None:
    from . import scenes

    size = {"width": options.width, "height": options.height}
    for name in ("squares", "torus_knot", "blades"):
        scene, variants = scenes.SCENES[name](**size), _all_techniques(options.backend)
        comparison = _measured(scene, variants, name, options.threads, "a_buffer", options.backend)
        _print_table(comparison, name)
        _write_folder(options.output, comparison, name, name)


def _all_techniques(backend: str = "cpu") -> list[tuple[str, dict[str, Any]]]:
    from .registry import techniques

    return [(entry.id, {}) for entry in techniques() if backend in entry.backends]


def _measured(
    scene: Scene,
    variants: Sequence[tuple[str, dict[str, Any]]],
    title: str,
    threads: int | None,
    reference: str,
    backend: Literal["cpu", "gpu"] = "cpu",
) -> Comparison:
    from tqdm import tqdm

    from .rendering import check_variants
    from .report import compare_techniques

    check_variants(scene, [reference])
    check_variants(scene, variants, backend)  # before there is a bar
    with tqdm(total=len(variants), desc=title, unit="technique", file=sys.stderr, leave=False) as bar:

        def advance(label: str) -> None:
            bar.set_postfix_str(label, refresh=False)
            bar.update(min(1, len(variants) - bar.n))

        return compare_techniques(
            scene, variants, reference=reference, backend=backend, threads=threads, progress=advance
        )


def _print_table(comparison: Comparison, title: str) -> None:
    from rich.console import Console

    from .report import headline, table

    print(headline(comparison, title))
    view = table(comparison)
    natural = (
        Console(width=10_000).measure(view).maximum
    )  # rich would rather cut columns off than exceed the width
    Console(width=natural, highlight=False).print(view)


def _write_folder(folder: Path, comparison: Comparison, stem: str, title: str) -> None:
    """Write `stem`.csv, `stem`.png and one EXR with its error map per technique."""
    from .exr import write_exr
    from .report import headline, write_csv
    from .sheet import write_contact_sheet

    folder.mkdir(parents=True, exist_ok=True)
    for row, frame in zip(comparison.rows, comparison.frames, strict=True):
        write_exr(folder / f"{stem}-{_file_name(row.label)}.exr", frame, reference=comparison.reference)
    write_csv(folder / f"{stem}.csv", comparison)
    write_contact_sheet(folder / f"{stem}.png", comparison, headline(comparison, title))
    print(f"wrote {folder / stem}.png, .csv and {len(comparison.rows)} EXR files\n")


def _file_name(label: str) -> str:
    """Keep what is safe in a file name: "lwboit bins=64" becomes "lwboit-bins=64"."""
    return "".join(c if c.isalnum() or c in "._=-" else "-" for c in label)


@contextlib.contextmanager
def _plain_warnings() -> Iterator[None]:
    """Print warnings as one line without the place in the code they come from."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"oitlab: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
