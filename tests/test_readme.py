"""What the README shows is true: its table is the registry's, its example runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import oitlab

ROOT = Path(__file__).parents[1]


def test_the_table_of_techniques_is_current() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "generate.py", "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        with oitlab.custom.temporary():
            exec(compile(block, "README.md", "exec"), {})


def test_every_citation_is_in_the_bibliography() -> None:
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "references.bib").read_text(), re.MULTILINE))
    for entry in oitlab.techniques():
        assert set(entry.citation) <= keys, entry.id
    for path in [*ROOT.glob("python/oitlab/**/*.py"), ROOT / "README.md", ROOT / "DESIGN.md"]:
        cited = re.findall(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d)\]", path.read_text())
        assert set(cited) <= keys, path.name
