"""Controllers against what theory says of them: exact where plant and model agree, bounded where they do not."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.simulation import CONTROLLERS, Disturbances, Push, simulate
from lieednn_sim.simulation.controllers.base import ComputedTorque
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Reference

HEAVIER = Disturbances(mass_scale=1.2)


@pytest.fixture(scope="module")
def arm(seeded):
    return seeded.arm


@pytest.mark.parametrize(
    ("controller", "seeds", "rms_mm", "rms_deg"),
    [
        ("position-servo", [1, 3, 4], 1.0, 0.1),
        ("inverse-dynamics", [1], 1e-8, 1e-6),
        ("computed-torque", [1], 1e-8, 1e-6),
        ("mocap", [1], 0.5, 0.05),
        ("mocap-deadbeat", [1], 0.005, 0.0005),
    ],
)
def test_tracking_and_final_error_over_seeded_targets(seeded, controller, seeds, rms_mm, rms_deg):
    for rollout, result in (seeded.run(seed, controller) for seed in seeds):
        assert result.controller == rollout.controller == controller
        for frame in result.frames:
            assert frame.tracking_rms_mm < rms_mm
            assert frame.tracking_rms_deg < rms_deg
            assert frame.final_mm < 1e-3
            assert frame.final_deg < 1e-4
            assert frame.settling_s <= 4.0
        assert result.contacts == 0
        assert all(joint.peak_velocity <= joint.velocity_limit for joint in result.joints)
        assert all(joint.peak_force <= joint.force_limit for joint in result.joints)
        led = controller.startswith("mocap")
        assert (result.peak_weld_force_n > 1.0) == (result.peak_weld_torque_n_m > 1.0) == led
        assert (max(joint.peak_constraint_force for joint in result.joints) > 1.0) == led


def started(arm, controller, q, qd):
    """The plant of a controller and its data at a state ``(n,)``."""
    plant = copy.deepcopy(arm.model)
    controller.equip(plant)
    data = mujoco.MjData(plant)
    data.qpos[:], data.qvel[:] = arm.qpos(q), arm.qvel(q, qd)
    return plant, data


def test_computed_torque_is_a_critically_damped_spring_of_10_hz(gantry):
    """From off a reference at rest: qdd = -2 w qd - w^2 q of what is measured."""
    rng, rest = np.random.default_rng(1), np.zeros((3, 4))
    q, qd, position, velocity = 1e-3 * rng.normal(size=(4, 4))
    controller = ComputedTorque(gantry, Reference.of(gantry, rest, rest))
    plant, data = started(gantry, controller, q, qd)
    controller.act(data, 0, Noise(position, velocity))
    mujoco.mj_step(plant, data)
    w = 2.0 * np.pi * 10.0
    expected = -2.0 * w * (qd + velocity) - w**2 * (q + position)
    np.testing.assert_allclose((data.qvel - qd) / 0.01, expected, rtol=1e-6)


@pytest.mark.parametrize("controller", ["position-servo", "inverse-dynamics", "computed-torque"])
def test_no_joint_is_said_to_exert_more_than_its_limit(arm, travel, controller):
    """Gravity compensation, which MuJoCo adds beside the actuators, does not count."""
    home, push = arm.keyframe("home"), Push("end effector", (0.0, 0.0, -2000.0), 0.05, 0.1)
    run = simulate(arm, travel(arm, home, home, 0.2), controller=controller, disturbances=Disturbances(pushes=(push,)))
    assert evaluate(run, clearance=False).force_fraction == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("controller", ["position-servo", "inverse-dynamics", "computed-torque"])
def test_wrong_masses_leave_a_small_error_that_feedback_bounds(arm, seeded, controller):
    target, motion = seeded.motion(1)
    _, right = seeded.run(1, controller)
    wrong = evaluate(simulate(arm, motion, target=target, controller=controller, disturbances=HEAVIER), clearance=False)
    assert wrong.end_effector.tracking_rms_mm > right.end_effector.tracking_rms_mm
    for frame in wrong.frames:
        assert frame.final_mm < 2.0
        assert frame.final_deg < 0.2
        assert frame.tracking_rms_mm < 2.5
    # Gravity compensation of the wrong masses is no compensation: the servo sags, by the missing weight over kp.
    assert wrong.end_effector.final_mm > 1e-3


def test_controllers_are_deterministic_and_leave_the_arm_s_model_alone(arm, travel):
    home = arm.keyframe("home")
    motion = travel(arm, home, home + 0.05 * (arm.keyframe("extended") - home), 0.4)
    before = arm.model.actuator_gainprm.copy(), arm.model.body_mass.copy(), arm.model.opt.enableflags
    for controller in CONTROLLERS:
        one, two = (simulate(arm, motion, controller=controller, disturbances=HEAVIER, hold=0.1) for _ in range(2))
        np.testing.assert_array_equal(one.q, two.q)
    np.testing.assert_array_equal(arm.model.actuator_gainprm, before[0])
    np.testing.assert_array_equal(arm.model.body_mass, before[1])
    assert arm.model.opt.enableflags == before[2]


def test_mocap_bodies_sit_on_the_reference_and_the_drives_are_idle(arm, seeded):
    (_, motion), (rollout, _) = seeded.motion(1), seeded.run(1, "mocap")
    assert not rollout.force.any()
    np.testing.assert_allclose(rollout.q[-1], motion.q[-1], atol=1e-6)


@pytest.mark.parametrize("name", ["compound", "telescope"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_ball_joints_gears_tendons_and_coupled_stages(small_arms, travel, name, controller):
    arm = small_arms[name]
    low, high = arm.position_limits.T
    goal = low + 0.7 * (high - low) if name == "telescope" else 0.5 * high
    start = arm.coordinates(arm.model.key_qpos[0]) if name == "telescope" else -0.2 * high
    rollout = simulate(arm, travel(arm, start, goal), target=goal, controller=controller, hold=0.5)
    result = evaluate(rollout, clearance=False)
    # The stages are tied by a soft constraint that no controller knows of.
    exact = controller in ("inverse-dynamics", "computed-torque") and name == "compound"
    for frame in result.frames:
        assert frame.tracking_rms_mm < (1e-8 if exact else 3.0)
        assert frame.tracking_rms_deg < (1e-8 if exact else 0.3)
        assert frame.final_mm < 0.01
        assert frame.final_deg < 1e-3
    if exact:
        np.testing.assert_allclose(rollout.q, rollout.q_ref, atol=1e-11)
        # The last row of a minimum-jerk motion and the first at rest have the same velocity, up to a step.
        np.testing.assert_allclose(rollout.qd, rollout.qd_ref, atol=0.05)
    if name == "telescope":
        grip = arm.model.joint("grip").qposadr[0]
        assert arm.qpos(goal)[grip] == 0.03, "what the arm does not know stays where home has it"


def test_forces_are_fed_forward_up_to_the_limits_of_the_joints(small_arms, travel):
    """What hangs on the vertical slide takes 3 mm of a servo's travel, 0.6 % of the range that its controls have."""
    hanging = small_arms["hanging"]
    spec = hanging.spec.copy()
    drive = spec.actuators[2]
    drive.ctrllimited, drive.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, [-0.5, 0.5]
    arm = Arm.from_spec(spec, hanging.source, "hanging")
    for end in (-0.4999, 0.4999):
        goal = np.array([0.1, 0.0, end, 0.0, 0.0, 0.0])
        rollout = simulate(arm, travel(arm, np.zeros(6), goal), controller="inverse-dynamics", hold=0.2)
        np.testing.assert_allclose(rollout.q, rollout.q_ref, atol=1e-9)
    assert arm.model.actuator_ctrllimited[2]


def test_welds_carry_what_hangs_on_them(small_arms, travel):
    """Nothing else holds this link: its weight and its moment about the frame, by hand."""
    arm = small_arms["hanging"]
    rest = np.zeros(6)
    rollout = simulate(arm, travel(arm, rest, rest, 0.2), controller="mocap", hold=1.0)
    weight = 2.0 * 9.81
    np.testing.assert_allclose(rollout.channels["weld_force"][-1], weight, rtol=1e-4)
    np.testing.assert_allclose(rollout.channels["weld_torque"][-1], weight * 0.1, rtol=1e-3)
    assert rollout.contacts.max() == 0
    assert rollout.contact_force.max() == 0.0
    # A telescope whose stages are coupled by an equality of the arm's own, pushed across it at 0.5 m from its axis.
    arm, rest = small_arms["telescope"], np.array([0.25, 0.1])
    pushed = Disturbances(pushes=(Push("end effector", (0.0, 20.0, 0.0), 0.0, 9.0),))
    rollout = simulate(arm, travel(arm, rest, rest, 0.2), controller="mocap", hold=1.0, disturbances=pushed)
    moment = 0.6 * rollout.channels["weld_force"][-1] + rollout.channels["weld_torque"][-1]
    np.testing.assert_allclose(moment, 20.0 * 0.5, rtol=1e-3)


def test_contacts_carry_what_lies_on_them(small_arms, travel):
    arm = small_arms["telescope"]
    home = arm.keyframe("home")
    rollout = simulate(arm, travel(arm, home, home, 0.2), controller="position-servo", hold=2.0)
    assert rollout.contacts[-1] == 1
    ball = arm.model.body("ball").mass[0] * 9.81
    np.testing.assert_allclose(rollout.contact_force[-1], ball, rtol=1e-3)


@pytest.mark.parametrize("controller", [name for name in CONTROLLERS if name != "mocap-deadbeat"])
def test_held_references_are_steps_for_the_controller_and_not_for_the_log(small_arms, travel, controller):
    arm = small_arms["compound"]
    motion = travel(arm, np.zeros(8), 0.4 * arm.position_limits[:, 1])
    every, held = (simulate(arm, motion, controller=controller, reference_rate=rate) for rate in (500.0, 100.0))
    smooth = simulate(arm, motion, controller=controller)
    np.testing.assert_array_equal(every.q, smooth.q)
    np.testing.assert_array_equal(held.q_ref, smooth.q_ref)
    if controller == "position-servo":
        np.testing.assert_array_equal(held.ctrl, np.repeat(smooth.ctrl[::5], 5, axis=0)[: len(held.t)])
    lagging, following = (evaluate(rollout, clearance=False).end_effector for rollout in (held, smooth))
    # The mean age of a sample is two of its five steps.
    speed = np.linalg.norm(np.diff(arm.link_poses(motion.q).translation[:, -1], axis=0), axis=1).max() / 0.002
    assert following.tracking_rms_mm < lagging.tracking_rms_mm < 1e3 * speed * 0.01
    assert lagging.final_mm < 1e-3


def test_bad_input(arm, small_arms, travel):
    motion = travel(arm, arm.keyframe("home"), arm.keyframe("extended"), 4.0)
    with pytest.raises(InputError, match=r"mocap-deadbeat follows every jump .* held for 5 steps; use mocap"):
        simulate(arm, motion, controller="mocap-deadbeat", reference_rate=100.0)
    other = Arm.load("telescopic_pr")
    other.model.actuator_biasprm[0, 1] = 0.0
    with pytest.raises(InputError, match="needs position actuators"):
        simulate(other, motion, controller="inverse-dynamics")
    assert simulate(other, motion, controller="computed-torque", hold=0.0).q.shape == motion.q.shape
