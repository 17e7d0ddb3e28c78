"""Logs of a comparison become the database of OMPL's own tool."""

from __future__ import annotations

import sqlite3
import subprocess
import sys

import pytest

import lieednn_sim as ls
from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.exports import export
from lieednn_sim.studies.comparison.rows import Row
from lieednn_sim.studies.comparison.study import Comparison


def row(planner, scene, seed, reason="", controller="mocap", **measured):
    return Row("telescopic_pr", scene, planner, controller, seed, 1.0, reason, **measured)


@pytest.fixture
def comparison(tmp_path):
    """Two scenes; in the first, one planner finds no motion for one of its seeds, and touches with the other."""
    table = Comparison().open(tmp_path / "table")
    table.add([row("minimum-jerk", "free", seed, planning_s=0.25 + seed, motion_s=4.0) for seed in range(3)])
    table.add([row("dmp", "free", 0, "plan: no way"), row("dmp", "free", 1, "contact: a and b", planning_s=0.5)])
    table.add([row("dmp", "window", 0, planning_s=0.125, tracking_rms_mm=0.1)])
    return table.path.parent


def test_the_tool_of_ompl_makes_its_database_of_the_logs(comparison, tmp_path, monkeypatch, capsys):
    pytest.importorskip("ompl")
    monkeypatch.chdir(tmp_path)
    assert main(["export", "table", "--format", "plannerarena", "--output", "out"]) == 0
    logs = ["out/table-telescopic_pr-free-mocap.log", "out/table-telescopic_pr-window-mocap.log"]
    assert capsys.readouterr().out.splitlines() == [
        "wrote in out: " + ", ".join(log.removeprefix("out/") for log in logs)
    ]
    tool = [sys.executable, "-m", "ompl.ompl_benchmark_statistics", "-d", "benchmark.db", *logs]
    subprocess.run(tool, check=True, capture_output=True)
    with sqlite3.connect("benchmark.db") as base:
        runs = base.execute(
            "SELECT e.name, p.name, r.seed, r.solved, r.arrived, r.time, r.motion_s, r.tracking_rms_mm FROM runs r"
            " JOIN experiments e ON e.id = r.experimentid JOIN plannerConfigs p ON p.id = r.plannerid ORDER BY 1, 2, 3"
        ).fetchall()
        limits = base.execute("SELECT version, timelimit, runcount, totaltime FROM experiments").fetchall()
    base.close()
    free, window = "telescopic_pr-free-mocap", "telescopic_pr-window-mocap"
    assert runs == [
        (free, "dmp", 0, 0, 0, None, None, None),
        (free, "dmp", 1, 1, 0, 0.5, None, None),
        *((free, "minimum-jerk", seed, 1, 1, 0.25 + seed, 4.0, None) for seed in range(3)),
        (window, "dmp", 0, 1, 1, 0.125, None, 0.1),
    ]
    assert limits == [
        (f"lieednn_sim {ls.__version__}", 60.0, 3, 4.25),
        (f"lieednn_sim {ls.__version__}", 60.0, 1, 0.125),
    ]


def test_a_controller_from_a_file_has_a_log(tmp_path):
    table = Comparison().open(tmp_path / "table")
    table.add([row("dmp", "free", 0, controller="my code/servo.py:make")])
    (log,) = export(table.path.parent, tmp_path / "out", format="plannerarena")
    assert log == tmp_path / "out/comparison-telescopic_pr-free-my_code_servo.py_make.log"


def test_what_is_no_comparison_or_has_no_rows_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "nowhere", "--format", "plannerarena"]) == 2
    assert "comparison.sqlite" in capsys.readouterr().err
    table = Comparison().open("empty")
    with pytest.raises(InputError, match="has no rows"):
        export(table.path.parent, "out", format="plannerarena")
    with pytest.raises(InputError, match="has no rate"):
        export(table.path.parent, "out", format="plannerarena", rate=100.0)
    assert not (tmp_path / "out").exists()
