"""The quickstart notebook runs as it stands, in an empty directory, with the package that is installed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# Figures, which take longer than all else, are for `tests/cli/test_cli.py`; these are a pixel.
UNDRAWN = """
import PIL.Image as raster  # IPython has an Image, too
from lieednn_sim.evaluation import plots
for what in ("network", "tracking", "joints", "clearance"):
    setattr(plots, f"plot_{what}", lambda *given: raster.new("1", (1, 1)).save(given[-1]))
"""
PATH = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "quickstart.ipynb"


# Libraries of Jupyter warn about each other, and about their own kernels.
@pytest.mark.filterwarnings("default")
def test_the_quickstart_runs_and_is_committed_without_outputs(tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    pytest.importorskip("viser")
    monkeypatch.setenv("LIEEDNN_SIM_PACKAGE", "")  # it is installed
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "runtime"))
    notebook = nbformat.read(PATH, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(UNDRAWN))
    (tmp_path / "empty").mkdir()
    resources = {"metadata": {"path": tmp_path / "empty"}}
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    text = "".join(output.get("text", "") for output in outputs)
    assert "globally stable for every bias" in text
    pages = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert len(pages) == 1
    assert len(pages[0]) > 500_000  # the page in 3D, with its meshes and its player
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 3
