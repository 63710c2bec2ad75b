"""Execute the notebooks, at full size and in place, or reduced and without keeping what they show.

Run it as `python notebooks/run.py` or `make notebooks`; `--small` is what the tests do.
"""

import argparse
import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
SMALL = "OITLAB_SMALL"
"""Notebooks reduce images, seeds and sweeps where this variable is set."""


def execute(path: Path, *, small: bool, timeout: int = 1800) -> nbformat.NotebookNode:
    """Run all cells of a notebook in a fresh kernel.

    Raises nbclient's CellExecutionError, with the cell and its traceback, where one fails.
    """
    notebook = nbformat.read(path, as_version=4)
    environment = {name: value for name, value in os.environ.items() if name != SMALL}
    if small:
        environment[SMALL] = "1"
    # a machine's name and times would make every run a change
    client = NotebookClient(
        notebook,
        timeout=timeout,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(HERE)}},
    )
    client.execute(env=environment)
    return notebook


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(HERE.glob("*.ipynb")))
    parser.add_argument("--small", action="store_true", help="reduced, and nothing is written")
    arguments = parser.parse_args()
    for path in arguments.notebooks:
        begin = time.perf_counter()
        notebook = execute(path, small=arguments.small)
        if not arguments.small:
            nbformat.write(notebook, path)
        print(f"{path.name}: {time.perf_counter() - begin:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
