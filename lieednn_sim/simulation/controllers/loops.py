"""Feedback linearisation of arms whose actuators act through closed loops, as the cylinder that lifts a boom."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import compensating_dofs, tangent_basis
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY, Controller
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.values import Floats


class LoopLinearisation(Controller):
    """Actuator forces f of least norm with T^T f = B^T (M a + bias - passive), T = moment B, within their limits.

    B(q) has the velocities of the model's dofs at unit rates of the coordinates, those of loops by the equalities'
    Jacobian at the measured state, so forces of the loops do no work. Position servos hold the lengths that their
    joints have along the reference, and a is the reference's acceleration; where no servo acts on a coordinate,
    2 w (v_ref - v) + w^2 (q_ref - q) is added to its acceleration, with w of 2 pi 10 Hz.

    Raises:
        InputError: the actuators cannot move all coordinates.
    """

    changes_plant = False

    def __init__(self, arm: Arm, reference: Reference) -> None:
        assert arm.dependents is not None
        self._arm, self._reference, self._loops = arm, reference, arm.dependents
        self._actuators = actuators = Actuators(arm)
        self._unit = tangent_basis(arm.space)[arm.dependents.dofs]
        self._frequency = np.where(actuators.servoed, 0.0, NATURAL_FREQUENCY)
        self._moved = np.zeros(arm.model.nv)
        self._moved[arm.dofs] = 1.0
        self._model = arm.model
        self._data, self._load = mujoco.MjData(self._model), np.zeros(arm.model.nv)
        self._compensated = compensating_dofs(arm.model)

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        arm, own, reference, actuators = self._arm, self._data, self._reference, self._actuators
        own.qpos[:], own.qvel[:] = data.qpos, data.qvel + noise.velocity
        mujoco.mj_integratePos(self._model, own.qpos, noise.position, 1.0)
        mujoco.mj_fwdPosition(self._model, own)
        mujoco.mj_fwdVelocity(self._model, own)
        row = reference.row(step)
        last = reference.known - 1
        now, after = min(row, last), min(row + 1, last)
        basis = self._loops.basis(own.qpos) @ self._unit
        q = arm.coordinates(own.qpos)
        slow = reference.qd[now] - arm.rates(q, own.qvel)
        pull = self._frequency * (2.0 * slow + self._frequency * (reference.q[now] - q))
        acceleration = self._moved * (reference.qvel[after] - reference.qvel[now]) / reference.timestep + basis @ pull
        mujoco.mj_mulM(self._model, own, self._load, acceleration)
        load = self._load + own.qfrc_bias - own.qfrc_passive - np.where(self._compensated, own.qfrc_gravcomp, 0.0)
        transmission = actuators.moment @ basis
        forces: Floats = np.linalg.lstsq(transmission.T, load @ basis, rcond=None)[0]
        # Servos are told the reference's lengths, so that they feed back; the others exert their forces alone.
        held = actuators.affine_controls(reference.qpos[now], reference.qvel[after], forces)
        direct = actuators.affine_controls(own.qpos, own.qvel, forces)
        controls = np.where(actuators.servos, held, direct)
        if noise.present:
            controls = controls + np.where(actuators.servos, actuators.measurement_error(noise), 0.0)
        actuators.write(controls, data.ctrl)
