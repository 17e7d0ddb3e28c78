"""Time budgets, by a clock of the test's own: kept by every planner, reported, of no effect until they are spent."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lieednn_sim import budget
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.budget import check_time, out_of_time, time_limit
from lieednn_sim.cli import main
from lieednn_sim.errors import InputError, OutOfTimeError, PlanError
from lieednn_sim.planning import PLANNERS, CertifiedOptions, certified, plan
from lieednn_sim.planning.motion import least_duration
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.studies import Case, Comparison, Settings, run_case, write_summary

SPEC = Arm.load("telescopic_pr").spec.copy()
# Motions of fewer samples are planned in less time.
SPEC.option.timestep = 0.01
ARM = Arm.from_spec(SPEC, Path("telescopic_pr.xml"), "telescopic_pr")
INSTALLED = sorted(set(PLANNERS) - set(PLANNERS.missing()))


@pytest.fixture
def looks(monkeypatch):
    """A clock that advances by a second at every reading, and counts the readings."""
    count = itertools.count(1)
    seen = []

    def look():
        seen.append(next(count))
        return float(seen[-1])

    monkeypatch.setattr(budget, "cpu_time", look)
    return seen


def planned(name="lieednn-certified", **changes):
    return plan(ARM, ARM.keyframe("extended"), planner=name, **changes).motion


def test_of_limits_within_each_other_the_earlier_one_counts(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(budget, "cpu_time", lambda: now[0])
    check_time()
    with time_limit(5.0):
        with time_limit(50.0):
            now[0] = 105.0
            check_time()
            now[0] = 105.1
            assert out_of_time()
            with pytest.raises(OutOfTimeError, match="out of time: the budget of 5 s of CPU time is spent"):
                check_time()
        with time_limit(1.0), pytest.raises(OutOfTimeError, match="the budget of 5 s"):
            check_time()
    assert not out_of_time()
    with time_limit(float("inf")):
        now[0] = 1e300
        check_time()


@pytest.mark.parametrize("name", INSTALLED)
def test_every_planner_stops_when_its_time_is_over(name, looks):
    with pytest.raises(OutOfTimeError, match=r"the budget of 0\.5 s of CPU time is spent"), time_limit(0.5):
        planned(name)
    # What is made of other libraries' loops looks some times more: at each edge that a tree was about to grow.
    assert 0 < len(looks) < 80


@pytest.mark.parametrize("name", INSTALLED)
def test_every_planner_looks_at_the_clock_often(name, monkeypatch):
    """Work between two looks is a bounded number of collision passes, which do not depend on the machine."""
    passes, at_look = itertools.count(), [0]
    geoms = ContactFinder.geoms

    def counted(self, qpos):
        next(passes)
        return geoms(self, qpos)

    def look():
        at_look.append(int(repr(passes)[6:-1]))
        return 0.0

    monkeypatch.setattr(ContactFinder, "geoms", counted)
    monkeypatch.setattr(budget, "cpu_time", look)
    options = PLANNERS[name].options
    little = options(max_collision_checks=(3_000, 30_000)) if "star" in name or name == "aorrtc" else None
    planned(name, duration=2.0, options=little)
    look()  # what comes after the last one counts, too
    assert max(np.diff(at_look)) < 150


def test_a_budget_that_is_not_spent_changes_nothing(looks):
    with time_limit(float("inf")):
        without = planned("trajectory-optimisation")
    with time_limit(1e9):
        within = planned("trajectory-optimisation")
    np.testing.assert_array_equal(without.q, within.q)


def test_a_case_that_runs_out_of_time_is_a_row_with_the_reason(looks, tmp_path):
    settings = Settings(time_budget=0.5)
    rows = run_case(Case("telescopic_pr", "free", "minimum-jerk", 0), ["mocap", "computed-torque"], settings)
    assert {row.success for row in rows} == {False}
    assert all(row.reason.startswith("plan: out of time: the budget of 0.5 s of CPU time is spent") for row in rows)
    assert all(row.planning_s >= 0.0 for row in rows)
    table = Comparison(common=settings).open(tmp_path)
    table.add(rows)
    write_summary(tmp_path / "summary.md", table)
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "A planner that has spent 0.5 s of CPU time on a problem has failed." in text
    assert "- 1 x plan, as: out of time: the budget of 0.5 s" in text


@pytest.mark.parametrize("planner", ["lieednn-certified", "linear-attractor"])
def test_the_command_stops_with_the_reason_and_leaves_nothing(planner, looks, tmp_path, capsys):
    words = ["plan", "--target", "extended", "--planner", planner, "--time-budget", "9"]
    assert main([*words, "--output", str(tmp_path / "run")]) == 2
    assert "error: out of time: the budget of 9 s of CPU time is spent" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "soon"])
def test_a_budget_is_a_time(value):
    with pytest.raises(InputError, match="seconds must be"), time_limit(value):
        planned()
    with pytest.raises(InputError, match="time_budget must be"):
        Settings(time_budget=value)


def calls(monkeypatch, owner, name):
    """Count the calls of a function of a module or class."""
    made, original = [], getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *given, **named: made.append(1) or original(*given, **named))
    return made


def test_networks_are_drawn_once_and_only_the_best_is_looked_at_closely(monkeypatch):
    drawn = calls(monkeypatch, certified, "_drawn")
    paths, tried = (calls(monkeypatch, NetworkPath, name) for name in ("integrate", "timed"))
    passes = calls(monkeypatch, ContactFinder, "geoms")
    motion = planned(duration=0.6, options=CertifiedOptions(n_first=24))
    assert len(drawn) == 1
    # Refused once for its haste, and timed again as it asks for, along the same path.
    assert (len(paths), len(tried)) == (1, 2)
    assert 0.6 < motion.t[-1] < 1.8
    # The samples of the motion, and configurations on the path of one candidate, not of 24.
    assert len(passes) < len(motion.t) + 400


def test_where_nothing_can_be_fast_enough_one_refusal_is_enough(monkeypatch):
    tried = calls(monkeypatch, NetworkPath, "timed")
    with pytest.raises(PlanError, match=r"best of 3 candidates"):
        planned(duration=0.1, options=CertifiedOptions(n_networks=5, n_first=3))
    assert len(tried) == 1


def test_the_least_duration_is_that_of_full_speed():
    v, a = np.full(8, np.inf), np.full(8, np.inf)
    v[:3], a[1:4] = 2.0, (4.0, 4.0, 9.0)
    arm = SimpleNamespace(velocity_limits=v, acceleration_limits=a, jerk_limits=np.full(8, np.inf))

    def least(*way):
        q = np.zeros(8)
        q[: len(way)] = way
        return least_duration(arm, np.zeros(8), q)

    assert least(6.0) == 3.0  # 6 m at 2 m/s
    assert least(0.0, 6.0) == 3.5  # and half a second to start and to brake at 4 m/s^2
    assert least(0.0, -0.25) == 0.5  # half of it in a quarter of a second, at 4 m/s^2
    assert least(0.0, 0.0, 0.0, 4.0) == pytest.approx(4.0 / 3.0)  # 2 sqrt(4 / 9)
    assert least(0.0, 0.0, 0.0, 0.0, 5.0) == pytest.approx(0.0)
    assert least(1.0, 6.0) == 3.5

    # With a jerk of 8 the acceleration of 4 is reached after half a second, and halves of a second later 2 is.
    arm.jerk_limits[1] = 8.0
    assert least(0.0, 6.0) == 4.0  # a second up to 2, 4 m at that, a second down
    assert least(0.0, 2.0) == 2.0  # nothing left to cruise
    assert least(0.0, 0.25) == pytest.approx(1.0)  # four times a quarter of a second: 4 (d / 2 j)^(1/3)
    # With a jerk of 32 it takes 2 / 4 + 4 / 32 up to 2, and a way of 1 is done at v (v / 4 + 1 / 8) = 1.
    arm.jerk_limits[1] = 32.0
    assert least(0.0, 6.0) == 3.0 + 0.625
    assert least(0.0, 1.0) == pytest.approx(2.0 / (2.0 * (np.sqrt(0.125**2 + 1.0) - 0.125)))
    # Without a limit of acceleration 2 sqrt(2 / 32), which is half a second.
    arm.acceleration_limits[1] = np.inf
    assert least(0.0, 6.0) == 3.5


def test_configurations_that_are_searched_for_take_a_look_at_the_clock(looks):
    arm = Arm.load("telescopic_rrp")
    home = arm.encode(arm.keyframe("home"))
    with time_limit(0.5), pytest.raises(OutOfTimeError):
        arm.decode(home)


def test_one_network_is_drawn_first_and_the_others_where_it_cannot_be_used(monkeypatch):
    hinge = '<body pos="0 0 .3"><joint axis="0 1 0" range="-90 90"/><geom size=".02"/>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{3 * hinge}{'</body>' * 3}</worldbody></mujoco>")
    arm = Arm.from_spec(spec)
    target = np.deg2rad([20.0, -40.0, 60.0])
    alone = plan(arm, target, planner="lieednn-certified")
    assert alone.details.n_networks == 1
    # The target's largest entry is 60 degrees, and no bias is larger than what the target asks for.
    assert np.abs(alone.network.bias).max() == pytest.approx(np.pi / 3.0, rel=0.1)
    weak = plan(arm, target, planner="lieednn-certified", options=CertifiedOptions(bias_magnitudes=(0.25, 0.125)))
    assert np.abs(weak.network.bias).max() == pytest.approx(0.25)
    real = certified._plan

    def refused(problem, networks, drawn):
        if drawn == 1:
            raise PlanError("not this one")
        return real(problem, networks, drawn)

    monkeypatch.setattr(certified, "_plan", refused)
    others = plan(arm, target, planner="lieednn-certified", options=CertifiedOptions(n_networks=5))
    assert others.details.n_networks == 5
    monkeypatch.setattr(certified, "_plan", lambda *_: refused(*_[:2], 1))
    with pytest.raises(PlanError, match="not this one"):
        plan(arm, target, planner="lieednn-certified", options=CertifiedOptions(n_networks=2))


OVERLAPPING = """
import scipy.linalg, threading
from threadpoolctl import threadpool_info
from lieednn_sim.budget import one_blas_thread

def numbers():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

def first():
    with one_blas_thread():
        began[0].set()
        began[1].wait(60.0)
    ended.set()

def second():
    began[0].wait(60.0)
    with one_blas_thread():
        began[1].set()
        ended.wait(60.0)
        with one_blas_thread():
            seen.append(numbers())
        seen.append(numbers())

for _ in range(2):
    began, ended, seen = (threading.Event(), threading.Event()), threading.Event(), []
    threads = [threading.Thread(target=work) for work in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(*seen, numbers())
    with one_blas_thread():
        print(numbers())
"""


def test_contexts_that_overlap_in_threads_keep_one_thread_of_blas_and_restore_the_number():
    """A thread that ends first neither lifts another's limit, nor does the last one leave the limit behind."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", OVERLAPPING], env=environment, capture_output=True, text=True)
    assert done.stdout.split("\n")[:4] == ["{1} {1} {2}", "{1}"] * 2, done.stderr
