"""Plans of views: joints of a compiled model that somebody else made."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.motion import check_joints, check_motion

# Two arms, whose joints take turns in qpos only by tree; things that lie, hang from a moved mocap body, and are tied.
SCENE = """
<mujoco>
  <option timestep="0.004" gravity="0 0 -9"/>
  <asset>
    <mesh name="wedge" vertex="0 0 0  .3 0 0  0 .2 0  0 0 .1  .3 .2 .05"/>
    <hfield name="ground" nrow="3" ncol="3" size=".2 .2 .1 .01" elevation="0 1 0 1 2 1 0 1 0"/>
  </asset>
  <worldbody>
    <geom type="plane" size="3 3 .1" pos="0 0 -.5"/>
    <geom type="hfield" hfield="ground" pos="2 2 -.5"/>
    <body name="thing" pos="0 0 1"><freejoint/><geom type="mesh" mesh="wedge"/></body>
    <body name="hanging" mocap="true" pos="0 0 3"><geom type="sphere" size=".15"/></body>
    <body name="other" pos="-1 0 0">
      <joint name="other" axis="0 0 1" range="-90 90"/><geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
    </body>
    <body name="a" pos="0 0 .2" euler="0 0 30">
      <joint name="turn" axis="0 0 1" damping="2" armature=".1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="2"/>
      <body name="b" pos=".4 0 0">
        <joint name="lift" axis="0 1 0" range="-60 60" ref="10" stiffness="3" springref="20" frictionloss=".2"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" friction="2 .1 .1"/>
        <body name="c" pos=".3 0 0">
          <joint name="out" type="slide" axis="1 0 0" range="0 .3"/>
          <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" rgba="1 0 0 1"/>
          <body name="d" pos=".3 0 0">
            <joint name="last" type="slide" axis="1 0 0" range="0 .3"/><geom type="sphere" size=".03"/>
            <body name="e" pos=".05 0 .02">
              <joint name="spin" axis="1 0 0" range="-90 90"/>
              <inertial pos="0 0 .01" mass=".1" diaginertia="1e-4 1e-4 1e-4"/>
              <site name="pen" euler="0 90 0"/>
            </body>
            <body name="finger" pos=".05 0 0">
              <joint name="finger" axis="0 0 1" range="0 40"/><geom type="box" size=".02 .01 .01"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="last" joint2="out" polycoef="0 1 0 0 0"/><weld body1="other" body2="thing" active="false"/>
  </equality>
  <actuator>
    <motor joint="turn" gear="3" ctrlrange="-20 20" ctrllimited="true"/>
    <position name="servo" joint="lift" kp="400" kv="40" forcerange="-50 50"/>
    <motor joint="out" ctrlrange="-90 90" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
JOINTS = ["turn", "lift", "out"]


def planned(model, data, joints, goal, *, tip=None, limits=None, **how):
    return ls.plan(ls.Arm.of(model, data, joints, tip=tip, limits=limits), goal, **how)


@pytest.fixture
def state():
    """The scene and a state of it: the arm turned, a thing lying elsewhere, a mocap body moved, a finger open."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    data.joint("turn").qpos, data.joint("lift").qpos, data.joint("finger").qpos = 3.5, 0.3, 0.4
    data.joint("out").qpos = data.joint("last").qpos = 0.1
    data.qpos[:3], data.mocap_pos[0] = [0.2, -0.9, 0.2], [0.5, 0.8, 0.5]
    mujoco.mj_forward(model, data)
    return model, data


def test_a_plan_in_somebody_elses_model_keeps_their_order_and_the_rest_where_it_is(state):
    model, data = state
    before = data.qpos.copy()
    goal = {"turn": 5.2, "lift": -0.4, "out": 0.25}
    found = planned(model, data, JOINTS, [goal[name] for name in JOINTS], tip="pen", limits={"turn": {"velocity": 2.0}})
    assert found.planner == "lieednn-shaped"
    assert found.network.certified
    assert found.arm.joint_names == ("turn", "lift", "out")
    assert found.arm.frames.names[-1] == "pen"
    np.testing.assert_array_equal(data.qpos, before)
    np.testing.assert_allclose(found.qpos[0], before, atol=1e-6)
    address = {name: int(model.joint(name).qposadr[0]) for name in (*JOINTS, "last", "finger")}
    for name, value in goal.items():
        assert found.qpos[-1, address[name]] == pytest.approx(value, abs=1e-6)
    np.testing.assert_allclose(found.qpos[:, address["last"]], found.qpos[:, address["out"]], atol=1e-12)
    rest = np.delete(np.arange(model.nq), [address[name] for name in (*JOINTS, "last")])
    np.testing.assert_array_equal(found.qpos[:, rest], np.tile(before[rest], (len(found.t), 1)))
    # The velocities are those of the positions, in MuJoCo's own order.
    step = np.zeros(model.nv)
    for k in range(50, len(found.t) - 1, 200):
        mujoco.mj_differentiatePos(model, step, 2.0 * found.arm.timestep, found.qpos[k - 1], found.qpos[k + 1])
        np.testing.assert_allclose(found.qvel[k], step, atol=2e-3)
    assert np.abs(found.qvel[:, model.joint("turn").dofadr[0]]).max() <= 2.0
    # Where the end effector goes, by their kinematics and by ours.
    their = mujoco.MjData(model)
    their.qpos[:] = found.qpos[300]
    mujoco.mj_kinematics(model, their)
    pose = found.arm.link_poses(found.motion.q[300])[-1]
    np.testing.assert_allclose(pose.translation, their.site("pen").xpos, atol=1e-9)
    np.testing.assert_allclose(pose.rotation.as_matrix().ravel(), their.site("pen").xmat, atol=1e-9)


def test_what_stands_in_the_way_is_avoided_where_the_data_has_it(state):
    model, data = state
    goal = [4.7, 0.3, 0.1]
    straight = planned(model, data, JOINTS, goal, planner="minimum-jerk")
    tip = mujoco.MjData(model)
    tip.qpos[:] = straight.qpos[len(straight.t) // 2]
    mujoco.mj_kinematics(model, tip)
    data.mocap_pos[0] = tip.body("d").xpos
    with pytest.raises(PlanError, match="'hanging'"):
        planned(model, data, JOINTS, goal, planner="minimum-jerk")
    # With a last joint that moves nothing that could touch.
    around = planned(model, data, [*JOINTS, "spin"], [*goal, 0.4])
    tip.mocap_pos[:] = data.mocap_pos
    for tip.qpos[:] in around.qpos[::20]:
        mujoco.mj_forward(model, tip)
        assert "hanging" not in {
            model.geom(g).id and model.body(model.geom_bodyid[g]).name for g in tip.contact.geom.flat
        }


def test_sets_of_goals_and_a_line_that_is_kept(state):
    model, data = state
    data.mocap_pos[0] = [0.0, 0.0, 5.0]
    far, near = [1.0, 0.5, 0.2], [3.4, 0.2, 0.15]
    found = planned(model, data, JOINTS, [far, near], tip="pen", planner="minimum-jerk")
    arm = found.arm
    assert dict(zip(arm.joint_names, found.target, strict=True)) == dict(zip(JOINTS, near, strict=True))
    tip = arm.tip(found.motion.q[0])
    up = ls.TaskSpaceRegion.line(tip, tip + np.array([0.0, 0.0, 0.1]))
    high = ls.TaskSpaceRegion.box([-9.0, -9.0, tip[2] + 0.1], [9.0, 9.0, tip[2] + 0.1])
    kept = planned(model, data, JOINTS, high, tip="pen", path_constraint=up)
    off = arm.tip(kept.motion.q)[:, :2] - tip[:2]
    assert np.abs(off).max() < 5e-4
    assert arm.tip(kept.target)[2] == pytest.approx(tip[2] + 0.1, abs=1e-5)


def test_the_start_may_be_any_turn_of_a_hinge_without_a_range(state):
    model, data = state
    data.joint("turn").qpos = 40.0
    found = planned(model, data, JOINTS, [41.0, 0.0, 0.2], planner="minimum-jerk")
    turned = found.qpos[[0, -1], model.joint("turn").qposadr[0]]
    np.testing.assert_allclose(turned, [40.0, 41.0], atol=1e-6)


def test_stages_that_follow_one_another_are_all_of_the_arm_of_the_first():
    stage = '<body pos=".1 0 0"><joint name="{0}" type="slide" axis="1 0 0" range="0 .1"/><geom size=".01"/>{1}</body>'
    bodies = stage.format("a", stage.format("b", stage.format("c", "")))
    ties = "".join(f'<joint joint1="{one}" joint2="{other}"/>' for one, other in ("ba", "cb"))
    text = f"<mujoco><worldbody><body>{bodies}</body></worldbody><equality>{ties}</equality></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    found = planned(model, mujoco.MjData(model), ["a"], [0.05], planner="minimum-jerk", duration=1.0)
    np.testing.assert_allclose(found.qpos[-1], 0.05, atol=1e-9)


@pytest.mark.parametrize(
    ("joints", "changes", "message"),
    [
        ([], {}, "at least one joint"),
        (["turn", "knee"], {}, "joint of the arm.*'knee'.*finger, last, lift, other, out, spin, turn"),
        (["turn", "turn"], {}, "joints must differ"),
        (["turn", "other"], {}, "'other' is not on the way to body 'a'|'turn' is not on the way to body 'other'"),
        (JOINTS, {"goal": [0.1, 0.2]}, "target of turn, lift, out must have shape"),
        (JOINTS, {"goal": [3.0, 2.0, 0.1]}, "target is out of reach: joint 'lift' would be at 2 rad"),
        (JOINTS, {"tip": "other"}, "the tip 'other' is not carried by the last link"),
    ],
)
def test_bad_input_is_named(state, joints, changes, message):
    model, data = state
    with pytest.raises(InputError, match=message):
        planned(model, data, joints, **{"goal": [3.6, 0.2, 0.1], **changes})


def test_data_of_another_model_or_with_nan_is_refused(state):
    model, data = state
    with pytest.raises(InputError, match="data must be of the model"):
        planned(model, mujoco.MjData(mujoco.MjModel.from_xml_string("<mujoco/>")), JOINTS, [3.6, 0.2, 0.1])
    data.qpos[0] = np.nan
    with pytest.raises(InputError, match="NaN"):
        planned(model, data, JOINTS, [3.6, 0.2, 0.1])


def test_a_view_in_another_state_keeps_what_was_asked_for(state):
    model, data = state
    arm = ls.Arm.of(model, data, JOINTS, tip="pen", limits={"turn": {"velocity": 2.0}}, clearance=0.004)
    arm = replace(
        arm, velocity_limits=np.array([2.0, 0.5, np.inf]), position_limits=arm.position_limits * [[1.0], [0.9], [1.0]]
    )
    data.joint("turn").qpos, data.joint("finger").qpos, data.mocap_pos[0], data.ctrl[1] = 4.0, 0.1, [0.0, 0.0, 4.0], 0.2
    moved = arm.at(data)
    np.testing.assert_array_equal(moved.velocity_limits, arm.velocity_limits)
    np.testing.assert_array_equal(moved.position_limits[1:], arm.position_limits[1:])
    # A hinge without a range turns as far to both sides as before.
    np.testing.assert_allclose(moved.position_limits[0], arm.position_limits[0] + 0.5)
    np.testing.assert_allclose(moved.qpos(moved.keyframe("home")), data.qpos, atol=1e-12)
    assert moved.clearance == 0.004
    np.testing.assert_array_equal(moved.data().ctrl, data.ctrl)
    np.testing.assert_array_equal(moved.data().mocap_pos, data.mocap_pos)
    np.testing.assert_array_equal(moved.model.body_pos[model.body("hanging").id], [0.0, 0.0, 4.0])
    assert moved.keyframes == ("home",)
    with pytest.raises(InputError, match="is no view of a compiled model"):
        ls.Arm.load("telescopic_pr").at(data)


@pytest.mark.parametrize("under", [1e-9, 1e-6, 5e-4])
def test_a_sensor_that_reads_below_a_limit_is_at_it(state, under):
    model, data = state
    data.joint("out").qpos = data.joint("last").qpos = model.joint("out").range[0] - under
    arm = ls.Arm.of(model, data, JOINTS, tip="pen")
    planned = ls.plan(arm, arm.position_limits.mean(axis=1), planner="minimum-jerk")
    np.testing.assert_array_equal(planned.motion.q[0], np.maximum(arm.keyframe("home"), arm.position_limits[:, 0]))
    with pytest.raises(InputError, match=r"up to 1e-12 beyond a limit is taken as at it: bring the joint back"):
        ls.plan(replace(arm, start_tolerance=1e-12), arm.position_limits.mean(axis=1))


FINGER = """<mujoco><compiler angle="radian"/><worldbody>
  <geom name="table" type="box" size=".6 .6 .02" pos=".3 0 .02"/>
  <body name="boom" pos="0 0 .5"><joint name="turn" axis="0 0 1" range="-1.5 1.5"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
    <body name="finger" pos=".3 0 -.1"><joint name="down" type="slide" axis="0 0 -1" range="0 .4"/>
      <geom name="finger" type="capsule" fromto="0 0 0 0 0 -.1" size=".01"/></body></body>
</worldbody></mujoco>"""


def finger_at(gap):
    model = mujoco.MjModel.from_xml_string(FINGER)
    data = mujoco.MjData(model)
    data.joint("down").qpos = 0.25 - gap
    return ls.Arm.of(model, data, ["turn", "down"])


def distances(arm, q):
    data, geoms = mujoco.MjData(arm.model), [arm.model.geom(name).id for name in ("finger", "table")]
    result = []
    for data.qpos[:] in arm.qpos(q):
        mujoco.mj_forward(arm.model, data)
        result.append(mujoco.mj_geomDistance(arm.model, data, *geoms, 1.0, None))
    return np.array(result)


@pytest.mark.parametrize(
    ("planner", "gap"),
    [("minimum-jerk", 1e-3), ("rrt-connect", 0.0), ("lieednn-certified", -5e-4), ("lieednn-shaped", -9e-4)],
)
def test_a_motion_leaves_what_is_nearer_than_the_clearance_at_its_start(planner, gap):
    arm = finger_at(gap)
    planned = ls.plan(arm, [1.0, 0.05], planner=planner)
    near = np.minimum(distances(arm, planned.motion.q), arm.clearance)
    assert near[0] == pytest.approx(gap, abs=1e-9)
    assert (np.diff(near) > -1e-5).all()
    assert near[-1] == arm.clearance
    assert planned.leaves.startswith(("'world' to 'finger' (", "'finger' to 'world' ("))
    check_motion(arm, planned.motion)
    slid = replace(planned.motion, q=planned.motion.q * [1.0, 0.0] + [0.0, planned.motion.q[0, 1]])
    with pytest.raises(PlanError, match="would come within 2 mm of"):
        check_motion(arm, replace(slid, qd=slid.qd * [1.0, 0.0]))


def test_only_a_start_may_be_near_and_no_deeper_than_the_tolerance():
    with pytest.raises(InputError, match=r"2 mm deep; motions lead out of contact from 1 mm deep at most"):
        ls.plan(finger_at(-2e-3), [1.0, 0.05])
    with pytest.raises(InputError, match=r"come nearer than the clearance of 2 mm, which dataclasses\.replace"):
        ls.plan(finger_at(0.0), [0.02, 0.249])
    with pytest.raises(PlanError, match=r"from the start the motion must leave what is near: .* \(0 mm, nearer than"):
        ls.plan(finger_at(0.0), [1.0, 0.05], planner="dmp")
    assert not ls.plan(finger_at(3e-3), [1.0, 0.05]).leaves


def test_a_motion_that_comes_back_to_what_it_leaves_is_refused():
    arm, t = finger_at(0.0), 0.002 * np.arange(1001)
    lifted = 1e-3 * np.sin(np.pi * t) ** 2
    q = np.stack([0.0 * t, 0.25 - lifted], axis=1)
    with pytest.raises(PlanError, match="the arm would come nearer again to what"):
        check_joints(arm.leaving(q[0])[0], t, q, np.gradient(q, t, axis=0))
