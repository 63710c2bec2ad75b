"""Frames and figures show themselves in notebooks."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import handmade
import oitlab
from oitlab._image import srgb_bytes


def decoded(data: bytes | None) -> Any:
    assert data is not None
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image)


def test_a_frame_shows_itself_as_write_png_writes_it(frames: list[oitlab.Frame], tmp_path: Path) -> None:
    for frame in (*frames, oitlab.render(oitlab.scenes.squares(width=9, height=5), "wboit", dtype="float64")):
        oitlab.write_png(tmp_path / "a.png", frame)
        assert frame._repr_png_() == (tmp_path / "a.png").read_bytes()


@pytest.mark.parametrize("color", [1e30, -5.0, np.inf, 0.5])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_frame_shows_itself(color: float, dtype: Any) -> None:
    pixel = decoded(handmade.frame(np.full((1, 1, 3), color, dtype))._repr_png_())
    wanted = {1e30: [255] * 3, -5.0: [0] * 3, np.inf: [255, 0, 255], 0.5: [188] * 3}[color]
    assert pixel.tolist() == [[wanted]]


def test_a_huge_frame_is_reduced_by_a_whole_factor() -> None:
    color = np.zeros((3, 4097, 3), np.float32)
    color[:, ::3] = 30.0
    image = decoded(handmade.frame(color)._repr_png_())
    assert image.shape == (1, 1366, 3)
    assert (image[0, :-1] == srgb_bytes(np.array(1 / 3))).all()


def test_a_notebook_shows_figures_and_frames_once() -> None:
    import nbformat
    from nbclient import NotebookClient

    table = "pd.DataFrame({'technique': ['a', 'b'], 'total_ms': [1.0, 2.0], 'mse': [0.1, 0.01]})"
    cells = [
        f"import pandas as pd, oitlab\noitlab.plot.pareto({table})",
        "oitlab.render(oitlab.scenes.squares(width=16, height=9), 'wboit')",
        f"import matplotlib.pyplot as plt\noitlab.plot.pareto({table})",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "", "language": "python"}
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    for cell in notebook.cells:
        images = [output for output in cell.outputs if "image/png" in output.get("data", {})]
        assert len(images) == 1, cell
        assert not [output for output in cell.outputs if output.output_type in ("stream", "error")], cell
