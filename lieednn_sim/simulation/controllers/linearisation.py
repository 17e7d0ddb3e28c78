"""Feedback linearisation by a model's own actuators, whatever else moves in it, and also through closed loops."""

from __future__ import annotations

import copy
from functools import cached_property

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.equalities import least_squares
from lieednn_sim.arm.forces import compensating_dofs, tangent_basis
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY, Controller
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Foreseen, Reference
from lieednn_sim.values import Floats


def feedback_linearisation(arm: Arm, reference: Reference) -> Controller:
    """The controller for an arm with closed loops, or without."""
    return (FeedbackLinearisation if arm.dependents is None else LoopLinearisation)(arm, reference)


class FeedbackLinearisation(Controller):
    """Forces B^T (M a + bias - passive) by the arm's own actuators, within their limits.

    B has the velocities of the model's dofs at unit rates of the arm's coordinates. Position servos add their own
    feedback: their controls are the planned positions, shifted by what velocity, gravity and inertia need. Where no
    servo acts, a = a_ref + 2 w (v_ref - v) + w^2 (q_ref - q), with w of 2 pi 10 Hz. Joints without an actuator get
    applied forces, without a limit. All other actuators keep their controls. The controller knows the arm and what is
    attached to it, but not contacts, what the hand holds, or other masses of the plant. Raises as `Actuators`.
    """

    changes_plant = False

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._reference, self._foreseen = reference, Foreseen(reference)
        self._actuators = actuators = Actuators(arm, complete=False)
        basis, transmission = tangent_basis(arm.space), actuators.transmission
        driven = transmission.any(axis=0)
        frequency, rates = np.where(actuators.servoed, 0.0, NATURAL_FREQUENCY), np.linalg.pinv(basis)
        space = arm.space
        self._mine, self._dofs = np.asarray(basis.any(axis=1), dtype=float), space.rate_addresses
        # Position errors of hinges and slides are differences; for ball joints MuJoCo computes them.
        self._places = None if len(space.balls) else space.addresses
        feedback = np.concatenate([basis * frequency**2 @ rates, basis * 2.0 * frequency @ rates], axis=1)
        self._feedback = feedback[:, np.concatenate([self._dofs, arm.model.nv + self._dofs])]
        self._fed_back, self._lag = bool(frequency.any()), np.zeros(2 * len(self._dofs))
        self._error, self._off, self._slow = np.zeros(arm.model.nv), *np.split(self._lag, 2)
        self._driving = np.flatnonzero(actuators.driving)
        self._exert = actuators.allocation[self._driving] / actuators.gain[self._driving, None]
        # The bias forces of direct drives at the measured state are compensated; those of servos are wanted.
        direct = actuators.driving & ~actuators.servos
        self._against = bool(actuators.bias[:2, direct].any())
        self._direct = direct[self._driving]
        damping = np.where(direct, actuators.bias[2] / actuators.gain, 0.0)
        self._damping = (damping[:, None] * actuators.moment)[self._driving][:, self._dofs]
        self._damped = bool(self._damping.any())
        self._bare = np.flatnonzero(basis[:, ~driven].any(axis=1))
        self._applied = arm.data().qfrc_applied[self._bare]
        # MuJoCo adds the gravity compensation of these dofs to the actuators' force.
        compensated = compensating_dofs(arm.model)
        self._compensated = np.flatnonzero(compensated & (self._mine > 0.0) & bool(arm.model.body_gravcomp.any()))
        self._model = arm.model
        self._load = np.zeros(arm.model.nv)
        self._plant: mujoco.MjModel | None = None
        self._views: tuple[Floats, ...] = ()
        self._data: mujoco.MjData | None = None

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`; changes nothing, but notes whether the plant's dynamics are those of the arm."""
        same = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_gravcomp")
        known = all(np.array_equal(getattr(plant, name), getattr(self._model, name)) for name in same)
        self._plant = plant if known else None

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`. Derived values in ``data``, such as inertias, are those of the last step."""
        known = data
        if self._plant is None or noise.present:
            known = _measured(*self._own, data, noise)
        elif step == 0:
            mujoco.mj_forward(self._plant, data)
        if known is not self._data:
            # Views are kept, since asking MuJoCo for one takes as long as reading it.
            self._data = known
            self._views = known.qpos, known.qvel, known.qfrc_bias, known.qfrc_passive, known.qfrc_gravcomp
            self._control, self._forces = data.ctrl, data.qfrc_applied
        qpos, qvel, bias, passive, compensation = self._views
        goal, velocity, acceleration, control = self._foreseen.row(step, self._goals)
        speed = qvel.take(self._dofs)
        if self._fed_back:
            if self._places is None:
                mujoco.mj_differentiatePos(self._model, self._error, 1.0, qpos, goal)
                self._error.take(self._dofs, out=self._off)
            else:
                np.subtract(goal, qpos.take(self._places), self._off)
            np.subtract(velocity, speed, self._slow)
            acceleration = acceleration + self._feedback @ self._lag
        load = self._load
        mujoco.mj_mulM(self._model, known, load, acceleration)
        load += bias
        load -= passive
        if len(self._compensated):
            load[self._compensated] -= compensation[self._compensated]
        control = control + self._exert @ load
        if self._damped:
            control -= self._damping @ speed
        if self._against:
            own = self._actuators.affine_controls(qpos, np.zeros_like(qvel), 0.0)[self._driving]
            control[self._direct] += own[self._direct]
        if noise.present:
            seen = self._actuators.measurement_error(noise)[self._driving]
            control[~self._direct] += seen[~self._direct]
        self._control[self._driving] = control
        if len(self._bare):
            self._forces[self._bare] = self._applied + load[self._bare]

    @cached_property
    def _own(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The dynamics that the controller knows, without contacts and constraints, if it cannot use the plant's."""
        model = copy.deepcopy(self._model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
        return model, mujoco.MjData(model)

    def _goals(self, steps: range) -> list[tuple[Floats, ...]]:
        """Desired positions, velocities and accelerations at some steps, and controls of servos that exert no force."""
        reference, actuators = self._reference, self._actuators
        rows = reference.row(np.array(steps))
        following = np.minimum(rows + 1, reference.known - 1)
        qpos, velocity, after = reference.qpos[rows], reference.qvel[rows], reference.qvel[following]
        acceleration = self._mine * (after - velocity) / reference.timestep
        controls = np.where(actuators.servos, actuators.affine_controls(qpos, after, 0.0), 0.0)[:, self._driving]
        goals = qpos if self._places is None else qpos[:, self._places]
        # Tuples are faster to unpack than arrays.
        return list(zip(goals, velocity[:, self._dofs], acceleration, controls, strict=True))


class LoopLinearisation(Controller):
    """Actuator forces f of least norm with T^T f = B^T (M a + bias - passive), T = moment B, within their limits.

    B(q) has the velocities of the model's dofs at unit rates of the coordinates, those of loops by the equalities'
    Jacobian at the measured state; so the loops' constraint forces do no work. Position servos hold the lengths that
    their joints have along the reference, and a is the reference's acceleration; where no servo acts on a coordinate,
    2 w (v_ref - v) + w^2 (q_ref - q) is added to its acceleration, with w of 2 pi 10 Hz. Raises as `Actuators`.
    """

    changes_plant = False

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._arm, self._reference = arm, reference
        self._actuators = actuators = Actuators(arm)
        self._frequency = np.where(actuators.servoed, 0.0, NATURAL_FREQUENCY)
        self._moved = np.zeros(arm.model.nv)
        self._moved[arm.dofs] = 1.0
        self._data, self._load = mujoco.MjData(arm.model), np.zeros(arm.model.nv)
        self._compensated = compensating_dofs(arm.model)

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        arm, reference, actuators = self._arm, self._reference, self._actuators
        own = _measured(arm.model, self._data, data, noise)
        row = reference.row(step)
        last = reference.known - 1
        now, after = min(row, last), min(row + 1, last)
        basis = arm.moving(own.qpos)
        q = arm.coordinates(own.qpos)
        slow = reference.qd[now] - arm.rates(q, own.qvel)
        pull = self._frequency * (2.0 * slow + self._frequency * (reference.q[now] - q))
        acceleration = self._moved * (reference.qvel[after] - reference.qvel[now]) / reference.timestep + basis @ pull
        mujoco.mj_mulM(arm.model, own, self._load, acceleration)
        load = self._load + own.qfrc_bias - own.qfrc_passive - np.where(self._compensated, own.qfrc_gravcomp, 0.0)
        transmission = actuators.moment @ basis
        forces, _ = least_squares(transmission.T, load @ basis)
        # Servos get controls for the reference's lengths, so that they feed back; the others only exert their forces.
        held = actuators.affine_controls(reference.qpos[now], reference.qvel[after], forces)
        direct = actuators.affine_controls(own.qpos, own.qvel, forces)
        controls = np.where(actuators.servos, held, direct)
        if noise.present:
            controls = controls + np.where(actuators.servos, actuators.measurement_error(noise), 0.0)
        actuators.write(controls, data.ctrl)


def _measured(model: mujoco.MjModel, own: mujoco.MjData, data: mujoco.MjData, noise: Noise) -> mujoco.MjData:
    """A model's own dynamics at the measured state."""
    own.qpos[:], own.qvel[:] = data.qpos, data.qvel + noise.velocity
    mujoco.mj_integratePos(model, own.qpos, noise.position, 1.0)
    own.mocap_pos[:], own.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    mujoco.mj_fwdPosition(model, own)
    mujoco.mj_fwdVelocity(model, own)
    return own
