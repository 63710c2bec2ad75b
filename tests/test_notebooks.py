"""The notebooks run, reduced, from an empty kernel; as committed they have run and say what they found."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def runner() -> ModuleType:
    spec = importlib.util.spec_from_file_location("run", NOTEBOOKS[0].parent / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def pictures(notebook: nbformat.NotebookNode) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


def conclusion(notebook: nbformat.NotebookNode) -> str:
    return str(outputs(notebook)[-1].get("data", {}).get("text/markdown", ""))


def test_there_are_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["1_quickstart", "2_weight_functions", "3_layered_wboit"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_reduced_and_concludes(path: Path, runner: ModuleType) -> None:
    notebook = runner.execute(path, small=True, timeout=300)
    committed = nbformat.read(path, as_version=4)
    assert pictures(notebook) == pictures(committed) > 0
    assert not any(output.get("name") == "stderr" for output in outputs(notebook))
    # the numbers in what was found come from the run, so they are there in a reduced one, too
    assert re.search(r"\d", conclusion(notebook))
    assert not re.search(r"\bnan\b", conclusion(notebook).lower())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_committed_as_it_ran(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    kinds = {output.output_type for output in outputs(notebook)}
    assert not kinds & {"error"}
    assert not any(output.get("name") == "stderr" for output in outputs(notebook))
    assert "found" in notebook.cells[-2].source.lower() or "found" in notebook.cells[-1].source.lower()
    assert conclusion(notebook).strip()
