"""Errors whose causes are known, on a hoist of two slides with simple numbers."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.evaluation import evaluate
from lieednn_sim.evaluation.diagnosis import error_causes
from lieednn_sim.planning import plan
from lieednn_sim.policies import make_policy
from lieednn_sim.simulation import Disturbances, follow, simulate

HOIST = """
<mujoco><option timestep=".002"/>
  <custom><numeric name="acceleration_limit" data="1000 1000"/></custom>
  <worldbody><site name="base_frame"/><body name="cart">
    <site name="link1_frame"/><joint name="drive" type="slide" axis="1 0 0" range="-1 1" {drive}/>
    <geom type="box" size=".1 .1 .1" mass="2"/>
    <body name="hook" pos="0 0 .5" gravcomp="{compensation}">
      <joint name="lift" type="slide" axis="0 0 1" range="-1 1" {lift}/>
      <site name="link2_frame"/><geom type="box" size=".1 .1 .1" mass="1"/>
    </body></body></worldbody>
  <actuator><position joint="drive" kp="1000" kv="110" {force}/>
    <position joint="lift" kp="{kp}" kv="{kv}" {control}/></actuator>
  <keyframe><key name="home" qpos="0 0"/></keyframe>
</mujoco>
"""


def moved(controller="position-servo", disturbances=None, imported=False, **changes):
    values = {"drive": "", "lift": "", "force": "", "compensation": 1, "kp": 2000, "kv": 90, "control": "", **changes}
    spec = mujoco.MjSpec.from_string(HOIST.format(**values))
    arm = Arm.from_spec(spec, floor="none") if imported else Arm.from_spec(spec, Path("hoist.xml"), "hoist")
    # Planned as if nothing limited the forces.
    strong = replace(arm, force_limits=np.full(2, np.inf))
    planned = plan(strong, np.array([0.5, 0.4]), planner="minimum-jerk", duration=1.0)
    return evaluate(simulate(arm, planned, controller=controller, disturbances=disturbances))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        # The hook of 1 kg lacks 0.3 of its compensation, 2.943 N.
        (
            {"compensation": 0.7, "kp": 1000},
            ["'lift' ends 2.94 mm", "its load of 2.94 N / kp 1000 pulls it off by 2.94 mm"],
        ),
        (
            {"drive": 'frictionloss="8"'},
            ["'drive' ends ", "dry friction of 8 N / kp 1000 holds it anywhere within 8 mm"],
        ),
        (
            {"drive": 'frictionloss="8"', "controller": "feedback-linearisation"},
            ["'drive' ends ", "dry friction of 8 N / kp 1000 holds it anywhere within 8 mm", "the controller inverse-"],
        ),
        (
            {"force": 'forcerange="-5 5"'},
            ["'drive' ends ", "its force limit of 5 N is reached in", "a longer duration"],
        ),
        # 1 kg and 210 N s/m against 10 N/m: the slow root is at 0.05 / s.
        ({"compensation": 0.7, "kp": 10, "kv": 210}, ["'lift' ends ", "its servo is slow", "in 15 s", "a longer hold"]),
        # The same against 105 N/m, nearly half of it from the joint itself: the root at 0.5 / s leaves 0.6 in the hold.
        (
            {"compensation": 0.7, "kp": 105, "kv": 110, "lift": 'damping="100"'},
            ["'lift' ends ", "its servo is slow", "in 1.4 s", "a longer hold"],
        ),
        ({"disturbances": Disturbances(payload=2.0)}, ["'lift' ends 9.81 mm", "knows nothing of payload 2 kg"]),
    ],
)
def test_what_holds_a_joint_off_is_told_with_what_it_is_worth(changes, expected):
    found = moved(**changes)
    joint = found.causes[0]
    assert all(any(text in line for line in found.causes) for text in expected)
    assert expected[0] in joint
    assert expected[1] in joint
    # What the run was not given is not blamed.
    words = {"friction": "drive", "load of": "compensation", "force limit": "force", "payload": "disturbances"}
    assert all((word in joint) == (given in changes) for word, given in words.items())
    assert f"final error {found.final_worst_mm:.3g} mm and 0 degrees:" in str(found)
    assert f"- {joint}" in str(found).splitlines()


def test_the_joint_that_matters_most_is_first_and_what_helps_does():
    changes = {"drive": 'frictionloss="8"', "compensation": 0.5}
    assert [line.split("'")[1] for line in moved(**changes).causes[:2]] == ["lift", "drive"]
    # In another's model the servo is told the load.
    found = moved(**changes, imported=True)
    assert [line.split("'")[1] for line in found.causes[:-1]] == ["drive"]
    helping = "what helps: the controller inverse-dynamics, or designed servos (servos='design', --servos design)"
    assert found.causes[-1] == helping
    told = moved(controller="inverse-dynamics", **changes)
    assert told.causes == ()
    assert told.final_worst_mm < 1e-6


def test_a_base_that_falls_is_the_first_cause(tmp_path):
    """A trolley of 50 kg, 20 mm over the ground, with a slide on it: nobody holds it up."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="3 3 .1"/><body name="trolley" pos="0 0 .12"><freejoint/>
        <geom type="box" size=".3 .3 .1" mass="50"/><body pos="0 0 .2"><joint name="x" type="slide" axis="1 0 0"
        range="-1 1"/><geom type="box" size=".05 .05 .05" mass=".1"/></body></body></worldbody></mujoco>"""
    )
    arm = Arm.of(model, mujoco.MjData(model), ["x"])
    (first,) = evaluate(simulate(arm, plan(arm, [0.05], duration=1.0))).causes
    assert re.match(r"a link ends 20\.\d mm and .* from where the joints have it: what carries the arm", first)


@pytest.mark.parametrize("controller", ["inverse-dynamics", "feedback-linearisation"])
def test_a_servo_that_would_have_to_be_told_more_than_its_control_range_is_named(controller):
    """To hold 9.81 N at 0.4 m a servo of 1000 N/m needs to be told 0.40981 m."""
    found = moved(controller, imported=True, compensation=0, kp=1000, control='ctrlrange="-1 .4"').causes
    assert found[0].startswith("joint 'lift' ends 9.81 mm off")
    assert found[0].endswith("0 degrees: its servo's control is at the end of its control range [-1, 0.4]")
    assert found[1:] == ("what helps: another target",)


def test_time_does_not_help_a_policy_whose_arm_cannot_bear_its_payload():
    hoist = {"drive": "", "lift": "", "force": "", "compensation": 0, "kp": 2000, "kv": 90}
    spec = mujoco.MjSpec.from_string(HOIST.format(**hoist, control='forcerange="-20 20"'))
    arm = Arm.from_spec(spec, floor="none").with_payload(3.0)
    policy = make_policy("linear-attractor", arm, [0.5, 0.4])
    first, *_, helps = evaluate(follow(policy, [0.5, 0.4], 1.0).rollout).causes
    held = "joint 'lift' cannot be held at the target with a payload of 3 kg: its load is 39.24 N, its force limit 20 N"
    assert first == held
    assert helps.startswith("what helps: another target, or a smaller load")
    assert "duration" not in helps


def test_angles_are_in_degrees_and_times_at_a_limit_in_percent(gantry):
    motion = plan(gantry, np.array([0.5, 0.0, 0.0, 0.5]), planner="minimum-jerk", duration=1.0).motion
    rollout, limit = simulate(gantry, motion, controller="inverse-dynamics"), gantry.force_limits[0]
    force = 0.9 * np.abs(rollout.force)
    force[:, 0] = -np.where(np.arange(len(force)) % 4 == 0, limit, 0.9 * limit)
    target = rollout.q[-1] - [0.05, 0.0, 0.0, np.deg2rad(7.0)]
    off = replace(rollout, force=force, target=target, q_ref=rollout.q_ref - rollout.q_ref[-1] + target, motion=None)
    turn, x, _ = error_causes(off)
    assert turn.startswith("joint 'turn' ends 7 degrees off, which alone moves a link by 0 mm and 7 degrees")
    assert x.startswith("joint 'x' ends 50 mm off, which alone moves a link by 50 mm and 0 degrees")
    assert f"its force limit of {limit:.3g} N is reached in 25.4 % of the time" in x
    always = replace(off, force=np.full_like(force, limit))
    assert "is reached in 100 % of the time, first at t = 0.00 s" in error_causes(always)[1]
    # The same error of a joint whose reference goes elsewhere, as that of a policy does that has not arrived.
    turn, x, helps = error_causes(replace(off, q_ref=rollout.q_ref))
    assert x.endswith("its reference ends 50 mm off")
    assert turn.endswith("its reference ends 7 degrees off")
    assert helps.startswith("what helps: a longer duration, or the end of the reference")


POST = '<geom name="post" type="box" size=".1 .3 .3" pos=".5 0 0" solref=".004 1"/></worldbody>'
ROPE = """</worldbody><tendon><fixed name="rope" range="-1 .4"><joint joint="drive" coef="1"/></fixed></tendon>"""


@pytest.mark.parametrize(
    ("added", "what", "force", "remedy"),
    [
        # The cart of +-0.1 m stops at 0.3 m; its servo of 1000 N/m would pull with 200 N.
        (POST, "the contact of 'post' and 'a geom of cart'", 150.0, "a motion planned with what it touches"),
        (ROPE, "the range of tendon 'rope'", 100.0, "a target that it allows"),
    ],
)
def test_what_blocks_a_joint_is_named_with_its_force_and_nothing_else_is(added, what, force, remedy):
    xml = HOIST.format(drive="", lift="", force='forcerange="-150 150"', compensation=1, kp=2000, kv=90, control="")
    free, blocked = (
        Arm.from_spec(mujoco.MjSpec.from_string(text), floor="none")
        for text in (xml, xml.replace("</worldbody>", added))
    )
    motion = plan(free, np.array([0.5, 0.4]), planner="minimum-jerk", duration=1.0).motion
    first, helps = evaluate(simulate(blocked, motion, controller="position-servo")).causes
    assert first.startswith("joint 'drive' ends")
    assert what in first
    assert float(first.split("holds it off with ")[1].removesuffix(" N")) == pytest.approx(force, rel=0.05)
    assert helps == f"what helps: {remedy}" + " in the arm's scene" * (added is POST)
