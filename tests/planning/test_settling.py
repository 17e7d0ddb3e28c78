"""Time laws for loads that swing: shapers by hand, the linear model by hand and by MuJoCo, least energy on a crane."""

import gantries
import numpy as np
import pytest
import task_cases
from scipy.spatial import cKDTree

import lieednn_sim as ls
from lieednn_sim.arm.oscillation import Mode, PassiveJoints, with_load
from lieednn_sim.errors import InputError, TooFastError
from lieednn_sim.planning import SettlingOptions, settled
from lieednn_sim.planning.settling import shaper
from lieednn_sim.planning.swing_model import SwingModel
from lieednn_sim.planning.time_laws import TimedCurve

OMEGA = np.sqrt(9.81 / gantries.LENGTH)


def swing_left(run, joint="swing"):
    """Largest angle of a pendulum after the motion [rad]."""
    address = run.arm.model.joint(joint).qposadr[0]
    return np.abs(run.qpos[run.t >= run.motion_end, address]).max()


def leaves(method, ratio, damping=0.0):
    """Fraction of a mode's swing that a shaper leaves where its frequency is ``ratio`` times what was believed."""
    delays, shares = shaper(SettlingOptions(method), (Mode("swing", 0.5, damping),))
    assert shares.sum() == pytest.approx(1.0)
    natural = ratio * np.pi
    root = natural * np.sqrt(1.0 - damping**2)
    return abs(np.sum(shares * np.exp((damping * natural + 1j * root) * (delays - delays.max()))))


def middles(duration, steps):
    """The middles of time steps, and their length [s]."""
    return duration * (np.arange(steps) + 0.5) / steps, duration / steps


def law_at(curve, t):
    """A planned motion's own law and its slopes, each ``(K, 1)``."""
    return [np.asarray(curve.own(t, k))[:, None] for k in range(3)]


def test_shapers_leave_of_a_mode_what_their_authors_say():
    assert leaves("zv", 1.0) == pytest.approx(0.0, abs=1e-12)
    assert leaves("zv", 1.0, damping=0.1) == pytest.approx(0.0, abs=1e-12)
    assert leaves("zvd", 1.0, damping=0.1) == pytest.approx(0.0, abs=1e-12)
    # |cos(pi r / 2)| of ZV, and its square of ZVD.
    assert leaves("zv", 1.2) == pytest.approx(abs(np.cos(0.6 * np.pi)))
    assert leaves("zvd", 1.2) == pytest.approx(np.cos(0.6 * np.pi) ** 2)
    assert leaves("ei", 1.0) == pytest.approx(0.05)
    # That is the most between both frequencies of which it leaves nothing.
    assert max(leaves("ei", ratio) for ratio in np.linspace(0.85, 1.15, 61)) < 0.0501


def test_two_modes_are_shaped_by_both_shapers():
    modes = Mode("swing", 0.5, 0.0), Mode("bend", 0.8, 0.0)
    delays, shares = shaper(SettlingOptions("zv", modes=2), modes)
    for mode in modes:
        assert abs(shares @ np.exp(2j * np.pi * mode.frequency * delays)) < 1e-12


def test_the_linear_model_leaves_of_a_pendulum_what_its_integral_says():
    """With cart and pendulum, the energy left is m / 2 times the squared integral of x'' exp(i omega t)."""
    arm = gantries.gantry()
    motion = ls.plan(arm, [2.0], planner="minimum-jerk", duration=4.0).motion
    curve, (t, step) = TimedCurve(arm, motion), middles(4.0, 2000)
    law = law_at(curve, t)
    (left,), _ = SwingModel([arm], curve.q).left(step, law)
    driven = step * (2.0 * law[2][:, 0] * np.exp(1j * OMEGA * t)).sum()
    assert left @ left == pytest.approx(5.0 * abs(driven) ** 2, rel=1e-3)


def test_a_shaped_motion_of_a_cart_leaves_its_pendulum_at_rest_in_simulation():
    arm = gantries.gantry()
    # In less than two periods, in which the motion as planned leaves much.
    plans = [ls.plan(arm, [1.0], planner="minimum-jerk", duration=5.0, settle=how) for how in (None, "zv", "zvd")]
    plain, zv, zvd = (swing_left(ls.simulate(arm, plan, hold=3.0)) for plan in plans)
    assert all(plan.t[-1] == pytest.approx(5.0) for plan in plans)
    assert zv < 0.02 * np.abs(ls.simulate(arm, plans[1]).qpos[:, 1]).max()
    assert plain > 3.0 * zv
    # 20 % more length is 9 % less frequency, to which ZVD is less sensitive.
    longer = with_load(arm, length=1.2)
    assert swing_left(ls.simulate(longer, plans[2], hold=3.0)) < swing_left(ls.simulate(longer, plans[1], hold=3.0))
    assert zvd < 0.02


@pytest.fixture(scope="module")
def crane():
    """The crane of the task in its first case, and a motion in 8 s."""
    task = task_cases.Crane()
    done = task.start(0)
    arm = ls.Arm.of(done.model, done.data, task.joints, tip="tip")
    return task, arm, ls.plan(arm, task.goals[0], planner="lieednn-shaped", duration=8.0)


def test_the_slopes_of_the_linear_model_are_its_differences(crane):
    _, arm, plan = crane
    curve, (t, step) = TimedCurve(arm, plan.motion), middles(8.0, 400)
    model, law = SwingModel([arm, with_load(arm, 1.2)], curve.q), law_at(curve, t)
    sine = (
        np.sin(np.pi * t / 8.0) ** 2,
        np.pi / 8.0 * np.sin(np.pi * t / 4.0),
        np.pi**2 / 32.0 * np.cos(np.pi * t / 4.0),
    )
    bump = [part[:, None] for part in sine]
    _, slopes = model.left(step, [np.hstack(pair) for pair in zip(law, bump, strict=True)])
    sides = [
        model.left(step, [part + side * change for part, change in zip(law, bump, strict=True)])[0]
        for side in (1e-5, -1e-5)
    ]
    np.testing.assert_allclose(slopes[..., 0], (sides[0] - sides[1]) / 2e-5, rtol=1e-3, atol=0.1)


def test_the_linear_model_leaves_what_mujoco_leaves(crane):
    _, arm, plan = crane
    for duration, tolerance in ((8.0, 0.2), (12.0, 0.1)):
        motion = ls.plan(arm, plan.target, planner="lieednn-shaped", duration=duration).motion
        curve, (t, step) = TimedCurve(arm, motion), middles(duration, 1000)
        model, passive = SwingModel([arm], curve.q), PassiveJoints(arm)
        run = ls.simulate(arm, motion, hold=0.0)
        there = passive.away(run.qpos[-3:], passive.at_rest(arm.qpos(motion.q[-1:]))[0])
        expected = model._scales[0] @ np.append(there[2], (there[2] - there[0]) / (2.0 * run.timestep))
        (linear,), _ = model.left(step, law_at(curve, t))
        assert np.linalg.norm(linear) == pytest.approx(np.linalg.norm(expected), rel=tolerance)
        assert linear @ expected > 0.9 * np.linalg.norm(linear) * np.linalg.norm(expected)


def test_least_energy_takes_the_swing_from_the_crane_on_its_path(crane):
    task, arm, plan = crane
    calm = ls.plan(arm, plan.target, planner="lieednn-shaped", duration=8.0, settle="least-energy")
    assert calm.t[-1] == pytest.approx(8.0)
    assert calm.network is not None
    assert calm.network.certificate == plan.network.certificate
    # The same path: no sample is further from a chord of the other's samples than these are from each other.
    distance, _ = cKDTree(plan.motion.q).query(calm.motion.q)
    assert distance.max() < np.linalg.norm(np.diff(plan.motion.q, axis=0), axis=1).max()
    assert calm.proved
    for mass, length, most in ((1.0, 1.0, 0.02), (1.2, 1.0, 0.05), (1.0, 0.8, 0.15)):
        loaded = with_load(arm, mass, length)
        uninformed = ls.simulate(loaded, task_cases.trapezoidal(plan.motion), hold=5.0)
        assert task._swing(ls.simulate(loaded, calm, hold=5.0)) < most * task._swing(uninformed)


def test_after_the_fastest_motion_half_a_period_is_added():
    arm = gantries.gantry()
    pytest.importorskip("toppra")
    fastest = ls.plan(arm, [1.0], planner="minimum-jerk", fastest=True)
    calm = ls.plan(arm, [1.0], planner="minimum-jerk", fastest=True, settle="zv")
    assert calm.t[-1] == pytest.approx(fastest.t[-1] + np.pi / OMEGA, abs=0.02)


def test_a_shaped_motion_takes_longer_where_limits_need_it_but_not_too_long():
    arm = gantries.gantry()
    motion = ls.plan(arm, [3.0], planner="minimum-jerk", duration=3.0).motion
    assert settled(arm, motion, SettlingOptions("zvd")).t[-1] > 3.3
    with pytest.raises(TooFastError):
        settled(arm, motion, SettlingOptions("zvd"), longest=3.2)


def test_an_arm_without_a_load_has_nothing_to_settle():
    with pytest.raises(InputError, match="nothing that swings"):
        ls.plan(ls.Arm.load("telescopic_pr"), "extended", settle="zv")
    with pytest.raises(InputError, match="least-energy"):
        ls.plan(gantries.gantry(), [1.0], settle="shaken")


def test_moves_of_a_sequence_settle():
    arm = gantries.gantry()
    moves = [ls.Move([1.0]), ls.Move([0.0], settle="zvd")]
    parts = ls.plan_sequence(arm, moves, planner="minimum-jerk", duration=5.0, settle="zv").parts
    own = ls.plan(arm, [1.0], planner="minimum-jerk", duration=5.0, settle="zv").motion
    np.testing.assert_allclose(parts[0].plan.motion.q, own.q)
    assert swing_left(ls.simulate(arm, parts[0].plan, hold=3.0)) < 0.01
    back = ls.plan(arm, [0.0], start=[1.0], planner="minimum-jerk", duration=5.0, settle="zvd").motion
    np.testing.assert_allclose(parts[1].plan.motion.q, back.q, atol=1e-9)
