"""Scripts that no other test runs, each on as little as it can do."""

from __future__ import annotations

import picture_arms
import pytest
import robustness
from PIL import Image


@pytest.mark.rendering
def test_the_picture_of_the_arms(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(picture_arms, "SIZE", (64, 48))
    monkeypatch.setattr(picture_arms, "ALONE", ("telescopic_pr",))
    monkeypatch.setattr(picture_arms, "AMONG", (("telescopic_pr", "free", 1),))
    path = tmp_path / "arms.jpg"
    picture_arms.main(str(path))
    assert capsys.readouterr().out == f"{path}\n"
    with Image.open(path) as picture:
        assert picture.size == (64, 96)


def test_bounds_are_measured_and_a_broken_one_is_told(tmp_path, monkeypatch, capsys):
    path = tmp_path / "robustness.md"
    assert robustness.main(["--cases", "3", "--output", str(path)]) == 0
    assert path.read_text() in capsys.readouterr().out
    assert path.read_text().count("| 1 | 0 |") == len(robustness.BOUNDS) * len(robustness.KINDS)
    monkeypatch.setattr(robustness, "unstable_step", lambda jacobian, method: 1e-9)
    assert robustness.main(["--cases", "1", "--output", str(path)]) == 1
