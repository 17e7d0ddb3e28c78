"""What an import adds to a file, and what it leaves alone, judged by MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError

# A torso that nothing drives carries two driven joints, with a hook that hangs from the last link.
LIFTED = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="torso" pos="0 0 1">
    <joint name="rise" type="slide" axis="0 0 1" range="-.2 .4"/><geom size=".1" mass="20"/>
    <body name="a" pos=".2 0 0"><joint name="turn" axis="0 0 1" range="-100 100"/><geom size=".04" mass="2"/>
      <body name="b" pos=".3 0 0"><joint name="lift" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="2"/><site name="tip" pos=".35 0 0"/>
        <body name="hook" pos=".4 0 0"><joint name="swing" axis="1 0 0" damping=".01"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".01" mass=".5"/></body></body></body></body>
  <body name="wall" pos="3 0 0"><joint name="door" axis="0 0 1"/><geom size=".1"/></body>
</worldbody><actuator>{}</actuator></mujoco>"""
DRIVES = '<position joint="turn" kp="500" kv="50"/><position joint="lift" kp="800" kv="60" forcerange="-{0} {0}"/>'


def lifted(force=60, actuators=DRIVES, **options):
    return ls.Arm.from_spec(
        mujoco.MjSpec.from_string(LIFTED.format(actuators.format(force))),
        **{"joints": ["turn", "lift"], "tip": "tip", "floor": "none", **options},
    )


def test_what_carries_the_arm_is_held_and_what_hangs_from_it_swings():
    arm = lifted()
    assert "new servos for rise: to hold" in arm.import_report.notes
    assert [arm.model.actuator(k).name for k in range(arm.model.nu)][2:] == ["rise"]
    run = ls.simulate(arm, ls.plan(arm, [1.2, 0.4], planner="minimum-jerk", duration=2.0))
    assert ls.evaluate(run, clearance=False).final_worst_mm < 1.0
    rise, swing = (arm.model.joint(name).qposadr[0] for name in ("rise", "swing"))
    assert np.abs(run.qpos[:, rise]).max() < 1e-3
    assert np.abs(run.qpos[:, swing]).max() > 0.01


def test_in_a_file_that_drives_nothing_all_joints_get_servos_that_hold_their_load():
    arm = lifted(actuators="")
    notes = arm.import_report.notes
    assert "new servos for turn, lift: there was no actuator" in notes
    assert "new servos for rise, swing, door: to hold" in notes
    data = arm.data()
    start = data.qpos.copy()
    mujoco.mj_step(arm.model, data, 1000)
    np.testing.assert_allclose(data.qpos, start, atol=1e-6)


def test_additions_can_be_switched_off():
    arm = lifted(servos="none", actuators="")
    assert arm.model.nu == 0
    run = ls.simulate(arm, ls.plan(arm, [0.5, 0.2], planner="minimum-jerk", duration=1.0))
    assert run.controller == "feedback-linearisation"
    for wrong in ({"servos": "some"}, {"overlaps": "some"}):
        with pytest.raises(InputError, match="some"):
            lifted(**wrong)
    nested = (
        '<mujoco><worldbody><body><geom type="box" size=".3 .1 .1"/><body><joint name="s" type="slide" axis="1 0 0" '
        'range="0 .4"/><geom type="box" size=".3 .05 .05"/></body></body></worldbody></mujoco>'
    )
    free, kept = (ls.Arm.from_spec(mujoco.MjSpec.from_string(nested), overlaps=how) for how in ("ignore", "keep"))
    assert free.contacts([0.1]) == []
    assert len(kept.contacts([0.1])) == 1


def test_a_motor_that_is_too_weak_on_the_way_is_named_with_the_time():
    """Level, link and hook weigh 9.81 (2 0.15 + 0.5 0.4) = 4.9 N m at the joint; at 60 degrees half of that."""
    down = np.deg2rad(59.0)
    arm = lifted(4.0, home={"lift": down})
    with pytest.raises(
        InputError, match=r"joint 'lift' cannot be held at t = 1\.\d+ s: its load is 4\.\d+ N m, .* 4 N"
    ):
        ls.plan(arm, [0.0, -down], planner="minimum-jerk", duration=3.0)
    ls.plan(lifted(6.0, home={"lift": down}), [0.0, -down], planner="minimum-jerk", duration=3.0)


def test_a_target_of_a_hinge_without_a_range_is_reached_the_short_way_round():
    wheel = '<body name="a"><joint name="spin" axis="0 0 1"/><geom size=".1"/>{}</body>'
    rod = '<body pos=".2 0 0"><joint name="out" type="slide" axis="1 0 0" range="0 .3"/><geom size=".02"/></body>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{wheel.format(rod)}</worldbody></mujoco>")
    arm = ls.Arm.from_spec(spec, floor="none")
    np.testing.assert_array_equal(arm.continuous, [True, False])
    plan = ls.plan(arm, [np.deg2rad(-170), 0.2], start=[np.deg2rad(170), 0.1], planner="minimum-jerk")
    assert np.abs(np.diff(plan.motion.q[:, 0])).sum() == pytest.approx(np.deg2rad(20), abs=1e-6)
