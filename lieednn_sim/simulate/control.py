"""Controllers: what drives the arm so that it follows a reference.

A controller may need other drives than the arm's model has, so each brings the plant that is simulated. What it knows
of the dynamics is the arm's model; a plant with other masses can be put in its place by `simulate`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError

Floats = NDArray[np.float64]

# Natural frequency of the computed-torque loop [Hz]; critically damped.
_TORQUE_LOOP_FREQUENCY = 10.0


@dataclass(frozen=True)
class Reference:
    """What a controller is to follow, sampled at the simulation's time steps.

    Attributes:
        q: ``(K, 2N)`` positions [rad, m].
        qd: ``(K, 2N)`` velocities [rad/s, m/s].
        timestep: [s].
    """

    q: Floats
    qd: Floats
    timestep: float

    def discrete_rates(self) -> tuple[Floats, Floats]:
        """Velocities and accelerations ``(K, 2N)`` with which semi-implicit steps land on every q exactly.

        q_{k+1} = q_k + h v_{k+1} and v_{k+1} = v_k + h a_k, from rest.
        """
        velocity = np.vstack([np.zeros_like(self.q[:1]), np.diff(self.q, axis=0) / self.timestep])
        ahead = np.vstack([velocity[1:], np.zeros_like(self.q[:1])])
        return velocity, (ahead - velocity) / self.timestep


class Controller(Protocol):
    """Drives one rollout.

    Attributes:
        plant: the model to simulate.
    """

    plant: mujoco.MjModel

    def act(self, data: mujoco.MjData, step: int) -> None:
        """Set the controls of a step from the state, after `mj_step1`."""


class PositionServo:
    """Position actuators with velocity feedforward: ctrl = q_ref + (kv / kp) qd_ref.

    A position actuator pulls with kp (ctrl - q) - kv qd, so without the second term it lags a moving reference by
    kv / kp seconds. The velocity is taken one step ahead of the position, because implicitfast damps with the velocity
    at the end of the step.

    Raises:
        InputError: an actuator is not a position actuator on one joint.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self.plant = arm.model
        drives = _Drives(arm.model)
        ahead = np.vstack([reference.qd[1:], reference.qd[-1:]])
        self._commands = drives.select(reference.q) + drives.lead * drives.select(ahead)

    def act(self, data: mujoco.MjData, step: int) -> None:
        """See `Controller`."""
        data.ctrl[:] = self._commands[step]


class InverseDynamicsServo:
    """The position servo with the forces of the reference fed forward: ctrl = q_ref + (kv qd_ref + tau) / kp.

    tau is what MuJoCo's inverse dynamics asks for, discretised as the integrator is, so a plant equal to the model
    follows to rounding. Feedback is the servo's own.

    Raises:
        InputError: an actuator is not a position actuator on one joint.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self.plant = arm.model
        drives, inverse = _Drives(arm.model), _InverseDynamics(arm.model)
        velocity, acceleration = reference.discrete_rates()
        forces = np.array([inverse(*row) for row in zip(reference.q, velocity, acceleration, strict=True)])
        pull = drives.damping * drives.select(velocity) + drives.select(forces)
        self._commands = drives.select(reference.q) + pull / drives.stiffness

    def act(self, data: mujoco.MjData, step: int) -> None:
        """See `Controller`."""
        data.ctrl[:] = self._commands[step]


class ComputedTorque:
    """Torque drives with feedback linearisation: tau = ID(q, qd, a_ref + 2 w (v_ref - qd) + w^2 (q_ref - q)).

    The plant's position actuators become direct drives with the same force limits; w is 2 pi 10 Hz.

    Raises:
        InputError: an actuator is not a position actuator on one joint.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._drives = _Drives(arm.model)
        self.plant = copy.deepcopy(arm.model)
        self.plant.actuator_gainprm[:, 0] = 1.0
        self.plant.actuator_biasprm[:, :3] = 0.0
        self.plant.actuator_ctrllimited[:] = 0
        self._inverse = _InverseDynamics(self.plant)
        self._q = reference.q
        self._velocity, self._acceleration = reference.discrete_rates()

    def act(self, data: mujoco.MjData, step: int) -> None:
        """See `Controller`."""
        omega = 2.0 * np.pi * _TORQUE_LOOP_FREQUENCY
        wanted = self._acceleration[step] + 2.0 * omega * (self._velocity[step] - data.qvel)
        wanted += omega**2 * (self._q[step] - data.qpos)
        data.ctrl[:] = self._drives.select(self._inverse(data.qpos, data.qvel, wanted))


class _Drives:
    """The position actuators of a model: stiffness kp, damping kv, and which coordinate each one moves."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.stiffness, self.damping = model.actuator_gainprm[:, 0].copy(), -model.actuator_biasprm[:, 2]
        if (
            (model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT).any()
            or (model.actuator_biasprm[:, 1] != -self.stiffness).any()
            or (self.stiffness <= 0.0).any()
        ):
            raise InputError("the controllers need position actuators on joints, one for each coordinate")
        self._coordinates = model.jnt_qposadr[model.actuator_trnid[:, 0]]
        self.lead = self.damping / self.stiffness

    def select(self, values: Floats) -> Floats:
        """Values ``(..., 2N)`` of the coordinates in the order of the actuators."""
        return values[..., self._coordinates]


class _InverseDynamics:
    """Joint forces ``(2N,)`` that the drives must exert, in the discrete time of the model's integrator."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.deepcopy(model)
        self._model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
        self._data = mujoco.MjData(self._model)

    def __call__(self, q: Floats, qd: Floats, acceleration: Floats) -> Floats:
        data = self._data
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, acceleration
        mujoco.mj_inverse(self._model, data)
        return data.qfrc_inverse.copy()
