"""Force limits by hand: what can be relied on in both directions, of native and of imported arms."""

import re
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import dry_friction, servo_gains
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.actuators import Actuators

CARRIAGE = """
<mujoco><compiler angle="radian"/><option gravity="0 0 0" {option}/>{flag}
  <worldbody><body name="base"><geom size=".05"/>{base}
    <body name="carriage"><joint name="x" type="slide" axis="1 0 0" range="-1 1" {joint}/><geom size=".05"/>{link1}
      <body name="stage" pos="0 0 1"><joint name="y" type="slide" axis="1 0 0" range="-2 2" {follower}/>
        <geom size=".05"/>{link2}</body></body></body></worldbody>
  {tie}
  <tendon><fixed name="belt"><joint joint="x" coef="1"/><joint joint="y" coef="3"/></fixed></tendon>
  <actuator>{actuators}</actuator>
  <keyframe><key name="home" qpos="0 0"/></keyframe>
</mujoco>
"""
TIE = '<equality><joint joint1="y" joint2="x" polycoef="0 2 0 0 0"/></equality>'
SERVO = '<position joint="x" kp="100" kv="9" {}/>'
BELT = '<motor tendon="belt" gear="2" ctrlrange="-5 4"/>'


def both_arms(actuators, joint="", follower="", tie="", **more):
    """An arm with the package's sites, and the same imported without them."""
    fields = {"actuators": actuators, "joint": joint, "follower": follower, "tie": tie}
    fields |= {"option": "", "flag": "", **more}
    last = "link1" if tie else "link2"
    sites = {"base": '<site name="base_frame"/>', "link1": '<site name="link1_frame"/>', "link2": "", last: ""}
    sites["link2"] = f'<site name="link{1 if tie else 2}_frame"/>'
    native = mujoco.MjSpec.from_string(CARRIAGE.format(**fields, **sites))
    foreign = mujoco.MjSpec.from_string(CARRIAGE.format(**fields, base="", link1="", link2=""))
    imported = Arm.from_spec(foreign, links=["stage"] if tie else ["carriage", "stage"], base="base")
    arms = [Arm.from_spec(native, Path("a.xml"), "a"), imported]
    assert [arm.joint_names for arm in arms] == [("x",) if tie else ("x", "y")] * 2
    return arms, imported.import_report


@pytest.mark.parametrize(
    ("actuators", "joint", "wanted", "span"),
    [
        (SERVO.format('forcerange="-10 200"'), "", 10.0, (-10.0, 200.0)),
        (SERVO.format('forcerange="-10 200" gear="-3"'), "", 30.0, (-600.0, 30.0)),
        # Two actuators on one joint: -10 - 60 to 200 + 40.
        (SERVO.format('forcerange="-10 200"') + '<motor joint="x" gear="20" ctrlrange="-3 2"/>', "", 70.0, (-70, 240)),
        # Two cables that can only pull: 0..50 and -80..0.
        ('<motor joint="x" ctrlrange="0 50"/><motor joint="x" gear="-2" ctrlrange="0 40"/>', "", 50.0, (-80.0, 50.0)),
        # A motor of 3 N for each unit of its control, the other way round.
        ('<general joint="x" gainprm="-3" ctrlrange="-5 4"/>', "", 12.0, (-12.0, 15.0)),
        # One of them without a limit.
        (SERVO.format('forcerange="-10 200"') + '<motor joint="x"/>', "", np.inf, (-np.inf, np.inf)),
        # The joint's own range lies within the actuator's, and clamps a sum.
        (SERVO.format('forcerange="-30 200"'), 'actuatorfrcrange="-25 40"', 25.0, (-25.0, 40.0)),
        (SERVO.format("") + '<motor joint="x"/>', 'actuatorfrcrange="-25 40"', 25.0, (-25.0, 40.0)),
        # No force in one direction: nothing is known.
        (SERVO.format('forcerange="1 200"'), "", np.inf, (-np.inf, np.inf)),
    ],
)
def test_limits_are_the_smaller_end_of_the_sum_of_the_ranges(actuators, joint, wanted, span):
    arms, report = both_arms(actuators, joint)
    for arm in arms:
        np.testing.assert_allclose(arm.force_limits, [wanted, np.inf])
    np.testing.assert_allclose(report.servos[0].force_range, span)


@pytest.mark.parametrize(
    ("actuators", "tie", "wanted"),
    [
        (SERVO.format('ctrlrange="-.5 .4"'), "", (-0.5, 0.4)),
        (SERVO.format('ctrlrange="-3 .4"'), "", (-1.0, 0.4)),
        (SERVO.format('ctrlrange="-.5 .4" gear="-2"'), "", (-0.2, 0.25)),
        # 300 ctrl + 10 - 100 x is no force at x = 3 ctrl + 0.1.
        ('<general joint="x" gainprm="300" biastype="affine" biasprm="10 -100" ctrlrange="-.1 .2"/>', "", (-0.2, 0.7)),
        # The tendon's length is x + 3 y = 7 x.
        ('<position tendon="belt" kp="9" ctrlrange="-3.5 1.4"/>', TIE, (-0.5, 0.2)),
        # Wide ranges, rounded ones, and those that are no ranges of positions.
        (SERVO.format('ctrlrange="-.9995 1"'), "", (-1.0, 1.0)),
        (SERVO.format('ctrlrange="-3 3"'), "", (-1.0, 1.0)),
        ('<intvelocity joint="x" kp="100" actrange="-1 1" ctrlrange="-.1 .1"/>', "", (-1.0, 1.0)),
        # Where two act, neither holds it alone.
        (SERVO.format('ctrlrange="-.5 0"') + SERVO.format('ctrlrange="0 .5"'), "", (-1.0, 1.0)),
        (SERVO.format('ctrlrange="-.5 .4"') + '<motor joint="x" ctrlrange="-9 9"/>', "", (-1.0, 1.0)),
        ('<motor joint="x" ctrlrange="-.5 .4"/>', "", (-1.0, 1.0)),
    ],
)
def test_coordinates_range_as_far_as_the_controls_of_their_servos(actuators, tie, wanted):
    arms, report = both_arms(actuators, tie=tie)
    for arm in arms:
        np.testing.assert_allclose(arm.position_limits[0], wanted)
    told = f"x: range [-1, 1] narrowed to [{wanted[0]:g}, {wanted[1]:g}], where its servo can hold it by its ctrlrange"
    assert [note for note in report.notes if "narrowed" in note] == [told] * (wanted != (-1.0, 1.0))
    with pytest.raises(InputError, match=f"x' would be at 9 m, its range is .*{'ctrlrange' * (wanted != (-1, 1))}"):
        arms[1].check_position([9.0] + [0.0] * (not tie))
    if wanted != (-1.0, 1.0):
        designed = Arm.from_spec(arms[0].spec.copy(), joints=["x"], servos="design")
        np.testing.assert_allclose(designed.position_limits[0], [-1.0, 1.0])
        assert not any("narrowed" in note for note in designed.import_report.notes)


def test_a_servo_that_can_hold_a_coordinate_nowhere_is_named():
    with pytest.raises(InputError, match=r"by its ctrlrange the servo of 'x' holds it nowhere in \[-1, 1\]"):
        both_arms(SERVO.format('ctrlrange="2 3"'))


def test_actuators_that_no_controller_can_drive_are_told_when_the_arm_is_read():
    slow = SERVO.format('name="slow" timeconst=".1"')
    arms, report = both_arms(slow)
    for arm in arms:
        (told,) = (
            note for note in arm.notes if note.startswith("no controller can drive slow: they need <position>, ")
        )
        with pytest.raises(InputError, match=re.escape(told.split("they need ")[1])):
            Actuators(arm)
    assert told in report.notes
    assert "servos='design'" in told
    designed = Arm.from_spec(arms[0].spec, joints=["x"], servos="design")
    assert not any("no controller" in note for note in designed.import_report.notes)
    assert Actuators(designed).driving.tolist()[:1] == [True]
    # A plugin's own law counts, though its gain and bias look like a motor's.
    law = '<extension><plugin plugin="mujoco.pid"><instance name="i"><config key="kp" value="9"/></instance></plugin>'
    arms, _ = both_arms('<plugin name="p" joint="x" plugin="mujoco.pid" instance="i"/>', flag=f"{law}</extension>")
    for arm in arms:
        assert any(note.startswith("no controller can drive p: ") for note in arm.notes)


def test_disabled_actuators_neither_drive_nor_hold():
    """A motor of 2 N beside a servo of 60 N that its group disables; then, by the flag, both are."""
    actuators = '<motor name="on" joint="x" ctrlrange="-2 2"/>' + SERVO.format('name="p" group="1" forcerange="-60 60"')
    (native, imported), report = both_arms(actuators, option='actuatorgroupdisable="1"')
    for arm in (native, imported):
        np.testing.assert_allclose(arm.force_limits, [2.0, np.inf])
        assert Actuators(arm, complete=False).driving.tolist()[:2] == [True, False]
    assert "actuators that the file disables, which neither drive nor hold: p" in report.notes
    (native, imported), report = both_arms(actuators, flag='<option><flag actuation="disable"/></option>')
    with pytest.raises(InputError, match="no actuator moves 'x', 'y'"):
        Actuators(native)
    assert "actuators that the file disables, which neither drive nor hold: on, p" in report.notes
    assert "new servos for x, y: there was no actuator" in report.notes
    data = imported.data()
    data.ctrl[:] = 0.1
    mujoco.mj_forward(imported.model, data)
    np.testing.assert_allclose(data.actuator_force, [0.0, 0.0, *(0.1 * imported.model.actuator_gainprm[2:, 0])])


def test_a_belt_of_two_stages_pulls_at_one_coordinate_through_both():
    """y = 2 x: the tendon's length is 2 (x + 3 y) = 14 x, and its force -5 to 4 makes -70 to 56."""
    arms, report = both_arms(BELT, tie=TIE)
    assert [arm.force_limits.tolist() for arm in arms] == [[56.0], [56.0]]
    assert report.servos[0].force_range == (-70.0, 56.0)
    # At y arrives -30 to 24, of which the joint lets 3 through, twice as much on x; at x itself -10 to 8.
    (native, _), report = both_arms(BELT, follower='actuatorfrcrange="-3 3"', tie=TIE)
    np.testing.assert_allclose(native.force_limits, [8.0 + 2.0 * 3.0])
    np.testing.assert_allclose(report.servos[0].force_range, (-16.0, 14.0))


def test_gains_of_servos_go_with_the_square_of_the_gear(gantry):
    """Gears of 2, 0.5, 1 and 1 with kp = 1000 and kv = 100; a coordinate that moves y by 3 sees nine times y's."""
    kp, kv = servo_gains(gantry.model, np.diag([1.0, 3.0, -1.0, 1.0]))
    np.testing.assert_allclose(kp, [4000.0, 9.0 * 250.0, 1000.0, 1000.0])
    np.testing.assert_allclose(kv, 0.1 * kp)


def test_dry_friction_of_stages_adds_up_whichever_way_they_go(gantry):
    """x holds with 3 N, and y, which goes back by twice as much, with 2 N."""
    spec = gantry.spec.copy()
    spec.joint("x").frictionloss, spec.joint("y").frictionloss = 3.0, 2.0
    rates = np.array([[1.0], [-2.0], [0.0], [0.0]])
    np.testing.assert_allclose(dry_friction(spec.compile(), rates), 3.0 + 2.0 * 2.0)
