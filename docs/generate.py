"""Rewrite the generated parts of README.md from the registry; `--check` says whether they are current."""

import argparse
import sys
from pathlib import Path

import oitlab

README = Path(__file__).parents[1] / "README.md"
BEGIN, END = "<!-- techniques: begin -->\n", "<!-- techniques: end -->\n"


def technique_table() -> str:
    """Lay the registry out as a Markdown table."""
    lines = [
        "| id | name | source | passes | bytes per pixel | order-independent |",
        "|---|---|---|---|---|---|",
    ]
    for entry in oitlab.techniques():
        independent = "yes" if entry.properties["order_independent"] else "no"
        cells = (
            f"`{entry.id}`",
            entry.name,
            ", ".join(entry.citation),
            entry.geometry_passes,
            entry.bytes_per_pixel,
            independent,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def current(text: str) -> str:
    """Renew the generated part of the README."""
    head, rest = text.split(BEGIN)
    _, tail = rest.split(END)
    return head + BEGIN + technique_table() + END + tail


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    old = README.read_text()
    new = current(old)
    if not check:
        README.write_text(new)
    elif old != new:
        print("README.md is not current: run `make readme`", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
