"""Controllers, which drive the arm along a reference.

A controller may change the simulated plant, since it may need other actuators than those of the arm's model. It knows
the dynamics of the arm's model; the plant may have other masses.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import required_forces, tangent_basis
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Foreseen, Reference, runs
from lieednn_sim.values import Floats

# Inputs by the part of MuJoCo's state that they set, each with steps along the first axis.
Inputs = dict[mujoco.mjtState, Floats]

#: Natural frequency w of the computed-torque loop, 10 Hz [rad/s]; it is critically damped.
NATURAL_FREQUENCY = 2.0 * np.pi * 10.0


class Controller(ABC):
    """Base class of controllers, which set the controls that make the simulated arm track a reference.

    A controller sees the part of the reference that is known so far, and may log channels of its own.

    Attributes:
        add_bodies: a method that adds the bodies that the controller needs to a copy of the arm's spec; None for none.
        changes_plant: whether `equip` changes the plant. If nothing does, the plant is the arm's model itself: copying
            large meshes takes as long as simulating seconds.
        channel_units: see `ChannelSource`.
    """

    changes_plant = True
    add_bodies: Callable[[Any], None] | None = None
    channel_units: Mapping[str, str] = MappingProxyType({})

    def equip(self, plant: mujoco.MjModel) -> None:  # noqa: B027 (few controllers need this hook)
        """Give the compiled plant the actuators that the controller needs."""

    def own_controls(self, controls: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """Controls ``(K, nu)`` with which the arm's own actuators exert the forces of the plant's, for a rollout."""
        return controls

    def inputs(self, steps: range, noise: Noise) -> Inputs | None:
        """The values that `act` would set at given steps if they follow from the reference alone; otherwise None.

        Args:
            steps: numbers of m steps.
            noise: ``(m, nv)`` measurement errors at these steps.
        """
        return None

    @abstractmethod
    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """Set the controls of a step.

        It is called before the step: time, qpos and qvel in ``data`` are of this step, derived values of the last.
        """

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `ChannelSource`."""
        return np.zeros(0)

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `ChannelSource`."""
        return ()


class DriveController(Controller):
    """Base class of controllers that use the arm's own actuators; raises as `Actuators`, and for closed loops."""

    def __init__(self, arm: Arm, reference: Reference) -> None:
        if arm.dependents is not None:
            raise InputError(f"arm {arm.name!r} moves closed loops, as the controller feedback-linearisation alone can")
        self._actuators = Actuators(arm)
        self._reference = reference


class FeedforwardServo(DriveController):
    """A servo whose controls follow from the reference alone, apart from sensor errors; for position actuators."""

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._actuators.require_servos()
        self._foreseen = Foreseen(reference)

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        self._actuators.free_controls(plant)

    @abstractmethod
    def controls(self, steps: range) -> Floats:
        """Controls ``(m, nu)`` at given steps for states measured without error."""

    def inputs(self, steps: range, noise: Noise) -> Inputs:
        """See `Controller`."""
        controls = self.controls(steps)
        if noise.present:
            controls += self._actuators.measurement_error(noise)
        return {mujoco.mjtState.mjSTATE_CTRL: controls}

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        controls = self._foreseen.row(step, self.controls)
        if noise.present:
            controls = controls + self._actuators.measurement_error(noise)
        self._actuators.write(controls, data.ctrl)


class PositionServo(FeedforwardServo):
    """Position actuators with velocity feedforward: ctrl = q_ref + (kv / kp) qd_ref, per unit gear.

    A position actuator exerts kp (ctrl - q) - kv qd, so without the second term it would lag a moving reference by
    kv / kp seconds. The joint damping of the model is compensated in the same way. The velocity is that of the next
    step, since the integrator implicitfast damps with the velocity at the end of the step. In a model that is not made
    for this package, and with a payload, the load of gravity and springs at q_ref is fed forward, too.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._model, self._damping = arm.model, arm.model.dof_damping.copy()

    def controls(self, steps: range) -> Floats:
        """See `FeedforwardServo`."""
        reference = self._reference
        rows = reference.row(np.array(steps))
        qpos, velocity = reference.qpos[rows], reference.qvel[np.minimum(rows + 1, reference.known - 1)]
        forces = self._damping * velocity
        if self._actuators.heavy:
            firsts, run = runs(qpos)
            forces += required_forces(self._model, qpos[firsts])[run]
        return self._actuators.servo_controls(qpos, velocity, forces)


class InverseDynamicsServo(FeedforwardServo):
    """The position servo with the forces of the reference fed forward: ctrl = q_ref + (kv qd_ref + tau) / kp.

    tau is the result of MuJoCo's inverse dynamics, discretised like the integrator, so a plant equal to the model
    follows the reference up to rounding. Feedback is that of the servo.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._inverse = _InverseDynamics(arm)

    def controls(self, steps: range) -> Floats:
        """See `FeedforwardServo`."""
        reference = self._reference
        rows = reference.row(np.array(steps))
        qpos, (velocity, acceleration) = reference.qpos[rows], reference.rates_at(rows)
        # Equal rows, such as those of a resting or held reference, are computed once.
        firsts, run = runs(np.hstack([qpos, velocity, acceleration]))
        inverse, forces = self._inverse, np.empty((len(firsts), velocity.shape[1]))
        position, rate, change = inverse.qpos, inverse.velocity, inverse.acceleration
        for row, *target in zip(forces, qpos[firsts], velocity[firsts], acceleration[firsts], strict=True):
            position[:], rate[:], change[:] = target
            row[:] = inverse.force()
        return self._actuators.servo_controls(qpos, velocity, forces[run])


class ComputedTorque(DriveController):
    """Feedback linearisation by torques: tau = ID(q, qd, a_ref + 2 w (v_ref - qd) + w^2 (q_ref - q)).

    The plant's actuators become direct-drive ones with the same force limits; w is 2 pi 10 Hz. The difference of two
    positions is the velocity that leads from one to the other in unit time. q and qd are measured values.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        super().__init__(arm, reference)
        self._inverse = _InverseDynamics(arm)
        self._model = self._inverse.model
        self._actuators.make_direct(self._model)
        self._foreseen = Foreseen(reference)
        # Gains of velocity and position, as arrays: multiplying by numbers takes twice as long.
        self._gains = np.outer([2.0 * NATURAL_FREQUENCY, NATURAL_FREQUENCY**2], tangent_basis(arm.space).any(axis=1))
        self._errors = np.empty_like(self._gains)
        self._lag, self._error = self._errors

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        self._actuators.make_direct(plant)

    def own_controls(self, controls: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """See `Controller`."""
        return self._actuators.own_controls(controls, qpos, qvel)

    def _goals(self, steps: range) -> list[tuple[Floats, ...]]:
        """Desired positions, velocities and accelerations at some steps."""
        rows = self._reference.row(np.array(steps))
        # Tuples are faster to unpack than arrays.
        return list(zip(self._reference.qpos[rows], *self._reference.rates_at(rows), strict=True))

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        inverse, lag, error = self._inverse, self._lag, self._error
        goal, velocity, acceleration = self._foreseen.row(step, self._goals)
        np.add(data.qvel, noise.velocity, inverse.velocity)
        inverse.qpos[:] = data.qpos
        mujoco.mj_integratePos(self._model, inverse.qpos, noise.position, 1.0)
        mujoco.mj_differentiatePos(self._model, error, 1.0, inverse.qpos, goal)
        # In place: a + 2 w (v - qd) + w^2 e.
        np.subtract(velocity, inverse.velocity, lag)
        self._errors *= self._gains
        lag += acceleration
        np.add(lag, error, inverse.acceleration)
        self._actuators.direct_controls(inverse.force(), data.ctrl)


class _InverseDynamics:
    """Joint forces required of the actuators, in the discrete time of the model's integrator.

    The model is a copy of the arm's, without contacts if it is a view. The user sets ``qpos`` ``(nq,)``, ``velocity``
    and ``acceleration`` ``(nv,)``: views, since asking MuJoCo for one takes as long as filling it.
    """

    def __init__(self, arm: Arm) -> None:
        self.model = copy.deepcopy(arm.model)
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
        if arm.qpos_home is not None:
            # The acceleration of what touches the hand is not known.
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._data = mujoco.MjData(self.model)
        self.qpos, self.velocity, self.acceleration = self._data.qpos, self._data.qvel, self._data.qacc
        self._force = self._data.qfrc_inverse

    def force(self) -> Floats:
        """Joint forces ``(nv,)`` for the present values; overwritten by the next call."""
        mujoco.mj_inverse(self.model, self._data)
        return self._force
