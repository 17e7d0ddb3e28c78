"""The comparison: rows and their numbers, resumption, refusals, statistics."""

from __future__ import annotations

import shutil
import signal
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lieednn_sim.cli import main
from lieednn_sim.errors import FileError, InputError, PlanError
from lieednn_sim.planning import find_tube, plan
from lieednn_sim.registry import PLANNERS
from lieednn_sim.studies import Case, Comparison, Settings, Table, compute, run_case, write_summary
from lieednn_sim.studies.comparison import case as cases
from lieednn_sim.studies.comparison.rows import BY_NAME, Row
from lieednn_sim.studies.comparison.summary import failures
from lieednn_sim.studies.rows import Group, wilson
from lieednn_sim.synthesis.shaping import encoder

CASE = Case("telescopic_pr", "free", "minimum-jerk", 0)
SMALL = Comparison(("minimum-jerk", "se3-geodesic"), ("telescopic_pr",), ("free",), ("position-servo",), seeds=1)
QUICK = Settings(duration=1.5, hold=0.2)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The directory of a small comparison."""
    directory = tmp_path_factory.mktemp("comparison")
    table = compute(replace(SMALL, common=QUICK), directory)
    write_summary(directory / "comparison.md", table, {"rrt-star": "ompl is not installed"})
    return directory


def test_a_row_holds_what_the_plan_says_of_itself():
    (row,) = run_case(CASE, ["computed-torque"], Settings())
    assert (row.success, row.reason, row.stability, row.mass_scale) == (True, "", "-", 1.0)
    value = {name: getattr(row, name) for name in BY_NAME}
    assert value["gap_mm"] == value["gap_end_deg"] == 0.0
    assert value["final_worst_mm"] < 1e-6
    # A straight line in joint space, and the peak of its law: 15/8 of the mean velocity.
    arm, target = cases.arm_and_target(CASE.arm, CASE.scene, CASE.seed)
    way = target - arm.keyframe("home")
    ranges = arm.position_limits[:, 1] - arm.position_limits[:, 0]
    assert value["path_ranges"] == pytest.approx(np.linalg.norm(way / ranges), rel=1e-5)
    assert value["velocity_fraction"] == pytest.approx((1.875 * abs(way) / 4.0 / arm.velocity_limits).max(), rel=1e-3)
    # The third derivative of sigma is 60 - 360 s + 360 s^2, whose mean square is 720.
    assert value["jerk_joints"] == pytest.approx((720.0 * ((way / ranges) ** 2).mean()) ** 0.5 / 4.0**3, rel=2e-3)
    assert value["motion_s"] == 4.0
    assert 3.0 < value["settling_s"] < 4.0


def test_no_planning_time_has_what_a_process_does_once():
    """Else the first problem of each worker took lieednn-shaped ten times as long as the next one."""
    for once in (encoder._universal, cases.load_arm, cases._arm_and_target):
        once.cache_clear()
    cases.arm_and_target(CASE.arm, CASE.scene, CASE.seed)
    assert encoder._universal.cache_info().currsize == 1


def test_only_motions_of_certified_networks_have_a_tube(tmp_path):
    """A number in its own column, a dash for others; and the page says why."""
    made = [run_case(replace(CASE, planner=name), ["mocap"], QUICK) for name in ("linear-attractor", "minimum-jerk")]
    arm, target = cases.arm_and_target(CASE.arm, CASE.scene, CASE.seed)
    size = find_tube(arm, plan(arm, target, planner="linear-attractor", duration=QUICK.duration)).size
    assert [row.tube_mm for (row,) in made] == [pytest.approx(1e3 * size, rel=1e-5), None]
    table = Comparison(common=QUICK).open(tmp_path)
    table.add([row for rows in made for row in rows])
    write_summary(tmp_path / "s.md", table)
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "nothing is proved about how other motions would go on" in text
    motions = text[text.index("## Motions") : text.index("## Tracking")]
    cells = {line.split(" | ")[2]: line.split(" | ")[-1] for line in motions.splitlines() if "telescopic_pr" in line}
    assert cells["minimum-jerk"] == "- |"
    assert float(cells["linear-attractor"].removesuffix(" |")) == pytest.approx(1e3 * size, rel=1e-2)


def test_masses_that_the_controller_does_not_know_show_in_the_row():
    (right,), (wrong,) = (
        run_case(CASE, ["inverse-dynamics"], replace(QUICK, mass_scale=scale)) for scale in (1.0, 1.2)
    )
    assert wrong.mass_scale == 1.2
    assert wrong.tracking_rms_mm > 1e3 * right.tracking_rms_mm
    # The plan is the same.
    assert (right.path_ranges, right.curvature) == (wrong.path_ranges, wrong.curvature)


def test_a_planner_that_fails_is_a_row_with_the_reason(monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise PlanError("joint 'turn1' would reach 2.5 rad")

    monkeypatch.setattr(cases, "plan", refuse)
    rows = run_case(CASE, ["mocap", "computed-torque"], QUICK)
    assert [row.reason for row in rows] == ["plan: joint 'turn1' would reach 2.5 rad"] * 2
    assert {(row.success, row.final_worst_mm) for row in rows} == {(False, None)}
    table = Comparison(common=QUICK).open(tmp_path)
    table.add(rows)
    write_summary(tmp_path / "s.md", table)
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "| minimum-jerk | 0 of 1 |" in text
    assert "- 1 x plan, as: joint 'turn1' would reach 2.5 rad (minimum-jerk 1)" in text


def test_a_bug_in_a_planner_is_not_swallowed_and_names_the_case(monkeypatch):
    monkeypatch.setattr(cases, "plan", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError) as caught:
        run_case(CASE, ["mocap"], QUICK)
    assert caught.value.__notes__ == ["while planning the case minimum-jerk:telescopic_pr:free:0"]


def untimed(rows):
    return {key: replace(row, planning_s=None) for key, row in rows.items()}


def test_a_case_that_raises_is_a_row_and_is_not_tried_again(finished, tmp_path, monkeypatch):
    def failing(case, *others):
        if case.planner == "linear-attractor":
            raise MemoryError("none\nleft")
        return run_case(case, *others)

    larger = replace(SMALL, planners=("linear-attractor", *SMALL.planners), common=QUICK)
    monkeypatch.setattr(Comparison, "run", staticmethod(failing))
    rows = compute(larger, tmp_path).rows
    lost = rows.pop(("telescopic_pr", "free", "linear-attractor", "position-servo", 0))
    assert (lost.reason, lost.success, lost.planned) == ("error: MemoryError: none left", False, False)
    # The others are those of another run, but for the planning time.
    assert untimed(rows) == untimed(Comparison.read(finished).rows)
    monkeypatch.setattr(Comparison, "run", None)
    assert len(compute(larger, tmp_path).rows) == 3


def test_rows_are_not_computed_again_and_a_larger_selection_adds(finished, tmp_path):
    shutil.copy(finished / "comparison.sqlite", tmp_path)
    # A mark in a row survives only where the row is not computed again.
    table = Comparison(common=QUICK).open(tmp_path)
    table.add([replace(row, reason="contact: marked") for row in table.rows.values()])
    larger = Comparison(("minimum-jerk",), ("telescopic_pr",), ("free",), ("position-servo", "mocap"), seeds=1)
    table = compute(replace(larger, common=QUICK), tmp_path)
    assert [(row.planner, row.controller, row.reason) for row in table.rows.values()] == [
        ("minimum-jerk", "mocap", ""),
        ("minimum-jerk", "position-servo", "contact: marked"),
        ("se3-geodesic", "position-servo", "contact: marked"),
    ]
    with pytest.raises(FileError, match=r"made with mass_scale 1.0, now 1.2; choose another --output"):
        Comparison(common=replace(QUICK, mass_scale=1.2)).open(tmp_path)


def test_the_summary_says_what_is_missing_and_what_is_proved(finished):
    text = (finished / "comparison.md").read_text(encoding="utf-8")
    assert "- rrt-star: ompl is not installed" in text
    assert "| telescopic_pr | free | se3-geodesic | position-servo | 1 of 1 | 21% to 100% |" in text
    assert text.rstrip().endswith("- none")


def test_interrupting_keeps_what_is_done(tmp_path, monkeypatch, capsys):
    """After the first case; `cli/test_interruption.py` and `test_workers.py` tell that workers are gone then, too."""
    add = Table.add
    monkeypatch.setattr(Table, "add", lambda self, rows: (add(self, rows), signal.raise_signal(signal.SIGINT)))
    options = "--planners minimum-jerk --arms telescopic_pr --scenes free --controllers position-servo --seeds 9"
    options += " --jobs 1 --duration 1 --hold 0"
    assert main(["compare", *options.split(), "--output", str(tmp_path)]) == 130
    assert capsys.readouterr().err.endswith("lieednn-sim: interrupted; files already reported are complete\n")
    assert len(Comparison.read(tmp_path).rows) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"comparison.sqlite", "lieednn_sim.json"}


@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_interval_solves_its_quadratic(count):
    """Its ends are where |p - k/n| = z sqrt(p (1 - p) / n)."""
    successes, total = count
    rate = successes / total
    for end in wilson(successes, total):
        assert abs(end - rate) == pytest.approx(1.959963985 * (end * (1.0 - end) / total) ** 0.5, abs=1e-7)


def test_failures_that_differ_in_names_and_numbers_are_counted_together():
    def row(planner, controller, seed, reason):
        return Row("a", "s", planner, controller, seed, 1.0, reason, planning_s=1.0)

    rows = [row("p", c, 0, "plan: joint 'a' at 1.5 rad, range [-1, 1e-3]") for c in ("x", "y")]
    rows += [row("r", c, 0, "plan: joint 'b' at -2 rad, range [-.5, 1]") for c in ("x", "y")]
    rows += [row("p", c, 1, "arrival: end effector ends 3 mm and 0 deg off") for c in ("x", "y")]
    rows += [row("r", "x", 1, "plan: joint 'c' at 3 rad, range [0, 1]")]
    # The most frequent first, and of each the planner that fails most.
    plan, arrival = failures(rows)
    assert (plan.step, plan.total, plan.counts) == ("plan", 3, (("r", 2), ("p", 1)))
    assert (arrival.step, arrival.total) == ("arrival", 2)
    # A plan's number counts once, whatever the number of controllers.
    assert Group((), tuple(rows)).values("planning_s") == [1.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Comparison(planners=("a-star",)), "no planner 'a-star'; allowed: .*minimum-jerk"),
        (lambda: Comparison(scenes=("sea",)), "no scene 'sea'"),
        (lambda: Comparison(seeds=0), "seeds must be at least 1, got 0"),
        (lambda: Comparison(first_seed=-1), "first_seed"),
        (lambda: Comparison(seeds=3, slow_seeds=4), "slow_seeds must be at most seeds, 3, got 4"),
        (lambda: Settings(mass_scale=0.0), "mass_scale must be positive"),
        (lambda: Settings(hold=-1.0), "hold must not be negative"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_missing_planners_are_left_out(monkeypatch):
    monkeypatch.setattr(PLANNERS, "missing", lambda: {"rrt-star": "pip install it"})
    made = Comparison(("rrt-star", "se3-geodesic"), ("telescopic_pr",), ("free",), seeds=1).cases()
    assert made == [Case("telescopic_pr", "free", "se3-geodesic", 0)]


def test_slow_planners_come_first(tmp_path):
    names = ("minimum-jerk", "lieednn-trained", "linear-attractor")
    study = Comparison(names, ("telescopic_pr",), ("free",), ("position-servo",), seeds=2)
    order = [(case.seed, case.planner) for case, *_ in study.todo(study.open(tmp_path))]
    declared = ("lieednn-trained", "minimum-jerk", "linear-attractor")
    assert order == [(seed, name) for seed in range(2) for name in declared]


def test_fresh_problems_begin_at_another_seed():
    slow = next(name for name, entry in PLANNERS.items() if entry.cost > 1.0 and not entry.install)
    study = Comparison(("minimum-jerk", slow), ("telescopic_pr",), ("free",), seeds=3, first_seed=40, slow_seeds=1)
    assert {(case.planner, case.seed) for case in study.cases()} == {
        *(("minimum-jerk", seed) for seed in (40, 41, 42)),
        (slow, 40),
    }
