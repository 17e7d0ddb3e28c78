"""Controllers against what theory says of them: exact where plant and model agree, bounded where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluate import evaluate
from lieednn_sim.planning import plan
from lieednn_sim.simulate import CONTROLLERS, simulate
from lieednn_sim.simulate.control import Reference


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


def fast_motion(arm: Arm, seed: int):
    rng = np.random.default_rng(seed)
    low, high = arm.position_limits.T
    while True:
        target = rng.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low))
        if not arm.contacts(target):
            return target, plan(arm, target, seed=seed, duration=4.0).motion


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("controller", "rms_mm", "rms_deg"),
    [
        ("position-servo", 1.0, 0.1),
        ("inverse-dynamics", 1e-8, 1e-6),
        ("computed-torque", 1e-8, 1e-6),
        ("mocap", 0.5, 0.05),
    ],
)
def test_tracking_and_final_error(arm, seed, controller, rms_mm, rms_deg):
    target, motion = fast_motion(arm, seed)
    rollout = simulate(arm, motion, controller=controller)
    result = evaluate(arm, rollout, target, motion)
    assert result.controller == rollout.controller == controller
    for frame in result.frames:
        assert frame.rms_translation_mm < rms_mm
        assert frame.rms_rotation_deg < rms_deg
        assert frame.final_translation_mm < 1e-3
        assert frame.final_rotation_deg < 1e-4
    led = controller == "mocap"
    assert (max(joint.peak_constraint_force for joint in result.joints) > 1.0) == led


@pytest.mark.parametrize("controller", ["position-servo", "inverse-dynamics", "computed-torque"])
def test_wrong_masses_leave_a_small_error_that_feedback_bounds(arm, controller):
    target, motion = fast_motion(arm, 1)
    right, wrong = (
        evaluate(arm, simulate(arm, motion, controller=controller, mass_scale=scale), target) for scale in (1.0, 1.2)
    )
    assert wrong.end_effector.rms_translation_mm > right.end_effector.rms_translation_mm
    for frame in wrong.frames:
        assert frame.final_translation_mm < 2.0
        assert frame.final_rotation_deg < 0.2
        assert frame.rms_translation_mm < 2.5
    # Gravity compensation of the wrong masses is no compensation: the servo sags, by the missing weight over kp.
    assert wrong.end_effector.final_translation_mm > 1e-3


def test_controllers_are_deterministic_and_leave_the_arm_s_model_alone(arm):
    _, motion = fast_motion(arm, 2)
    before = arm.model.actuator_gainprm.copy(), arm.model.body_mass.copy(), arm.model.opt.enableflags
    for controller in CONTROLLERS:
        one, two = (simulate(arm, motion, controller=controller, mass_scale=1.1, hold=0.1) for _ in range(2))
        np.testing.assert_array_equal(one.q, two.q)
    np.testing.assert_array_equal(arm.model.actuator_gainprm, before[0])
    np.testing.assert_array_equal(arm.model.body_mass, before[1])
    assert arm.model.opt.enableflags == before[2]


def test_discrete_rates_are_what_semi_implicit_steps_need():
    q = np.cumsum(np.random.default_rng(0).normal(size=(50, 3)), axis=0)
    reference = Reference(q, np.zeros_like(q), 0.1)
    velocity, acceleration = reference.discrete_rates()
    position, speed = q[0].copy(), velocity[0].copy()
    for k in range(49):
        speed = speed + 0.1 * acceleration[k]
        position = position + 0.1 * speed
        np.testing.assert_allclose(position, q[k + 1], atol=1e-9)
    np.testing.assert_array_equal(velocity[0], 0.0)


def test_mocap_ghosts_sit_on_the_reference_and_the_drives_are_idle(arm):
    _, motion = fast_motion(arm, 3)
    rollout = simulate(arm, motion, controller="mocap", hold=0.2)
    drives = rollout.force - mujoco_gravity(arm, rollout)
    assert np.abs(drives).max() < 1e-9
    np.testing.assert_allclose(rollout.q[-1], motion.q[-1], atol=1e-6)


def mujoco_gravity(arm: Arm, rollout) -> np.ndarray:
    """What gravity compensation alone exerts at the positions of a rollout."""
    data, forces = mujoco.MjData(arm.model), np.zeros_like(rollout.force)
    for k, q in enumerate(rollout.q):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(arm.model, data)
        mujoco.mj_fwdVelocity(arm.model, data)
        forces[k] = data.qfrc_gravcomp
    return forces


def test_bad_input(arm):
    _, motion = fast_motion(arm, 0)
    with pytest.raises(InputError, match="no controller 'pid'; allowed: computed-torque, inverse-dynamics, mocap"):
        simulate(arm, motion, controller="pid")
    with pytest.raises(InputError, match="mass_scale must be positive"):
        simulate(arm, motion, mass_scale=0.0)
    other = Arm.load("telescopic_pr")
    other.model.actuator_biasprm[0, 1] = 0.0
    with pytest.raises(InputError, match="need position actuators"):
        simulate(other, motion, controller="computed-torque")
