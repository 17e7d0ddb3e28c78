"""Simulations of a given model whose arm follows a plan: what drives it, and what else moves."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.errors import InputError, SimulationError

# A motor, a servo and a joint without an actuator; a stage that follows; a gripper, and a ball that falls on the floor.
ROBOT = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="3 3 .1"/>
    <body name="ball" pos="-1 0 .5"><freejoint/><geom size=".05"/></body>
    <body name="post" mocap="true"><geom type="cylinder" size=".05 .2"/></body>
    <body name="a" pos="0 0 .6">
      <joint name="turn" axis="0 0 1" range="-120 120" damping="1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
      <body name="b" pos=".3 0 0">
        <joint name="lift" axis="0 1 0" range="-60 60"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
        <body name="c" pos=".3 0 0">
          <joint name="reach" type="slide" axis="1 0 0" range="0 .2"/>
          <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/>
          <body name="d" pos=".2 0 0">
            <joint name="stage" type="slide" axis="1 0 0" range="0 .2"/><geom size=".02"/><site name="tip"/>
            <body name="finger" pos=".06 0 0">
              <joint name="finger" axis="0 0 1" range="-40 40" damping=".1"/><geom type="box" size=".02 .01 .01"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="stage" joint2="reach" polycoef="0 1 0 0 0"/></equality>
  <actuator>
    <position name="grip" joint="finger" kp="2"/>
    <position name="lift" joint="lift" kp="800" kv="80"/>
    <motor name="turn" joint="turn" gear="4"/>
  </actuator>
</mujoco>
"""
JOINTS = ["reach", "turn", "lift"]


@pytest.fixture(scope="module")
def case():
    model = mujoco.MjModel.from_xml_string(ROBOT)
    data = mujoco.MjData(model)
    data.joint("turn").qpos, data.mocap_pos[0], data.ctrl[0] = -0.5, [0.0, 1.5, 0.0], 0.3
    mujoco.mj_forward(model, data)
    return model, data, ls.plan_in(model, data, JOINTS, [0.15, 0.9, -0.4], tip="tip", planner="minimum-jerk")


def test_each_kind_of_actuator_follows_the_plan_and_the_rest_obeys_physics_alone(case):
    model, data, found = case
    before, masses = data.qpos.copy(), model.body_mass.copy()
    run = ls.run_in(model, data, found, hold=0.5)
    np.testing.assert_array_equal(data.qpos, before)
    np.testing.assert_array_equal(model.body_mass, masses)
    assert data.time == 0.0
    assert run.t[-1] == pytest.approx(found.t[-1] + 0.5)
    assert run.joint_names == ("turn", "lift", "reach")
    assert np.abs(run.tracking_error).max() < 2e-3
    # The planned rows are those of the plan at the model's own steps, then its end.
    stride = round(model.opt.timestep / found.arm.timestep)
    np.testing.assert_array_equal(run.planned[: len(found.t[::stride])], found.qpos[::stride])
    np.testing.assert_array_equal(run.planned[-1], found.qpos[-1])
    # What the arm does not touch moves as without it.
    alone = mujoco.MjData(model)
    alone.ctrl[0] = 0.3
    for _ in run.t[1:]:
        mujoco.mj_step(model, alone)
    np.testing.assert_allclose(run.qpos[-1, :3], alone.qpos[:3], atol=1e-9)
    assert (run.ctrl[:, 0] == 0.3).all()
    assert run.qpos[-1, model.joint("finger").qposadr[0]] == pytest.approx(0.3, abs=0.02)
    # Where the tip is, in two ways, and the mocap body where the data has it.
    tip = run.poses("tip")[-1].translation
    np.testing.assert_allclose(tip, run.poses("tip", planned=True)[-1].translation, atol=2e-3)
    np.testing.assert_allclose(tip, found.arm.tip(found.plan.motion.q[-1]), atol=2e-3)
    np.testing.assert_array_equal(run.poses("post")[0].translation, [0.0, 1.5, 0.0])
    assert run == ls.run_in(model, data, found, hold=0.5)


def test_servos_sag_under_gravity_without_feedforward(case):
    model, data, found = case
    plain = ls.run_in(model, data, found, feedforward=False)
    # In the end a servo is off by the torque of gravity over its stiffness.
    rest = mujoco.MjData(model)
    rest.qpos[:] = plain.qpos[-1]
    mujoco.mj_forward(model, rest)
    sag = -rest.qfrc_bias[model.joint("lift").dofadr[0]] / 800.0
    assert abs(sag) > 3e-3
    assert plain.tracking_error[-1] == pytest.approx([0.0, sag, 0.0], abs=5e-4)


def test_a_force_that_the_data_applies_stays_and_pushes_the_arm(case):
    model, data, found = case
    pushed = mujoco.MjData(model)
    mujoco.mj_copyData(pushed, model, data)
    pushed.qfrc_applied[model.joint("reach").dofadr[0]] = 5.0
    one, other = (ls.run_in(model, state, found).tracking_error[-1, 2] for state in (pushed, data))
    # In the end the feedback, m w^2 times the error, holds the force, with the mass of both stages, of which the second
    # moves twice as far. It follows the first by a soft equality.
    mass = model.body_subtreemass[model.body("c").id] + model.body_subtreemass[model.body("d").id] * 3.0
    assert one - other == pytest.approx(5.0 / mass / (2.0 * np.pi * 10.0) ** 2, rel=0.2)


def test_what_cannot_be_simulated_is_named(case):
    model, data, found = case
    elsewhere = mujoco.MjData(model)
    with pytest.raises(InputError, match=r"not where the plan begins: its joint 'turn' is 0\.5"):
        ls.run_in(model, elsewhere, found)
    other = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InputError, match="data must be of the model"):
        ls.run_in(model, mujoco.MjData(other), found)
    with pytest.raises(
        InputError, match=f"plan is of another model: it has {model.nq} positions, and this model has 0"
    ):
        ls.run_in(other, mujoco.MjData(other), found)
    with pytest.raises(InputError, match="hold must be from 0"):
        ls.run_in(model, data, found, hold=-1.0)
    elsewhere.qpos[:] = data.qpos
    elsewhere.qvel[0] = 1e12
    with pytest.raises(SimulationError, match=r"simulation of the given model failed at t = 0\.00"):
        ls.run_in(model, elsewhere, found)
    with pytest.raises(InputError, match="no body or site 'cup'"):
        ls.run_in(model, data, found, hold=0.0).poses("cup")
