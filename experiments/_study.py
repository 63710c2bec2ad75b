"""What the studies share: command line, provenance, files, and the look of the plots."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from oitlab._palette import BLACK, BLUE, GREEN, GREY, ORANGE, PINK, RED, SKY, YELLOW
from oitlab._provenance import provenance

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

__all__ = [
    "BLACK", "BLUE", "CHECKOUT", "GREEN", "GREY", "ORANGE", "PINK", "RED", "SKY", "YELLOW",
    "Study", "markdown_table", "plot_style", "show_image", "srgb", "stop", "three_digits",
]  # fmt: skip

CHECKOUT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Study:
    """One run of a study: where its files go and how large it is."""

    name: str
    folder: Path
    quick: bool

    @classmethod
    def from_command_line(cls, name: str, description: str | None) -> Study:
        """Read `--quick` and `--output`; the folder is made."""
        parser = argparse.ArgumentParser(description=description.splitlines()[0] if description else None)
        parser.add_argument("--quick", action="store_true", help="a small run that shows that all works")
        parser.add_argument(
            "--output", type=Path, default=CHECKOUT / "docs" / name, help="folder (default docs/%(prog)s)"
        )
        parser.prog = name
        arguments = parser.parse_args()
        arguments.output.mkdir(parents=True, exist_ok=True)
        return cls(name, arguments.output, arguments.quick)

    def save_figure(self, figure: Figure, name: str) -> None:
        """Write a figure as PNG at print resolution."""
        figure.savefig(self.folder / name, dpi=100 if self.quick else 200)
        plt.close(figure)

    def save(self, results: dict[str, Any], markdown: str) -> None:
        """Write results.json and table.md, both with the machine, versions, date and commit."""
        command = f"python experiments/{self.name}.py" + (" --quick" if self.quick else "")
        about = {"command": command, **provenance()}
        path = self.folder / "results.json"
        text = json.dumps({"about": about, **results}, indent=1, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")
        (self.folder / "table.md").write_text(f"{markdown}\n\n{_footer(about)}\n", encoding="utf-8")
        print(markdown, f"\n\n{_footer(about)}\n\nwritten: {self.folder}", sep="")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out a Markdown table: the first column to the left, the others to the right."""
    lines = [header, [":--", *["--:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def three_digits(value: float) -> str:
    """Show three significant digits without an exponent where the number is of everyday size."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.2g}"
    digits = 2 if value == 0 else max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{digits}f}"


def plot_style() -> None:
    """Set type for a page that is 18 cm wide."""
    plt.rcParams.update(
        {
            "font.size": 8,
            "axes.titlesize": 8.5,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#dddddd",
            "grid.linewidth": 0.5,
            "lines.linewidth": 1.3,
            "legend.frameon": False,
            "figure.constrained_layout.use": True,
        }
    )


def srgb(linear: Any) -> Any:
    """Encode linear RGB for display, clipped to [0, 1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def show_image(axes: Any, image: Any, title: str = "", **keywords: Any) -> Any:
    """Draw an image without ticks; the frame stays, so that dark images have an edge."""
    drawn = axes.imshow(image, interpolation="nearest", **keywords)
    axes.set(xticks=[], yticks=[], title=title)
    axes.grid(visible=False)
    axes.spines[:].set(visible=True, linewidth=0.5, color=GREY)
    return drawn


def stop(message: str) -> None:
    """End the study with a message and no traceback."""
    print(message, file=sys.stderr)
    raise SystemExit(2)


def _footer(about: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    commit = about["commit"] or "unknown"
    return (
        f"`{about['command']}`, {about['date']}, commit {commit}, {about['cpu']}, {about['cores']} "
        f"cores, load average {about['load_average']}, {about['system']}; {versions}."
    )
