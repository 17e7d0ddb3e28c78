"""Controllers: what drives the arm so that it follows a reference.

A controller may need other drives than the arm's model has, so each changes the plant that is simulated. What it knows
of the dynamics is the arm's model; the plant may have other masses.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Foreseen, Reference, runs
from lieednn_sim.values import Floats

# By the part of MuJoCo's state which it sets, each with steps along the first axis.
Inputs = dict[mujoco.mjtState, Floats]

# Natural frequency w of the computed-torque loop [rad/s], that is 10 Hz; critically damped.
_OMEGA = 2.0 * np.pi * 10.0


class Controller(ABC):
    """Drives one rollout along a reference, of which it reads what is known, and may log channels of its own.

    Attributes:
        adds_bodies: whether `add_bodies` does anything; a plant without new bodies need not be compiled again.
        channel_units: see `ChannelSource`.
    """

    adds_bodies = False
    channel_units: Mapping[str, str] = MappingProxyType({})

    def add_bodies(self, spec: Any) -> None:  # noqa: B027 (few controllers need it, and the next)
        """Add the bodies that the controller needs to a copy of the arm's spec."""

    def equip(self, plant: mujoco.MjModel) -> None:  # noqa: B027
        """Give the compiled plant the drives that the controller needs."""

    def inputs(self, steps: range, noise: Noise) -> Inputs | None:
        """What `act` would set at some steps, where that follows from the reference alone; None where it does not.

        Args:
            steps: m of them.
            noise: errors of their measurements ``(m, nv)``.
        """
        return None

    @abstractmethod
    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """Set the controls of a step.

        Called before the step; of ``data`` only time, qpos and qvel belong to it, what follows from them does not yet.
        """

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `ChannelSource`."""
        return np.zeros(0)

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `ChannelSource`."""
        return ()


class DriveController(Controller):
    """What controllers with joint drives share: the arm's own drives, as they are."""

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._actuators = Actuators(arm)
        self._reference = reference


class FeedforwardServo(DriveController):
    """A servo whose controls follow from the reference alone, but for what the sensors get wrong.

    Raises:
        InputError: the arm is not driven by position actuators on joints or fixed tendons.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._actuators.require_servos()
        self._foreseen = Foreseen(reference, self.controls)

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        self._actuators.free_controls(plant)

    @abstractmethod
    def controls(self, steps: range) -> Floats:
        """Controls ``(m, nu)`` of some steps, whose states are measured without error."""

    def inputs(self, steps: range, noise: Noise) -> Inputs:
        """See `Controller`."""
        controls = self.controls(steps)
        if noise.present:
            controls += self._actuators.measurement_error(noise)
        return {mujoco.mjtState.mjSTATE_CTRL: controls}

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        data.ctrl[:] = self._foreseen[step]
        if noise.present:
            data.ctrl += self._actuators.measurement_error(noise)


class PositionServo(FeedforwardServo):
    """Position actuators with velocity feedforward: ctrl = q_ref + (kv / kp) qd_ref, per unit gear.

    A position actuator pulls with kp (ctrl - q) - kv qd, so without the second term it lags a moving reference by
    kv / kp seconds; the damping of the joints themselves, which the model knows, is fed forward with it. The velocity
    is taken one step ahead of the position, because implicitfast damps with the velocity at the end of the step.

    Raises:
        InputError: the arm is not driven by position actuators on joints or fixed tendons.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._damping = arm.model.dof_damping.copy()

    def controls(self, steps: range) -> Floats:
        """See `FeedforwardServo`."""
        reference = self._reference
        rows = reference.rows(steps)
        velocity = reference.qvel[np.minimum(rows + 1, reference.known - 1)]
        return self._actuators.servo_controls(reference.qpos[rows], velocity, self._damping * velocity)


class InverseDynamicsServo(FeedforwardServo):
    """The position servo with the forces of the reference fed forward: ctrl = q_ref + (kv qd_ref + tau) / kp.

    tau is what MuJoCo's inverse dynamics asks for, discretised as the integrator is, so a plant equal to the model
    follows to rounding. Feedback is the servo's own.

    Raises:
        InputError: the arm is not driven by position actuators on joints or fixed tendons.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._inverse = _InverseDynamics(arm.model)

    def controls(self, steps: range) -> Floats:
        """See `FeedforwardServo`."""
        reference = self._reference
        rows = reference.rows(steps)
        qpos, (velocity, acceleration) = reference.qpos[rows], reference.rates_at(rows)
        # A reference that rests, or is held, asks for the same again.
        firsts, run = runs(np.hstack([qpos, velocity, acceleration]))
        inverse, forces = self._inverse, np.empty((len(firsts), velocity.shape[1]))
        position, rate, change = inverse.qpos, inverse.velocity, inverse.acceleration
        for row, *wanted in zip(forces, qpos[firsts], velocity[firsts], acceleration[firsts], strict=True):
            position[:], rate[:], change[:] = wanted
            row[:] = inverse.force()
        return self._actuators.servo_controls(qpos, velocity, forces[run])


class ComputedTorque(DriveController):
    """Torque drives with feedback linearisation: tau = ID(q, qd, a_ref + 2 w (v_ref - qd) + w^2 (q_ref - q)).

    The plant's actuators become direct drives with the same force limits; w is 2 pi 10 Hz. The difference of positions
    is the velocity that leads from one to the other in unit time. q and qd are measured.

    Raises:
        InputError: the arm's actuators are not on joints or fixed tendons.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._inverse = _InverseDynamics(arm.model)
        self._model = self._inverse.model
        self._actuators.make_direct(self._model)
        self._foreseen = Foreseen(reference, self._goals)
        self._turning = arm.model.nq > arm.model.nv
        # Of velocity and position. Arrays are multiplied by arrays in half the time that they are by numbers.
        self._gains = np.full((2, arm.model.nv), [[2.0 * _OMEGA], [_OMEGA**2]])
        self._errors = np.empty_like(self._gains)
        self._lag, self._error = self._errors

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        self._actuators.make_direct(plant)

    def _goals(self, steps: range) -> list[tuple[Floats, ...]]:
        """Positions, velocities and accelerations to be at some steps."""
        rows = self._reference.rows(steps)
        # An array takes longer to be unpacked than a tuple.
        return list(zip(self._reference.qpos[rows], *self._reference.rates_at(rows), strict=True))

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        inverse, lag, error = self._inverse, self._lag, self._error
        goal, velocity, acceleration = self._foreseen[step]
        np.add(data.qvel, noise.velocity, inverse.velocity)
        if self._turning:
            # Without noise quaternions are made of unit length all the same.
            inverse.qpos[:] = data.qpos
            mujoco.mj_integratePos(self._model, inverse.qpos, noise.position, 1.0)
            mujoco.mj_differentiatePos(self._model, error, 1.0, inverse.qpos, goal)
        else:
            np.add(data.qpos, noise.position, inverse.qpos)
            np.subtract(goal, inverse.qpos, error)
        # In place: a + 2 w (v - qd) + w^2 e.
        np.subtract(velocity, inverse.velocity, lag)
        self._errors *= self._gains
        lag += acceleration
        np.add(lag, error, inverse.acceleration)
        self._actuators.direct_controls(inverse.force(), data.ctrl)


class _InverseDynamics:
    """Joint forces that the drives must exert, in the discrete time of the model's integrator.

    Attributes:
        model: a copy of its own.
        qpos: ``(nq,)`` to be set, like the next two; views are held, for to ask for them takes as long as to fill them.
        velocity: ``(nv,)``.
        acceleration: ``(nv,)``.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = copy.deepcopy(model)
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
        self._data = mujoco.MjData(self.model)
        self.qpos, self.velocity, self.acceleration = self._data.qpos, self._data.qvel, self._data.qacc
        self._force = self._data.qfrc_inverse

    def force(self) -> Floats:
        """Joint forces ``(nv,)`` of what was set, until the next call."""
        mujoco.mj_inverse(self.model, self._data)
        return self._force
