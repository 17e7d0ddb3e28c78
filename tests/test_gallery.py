"""Examples of the gallery that nobody can run here, since they need models that are not the project's.

`make docs` runs all others, and stops where one fails.
"""

from __future__ import annotations

from pathlib import Path

import pytest

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "gallery"
KEPT = GALLERY.parent / "_static" / "kept"


@pytest.mark.parametrize("page", sorted(KEPT.glob("*.html")), ids=lambda path: path.stem)
def test_example_with_a_kept_page(page: Path) -> None:
    """The script shows its page, says when that was made and names the models' licence; the files are small."""
    text = (GALLERY / f"{page.stem}.py").read_text()
    compile(text, page.stem, "exec")
    assert f'src="../../_static/kept/{page.name}"' in text
    assert f"sphinx_gallery_thumbnail_path = '_static/kept/{page.stem}.jpg'" in text
    assert "The page was made on " in text
    assert f"<../../_static/kept/{page.stem}.license.txt>" in text
    assert page.with_suffix(".license.txt").exists()
    assert page.stat().st_size < 3e6
    assert page.with_suffix(".jpg").stat().st_size < 2e5
