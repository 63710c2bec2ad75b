"""Fingerprints, other processes, the command line and documents."""

import io
import pickle
import re
import textwrap
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import _custom_examples as examples
import oitlab
from oitlab import custom
from oitlab.cli import main

# fingerprints and other processes

LEVEL = 0.5


def test_a_fingerprint_follows_what_the_function_computes() -> None:
    def of(source: str, **names: Any) -> str | None:
        scope = {"np": np, "__name__": "__main__", **names}
        exec(textwrap.dedent(source), scope)
        with custom.temporary():
            oitlab.technique(scope["mine"])
            return oitlab.techniques()["mine"].fingerprint

    base = "def mine(batch, *, k=1):\n    return np.full((len(batch), 3), 0.5 * k), half(batch)\n"
    helper = "def half(batch):\n    return np.full(len(batch), 0.5)\n"
    same = of(base + helper)
    assert same == of(helper + "\n\n" + base.replace(":\n", ":\n    # a comment\n", 1))
    assert isinstance(same, str)
    changes = {
        same,
        of(base.replace("0.5", "0.25") + helper),
        of(base.replace("k=1", "k=2") + helper),
        of(base.replace("full", "empty", 1) + helper),
        of(base + helper.replace("0.5", "0.25")),
        of(base.replace("0.5", "LEVEL") + helper, LEVEL=0.5),
        of(base.replace("0.5", "LEVEL") + helper, LEVEL=0.25),
        of(base.replace("0.5", "LEVEL[0]") + helper, LEVEL=np.array([0.5])),
        of(base.replace("0.5", "LEVEL[0]") + helper, LEVEL=np.array([0.25])),
        of(base.replace("0.5", "LEVEL['a']") + helper, LEVEL={"a": 0.5}),
        of(base.replace("0.5", "LEVEL['a']") + helper, LEVEL={"a": 0.25}),
        of(base + "class Half:\n  k = 0.5\n  def __call__(self, batch): return self.k\nhalf = Half()\n"),
        of(base + "class Half:\n  k = 0.25\n  def __call__(self, batch): return self.k\nhalf = Half()\n"),
        of(base + "class Half:\n  k = 0.5\n  def __call__(self, batch): return -self.k\nhalf = Half()\n"),
    }
    assert len(changes) == 14


def test_a_fingerprint_follows_numba_and_options() -> None:
    prints = set()
    for options in (
        {},
        {"order": "submission"},
        {"exact_for_one": True},
        {"transmittance": examples.over_curve},
    ):
        oitlab.technique(**options)(examples.numba_over)
        prints.add(oitlab.techniques()["numba_over"].fingerprint)
    oitlab.technique(examples.numpy_over)
    oitlab.technique(id="numba_over")(examples.numpy_over)
    prints.add(oitlab.techniques()["numba_over"].fingerprint)
    assert len(prints) == 5


def rendered_elsewhere(shipment: Any, fragments: oitlab.Fragments, params: Any) -> tuple[Any, Any]:
    first = custom.receive(pickle.loads(shipment))
    definition = oitlab.techniques()[first].definition
    assert custom.receive(pickle.loads(shipment)) == first
    assert oitlab.techniques()[first].definition is definition
    frame = oitlab.render(fragments, first, params)
    return frame.color, oitlab.techniques()[first].fingerprint


def test_other_processes_render_the_same(mine: list[str], fragments: oitlab.Fragments) -> None:
    table = np.linspace(0, 1, 5)

    @oitlab.technique
    def closure(batch: oitlab.Batch, *, k: int = 2) -> tuple[Any, Any]:
        color, share = examples.numba_over(batch)
        return color + table[k] * LEVEL, share

    @oitlab.technique(params={"k": oitlab.Param(1, min=0, max=4)})
    def closure_too(batch: oitlab.Batch, *, k: int) -> tuple[Any, Any]:
        return closure(batch, k=k)

    jobs: list[tuple[str, Any]] = [*((name, {}) for name in mine), ("closure", {"k": 4}), ("closure_too", {})]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for name, params in jobs:
            box = pickle.dumps(custom.shippable(name))
            color, fingerprint = pool.submit(rendered_elsewhere, box, fragments, params).result(120)
            np.testing.assert_array_equal(color, oitlab.render(fragments, name, params).color)
            assert fingerprint == oitlab.techniques()[name].fingerprint, name


def test_what_cannot_be_shipped_is_refused() -> None:
    with pytest.raises(ValueError, match="technique 'wboit' is built in"):
        custom.shippable("wboit")
    with pytest.raises(ValueError, match="technique 'nothing' is not registered"):
        custom.shippable("nothing")
    with pytest.raises(ValueError, match="shipment must come from"):
        custom.receive(b"")  # type: ignore[arg-type]
    lock = threading.Lock()
    oitlab.technique(lambda batch: (lock, None), id="locked")
    with pytest.raises(ValueError, match="technique 'locked' cannot be sent to another process"):
        custom.shippable("locked")
    assert oitlab.techniques()["locked"].fingerprint


# the command line and documents

PLUGIN = """
import numpy as np, oitlab

@oitlab.technique(citation=["Porter1984"])
def gray(batch, *, level=0.5):
    "The same gray everywhere."
    return np.full((len(batch), 3), level), np.ones(len(batch))
"""


def test_the_command_line_imports_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plugin = tmp_path / "plugin.py"
    plugin.write_text(PLUGIN)
    scene = ["scene:squares", "--width", "24", "--height", "16"]
    variants = ["--techniques", "gray:level=0.25,wboit", "-o", str(tmp_path)]
    assert main(["--import", str(plugin), "compare", *scene, *variants]) == 0
    assert "gray level=0.25" in capsys.readouterr().out
    assert (tmp_path / "squares.csv").read_text().count("gray level=0.25") == 1
    picture = ["--technique", "gray", "--param", "level=0.25", "-o", str(tmp_path / "a.exr")]
    assert main(["--import", str(plugin), "render", *scene, *picture]) == 0
    assert oitlab.read_exr(tmp_path / "a.exr").technique == "gray"
    capsys.readouterr()
    assert main(["--import", str(plugin), "techniques", "gray"]) == 0
    assert "The same gray everywhere." in capsys.readouterr().out
    for wrong, message in ((str(tmp_path / "none.py"), "none.py"), ("no_such_module", "no_such_module")):
        assert main(["--import", wrong, "techniques", "--ids"]) == 2
        assert re.search(message, capsys.readouterr().err)


def test_the_readme_example_runs() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    section = text.split("## A technique of your own")[1].split("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.S)
    output = io.StringIO()
    exec(code, {"print": lambda *values: print(*values, file=output), "__name__": "__main__"})
    assert "nearest" in oitlab.techniques()
    errors = [float(value) for value in re.findall(r"RMSE ([-\d.e]+)", output.getvalue())]
    assert len(errors) == 3
    assert errors[0] < 1e-6 < errors[1] < errors[2]
