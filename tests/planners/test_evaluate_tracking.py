"""The script that compares planners and controllers: rows, resumption, refusals."""

from __future__ import annotations

import csv
import importlib
import sys
from pathlib import Path

import pytest

from lieednn_sim.errors import PlanError

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    yield importlib.import_module("evaluate_tracking")
    sys.modules.pop("evaluate_tracking", None)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_rows_are_computed_once_and_read_again(script, tmp_path, capsys):
    command = ["--seeds", "1", "--planners", "minimum-jerk", "--controllers", "computed-torque"]
    command += ["--jobs", "1", "--output", str(tmp_path)]
    assert script.main(command) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "comparison.md")
    (row,) = read(tmp_path / "comparison.csv")
    assert tuple(row) == script.COLUMNS
    assert (row["planner"], row["controller"], row["seed"], row["success"]) == (
        "minimum-jerk",
        "computed-torque",
        "0",
        "yes",
    )
    assert row["certified"] == "-"
    assert float(row["gap_mm"]) == 0.0
    assert float(row["final_worst_mm"]) < 1e-6
    # A straight line in joint space, and the peak of its law: 15/8 of the mean velocity.
    arm = script._arm()
    problem = script.draw_problem(arm, 0)
    way, ranges = problem.target - problem.start, arm.position_limits[:, 1] - arm.position_limits[:, 0]
    assert float(row["path_ranges"]) == pytest.approx(((way / ranges) ** 2).sum() ** 0.5, rel=1e-5)
    assert float(row["velocity_share"]) == pytest.approx((1.875 * abs(way) / 4.0 / arm.velocity_limits).max(), rel=1e-3)
    # The third derivative of sigma is 60 - 360 s + 360 s^2, whose mean square is 720.
    jerk = (720.0 * ((way / ranges) ** 2).mean()) ** 0.5 / 4.0**3
    assert float(row["jerk_rms"]) == pytest.approx(jerk, rel=2e-3)

    # A mark in a row survives only where the row is not computed again.
    table = tmp_path / "comparison.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(",yes,,", ",no,marked,"), encoding="utf-8")
    assert script.main(command) == 0
    assert read(table)[0]["reason"] == "marked"
    assert "- minimum-jerk, computed-torque, seed 0: marked" in (tmp_path / "comparison.md").read_text(encoding="utf-8")


def test_a_planner_that_fails_is_a_row_with_the_reason(script, monkeypatch, tmp_path):
    def refuse(*_):
        raise PlanError("in the way")

    monkeypatch.setattr(script, "plan_network", refuse)
    rows = script.run("screw", 3, ["mocap", "computed-torque"])
    assert [row["reason"] for row in rows] == ["plan: in the way"] * 2
    assert {row["success"] for row in rows} == {"no"}
    assert {row["final_worst_mm"] for row in rows} == {""}
    script.write_summary(tmp_path / "s.md", {(row["planner"], row["controller"], 3): row for row in rows})
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "| screw | 0 of 1 |" in text
    assert "| screw | mocap | 0 of 1 |" in text
    assert text.count("in the way") == 1


def test_files_that_are_no_comparison_are_refused(script, tmp_path, capsys):
    table = tmp_path / "comparison.csv"
    header = ",".join(script.COLUMNS)
    for text in (
        "a,b\n1,2\n",
        f"{header}\nscrew,mocap\n",
        f"{header}\nscrew,mocap,x{',' * (len(script.COLUMNS) - 3)}\n",
    ):
        table.write_text(text, encoding="utf-8")
        assert script.main(["--seeds", "1", "--output", str(tmp_path)]) == 1
        assert "remove it or choose another --output" in " ".join(capsys.readouterr().err.split())
        assert table.read_text(encoding="utf-8") == text
    with pytest.raises(SystemExit):
        script.main(["--seeds", "0"])
    assert "must be at least 1, got 0" in capsys.readouterr().err
