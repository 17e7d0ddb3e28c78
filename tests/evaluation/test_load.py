"""What a motion leaves swinging and bending, against a pendulum's and a spring's own numbers."""

import gantries
import numpy as np
import pytest

import lieednn_sim as ls

OMEGA = np.sqrt(9.81 / gantries.LENGTH)


def load_of(arm, hold=8.0):
    run = ls.simulate(arm, ls.plan(arm, [1.0], planner="minimum-jerk", duration=2.5), hold=hold)
    return ls.evaluate(run).load, run


def test_swing_settling_and_clearance_are_those_of_the_pendulum():
    ratio = 0.05
    arm = gantries.gantry(damping=2.0 * ratio * OMEGA * 5.0 * gantries.LENGTH**2)
    load, run = load_of(arm, hold=30.0)
    angle = np.rad2deg(run.qpos[run.t >= run.motion_end, 1])
    assert load.swing_deg == pytest.approx(np.abs(angle).max())
    assert load.swing_deg > 2.0
    # Within half a swing after the envelope has come down to 1 degree.
    decayed = np.log(load.swing_deg) / (ratio * OMEGA)
    assert decayed - np.pi / OMEGA < load.settling_s < decayed + 0.1
    assert load.clearance_mm == pytest.approx(1e3 * (5.0 - gantries.LENGTH) - 1.0, abs=5.0)
    assert load.bending_mm == 0.0
    assert "settles in" in str(ls.evaluate(run))


def test_without_damping_it_never_settles():
    load, _ = load_of(gantries.gantry())
    assert load.settling_s is None
    assert "does not settle" in str(load)


def test_bending_is_what_springs_before_the_end_effector_move_it():
    """A spring along the rail between cart and tip: its displacement is the tip's."""
    spring = '<body><joint name="bend" type="slide" axis="1 0 0" stiffness="50"/><geom size="0.05" mass="2"/>{}</body>'
    arm = gantries.gantry(spring.format('<site name="end"/>'))
    model, data = arm.model, arm.data()
    arm = ls.Arm.of(model, data, ["cart"], tip="end")
    load, run = load_of(arm)
    assert load.bending_mm == pytest.approx(1e3 * np.abs(run.qpos[run.t >= run.motion_end, 1]).max(), rel=1e-3)
    assert load.bending_mm > 5.0
    assert load.swing_deg == 0.0
    assert load.clearance_mm is None


def test_an_arm_on_which_nothing_swings_has_no_load():
    arm = ls.Arm.load("telescopic_pr")
    assert ls.evaluate(ls.simulate(arm, ls.plan(arm, "extended"))).load is None
