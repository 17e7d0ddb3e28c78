"""Every example of the gallery runs as a script in an empty directory, prints something, leaves something to see."""

from __future__ import annotations

import runpy
from pathlib import Path

import matplotlib
import pytest

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "gallery"
SHOWN = {".png", ".jpg", ".html"}
# What needs OpenGL says so by one of these.
RENDERS = ("render_still", "render_video", ".render(")


def examples() -> list:
    found = sorted(GALLERY.glob("*.py"))
    return [
        pytest.param(
            path, id=path.stem, marks=[pytest.mark.rendering] if any(w in path.read_text() for w in RENDERS) else []
        )
        for path in found
    ]


@pytest.mark.parametrize("script", examples())
def test_example(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    from matplotlib import pyplot as plt  # after the backend

    plt.close("all")
    runpy.run_path(str(script), run_name="__main__")
    figures = plt.get_fignums()
    plt.close("all")
    assert figures or any(path.suffix in SHOWN for path in tmp_path.rglob("*"))
    assert capsys.readouterr().out.strip()
