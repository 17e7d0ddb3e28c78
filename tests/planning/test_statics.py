"""Forces that motions need, with numbers by hand: a lift of 2 kg, and a boom of a metre behind it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.cli import main
from lieednn_sim.errors import InputError, TooFastError
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.statics import check_forces, force_use

G = 9.81
STEEL = 0.4 * (3.0 / (4.0 * np.pi * 7850.0)) ** (2.0 / 3.0)  # moment of inertia of a ball of a kilogram [kg m^2]
LIFT = """
<mujoco><option timestep=".002" integrator="implicitfast"/>
  <custom><numeric name="acceleration_limit" data="1000 1000"/></custom>
  <worldbody><site name="base_frame"/>
    <body name="cart"><site name="link1_frame"/>
      <joint name="lift" type="slide" axis="0 0 1" range="-1 1" damping="{damping}" frictionloss="{friction}"/>
      <inertial pos="0 0 0" mass="1.5" diaginertia=".1 .1 .1"/>
      <body name="boom"><joint name="swing" axis="0 -1 0" range="-170 170"/>
        <inertial pos=".2 0 0" mass=".5" diaginertia=".01 .01 .01"/><site name="link2_frame" pos="1 0 0"/></body></body>
    {can}
  </worldbody>
  <actuator><position joint="lift" kp="9000" kv="600" forcerange="-100 100"/>
    <position joint="swing" kp="2000" kv="200" forcerange="-{torque} {torque}"/></actuator>
  <keyframe><key name="home" qpos="0 0{pose}"/></keyframe></mujoco>"""
CAN = '<body name="can" pos="1 0 0"><freejoint/><inertial pos="0 0 0" mass="3" diaginertia="{0} {0} {0}"/></body>'


def filled(text, **changes):
    return text.format(**{"damping": 0.0, "friction": 0.0, "torque": 90.0, "can": "", "pose": "", **changes})


def hoist(text=LIFT, **changes):
    return ls.Arm.from_spec(mujoco.MjSpec.from_string(filled(text, **changes)), Path("hoist.xml"), "hoist")


def moved(arm, target, duration, **options):
    return ls.plan(arm, target, planner="minimum-jerk", duration=(duration, duration), **options)


@pytest.mark.parametrize("payload", [0.0, 3.0])
def test_the_force_of_a_swing_is_that_of_its_masses_by_hand(payload):
    arm = hoist(torque=1000.0).with_payload(payload)
    motion = moved(arm, [0.0, 1.5], 1.0).motion
    q, qd = motion.q[:-1, 1], motion.qd[:-1, 1]
    qdd = np.diff(motion.qd[:, 1]) / motion.timestep
    inertia, moment = 0.01 + 0.5 * 0.2**2 + payload + STEEL * payload ** (5.0 / 3.0), 0.5 * 0.2 + payload
    swing = inertia * qdd + moment * G * np.cos(q)
    lift = (2.0 + payload) * G + moment * (qdd * np.cos(q) - qd**2 * np.sin(q))
    wanted = max(np.abs(swing).max() / 1000.0, np.abs(lift).max() / 100.0)
    assert force_use(arm, motion.t, motion.q, motion.qd) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize(("damping", "friction"), [(0.0, 0.0), (20.0, 0.0), (20.0, 6.0)])
def test_a_motion_is_stretched_to_where_the_force_is_at_its_limit(damping, friction):
    """Upwards F = m (g + a / s^2) + friction + damping v / s: at 4.9 of 5 kg 9.81 N, of 100 N, the rest accelerates."""
    arm = hoist(damping=damping, friction=friction).with_payload(3.0)
    fast = moved(replace(arm, force_limits=np.full(2, np.inf)), [0.8, 0.0], 0.25).motion
    with pytest.raises(
        TooFastError,
        match=r"joint 'lift' would be overloaded at t = 0\.\d+ s with a payload of 3 kg"
        r": its load is [\d.]+ N, its force limit 100 N; a duration of at least",
    ) as caught:
        check_motion(arm, fast)
    # The peaks of the minimum-jerk law in units of d / T^2 and d / T, wherever their sum with damping is largest.
    s = np.linspace(0.0, 1.0, 20001)
    v, a = 30.0 * s**2 * (1.0 - s) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    spare = 100.0 - 5.0 * G - friction
    f1, f2 = damping * 0.8 * v, 5.0 * 0.8 * a
    needed = ((f1 + np.sqrt(np.maximum(f1**2 + 4.0 * spare * f2, 0.0))) / (2.0 * spare)).max()
    assert caught.value.duration == pytest.approx(needed, rel=5e-3)
    slow = ls.plan(arm, [0.8, 0.0], planner="minimum-jerk", duration=(0.25, 2.0)).motion
    assert needed <= slow.t[-1] <= 1.05 * needed
    assert 0.9 < force_use(arm, slow.t, slow.q, slow.qd) <= 1.0 + 1e-6


@pytest.mark.parametrize("at", [3, 1003, 1990])
def test_a_jolt_between_the_samples_that_are_looked_at_first_is_found(at):
    """Of 45 m/s^2 for three steps, and back with half of it."""
    qdd = np.zeros(2001)
    qdd[at : at + 3], qdd[at + 3 : at + 9] = 45.0, -22.5
    qd = np.stack([np.append(0.0, 0.002 * np.cumsum(qdd)[:-1]), np.zeros(2001)], axis=1)
    duration, reason = check_forces(hoist(), t := 0.002 * np.arange(2001), 0.002 * np.cumsum(qd, axis=0), qd)
    assert f"at t = {t[at]:.2f} s" in reason
    assert f"its load is {2.0 * (G + 45.0):.4g} N" in reason
    assert duration == pytest.approx(4.0 * np.sqrt(90.0 / (100.0 - 2.0 * G)))


@pytest.mark.parametrize(
    ("friction", "jolts", "at", "load"),
    [
        # Between the looks, and weaker than the one downwards before it.
        (0.0, [(0, 10, -20.0), (1030, 1050, 19.98)], "t = 2.0", 5.0 * (G + 19.98)),
        # In the first step from rest, which dry friction resists.
        (20.0, [(0, 1, 8.03), (1000, 1001, -8.03)], "t = 0.00", 5.0 * (G + 8.03) + 20.0),
    ],
)
def test_a_jolt_that_the_first_looks_could_miss_is_found(friction, jolts, at, load):
    qdd = np.zeros(2001)
    for first, last, value in jolts:
        qdd[first:last] = value
    qd = np.stack([np.append(0.0, 0.002 * np.cumsum(qdd)[:-1]), np.zeros(2001)], axis=1)
    arm, t = hoist(friction=friction).with_payload(3.0), 0.002 * np.arange(2001)
    _, reason = check_forces(arm, t, 0.002 * np.cumsum(qd, axis=0), qd)
    assert f"at {at}" in reason
    assert f"its load is {load:.4g} N, its force limit 100 N" in reason


SHARED = """
<mujoco><option timestep=".002" integrator="implicitfast" gravity="0 0 0"/>
  <custom><numeric name="acceleration_limit" data="1000 1000"/></custom>
  <worldbody><body><joint name="roll" axis="1 0 0" range="-99 99"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body><joint name="pitch" axis="0 1 0" range="-99 99"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <site name="tip" pos="0 0 .3"/></body></body></worldbody>
  <tendon><fixed name="sum"><joint joint="roll" coef="1"/><joint joint="pitch" coef="1"/></fixed>
    <fixed name="difference"><joint joint="roll" coef="1"/><joint joint="pitch" coef="-1"/></fixed></tendon>
  <actuator><motor tendon="sum" ctrlrange="-10 10"/><motor {other} ctrlrange="-10 10"/></actuator></mujoco>"""


@pytest.mark.parametrize(("other", "pulls"), [('tendon="difference"', [1.0, -1.0]), ('joint="roll"', [1.0, 0.0])])
def test_actuators_that_move_several_joints_keep_their_own_limits(other, pulls):
    """The limits of the joints are 20 N m and more, but both at once would need more than 10 N m of an actuator."""
    model = mujoco.MjModel.from_xml_string(SHARED.format(other=other))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["roll", "pitch"], tip="tip")
    assert arm.joint_names == ("roll", "pitch")
    planned = ls.plan(arm, [0.9, -0.9], planner="minimum-jerk", duration=(0.5, 5.0))
    data, largest, motion = mujoco.MjData(model), 0.0, planned.motion
    for q, qd, qdd in zip(motion.q, motion.qd, np.diff(motion.qd, axis=0) / motion.timestep, strict=False):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        exerted = np.linalg.solve(np.array([[1.0, 1.0], pulls]).T, data.qfrc_inverse)
        largest = max(largest, float(np.abs(exerted).max()))
    assert 9.0 < largest <= 10.0 * (1.0 + 1e-6)
    result = ls.evaluate(ls.simulate(arm, planned))
    assert result.final_worst_mm < 0.1
    assert result.planned_force_fraction == pytest.approx(0.1 * largest)
    assert result.force_fraction == pytest.approx(0.1 * largest, rel=0.01)


@pytest.mark.parametrize(
    ("drive", "what"),
    [
        ('<motor name="drive" joint="lift" ctrlrange="0 30"/>', "actuator 'drive' cannot hold"),
        ('<motor name="drive" tendon="rope" ctrlrange="-99 99"/>', "joint 'lift' cannot be held"),
    ],
)
def test_actuators_that_only_push_and_tendons_have_limits(drive, what):
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><body name="cart">
        <joint name="lift" type="slide" axis="0 0 1" range="-1 1"/><geom size=".1" mass="2"/></body></worldbody>
        <tendon><fixed name="rope" actuatorfrclimited="true" actuatorfrcrange="-30 30"><joint joint="lift" coef="1"/>
        </fixed></tendon><actuator>{drive}</actuator></mujoco>""")
    arm = ls.Arm.of(model, mujoco.MjData(model), ["lift"], limits={"lift": {"acceleration": 99.0}})
    slow = ls.plan(arm, [0.5], planner="minimum-jerk", duration=(0.2, 2.0)).motion
    assert 0.9 < force_use(arm, slow.t, slow.q, slow.qd) <= 1.0 + 1e-6
    with pytest.raises(InputError, match=rf"{what} at the start with a payload of 2 kg: its load is 39.24 N.* 30 N"):
        ls.plan(arm, [0.5], planner="minimum-jerk", payload=2.0)


@pytest.mark.parametrize("other", ["99", "20"])
def test_actuators_at_one_limited_tendon_share_its_force(other):
    """A cart of 1 kg on two winches; MuJoCo clips the sum of their forces, wherever they stand."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="cart">
        <joint name="x" type="slide" axis="1 0 0" range="-1 1"/><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
        <geom size=".1" mass="1"/></body></worldbody><tendon>
        <fixed name="rope" actuatorfrclimited="true" actuatorfrcrange="-30 30"><joint joint="x" coef="1"/></fixed>
        <fixed name="both"><joint joint="x" coef="1"/><joint joint="y" coef="1"/></fixed></tendon>
        <actuator><motor tendon="rope" ctrlrange="-99 99"/><motor tendon="rope" ctrlrange="-{other} {other}"/>
        <motor tendon="both" ctrlrange="-50 50"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    data.ctrl[:] = 99.0
    mujoco.mj_forward(model, data)
    arm = ls.Arm.of(model, mujoco.MjData(model), ["x", "y"], limits={name: {"acceleration": 999.0} for name in "xy"})
    np.testing.assert_allclose(arm.force_limits, data.qfrc_actuator)  # 30 + 50 and 50
    # y at rest takes nothing of the third winch, so that x has the rope alone.
    with pytest.raises(TooFastError, match=r"tendon 'rope' would be overloaded .* its force limit 30 N"):
        ls.plan(arm, [0.9, 0.0], planner="minimum-jerk", duration=(0.3, 0.3))
    motion = ls.plan(arm, [0.9, 0.0], planner="minimum-jerk", duration=(0.3, 2.0)).motion
    assert 28.0 < np.abs(np.diff(motion.qd[:, 0])).max() / motion.timestep < 30.0


DAMPED = 'gainprm="100" biastype="affine" biasprm="0 0 -{0}" ctrlrange="-1 1"'


@pytest.mark.parametrize("loss", [0.0, 20.0])
def test_a_motor_that_is_weaker_at_speed_moves_as_one_with_a_damper(loss):
    """100 N at full control, less 20 N s/m: a limit by the control range alone."""
    pytest.importorskip("toppra")

    def driven(drive, damping):
        model = mujoco.MjModel.from_xml_string(f"""<mujoco><option integrator="implicitfast"/><worldbody><body>
            <joint name="lift" type="slide" axis="0 0 1" range="-1 1" damping="{damping}"/><geom size=".1" mass="2"/>
            </body></worldbody><actuator><general joint="lift" {drive}/></actuator></mujoco>""")
        return ls.Arm.of(model, mujoco.MjData(model), ["lift"], limits={"lift": {"acceleration": 99.0}})

    arm = driven(DAMPED.format(loss), 0.0)
    plans = [
        ls.plan(each, [0.5], planner="minimum-jerk", fastest=True)
        for each in (arm, driven('gainprm="100" ctrlrange="-1 1"', loss))
    ]
    times = [planned.motion.t[-1] for planned in plans]
    assert times[0] == pytest.approx(times[1], abs=0.004)
    assert times[0] > 0.2 + 0.002 * loss
    run = ls.evaluate(ls.simulate(arm, plans[0]))
    assert run.tracking_max_mm < 3.0
    assert 0.9 < run.planned_force_fraction <= 1.0 + 1e-6
    assert run.force_fraction == pytest.approx(run.planned_force_fraction, abs=0.05)
    with pytest.raises(InputError, match=r"cannot be held at the start with a payload of 9 kg: its load is 107\.9 N"):
        ls.plan(arm, [0.5], planner="minimum-jerk", payload=9.0)


def test_actuators_of_closed_loops_are_compared_in_a_run_too():
    """The luff of the crane has no actuator: its cylinder has."""
    arm = ls.Arm.load("telescopic_crane")
    near = arm.keyframe("home") + 0.05
    planned = ls.plan(arm, near, planner="minimum-jerk", payload=2000.0, duration=1.5)
    result = ls.evaluate(ls.simulate(arm, planned, hold=0.1), clearance=False)
    assert result.planned_force_fraction > 0.3
    assert result.force_fraction == pytest.approx(result.planned_force_fraction, rel=0.05)
    stroke = arm.model.joint("stroke").id
    arm.model.jnt_actfrclimited[stroke], arm.model.jnt_actfrcrange[stroke] = 1, (-1e3, 1e3)
    with pytest.raises(InputError, match=r"joint 'stroke' cannot be held at the start: its load is .* limit 1000"):
        ls.plan(arm, near, planner="minimum-jerk")


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize(("damping", "friction"), [(0.0, 0.0), (20.0, 0.0), (20.0, 6.0)])
def test_the_fastest_lift_pulls_and_brakes_with_all_the_force_there_is(damping, friction, down):
    """Up at (F - m g - friction - c v) / m, then braking at (F + m g + friction + c v) / m; down with g reversed."""
    pytest.importorskip("toppra")
    arm, mass, weight = (
        hoist(damping=damping, friction=friction).with_payload(3.0),
        5.0,
        5.0 * G * (-1.0 if down else 1.0),
    )
    ends = np.array([[0.0, 0.0], [0.8, 0.0]])[:: -1 if down else 1]
    motion = ls.plan(arm, ends[1], start=ends[0], planner="minimum-jerk", fastest=True).motion
    # Times and ways from rest to a speed and back, by integrating over the speed.
    v = np.linspace(0.0, 8.0, 200_001)
    force = [np.maximum(100.0 - side * (weight + friction + damping * v), 1e-3) / mass for side in (1.0, -1.0)]
    time, way = (cumulative_trapezoid(sum(power / a for a in force), v, initial=0.0) for power in (1.0, v))
    least = float(np.interp(0.8, way, time))
    assert least <= motion.t[-1] + arm.timestep
    # It is averaged over a 140th of it, and the dampers' force is replaced by a tangent.
    assert motion.t[-1] <= (1.02 if damping == 0.0 else 1.13) * least + 2.0 * arm.timestep
    # Forces by MuJoCo, with the acceleration of each step.
    model, largest = arm.model, 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    data = mujoco.MjData(model)
    for q, qd, qdd in zip(motion.q, motion.qd, np.diff(motion.qd, axis=0) / motion.timestep, strict=False):
        data.qpos[:2], data.qvel[:2], data.qacc[:2] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        largest = max(largest, abs(data.qfrc_inverse[0] + friction * np.sign(qd[0])))
    assert 98.0 < largest <= 100.0 * (1.0 + 1e-5)


def test_a_mass_that_cannot_be_held_is_refused_with_its_load():
    arm = hoist(torque=1000.0)
    ls.plan(arm, [0.5, 0.0], planner="minimum-jerk", payload=8.0)
    # 2 + 8.3 kg weigh 101.04 N.
    with pytest.raises(
        InputError, match=r"'lift' cannot be held at the start with a payload of 8\.3 kg: its load is 101 N"
    ):
        ls.plan(arm, [0.5, 0.0], planner="minimum-jerk", payload=8.3)
    with pytest.raises(
        InputError, match=r"joint 'swing' cannot be held at t = \d\.\d+ s with a payload of 3 kg: .* 26"
    ):
        ls.plan(hoist(torque=26.0), [0.0, -1.2], start=[0.0, 1.2], planner="minimum-jerk", payload=3.0)
    with pytest.raises(InputError, match="payload must not be negative"):
        arm.with_payload(-1.0)


def test_a_payload_weighs_what_it_is_said_to(tmp_path):
    arm = hoist()
    assert arm.with_payload(3.0).with_payload(1e-9).model.body_mass.sum() == pytest.approx(5.0 + 1e-9, abs=1e-12)
    changed = LIFT.replace("<option", '<compiler boundmass="0.5"/><option')
    with pytest.raises(InputError, match="boundmass in the file of 'hoist' would change the payload"):
        hoist(changed).with_payload(0.1)
    alone = '<mujoco><worldbody><body name="arm"><joint axis="0 1 0" range="-9 9"/><geom size=".1"/><site name="tip" '
    model = mujoco.MjModel.from_xml_string(alone + 'pos=".5 0 0"/></body></worldbody></mujoco>')
    with pytest.raises(InputError, match=r"to 'arm' of a compiled model, .* symmetric"):
        ls.Arm.of(model, mujoco.MjData(model), [""], tip="tip").with_payload(1.0)
    # What an imported arm holds stays in its hand.
    (tmp_path / "can.xml").write_text(filled(LIFT, can=CAN.format(0.01), pose=" 1 0 0 1 0 0 0"))
    holding = ls.Arm.load(tmp_path / "can.xml", joints=["lift", "swing"], tip="link2_frame").holding("can")
    planned = moved(holding, [0.2, 1.0], 2.0, payload=2.0)
    motion = planned.motion
    uses = [force_use(each, motion.t, motion.q, motion.qd) for each in (holding, planned.arm)]
    assert planned.arm.grasp is not None
    assert uses[1] - uses[0] == pytest.approx(2.0 * G / 100.0, abs=0.05)


def test_what_is_held_weighs_as_a_payload_of_its_mass():
    can = CAN.format(STEEL * 3.0 ** (5.0 / 3.0))
    model = mujoco.MjModel.from_xml_string(filled(LIFT, can=can, pose=" 1 0 0 1 0 0 0"))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["lift", "swing"], tip="link2_frame")
    motion = moved(arm, [0.2, 1.0], 1.0).motion
    uses = [force_use(each, motion.t, motion.q, motion.qd) for each in (arm, arm.with_payload(3.0), arm.holding("can"))]
    assert uses[1] == pytest.approx(uses[2], rel=1e-3)
    assert uses[1] > uses[0] + 0.2


@pytest.mark.parametrize("controller", [None, "position-servo", "computed-torque", "feedback-linearisation"])
def test_controllers_know_the_payload_of_a_plan_and_the_run_says_so(controller, tmp_path):
    arm = hoist()
    planned = ls.plan(arm, [0.6, 0.9], planner="minimum-jerk", duration=1.0, payload=4.0)
    run = ls.simulate(arm, planned, controller=controller)
    assert run.arm.payload == planned.arm.payload == 4.0
    assert controller or run.controller == "inverse-dynamics"
    result = ls.evaluate(run)
    assert result.final_worst_mm < 0.1
    assert result.planned_force_fraction == pytest.approx(force_use(run.arm, run.motion.t, run.motion.q, run.motion.qd))
    assert f"forces up to {result.planned_force_fraction:.0%} of a limit as planned, " in str(result)
    assert 0.9 < result.force_fraction <= 1.0
    run.save(tmp_path / "run.npz")
    loaded = ls.Rollout.load(tmp_path / "run.npz", arm, planned.motion)
    assert (loaded.arm.payload, loaded.arm.fingerprint) == (4.0, run.arm.fingerprint)
    np.testing.assert_array_equal(loaded.force, run.force)
    assert ls.simulate(arm.with_payload(1.0), planned, hold=0.0).arm.payload == 1.0  # its own
    many = ls.simulate_many(arm, [planned], controller="inverse-dynamics")
    assert np.abs(many.q[0, -1] - planned.target).max() < 1e-4
    with pytest.raises(InputError, match="several payloads"):
        ls.simulate_many(arm, [planned, replace(planned, arm=arm)])


@pytest.mark.usefixtures("no_plots")
def test_a_payload_stays_in_a_run_directory(tmp_path, capsys):
    words = ["--planner", "minimum-jerk", "--duration", "2", "--output", str(tmp_path)]
    assert main(["plan", "--payload", "6", *words]) == 0
    assert "6 kg" in capsys.readouterr().out
    assert main(["simulate", str(tmp_path), "--hold", "0.1"]) == 0
    assert main(["evaluate", str(tmp_path)]) == 0
    told = json.loads((tmp_path / "metrics.json").read_text())
    motion, arm = Motion.load(tmp_path / "motion.npz"), ls.Arm.load("telescopic_pr")
    alone, loaded = (force_use(each, motion.t, motion.q, motion.qd) for each in (arm, arm.with_payload(6.0)))
    assert told["planned_force_fraction"] == pytest.approx(loaded)
    assert loaded > alone + 0.1


def test_a_velocity_servo_is_not_as_weak_as_its_feedback_is_strong():
    spec = mujoco.MjSpec.from_string(
        """<mujoco><option gravity="0 0 0"/><worldbody><body name="link"><joint name="hinge" range="-170 170"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
        <actuator><velocity name="servo" joint="hinge" kv="500" ctrlrange="-2 2" forcerange="-7 7"/></actuator>
        </mujoco>"""
    )
    model = spec.compile()
    arm = ls.Arm.of(model, mujoco.MjData(model), joints=["hinge"])
    t = np.linspace(0.0, 2.0, 1001)
    q, qd = 0.5 * (1.0 - np.cos(np.pi * t / 2.0)), 0.25 * np.pi * np.sin(np.pi * t / 2.0)
    assert check_forces(arm, t, q[:, None], qd[:, None]) is None
