"""Arms that actuators move through closed loops, from the plan to the run: a crane's cylinder, a palletiser, a lift."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arm.loops import PALLETISER, SCISSOR_LIFT

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.simulation import Disturbances


@pytest.fixture(scope="module")
def crane():
    return ls.Arm.load("telescopic_crane")


def test_the_cylinder_lifts_the_crane_to_its_target_and_holds_what_statics_ask_for(crane):
    """By virtual work: the cylinder's force times its travel is the work against gravity."""
    target = crane.keyframe("home") + np.array([0.05, 0.05, 0.1])
    run = ls.simulate(crane, ls.plan(crane, target, planner="minimum-jerk", duration=1.3), hold=1.0)
    assert run.controller == "feedback-linearisation"
    assert ls.evaluate(run, clearance=False).final_worst_mm < 0.1

    def height_and_stroke(luff):
        data = mujoco.MjData(crane.model)
        data.qpos[:] = crane.qpos([target[0], luff, target[2]])
        mujoco.mj_kinematics(crane.model, data)
        return crane.model.body_mass @ data.xipos[:, 2], data.joint("stroke").qpos[0]

    (low, begin), (high, end) = (height_and_stroke(target[1] + step) for step in (-1e-4, 1e-4))
    data = mujoco.MjData(crane.model)
    data.qpos[:], data.ctrl[:] = run.qpos[-1], run.ctrl[-1]
    mujoco.mj_forward(crane.model, data)
    force = data.actuator("stroke").force[0]
    assert force == pytest.approx(9.81 * (high - low) / (end - begin), rel=0.01)


def test_other_masses_and_noise_are_held_by_the_servos(crane):
    target = crane.keyframe("home") + np.array([0.03, 0.03, 0.03])
    plan = ls.plan(crane, target, planner="minimum-jerk", duration=1.0)
    heavier = ls.simulate(crane, plan, hold=0.3, disturbances=Disturbances(mass_scale=1.05))
    assert 0.1 < ls.evaluate(heavier, clearance=False).final_worst_mm < 20.0
    noisy = ls.simulate(crane, plan, hold=0.3, disturbances=Disturbances(position_noise=1e-5))
    assert ls.evaluate(noisy, clearance=False).final_worst_mm < 5.0
    with pytest.raises(InputError, match="moves closed loops, as the controller feedback-linearisation alone can"):
        ls.simulate(crane, plan, controller="position-servo")


def test_a_cylinder_that_is_too_weak_is_named_before_anything_moves(crane):
    spec = crane.copied_spec()
    spec.actuator("stroke").forcerange = [-5000.0, 5000.0]
    weak = crane.recompiled(spec)
    with pytest.raises(InputError, match=r"actuator 'stroke' cannot hold at the start: .* limit 5000 N or"):
        ls.plan(weak, [0.1, 0.6, 1.0])


@pytest.mark.parametrize(("xml", "tip", "joints"), [(PALLETISER, "tool", 4), (SCISSOR_LIFT, "platform", 1)])
def test_files_with_loops_go_the_whole_road(xml, tip, joints):
    arm = ls.Arm.from_spec(mujoco.MjSpec.from_string(xml), tip=tip, floor="none")
    assert arm.n_joints == joints
    target = arm.keyframe("home") + 0.1 * np.minimum(arm.position_limits[:, 1] - arm.keyframe("home"), 1.0)
    run = ls.simulate(arm, ls.plan(arm, target, planner="minimum-jerk", duration=1.0), hold=0.3)
    assert ls.evaluate(run, clearance=False).final_worst_mm < 0.1
    # The bars keep wrist and platform level on the way.
    data = mujoco.MjData(arm.model)
    for data.qpos[:] in run.qpos[::200]:
        mujoco.mj_kinematics(arm.model, data)
        np.testing.assert_allclose(data.site(tip).xmat[6:], [0.0, 0.0, 1.0], atol=1e-4)


def test_what_hangs_from_the_crane_swings(crane):
    plan = ls.plan(crane, crane.keyframe("home") + np.array([0.1, 0.0, 0.0]), planner="minimum-jerk", duration=1.8)
    run = ls.simulate(crane, plan, hold=0.2)
    address = crane.model.jnt_qposadr[crane.model.joint("swing_across").id]
    assert 1e-3 < np.abs(run.qpos[:, address]).max() < math.pi / 2
    assert replace(crane, clearance=0.0).near_contacts(crane.keyframe("home")) == []
