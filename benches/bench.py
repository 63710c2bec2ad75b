"""`make bench` and `make bench-full`: how fast oitlab is beside others, how time grows, what memory it takes.

    python benches/bench.py peers skips          # what `make bench` runs
    python benches/bench.py                      # all parts
    python benches/bench.py pareto --quick       # small images, one repetition: shows that it works

Numbers are whole calls from Python to NumPy array. Compare ratios of one run, not milliseconds of different
days.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from pathlib import Path

from harness import Run
from peers import PEERS

PARTS = {"peers": "against_peers", "pareto": "pareto", "scaling": "scaling", "skips": "skips",
         "memory": "memory", "sweep": "sweep_time", "weights": "weights", "gpu": "gpu"}  # fmt: skip


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="small images, one repetition")
    parser.add_argument("--huge", action="store_true", help="scaling up to 3e8 fragments and 1e7 triangles")
    parser.add_argument("--repeats", type=int, help="timed frames (default 7, quick 1)")
    parser.add_argument("--output", type=Path, default=Path("out/bench"), help="folder (default %(default)s)")
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=PEERS, metavar="PEER",
                        help=f"of {', '.join(PEERS)} (default: all that are installed)")  # fmt: skip
    parser.add_argument("--peer-python", default=os.environ.get("OITLAB_PEER_PYTHON", sys.executable),
                        help="who has the peers (default $OITLAB_PEER_PYTHON, or this one)")  # fmt: skip
    parser.add_argument(
        "--budget", type=float, default=20.0, help="seconds of timed frames per peer and mode"
    )
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds after which a peer is given up")
    options = parser.parse_args()
    if unknown := set(options.parts) - PARTS.keys():
        parser.error(f"no part named {', '.join(sorted(unknown))}; the parts are {', '.join(PARTS)}")
    run = Run(
        options.output,
        quick=options.quick,
        huge=options.huge,
        repeats=options.repeats or (1 if options.quick else 7),
        peer_python=options.peer_python,
        peers=tuple(options.peers),
        budget=options.budget,
        timeout=options.timeout,
    )
    for part in options.parts or PARTS:
        print(f"# {part}\n", flush=True)
        importlib.import_module(PARTS[part]).main(run)
    print(f"written: {options.output}")


if __name__ == "__main__":
    main()
