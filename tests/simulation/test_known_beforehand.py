"""Controls that are known beforehand: all at once, and many rollouts at once, are the same as one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.simulation import Controller, Disturbances, Push, simulate, simulate_many
from lieednn_sim.simulation.controllers.base import FeedforwardServo
from lieednn_sim.simulation.controllers.mocap import MocapWelds

CHANGES = Disturbances(
    pushes=(Push("end effector", (20.0, 5.0, -3.0), 0.1, 0.1), Push("link 1", (0.0, 5.0, 0.0), 0.15, 0.2)),
    payload=0.5,
    mass_scale=1.1,
    position_noise=1e-4,
    velocity_noise=1e-3,
    seed=3,
)


@pytest.mark.parametrize(
    ("name", "controller"),
    [
        ("telescopic_pr", "position-servo"),
        ("telescopic_compound", "inverse-dynamics"),
        ("telescopic_compound", "mocap"),
    ],
)
def test_all_at_once_is_step_by_step(name, controller, travel, monkeypatch):
    arm = Arm.load(name)
    motion = travel(arm, arm.keyframe("home"), draw_target(arm, 3), duration=0.3)
    given = {"controller": controller, "hold": 0.1, "disturbances": CHANGES, "reference_rate": 250.0}
    at_once = simulate(arm, motion, **given)
    for kind in (FeedforwardServo, MocapWelds):
        monkeypatch.setattr(kind, "inputs", Controller.inputs)
    assert simulate(arm, motion, **given) == at_once
    assert np.abs(at_once.channels["push_force"]).max() > 0.0


@pytest.mark.parametrize(
    ("name", "controller"),
    [
        ("telescopic_pr", "position-servo"),
        ("telescopic_compound", "inverse-dynamics"),
        ("telescopic_pr", "mocap-deadbeat"),
    ],
)
def test_each_of_many_is_as_it_is_alone(name, controller, travel):
    """Of several lengths, in more threads than there are cores."""
    arm = Arm.load(name)
    targets = [draw_target(arm, seed) for seed in range(5)]
    motions = [travel(arm, arm.keyframe("home"), q, 0.2 + 0.04 * k) for k, q in enumerate(targets)]
    many = simulate_many(arm, motions, controller=controller, hold=0.05, disturbances=CHANGES, threads=3)
    assert (len(many), many.q.shape) == (5, (5, 206, arm.n_joints))
    assert not many.failures
    for k in range(5):
        alone = many.rollout(k)
        np.testing.assert_array_equal(many.t, alone.t)
        np.testing.assert_array_equal(many.q[k], alone.q)
        np.testing.assert_array_equal(many.qd[k], alone.qd)
        np.testing.assert_array_equal(many.ctrl[k], alone.ctrl)
        assert alone.motion == motions[k]
        assert alone.disturbances == CHANGES


def test_what_fails_among_many_says_why_and_leaves_the_others(travel):
    """A drive that pushes away from where it shall be: nothing happens to the motion that stays at home, unpushed."""
    arm = Arm.load("telescopic_pr")
    arm.model.dof_damping[:] = 1.5 * arm.model.actuator_biasprm[:, 2]
    home = arm.keyframe("home")
    still, moved = travel(arm, home, home, 0.5), travel(arm, home, draw_target(arm, 3), 0.5)
    many = simulate_many(arm, [moved, still, moved], hold=0.0)
    with pytest.raises(SimulationError) as alone:
        many.rollout(0)
    assert {0, 2} <= many.failures.keys()
    assert many.failures[0] == many.failures[2] == str(alone.value)
    assert np.isnan(many.q[[0, 2]]).all()
    assert np.isfinite(many.q[1]).all() == (1 not in many.failures)


def test_controllers_that_need_the_state_are_refused(travel):
    arm = Arm.load("telescopic_pr")
    motion = travel(arm, arm.keyframe("home"), arm.keyframe("extended"), 0.1)
    with pytest.raises(InputError, match="computed-torque needs the state at every step"):
        simulate_many(arm, [motion], controller="computed-torque")
    with pytest.raises(InputError, match="at least one motion"):
        simulate_many(arm, [])


@pytest.mark.parametrize("index", [1, -2])
def test_a_rollout_that_is_not_there_is_refused(travel, index):
    arm = Arm.load("telescopic_pr")
    home = arm.keyframe("home")
    many = simulate_many(arm, [travel(arm, home, home, 0.1)], hold=0.0)
    np.testing.assert_array_equal(many.rollout(-1).q, many.q[0])
    with pytest.raises(InputError, match="index must be"):
        many.rollout(index)
