"""The command `oitlab sweep`."""

from __future__ import annotations

import argparse
import sys
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._scene_option import PREFIX, add_scene, scene_of
from ._variant_text import parse_values, parse_variant, split_outside

if TYPE_CHECKING:
    import pandas as pd

    from .scene import Scene

_METRIC_OPTIONS = {
    "data_range": "largest difference of two channels, for psnr",
    "threshold": "error above which a pixel is bad; default: 1/255",
    "luminance": "of 1.0 in cd/m2, for delta_e_itp; default: 100",
    "pixels_per_degree": "of visual angle, for flip",
}


def add(commands: Any) -> None:
    """Add `oitlab sweep` to the commands."""
    command = commands.add_parser("sweep", help="try every combination of params, one row each")
    add_scene(command, several=True)
    command.add_argument(
        "--grid",
        action="append",
        required=True,
        metavar="ID:NAME=A,B",
        help="repeatable; wboit:weight=mb7,mb9:weight_shift=0,1 has four combinations; tuples in brackets",
    )
    command.add_argument(
        "--reference", default="a_buffer", metavar="ID", help="ID:NAME=VALUE; default: a_buffer"
    )
    command.add_argument("--metrics", metavar="A,B,...", help="of compare, or all; default: mse,max_error")
    for name, meaning in _METRIC_OPTIONS.items():
        command.add_argument(f"--{name.replace('_', '-')}", type=float, metavar="X", help=meaning)
    command.add_argument("--seeds", metavar="N,N,...", help="of what draws random numbers")
    command.add_argument("--repeats", type=int, default=1, metavar="N", help="renders, for times; default: 1")
    command.add_argument("--group", type=int, metavar="N", help="most variants that share a rasterisation")
    command.add_argument(
        "--store", type=Path, metavar="FILE", help="keep finished rows there, and do not repeat them"
    )
    command.add_argument(
        "--backend",
        default="cpu",
        metavar="A,B",
        help="cpu, gpu or cpu,gpu for rows of both; references are rendered on the cpu; default: cpu",
    )
    command.add_argument("--workers", type=int, metavar="N", help="render in that many processes")
    command.add_argument("-o", "--output", type=Path, metavar="FILE.csv", help="default: print the table")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run it; after Ctrl-C, what is finished is written all the same.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C.
    """
    from .sweeping import SweepFailed, SweepInterrupted, sweep

    _check_output(options.output)
    keywords = _keywords(options)
    with warnings.catch_warnings(record=True) as caught, ExitStack() as stack:
        warnings.filterwarnings("always", category=SweepInterrupted)
        keywords["executor"] = _executor(options.workers, stack)
        try:
            table = sweep(_scenes(options), _grid(options.grid), **keywords)
        except SweepFailed as error:
            _show(error.table, options.output)
            raise ValueError(str(error)) from error
    _show(table, options.output)
    stopped = [warning for warning in caught if issubclass(warning.category, SweepInterrupted)]
    for warning in caught:
        if warning not in stopped:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    if stopped:
        print(f"oitlab: {stopped[0].message}", file=sys.stderr)
        raise KeyboardInterrupt


def _check_output(path: Path | None) -> None:
    if path is None:
        return
    if path.suffix.lower() != ".csv":
        raise ValueError(f"{path}: expected a name that ends in .csv")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")


def _keywords(options: argparse.Namespace) -> dict[str, Any]:
    given = {name: getattr(options, name) for name in _METRIC_OPTIONS if getattr(options, name) is not None}
    metrics = options.metrics
    return {
        "reference": parse_variant(options.reference),
        "metrics": metrics.split(",") if metrics and metrics != "all" else metrics,
        "metric_options": given,
        "seeds": None if options.seeds is None else _integers(options.seeds),
        "repeats": options.repeats,
        "group": options.group,
        "threads": options.threads,
        "store": options.store,
        "backend": options.backend.split(","),
    }


def _integers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"--seeds: expected integers between commas, got {text!r}") from None


def _scenes(options: argparse.Namespace) -> dict[str, Scene]:
    """Scenes by their file's name, or by all of their path where two files share a name."""
    short = [Path(name.removeprefix(PREFIX)).name for name in options.scene]
    names = short if len(set(short)) == len(short) else options.scene
    if len(set(names)) < len(names):
        raise ValueError("a scene is named twice")
    return {name: scene_of(options, given) for name, given in zip(names, options.scene, strict=True)}


def _grid(texts: list[str]) -> list[tuple[str, dict[str, Any]]]:
    split = (split_outside(text, ":") for text in texts)
    return [(technique.strip(), dict(map(parse_values, settings))) for technique, *settings in split]


def _executor(workers: int | None, stack: ExitStack) -> Any:
    if workers is None:
        return None
    if workers < 1:
        raise ValueError(f"--workers must be at least 1, got {workers}")
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    return stack.enter_context(ProcessPoolExecutor(workers, mp_context=get_context("spawn")))


def _show(table: pd.DataFrame, output: Path | None) -> None:
    if output is not None:
        from ._atomic import replacing

        with replacing(output) as temporary:
            table.to_csv(temporary, index=False)
        print(f"wrote {output}: {len(table)} rows")
        return
    keys = [name for name in table.attrs["keys"] if name == "technique" or table[name].nunique() > 1]
    print(table[[*keys, *table.attrs["metrics"], "resolve_ms", "total_ms"]].to_string(index=False))
