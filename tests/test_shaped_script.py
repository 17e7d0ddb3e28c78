"""The script that measures shaped networks, on as little as it can do."""

from __future__ import annotations

import pytest
import shaped


def test_shaped_networks_are_measured_once_and_the_rest_goes_on(tmp_path, monkeypatch):
    arguments = ["--arms", "telescopic_pr", "--scenes", "free", "--output", str(tmp_path)]
    shaped.main([*arguments, "--seeds", "1"])
    first = shaped.read(tmp_path / "rows.csv")
    assert [(row.seed, row.teacher, row.certified, row.reason) for row in first] == [(0, "minimum-jerk", True, "")]
    assert first[0].jerk == pytest.approx(1.0, abs=0.05)
    assert first[0].effort == pytest.approx(1.0, abs=0.05)
    assert 0.0 < first[0].gap_mm < 1.0
    # A line that was cut is measured again; what is there is not.
    with (tmp_path / "rows.csv").open("a") as file:
        file.write("telescopic_pr,free,1,mini")
    seen = []

    def failing(arm, scene, seed):
        seen.append(seed)
        return shaped.Row(arm.name, scene, seed, reason="plan: no")

    monkeypatch.setattr(shaped, "measured", failing)
    shaped.main([*arguments, "--seeds", "2"])
    assert seen == [1]
    text = (tmp_path / "summary.md").read_text()
    assert "| telescopic_pr | free | 1 of 2 | 1 |" in text
    assert "- telescopic_pr, free, seed 1: plan: no" in text
    assert [row.seed for row in shaped.read(tmp_path / "rows.csv")] == [0, 1]
