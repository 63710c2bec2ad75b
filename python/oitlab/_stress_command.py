"""The command `oitlab stress`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    """Add `oitlab stress` to the commands."""
    command = commands.add_parser("stress", help="try techniques on layers that are hard on numbers")
    command.add_argument("ids", nargs="*", metavar="ID", help="default: all techniques")
    command.add_argument(
        "--formats", default="f32,f16,unorm8", metavar="A,B,...", help="storage formats; default: %(default)s"
    )
    command.add_argument("--seed", type=int, default=0, metavar="N", help="of colours and depths; default: 0")
    command.add_argument(
        "--tolerance",
        type=float,
        default=1 / 255,
        metavar="X",
        help="largest error that will do; default: 1/255",
    )
    command.add_argument("--threads", type=int, metavar="N", help="default: all")
    command.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FOLDER",
        help="write table.md, table.csv and error_against_layers.png there; default: print the tables",
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run it."""
    from tqdm import tqdm

    from . import _stress_report as report
    from .registry import techniques

    for name in options.ids:
        if name not in techniques():
            raise ValueError(f"unknown technique {name!r}; known: {', '.join(techniques().ids)}")
    names = list(dict.fromkeys(techniques()[name].id for name in options.ids)) or list(techniques().ids)
    formats = options.formats.split(",")
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
    with tqdm(total=len(names), unit="technique", file=sys.stderr, leave=False) as bar:

        def advance(name: str) -> None:
            bar.set_postfix_str(name, refresh=False)
            bar.update(int(name != names[0]))

        found = report.run(names, formats, options.seed, options.tolerance, options.threads, advance)
    if options.output:
        command = " ".join(["oitlab", "stress", *options.ids, *_changed(options)])
        for path in report.write(options.output, *found, command, options.tolerance):
            print(f"wrote {path}")
    else:
        print(report.markdown(found[0], options.tolerance))


def _changed(options: argparse.Namespace) -> list[str]:
    """Give the options of `oitlab stress` that decide what its tables say and are not the defaults."""
    usual = {"formats": "f32,f16,unorm8", "seed": 0, "tolerance": 1 / 255}
    return [
        f"--{name} {getattr(options, name)}"
        for name, value in usual.items()
        if getattr(options, name) != value
    ]
