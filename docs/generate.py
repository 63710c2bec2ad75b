"""Rewrite the generated parts of README.md from the registry; `--check` says whether they are current."""

import argparse
import sys
from pathlib import Path

import oitlab

README = Path(__file__).parents[1] / "README.md"
MESHES = Path(__file__).parent / "real_meshes" / "table.md"


def between(text: str, name: str) -> tuple[str, str, str]:
    """Split at the markers of a generated part: before, inside and after."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->\n"
    head, rest = text.split(begin)
    inside, tail = rest.split(end)
    return head + begin, inside, end + tail


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


def mesh_table() -> str:
    """Take the table of the study of real meshes, with what it was measured on."""
    _, table, after = between(MESHES.read_text(), "real_meshes")
    return f"{table}\n{after.strip().splitlines()[-1]}\n"


def current(text: str) -> str:
    """Renew the generated parts of the README."""
    for name, part in (("techniques", technique_table()), ("real meshes", mesh_table())):
        head, _, tail = between(text, name)
        text = head + part + tail
    return text


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
