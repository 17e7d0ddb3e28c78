"""Learned motions of an end effector on arms."""

from __future__ import annotations

import itertools
import json

import mujoco
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import lieednn_sim as ls
from lieednn_sim import budget
from lieednn_sim.cli import main
from lieednn_sim.errors import FileError, InputError, NoSolutionError, OutOfTimeError, PlanError
from lieednn_sim.learning.demonstrations import Demonstration, LearnedMotion, ShapedMotion, align
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.planning.time_laws import recorded_law
from lieednn_sim.studies.demonstrations import models

ARM = ls.Arm.load("telescopic_pr")
S = np.linspace(0.0, 1.0, 120)


def recorded(bend):
    """Time and pose of the arm's end effector, as MuJoCo has them, on a way that bends."""
    q = ARM.keyframe("home") + np.outer(S, [0.1, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1][: ARM.n_joints])
    q[:, 1] += bend * np.sin(np.pi * S)
    q = np.clip(q, *ARM.position_limits.T)
    data, site = mujoco.MjData(ARM.model), ARM.model.site(f"link{ARM.n_links}_frame").id
    rows = []
    for data.qpos[:] in ARM.qpos(q):
        mujoco.mj_kinematics(ARM.model, data)
        turn = np.empty(4)
        mujoco.mju_mat2Quat(turn, data.site_xmat[site])
        rows.append([*data.site_xpos[site], *turn])
    return q, np.column_stack([3.0 * S, rows])


TABLES = [recorded(bend) for bend in (0.2, 0.25, 0.3)]


def fit(samples):
    shown = [Demonstration.from_samples(table[:, 1:], table[:, 0]) for _, table in TABLES]
    return ShapedMotion.fit(align(shown, samples=samples))


@pytest.fixture(scope="module")
def learned():
    """A third of the usual samples, each of which the arm has to follow."""
    return fit(60)


@pytest.fixture(scope="module")
def followed(learned):
    """The plan on the arm, and how often its budget was looked at."""
    clock = itertools.count()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(budget, "cpu_time", clock.__next__)
        with ls.time_limit(1e9):
            plan = ls.plan_learned(ARM, learned)
        return plan, next(clock)


def off(arm, plan, poses):
    """Largest distance of a learned pose's place from the end effector's path [m]."""
    path = arm.tip(plan.motion.q)
    return max(np.linalg.norm(path - place, axis=1).min() for place in poses.translation)


@pytest.mark.parametrize("turning", [True, False])
def test_the_end_effector_moves_as_was_shown(learned, followed, turning):
    plan = followed[0] if turning else ls.plan_learned(ARM, learned, turning=False)
    assert plan.network.certificate
    assert plan.guide.planner == "learned motion"
    assert off(ARM, plan, learned.poses()) < 1e-3
    assert plan.t[-1] == pytest.approx(3.0)
    ends = ARM.link_poses(plan.motion.q[[0, -1]]).as_matrix()[:, -1]
    shown = learned.poses().as_matrix()[[0, -1]]
    np.testing.assert_allclose(ends[:, :3, 3], shown[:, :3, 3], atol=1e-5)
    if turning:
        np.testing.assert_allclose(ends, shown, atol=1e-5)


def test_from_elsewhere_to_elsewhere(learned):
    start, aside = TABLES[0][0][20], np.array([0.02, -0.03, 0.01])
    goal = transforms(learned.goal.rotation.as_matrix(), learned.goal.translation + aside)
    # A position has the rotation that was recorded.
    plan = ls.plan_learned(ARM, learned, start=start, goal=goal.translation.tolist(), turning=False, duration=5.0)
    np.testing.assert_allclose(plan.motion.q[0], start, atol=1e-12)
    np.testing.assert_allclose(ARM.tip(plan.motion.q[-1]), goal.translation, atol=1e-5)
    assert off(ARM, plan, learned.poses(ARM.link_poses(start)[-1], goal)) < 1e-3
    assert plan.t[-1] == pytest.approx(5.0)


def test_recordings_that_do_not_begin_at_rest_are_given_time_to():
    # A constant speed, which would have to be reached within the first of 40 steps, by an acceleration of 40 and more.
    t = np.linspace(0.0, 1.0, 41)
    s = np.linspace(0.0, 1.0, 2001)
    fraction, rate = recorded_law(3.0 * t, t)(s)
    np.testing.assert_allclose([*fraction[[0, -1]], *rate[[0, -1]]], [0.0, 1.0, 0.0, 0.0], atol=1e-12)
    assert rate.max() < 1.4
    assert np.abs(np.diff(rate) / s[1]).max() < 16.0
    # What begins at rest is as it was.
    eased = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    np.testing.assert_allclose(recorded_law(t, eased)(s)[0], PchipInterpolator(t, eased)(s), atol=3e-3)


def test_what_cannot_be_done_says_why(learned):
    with pytest.raises(InputError, match=r"the position of goal must have shape \(3,\), got \(8,\)"):
        ls.plan_learned(ARM, learned, goal=ARM.keyframe("home"))
    far = transforms(np.eye(3), np.array([9.0, 0.0, 0.0]))
    with pytest.raises(
        NoSolutionError, match=r"at the start of the learned motion, \(.*\) m, .* give another goal or start"
    ):
        ls.plan_learned(ARM, learned, goal=far)
    with pytest.raises(
        PlanError, match=r"at \d+ % of the way the end effector cannot come nearer .* give another goal or start"
    ):
        ls.plan_learned(ARM, learned, start="home", goal=far)


def test_a_budget_that_is_spent_at_the_end_is_what_is_told(learned, followed, monkeypatch):
    monkeypatch.setattr(budget, "cpu_time", itertools.count().__next__)
    budget_s = float(followed[1] - 3)
    with pytest.raises(OutOfTimeError, match=f"the budget of {budget_s:g} s of CPU time"), ls.time_limit(budget_s):
        ls.plan_learned(ARM, learned)


def test_the_commands_take_it_to_a_run(tmp_path, capsys, monkeypatch):
    learned = fit(200)
    # `cli/test_demonstrations.py` compares and draws.
    monkeypatch.setattr(models, "SAMPLES", 50)
    for plot in ("plot_field", "plot_paths"):
        monkeypatch.setattr(f"lieednn_sim.cli.demonstrations.{plot}", lambda *_: None)
    files = [tmp_path / f"d{k}.csv" for k in range(len(TABLES))]
    for file, (_, table) in zip(files, TABLES, strict=True):
        np.savetxt(file, table, delimiter=",", header="t,x,y,z,qw,qx,qy,qz", comments="")
    out, run = str(tmp_path / "learned"), str(tmp_path / "run")
    assert (
        main(["learn", *map(str, files), "--output", out, "--rivals", "none", "--starts", "1", "--no-leave-one-out"])
        == 0
    )
    loaded = LearnedMotion.load(out)
    np.testing.assert_allclose(loaded.poses().as_matrix(), learned.poses().as_matrix(), atol=1e-9)
    assert main(["simulate", out]) == 2
    assert f"put a learned motion on an arm by 'lieednn-sim plan --learned {out}" in capsys.readouterr().err
    assert main(["plan", "--learned", out, "--output", run]) == 0
    assert "planner: lieednn-shaped, as shown" in capsys.readouterr().out
    assert main(["simulate", run, "--controller", "feedback-linearisation"]) == 0
    rollout = ls.Rollout.load(f"{run}/rollout.npz", ARM, ls.planning.Motion.load(f"{run}/motion.npz"))
    np.testing.assert_allclose(ARM.tip(rollout.q[-1]), learned.goal.translation, atol=1e-3)
    assert main(["plan", "--learned", out, "--planner", "rrt-connect", "--output", run]) == 2
    report = json.loads((tmp_path / "learned" / "report.json").read_text())
    (tmp_path / "learned" / "report.json").write_text(json.dumps({**report, "start_twist": [0.0]}))
    with pytest.raises(FileError, match="start_twist must have shape"):
        LearnedMotion.load(out)
    with pytest.raises(FileError, match="holds no learned motion"):
        LearnedMotion.load(tmp_path)
