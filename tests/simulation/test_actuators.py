"""Controls, lengths and forces of actuators, compared with MuJoCo's own results."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.disturbances import Noise

seeds = st.integers(0, 2**32 - 1)
arms = st.sampled_from(["compound", "telescope"])


def random_state(arm: Arm, rng: np.random.Generator) -> mujoco.MjData:
    data = mujoco.MjData(arm.model)
    q = 0.4 * rng.uniform(*arm.position_limits.T)
    data.qpos[:] = arm.qpos(q)
    data.qvel[:] = arm.qvel(q, rng.normal(size=arm.n_joints))
    return data


@settings(max_examples=10)
@given(seed=seeds, name=arms)
def test_lengths_velocities_and_forces_are_mujoco_s(small_arms, seed, name):
    arm, rng = small_arms[name], np.random.default_rng(seed)
    actuators, data = Actuators(arm), random_state(arm, rng)
    wanted = rng.normal(size=arm.model.nv)
    data.ctrl[:] = actuators.servo_controls(data.qpos, data.qvel, wanted)
    mujoco.mj_forward(arm.model, data)
    moving = actuators.driving
    np.testing.assert_allclose(actuators.lengths(data.qpos)[moving], data.actuator_length[moving], atol=1e-12)
    np.testing.assert_allclose((actuators.moment @ data.qvel)[moving], data.actuator_velocity[moving], atol=1e-12)
    np.testing.assert_allclose(data.actuator_force[moving], (actuators.allocation @ wanted)[moving], atol=1e-9)
    # What the arm's joints can do is done by those forces; internal ones between coupled stages do not matter.
    driven = np.where(actuators.driving, data.actuator_force, 0.0)
    basis, moment = tangent_basis(arm.space), np.zeros((arm.model.nu, arm.model.nv))
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    np.testing.assert_allclose(basis.T @ (moment.T @ driven), basis.T @ wanted, atol=1e-9)


@settings(max_examples=10)
@given(seed=seeds, name=arms)
def test_noise_in_the_controls_is_noise_in_the_measurement(small_arms, seed, name):
    """The servo's force at the true state with disturbed controls is its force at a disturbed state."""
    arm, rng = small_arms[name], np.random.default_rng(seed)
    actuators, data = Actuators(arm), random_state(arm, rng)
    noise = Noise(*(1e-3 * (tangent_basis(arm.space) != 0.0).any(axis=1) * rng.normal(size=(2, arm.model.nv))))
    controls = rng.normal(size=arm.model.nu)
    data.ctrl[:] = controls + actuators.measurement_error(noise)
    mujoco.mj_forward(arm.model, data)
    disturbed = data.actuator_force.copy()
    if name == "compound":
        # What the servos of a ball joint measure is its rotation vector, so that is what the noise is of.
        data.qpos[:] = arm.qpos(arm.coordinates(data.qpos) + noise.position @ tangent_basis(arm.space))
    else:
        data.qpos += np.insert(noise.position, 3, 0.0)  # the ball that lies about has a quaternion, and no noise
    data.qvel += noise.velocity
    data.ctrl[:] = controls
    mujoco.mj_forward(arm.model, data)
    np.testing.assert_allclose(disturbed, data.actuator_force, atol=1e-8)


def test_actuators_off_the_arm_keep_the_controls_of_home(small_arms):
    arm = small_arms["telescope"]
    actuators = Actuators(arm)
    assert actuators.driving.tolist() == [False, True, True]
    assert actuators.servo_controls(arm.model.qpos0, np.zeros(arm.model.nv))[0] == 0.03
    assert actuators.direct_controls(np.zeros(arm.model.nv))[0] == 0.03


def test_arms_that_cannot_be_driven_are_refused(small_arms):
    def changed(joint: str, **values) -> Arm:
        spec = small_arms["telescope"].spec.copy()
        for name, value in values.items():
            setattr(spec.actuator(joint), name, value)
        return Arm.from_spec(spec, small_arms["telescope"].source, "changed")

    with pytest.raises(InputError, match="no actuator moves 'turn'"):
        Actuators(changed("turn", target="grip"))
    with pytest.raises(InputError, match="actuator 'turn' moves the arm in a way"):
        Actuators(changed("turn", gaintype=mujoco.mjtGain.mjGAIN_AFFINE))
    with pytest.raises(InputError, match="computed-torque does without"):
        Actuators(changed("turn", biasprm=np.zeros(10))).require_servos()


def test_actuators_that_pull_on_the_same_joints_together_are_refused(gantry):
    spec = gantry.spec.copy()
    both = spec.add_tendon(name="both")
    for actuator in spec.actuators:
        if actuator.target in ("y", "z"):
            both.wrap_joint(actuator.target, 1.0)
            actuator.target, actuator.trntype = "both", mujoco.mjtTrn.mjTRN_TENDON
    with pytest.raises(InputError, match="'tied' cannot be driven: its actuators cannot move all joints independently"):
        Actuators(Arm.from_spec(spec, gantry.source, "tied"))
