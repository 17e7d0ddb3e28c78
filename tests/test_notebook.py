"""The quickstart notebook runs as it stands, in an empty directory, with the package that is installed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

PATH = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "quickstart.ipynb"


# IPython's own warnings are not ours.
@pytest.mark.filterwarnings("default")
@pytest.mark.usefixtures("no_plots")
def test_the_quickstart_runs_and_is_committed_without_outputs(tmp_path, monkeypatch):
    shells, capture = pytest.importorskip("IPython.core.interactiveshell"), pytest.importorskip("IPython.utils.capture")
    pytest.importorskip("viser")
    monkeypatch.setenv("LIEEDNN_SIM_PACKAGE", "")  # it is installed
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    cells = json.loads(PATH.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    shell, outputs, text = shells.InteractiveShell.instance(), [], ""
    shell.history_manager.enabled = False
    try:
        for cell in cells:
            if cell["cell_type"] == "code":
                with capture.capture_output() as captured:
                    done = shell.run_cell("".join(cell["source"]))
                done.raise_error()
                outputs += [output.data for output in captured.outputs]
                text += captured.stdout
    finally:
        shells.InteractiveShell.clear_instance()
    assert "globally stable for every bias" in text
    pages = [data["text/html"] for data in outputs if "text/html" in data]
    assert len(pages) == 1
    assert len(pages[0]) > 500_000  # the page in 3D, with its meshes and its player
    assert sum("image/png" in data for data in outputs) >= 3
