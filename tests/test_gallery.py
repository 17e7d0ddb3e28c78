"""Every example of the gallery without a kept page runs in an empty directory, prints something, leaves something."""

from __future__ import annotations

import runpy
from pathlib import Path

import matplotlib
import pytest

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "gallery"
# Pages of examples that nobody can run here, since they need models that are not the project's.
KEPT = GALLERY.parent / "_static" / "kept"
SHOWN = {".png", ".jpg", ".html"}
# What needs OpenGL says so by one of these.
RENDERS = ("render_still", "render_video", ".render(")


def examples() -> list:
    kept = {path.stem for path in KEPT.glob("*.html")}
    found = [path for path in sorted(GALLERY.glob("*.py")) if path.stem not in kept]
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


@pytest.mark.parametrize("page", sorted(KEPT.glob("*.html")), ids=lambda path: path.stem)
def test_example_with_a_kept_page(page: Path) -> None:
    """The script shows its page, says when that was made and names the models' licence; the files are small."""
    text = (GALLERY / f"{page.stem}.py").read_text()
    compile(text, page.stem, "exec")
    assert f'src="../../_static/kept/{page.name}"' in text
    assert f"sphinx_gallery_thumbnail_path = '_static/kept/{page.stem}.jpg'" in text
    assert "by hand: on " in text
    assert f"<../../_static/kept/{page.stem}.license.txt>" in text
    assert page.with_suffix(".license.txt").exists()
    assert page.stat().st_size < 3e6
    assert page.with_suffix(".jpg").stat().st_size < 2e5
