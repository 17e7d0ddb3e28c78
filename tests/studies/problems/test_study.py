"""Planners on published problems."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import motion_bench_maker
import pytest

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import FileError, InputError, PlanError
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import least_duration
from lieednn_sim.studies.problems import study
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets
from lieednn_sim.studies.problems.study import OPTIONS, PublishedProblems, Solution, solve
from lieednn_sim.studies.study import compute
from lieednn_sim.studies.table import Table


def test_a_straight_way_is_measured_by_hand(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Without toppra the planner's own law stays.
    monkeypatch.setattr(study, "_TIMED", False)
    (row,) = solve(str(tiny), "easy", 1, "minimum-jerk", 10.0)
    assert (row.success, row.skipped) == (True, False)
    # The shoulder turns by 1.2 rad at 1 rad/s at most, and minimum jerk peaks at 15/8 of the mean: 2.25 s, and 2 %.
    assert row.cspace_path_length == pytest.approx(1.2, rel=1e-6)
    assert row.motion_time == pytest.approx(1.02 * 1.2 * 15.0 / 8.0, rel=0.02)


def test_paths_are_run_through_at_the_limits(tiny: Path) -> None:
    pytest.importorskip("toppra")
    (row,) = solve(str(tiny), "easy", 1, "minimum-jerk", 10.0)
    arm, start, goal = ProblemSets(tiny).problem("easy", 1)
    least = least_duration(arm, start, goal)
    assert least <= row.motion_time <= 1.01 * least
    assert row.cspace_path_length == pytest.approx(1.2, rel=1e-6)


def test_a_path_that_only_just_passes_keeps_its_law(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def touching(*_: object) -> None:
        raise PlanError("'fore' would touch 'obstacle_post'")

    monkeypatch.setattr(study, "retime", touching)
    monkeypatch.setattr(study, "_TIMED", True)
    (row,) = solve(str(tiny), "easy", 1, "minimum-jerk", 10.0)
    assert row.motion_time == pytest.approx(1.02 * 1.2 * 15.0 / 8.0, rel=0.02)


def test_what_cannot_be_is_skipped_and_what_is_not_found_has_failed(tiny: Path) -> None:
    (skipped,), (failed,) = (
        solve(str(tiny), "post", 2, "rrt-connect", 10.0),
        solve(str(tiny), "post", 1, "minimum-jerk", 10.0),
    )
    assert skipped.skipped
    assert not skipped.success
    assert skipped.reason.startswith("skipped: goal is out of reach: ")
    assert "obstacle_post" in skipped.reason
    assert not failed.skipped
    assert not failed.success
    assert failed.reason.startswith("plan: ")
    (unread,) = solve(str(tiny), "post", 3, "minimum-jerk", 10.0)
    assert unread.reason.startswith("problem: ")
    assert not unread.skipped


def test_a_shaped_network_goes_around_as_its_guide_does(tiny: Path) -> None:
    pytest.importorskip("ompl")
    arm, start, goal = ProblemSets(tiny).problem("post", 1)
    made = plan(
        arm, goal, start=start, planner="lieednn-shaped", duration=(4.0, 400.0), options=OPTIONS["lieednn-shaped"]
    )
    assert made.guide is not None
    assert made.guide.planner == "rrt-connect"
    collisions = Collisions(arm)
    assert min(collisions.clearance(q) for q in made.motion.q[::8]) > 0.0


def test_a_study_goes_on_where_it_was_stopped(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def stopped(run: object, todo: list[tuple[str, str, int, str, float]], done: Any, **_: object) -> None:
        asked.append([task[1:4] for task in todo])
        done(todo[0], [Solution(*todo[0][1:4], solve_time=1.0)], None)

    monkeypatch.setattr("lieednn_sim.studies.study.run_each", stopped)
    sets = ProblemSets(tiny)
    for _ in range(2):
        compute(PublishedProblems(sets, ["minimum-jerk"], 2), tmp_path)
    assert asked == [[("easy", 1, "minimum-jerk"), ("post", 1, "minimum-jerk")], [("post", 1, "minimum-jerk")]]
    with pytest.raises(FileError, match="time_budget"):
        compute(PublishedProblems(sets, ["minimum-jerk"], 2, 5.0), tmp_path)
    with pytest.raises(InputError, match="problems"):
        PublishedProblems(sets, problems=0)


def test_the_script_writes_tables_and_a_summary(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def here(run: Any, todo: list[tuple[object, ...]], done: Any, **_: object) -> None:
        for task in todo:
            done(task, run(*task), None)

    monkeypatch.setattr("lieednn_sim.studies.study.run_each", here)
    words = ["--robots", "tiny", "--planners", "minimum-jerk", "--output", str(tmp_path)]
    motion_bench_maker.main([str(tiny.parent), *words])
    rows = list(Table(tmp_path / "tiny" / "problems.sqlite", Solution).rows.values())
    assert [row.success for row in rows] == [True, True, False, False]
    assert "| tiny | `minimum-jerk` | 4 | 1 | 2 of 3 |" in (tmp_path / "motion_bench_maker.md").read_text()
    with pytest.raises(InputError, match="problems must be at least 1, got 0"):
        motion_bench_maker.main([str(tiny.parent), *words, "--problems", "0"])
