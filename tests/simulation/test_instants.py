"""Single steps by hand: what a push and a controller do at one instant."""

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.simulation.controllers.base import ComputedTorque, PositionServo
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Reference


def test_a_servo_is_told_the_position_of_now_and_the_velocity_of_the_next_step(gantry):
    """Gears 2, 1/2, 1, 1 with kp 1000 and kv 100: ctrl = gear q + 0.1 gear qd, with the velocity one row ahead."""
    rows = np.arange(5.0)[:, None]
    q, qd = 0.01 * rows * [1.0, 2.0, 3.0, 4.0], 0.1 * (rows + 1.0) ** 2 * [1.0, -1.0, 2.0, 1.0]
    gear = np.array([2.0, 0.5, 1.0, 1.0])
    reference = Reference.of(gantry, q, qd)
    servo = PositionServo(gantry, reference)
    data, silent = mujoco.MjData(gantry.model), Noise(np.zeros(4), np.zeros(4))
    for step, ahead in ((0, 1), (2, 3), (4, 4)):
        servo.act(data, step, silent)
        np.testing.assert_allclose(data.ctrl, gear * (q[step] + 0.1 * qd[ahead]), atol=1e-12)
    # A held reference is seen at its sample, and with the velocity behind that.
    servo = PositionServo(gantry, Reference.of(gantry, q, qd, hold=2))
    servo.act(data, 3, Noise(np.full(4, 0.01), np.full(4, 0.3)))
    np.testing.assert_allclose(data.ctrl, gear * (q[2] + 0.1 * qd[3] - 0.01 - 0.1 * 0.3), atol=1e-12)


def test_the_damping_of_the_joints_is_fed_forward(gantry):
    damped = Arm.from_spec(gantry.spec.copy(), gantry.source, "damped")
    damped.model.dof_damping[:] = [40.0, 0.0, 20.0, 0.0]
    qd = np.full((3, 4), 0.5)
    servo = PositionServo(damped, Reference.of(damped, np.zeros((3, 4)), qd))
    data = mujoco.MjData(damped.model)
    servo.act(data, 0, Noise(np.zeros(4), np.zeros(4)))
    # A force f on a joint is f / gear of its actuator, which 1 / 1000 of the control makes.
    np.testing.assert_allclose(data.ctrl, [0.1 + 20.0 / 2.0 / 1000.0, 0.025, 0.05 + 10.0 / 1000.0, 0.05], atol=1e-12)


def test_computed_torque_acts_on_what_is_measured(small_arms):
    arm, rng = small_arms["compound"], np.random.default_rng(1)
    assert arm.model.nq > arm.model.nv
    torque = ComputedTorque(arm, Reference.of(arm, *0.1 * rng.normal(size=(2, 4, arm.n_joints))))
    data, silent = mujoco.MjData(arm.model), Noise(*-np.zeros((2, arm.model.nv)))
    data.qvel[:] = rng.normal(size=arm.model.nv)
    errors = Noise(*0.1 * rng.normal(size=(2, arm.model.nv)))
    torque.act(data, 2, silent)
    true = data.ctrl.copy()
    torque.act(data, 2, errors)
    measured = data.ctrl.copy()
    mujoco.mj_integratePos(arm.model, data.qpos, errors.position, 1.0)
    data.qvel += errors.velocity
    torque.act(data, 2, silent)
    np.testing.assert_allclose(data.ctrl, measured, rtol=1e-12)
    assert np.abs(measured - true).max() > 1.0
