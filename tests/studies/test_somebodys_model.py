"""A scene file of somebody else, with two arms, grippers and a can: compared, shown live, run by a policy."""

from __future__ import annotations

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.live.session import Session

JAW = (
    '<body name="{0}jaw{1}" pos=".12 {2} 0"><joint name="{0}jaw{1}" type="slide" axis="0 {3} 0" range="-.03 .03" '
    'damping="2"/><geom name="{0}jaw{1}" type="box" size=".03 .005 .01"/></body>'
)
ARM = """
<body name="{0}base" pos="0 {1} .3"><geom type="cylinder" size=".05 .05"/>
  <geom size=".07" contype="0" conaffinity="0" rgba="1 1 1 .3"/>
  <body name="{0}a" pos="0 0 .1"><joint name="{0}turn" axis="0 0 1" range="-100 100" damping="1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .25 0 0"/>
    <body name="{0}b" pos=".25 0 0"><joint name="{0}lift" axis="0 1 0" range="-70 70" damping="1"/>
      <geom type="capsule" size=".025" fromto="0.06 0 0 .2 0 0"/>
      <body name="{0}hand" pos=".2 0 0"><joint name="{0}reach" type="slide" axis="1 0 0" range="0 .15" damping="5"/>
        <geom type="capsule" size=".02" fromto="0.02 0 0 .08 0 0"/><site name="{0}tip" pos=".12 0 0"/>{2}</body>
    </body></body></body>"""
SERVOS = "".join(
    f'<position joint="{{0}}{name}" kp="{kp}" kv="{kv}" forcerange="-{force} {force}"/>'
    for name, kp, kv, force in (("turn", 400, 40, 60), ("lift", 400, 40, 60), ("reach", 4000, 300, 200))
)
GRIP = '<position joint="{0}jaw1" kp="200"/><position joint="{0}jaw2" kp="200"/>'


def sides(text: str) -> str:
    return "".join(text.format(side) for side in ("left/", "right/"))


def arms() -> str:
    jaws = {side: JAW.format(side, 1, 0.02, 1) + JAW.format(side, 2, -0.02, -1) for side in ("left/", "right/")}
    return "".join(ARM.format(side, y, jaws[side]) for side, y in (("left/", -0.4), ("right/", 0.4)))


SCENE = f"""
<mujoco><option timestep="0.004" integrator="implicitfast"/>
  <worldbody><geom name="ground" type="plane" size="2 2 .1"/>
    <geom name="table" type="box" size=".2 .5 .02" pos=".6 0 .18"/>
    <body name="can" pos=".55 -.2 .25"><freejoint/><geom type="cylinder" size=".03 .05" mass=".2"/></body>{arms()}
  </worldbody><actuator>{sides(SERVOS)}{sides(GRIP)}</actuator>
  <keyframe><key name="home" qpos=".55 -.2 .25 1 0 0 0{" 0" * 10}" ctrl="{"0 " * 6}{"-.02 " * 4}"/></keyframe>
</mujoco>"""
JOINTS = ["right/turn", "right/lift", "right/reach"]
LIMITS = {name: {"velocity": 1.5, "acceleration": 6.0} for name in JOINTS}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "two_arms.xml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def arm(file):
    return ls.Arm.load(file, joints=JOINTS, tip="right/tip", limits=LIMITS)


def test_nothing_of_the_model_is_changed_but_what_is_said(arm):
    given = mujoco.MjSpec.from_string(SCENE).compile()
    for size in ("nq", "nv", "nu", "nbody", "ngeom", "njnt", "neq"):
        assert getattr(arm.model, size) == getattr(given, size)
    for name in ("body_mass", "jnt_range", "actuator_gainprm", "actuator_biasprm", "body_gravcomp", "geom_margin"):
        np.testing.assert_array_equal(getattr(arm.model, name), getattr(given, name))
    report = arm.import_report
    assert all(servo.kept for servo in report.servos)
    assert not any("servos" in note or "floor" in note for note in report.notes)
    assert {"left/turn", "right/jaw1"} <= set(report.others)


def test_a_run_is_physics_for_all_that_is_not_the_arms(arm):
    """The can falls onto the table, the other arm and the jaws are held by their own servos."""
    target = arm.keyframe("home") + np.array([-0.5, -0.3, 0.05])
    run = ls.simulate(arm, ls.plan(arm, target))
    assert ls.evaluate(run).final_worst_mm < 0.1
    assert not run.contacts.any(), "neither a can on the table nor the jaws of one hand count"
    model, last = arm.model, run.qpos[-1]
    can = model.jnt_qposadr[next(j for j in range(model.njnt) if model.jnt_type[j] == 0)]
    assert last[can + 2] == pytest.approx(0.18 + 0.02 + 0.05, abs=2e-3)
    # The jaws are told to close, and the other arm to stay.
    jaws, others = (
        [model.joint(name).qposadr[0] for name in arm.import_report.others if word in name]
        for word in ("jaw", "left/turn")
    )
    assert (last[jaws] < -0.01).all()
    assert np.abs(last[others] - arm.qpos_home[others]).max() < 1e-3


def test_a_can_of_the_scene_is_carried(arm):
    with pytest.raises(
        ls.errors.InputError, match=r"'can' is 0\.\d+ m or more from the hand, .* up to 0\.1 m away: mov"
    ):
        arm.holding("can")
    assert arm.holding("can", tied=True).grasp.carrier == arm.model.body("right/hand").id
    near = arm.data()
    near.joint("joint0").qpos[:3] = arm.tip(arm.keyframe("home"))
    held = arm.at(near).holding("can")
    q = held.keyframe("home") + np.array([0.2, 0.0, 0.05])
    moved = held.qpos(q)[:3] - held.qpos(held.keyframe("home"))[:3]
    assert np.linalg.norm(moved) > 0.05
    assert ("can", "right/hand") not in held.near_contacts(q)


def test_five_planners_are_compared_in_it(file, arm, tmp_path):
    (tmp_path / "right.yaml").write_text(
        f"model: {file}\njoints: [{', '.join(JOINTS)}]\ntip: right/tip\nlimits:\n"
        + "".join(f"  {name}: {{velocity: 1.5, acceleration: 6}}\n" for name in JOINTS)
    )
    planners = ["lieednn-certified", "lieednn-shaped", "minimum-jerk", "se3-geodesic", "linear-attractor"]
    table = ls.compare(
        tmp_path / "table",
        planners=planners,
        arms=[str(tmp_path / "right.yaml")],
        scenes=["free"],
        controllers=["inverse-dynamics"],
        seeds=1,
    )
    rows = list(table.rows.values())
    assert len(rows) == 5
    assert all(row.success for row in rows), [row.reason for row in rows]


def test_a_certified_policy_a_task_and_the_live_view_take_it(arm):
    target = arm.keyframe("home") + np.array([0.3, 0.2, 0.05])
    policy = ls.make_policy("lieednn-certified", arm, target)
    assert policy.rate == pytest.approx(125.0)  # the nearest to 100 Hz at steps of 4 ms
    assert policy.certified
    assert np.abs(ls.follow(policy, target, 3.0).rollout.q[-1] - target).max() < 5e-3
    task = make_task("reach", arm)
    task.begin(np.random.default_rng(0))
    assert all(np.isfinite(value).all() for value in task.step(np.zeros(3))[0].values())
    session = Session(arm, target=target)
    session.settle()
    for _ in range(20):
        session.advance(25)
    assert np.abs(session.tick.q - target).max() < 5e-3
    session.close()
