"""Simulations of views: what drives an arm in somebody's model, and what else moves in it."""

from __future__ import annotations

import pickle
import tracemalloc

import mujoco
import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim import simulation
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.simulation import make_plant

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
JOINTS = ["turn", "lift", "reach"]


def view(model, data):
    return ls.Arm.of(model, data, JOINTS, tip="tip")


@pytest.fixture(scope="module")
def case():
    model = mujoco.MjModel.from_xml_string(ROBOT)
    data = mujoco.MjData(model)
    data.joint("turn").qpos, data.mocap_pos[0], data.ctrl[0] = -0.5, [0.0, 1.5, 0.0], 0.3
    mujoco.mj_forward(model, data)
    arm = view(model, data)
    return model, data, arm, ls.plan(arm, [0.9, -0.4, 0.15], planner="minimum-jerk")


def test_each_kind_of_actuator_follows_the_plan_and_the_rest_obeys_physics_alone(case):
    model, data, arm, found = case
    before, masses = arm.qpos_home.copy(), arm.model.body_mass.copy()
    run = ls.simulate(arm, found, hold=0.5)
    assert run.controller == "feedback-linearisation"
    np.testing.assert_array_equal(arm.qpos_home, before)
    np.testing.assert_array_equal(arm.model.body_mass, masses)
    assert data.time == 0.0
    assert run.t[-1] == pytest.approx(found.t[-1] + 0.5)
    assert np.abs(run.tracking_error).max() < 2e-3
    np.testing.assert_array_equal(run.q_ref[: len(found.t)], found.motion.q)
    # What the arm does not touch moves as without it.
    alone = mujoco.MjData(model)
    alone.ctrl[0] = 0.3
    for _ in run.t[1:]:
        mujoco.mj_step(model, alone)
    np.testing.assert_allclose(run.qpos[-1, :3], alone.qpos[:3], atol=1e-9)
    assert (run.ctrl[:, 0] == 0.3).all()
    assert run.qpos[-1, model.joint("finger").qposadr[0]] == pytest.approx(0.3, abs=0.02)
    # The ball on the floor is no contact of the arm.
    assert run.contacts.max() == 0
    tip = run.poses("tip")[-1].translation
    np.testing.assert_allclose(tip, run.link_position[-1, -1], atol=1e-9)
    np.testing.assert_allclose(tip, arm.tip(found.motion.q[-1]), atol=2e-3)
    np.testing.assert_array_equal(run.poses("post")[0].translation, [0.0, 1.5, 0.0])
    with pytest.raises(InputError, match="no body or site 'cup'"):
        run.poses("cup")
    assert run == ls.simulate(arm, found, hold=0.5)


def test_poses_of_a_body_take_no_memory_for_all_others():
    many = "".join(f'<body pos="0 {5 + k} 0"><geom size=".01"/></body>' for k in range(300))
    model = mujoco.MjModel.from_xml_string(ROBOT.replace("</worldbody>", f"{many}</worldbody>"))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["turn", "lift", "reach"], tip="tip")
    run = ls.simulate(arm, ls.plan(arm, [0.3, 0.2, 0.1], planner="minimum-jerk", duration=1.0))
    tracemalloc.start()
    try:
        run.poses("tip")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.1 * len(run.t) * model.nbody * 12 * 8


def test_a_rollout_of_a_view_is_judged_saved_and_loaded(case, tmp_path):
    model, data, arm, found = case
    run = ls.simulate(arm, found)
    result = ls.evaluate(run)
    assert result.contacts == 0
    assert result.final_worst_mm < 1.0
    assert 0.0 < result.clearance_mm < 1000.0
    run.save(tmp_path / "run.npz")
    assert ls.Rollout.load(tmp_path / "run.npz", arm, found.motion) == run
    np.testing.assert_array_equal(ls.Rollout.load(tmp_path / "run.npz", view(model, data)).qpos, run.qpos)
    assert pickle.loads(pickle.dumps(run.arm)).fingerprint == arm.fingerprint


def test_a_force_that_the_data_applies_stays_and_pushes_the_arm(case):
    model, data, arm, found = case
    pushed = mujoco.MjData(model)
    mujoco.mj_copyData(pushed, model, data)
    pushed.qfrc_applied[model.joint("reach").dofadr[0]] = 5.0
    one, other = (ls.simulate(each, found).tracking_error[-1, 2] for each in (arm.at(pushed), arm))
    # In the end the feedback, m w^2 times the error, holds the force, with the mass of both stages, of which the second
    # moves twice as far. It follows the first by a soft equality.
    mass = model.body_subtreemass[model.body("c").id] + model.body_subtreemass[model.body("d").id] * 3.0
    assert one - other == pytest.approx(5.0 / mass / (2.0 * np.pi * 10.0) ** 2, rel=0.2)


def test_a_simulation_begins_in_the_whole_state_of_the_view():
    text = ROBOT.replace("<actuator>", "<actuator><general name='slow' joint='finger' dyntype='filter' dynprm='5'/>")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.act[0], data.ctrl[0], data.qvel[2] = 0.02, 0.01, 1.0
    arm = view(model, data)
    run = ls.simulate(arm, ls.plan(arm, [0.2, 0.0, 0.0], planner="minimum-jerk", duration=0.5), hold=0.0)
    alone = mujoco.MjData(model)
    mujoco.mj_copyData(alone, model, data)
    mujoco.mj_step(model, alone)
    assert run.qpos[1, 2] == pytest.approx(alone.qpos[2], abs=1e-12)
    held = arm.data()
    np.testing.assert_array_equal(held.act, data.act)
    assert (run.ctrl[:, model.actuator("slow").id] == 0.01).all()


@pytest.mark.parametrize("controller", ["position-servo", "inverse-dynamics", "computed-torque"])
def test_other_controllers_drive_a_view_where_its_actuators_allow(controller):
    servos = (
        '<position name="reach" joint="reach" kp="900" kv="90"/><position name="turn" joint="turn" kp="800" kv="80"/>'
    )
    model = mujoco.MjModel.from_xml_string(ROBOT.replace('<motor name="turn" joint="turn" gear="4"/>', servos))
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.3
    arm = view(model, data)
    found = ls.plan(arm, [0.4, -0.1, 0.1], planner="minimum-jerk")
    run = ls.simulate(arm, found, controller=controller)
    assert np.abs(run.tracking_error).max() < (0.02 if controller == "position-servo" else 2e-3)
    assert (run.ctrl[:, 0] == 0.3).all()
    with pytest.raises(InputError, match="a view of a compiled model has no spec to change"):
        ls.simulate(arm, found, controller="mocap")


def test_disturbances_act_on_a_view(case):
    _, _, arm, found = case
    calm = ls.simulate(arm, found, hold=0.2)
    for changes, least in (
        (ls.Disturbances(pushes=(ls.Push("end effector", (0.0, 0.0, -20.0), 1.0, 0.3),)), 2e-3),
        (ls.Disturbances(mass_scale=1.3), 1e-3),
        (ls.Disturbances(payload=0.5), 1e-3),
        (ls.Disturbances(position_noise=1e-3), 2e-4),
    ):
        run = ls.simulate(arm, found, hold=0.2, disturbances=changes)
        off = np.abs(run.q - calm.q).max()
        assert least < off < 0.3, changes
        # The ball and its fall are no part of the arm.
        np.testing.assert_allclose(run.qpos[:50, :3], calm.qpos[:50, :3], atol=1e-9)
    assert run == ls.simulate(arm, found, hold=0.2, disturbances=changes)  # the noise is the same again
    moving = simulation.MovingObstacle("post", (0.0, 1.0), ((0.0, 1.5, 0.0), (0.0, 2.0, 0.0)))
    run = ls.simulate(
        arm,
        found,
        hold=0.0,
        disturbances=ls.Disturbances(obstacles=(moving,)),
        log=[ls.Channel("post", "m", lambda data: data.body("post").xpos)],
    )
    assert run.channels["post"][-1] == pytest.approx([0.0, 2.0, 0.0])


def test_a_payload_is_that_of_the_same_body_in_the_spec(case):
    _, _, arm, _ = case
    plant = make_plant(arm, ls.Disturbances(payload=0.7))
    spec = mujoco.MjSpec.from_string(ROBOT)
    compensated = mujoco.MjSpec.from_string(ROBOT.replace('<body name="d"', '<body name="d" gravcomp="1"')).compile()
    with pytest.raises(
        InputError, match="cannot be added to 'd' of a compiled model, whose gravity MuJoCo compensates"
    ):
        make_plant(view(compensated, mujoco.MjData(compensated)), ls.Disturbances(payload=0.7))
    frame = arm.frames[-1:]
    radius = (3.0 * 0.7 / (4.0 * np.pi * 7850.0)) ** (1.0 / 3.0)
    body = arm.model.body(int(frame.bodies[0])).name
    inertia = [0.4 * 0.7 * radius**2] * 3
    spec.body(body).add_body(
        name="load", pos=frame.positions[0], mass=0.7, ipos=[0, 0, 0], inertia=inertia, explicitinertial=True
    )
    loaded = spec.compile()
    q = [0.3, -0.2, 0.1]
    forces = []
    for model in (plant, loaded):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = arm.qpos(q), arm.qvel(q, [1.0, -2.0, 0.3])
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        forces.append(np.vstack([data.qfrc_bias, matrix]))
    np.testing.assert_allclose(*forces, atol=1e-9)


def test_a_certified_policy_runs_a_view(case):
    _, _, arm, found = case
    target = found.motion.q[-1]
    policy = ls.make_policy("lieednn-shaped", arm, target, rate=125.0)
    following = ls.follow(policy, target, 6.0)
    assert following.rollout.controller == "feedback-linearisation"
    np.testing.assert_allclose(following.rollout.q[-1], target, atol=2e-3)


def test_a_motor_that_cannot_hold_its_load_is_named():
    model = mujoco.MjModel.from_xml_string(ROBOT.replace('kp="800" kv="80"', 'kp="800" kv="80" forcerange="-1 1"'))
    arm = view(model, mujoco.MjData(model))
    with pytest.raises(InputError, match=r"'lift' cannot be held at the start: its load is .* N m, its force limit 1"):
        ls.plan(arm, [0.9, -0.4, 0.15])


# The shoulder's motor gives 10 * 0.7 = 7 N m.
WEAK = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body pos="0 0 1"><joint name="j1" axis="0 1 0" range="-120 120" damping="1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/>
    <body pos=".4 0 0"><joint name="j2" axis="0 1 0" range="-140 140" damping=".5"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".5"/><site name="tip" pos=".3 0 0"/></body></body>
</worldbody><actuator><motor joint="j1" gear="10" ctrlrange="-.7 .7" forcerange="-9 9"/>{}</actuator></mujoco>"""
MOTOR, SERVO = (
    '<general joint="j2" gainprm="2" gear="5" ctrlrange="-1 1"/>',
    '<position joint="j2" kp="60" ctrlrange="-1.5 1.5" forcerange="-10 10"/>',
)


@pytest.mark.parametrize(
    ("controller", "second", "file"),
    [
        ("feedback-linearisation", MOTOR, False),
        ("feedback-linearisation", SERVO, True),
        ("computed-torque", MOTOR, True),
        ("computed-torque", SERVO, False),
    ],
)
def test_motors_exert_no_more_than_their_control_ranges_give_and_controls_can_be_replayed(controller, second, file):
    xml = WEAK.format(second)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0] = 1.5
    if file:
        arm = ls.Arm.from_spec(mujoco.MjSpec.from_string(xml), home={"j1": 1.5}, floor="none")
    else:
        arm = ls.Arm.of(model, data, ["j1", "j2"], tip="tip")
    np.testing.assert_allclose(arm.force_limits, [7.0, 10.0])
    motion = ls.plan(arm, [1.2, 0.5], planner="minimum-jerk", duration=1.0).motion
    heavy = ls.simulate(arm, motion, controller=controller, disturbances=ls.Disturbances(payload=12.0))
    np.testing.assert_allclose(np.abs(heavy.force).max(axis=0)[0], 7.0)
    assert (np.abs(heavy.force) <= arm.force_limits + 1e-9).all()
    assert (np.abs(heavy.ctrl) <= [0.7, model.actuator_ctrlrange[1, 1]]).all()
    assert ls.evaluate(heavy).force_fraction <= 1.0 + 1e-12
    run = ls.simulate(arm, motion, controller=controller)
    data.qpos[:] = run.qpos[0]
    for row, data.ctrl[:] in zip(run.qpos, run.ctrl, strict=True):
        np.testing.assert_allclose(data.qpos, row, atol=1e-9)
        mujoco.mj_step(model, data)


def test_neither_fingers_that_touch_nor_what_is_in_a_gap_is_a_contact():
    slide = '<joint name="f{0}" type="slide" axis="0 1 0" stiffness="1e3"/>'
    finger = f'<body pos=".3 {{0}}.02 0">{slide}<geom size=".021"/></body>'
    link = '<joint name="turn" axis="0 0 1" range="-90 90"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>'
    near = '<geom size=".02" pos=".1 0 -.07" margin=".001" gap=".05"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody>{near}<body>{link}{finger.format("")}{finger.format("-")}</body>'
        '</worldbody><actuator><motor joint="turn"/></actuator></mujoco>'
    )
    arm = ls.Arm.of(model, mujoco.MjData(model), ["turn"])
    run = ls.simulate(arm, ls.plan(arm, [0.1], planner="minimum-jerk", duration=0.5), hold=0.0)
    data = arm.data()
    mujoco.mj_forward(model, data)
    assert sorted(data.contact.exclude) == [0, 1]
    assert not run.contacts.any()


@pytest.mark.parametrize("policy", ["allowed", "init"])
def test_an_arm_does_not_sleep_while_what_it_does_not_touch_may(policy):
    """Controls do not wake what sleeps in MuJoCo: the arm ended off its target, here by more than half a radian."""
    asleep = ROBOT.replace('"implicitfast"/>', '"implicitfast"><flag sleep="enable"/></option>')
    asleep = asleep.replace('name="a"', f'name="a" sleep="{policy}"').replace('name="ball"', 'name="ball" sleep="init"')
    model = mujoco.MjModel.from_xml_string(asleep)
    imported = ls.Arm.from_spec(mujoco.MjSpec.from_string(asleep), joints=JOINTS, tip="tip")
    for arm in (view(model, mujoco.MjData(model)), imported):
        run = ls.simulate(arm, ls.plan(arm, [0.6, -0.4, 0.1], planner="minimum-jerk"))
        assert np.abs(run.tracking_error[-1]).max() < 2e-3
        assert run.qpos[-1, 2] == 0.5
    assert imported.spec.body("a").sleep == mujoco.mjtSleepPolicy.mjSLEEP_NEVER, "what is compiled later needs it, too"
