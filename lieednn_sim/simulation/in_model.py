"""Simulations of a compiled model that somebody else made, in which an arm follows a plan of `plan_in`."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.compiled import shared_addresses
from lieednn_sim.errors import InputError
from lieednn_sim.planning.in_model import ModelPlan
from lieednn_sim.simulation.actuators import ModelActuators
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY
from lieednn_sim.simulation.disturbances import tangent_basis
from lieednn_sim.simulation.model_run import ModelRun
from lieednn_sim.simulation.simulation import failure
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

# How far the arm may be from where the plan begins [rad, m].
_START_TOLERANCE = 0.01
_LONGEST_HOLD = 1e4  # [s]
_SEEN = 100  # steps between calls of ``progress``


def run_in(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    found: ModelPlan,
    *,
    hold: float = 1.0,
    feedforward: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> ModelRun:
    """Simulate a model from its present state while the arm's joints follow a plan; all other things move as they do.

    The arm's own actuators drive it, within their limits. Position servos are set to the planned positions, shifted by
    what velocity, gravity and inertia need. Other actuators exert the torques of feedback linearisation (10 Hz,
    critically damped), as the controller ``computed-torque`` does; for joints that no actuator moves, these are applied
    as generalised forces without a limit. The controller knows the arm and what is attached to it, but neither contacts
    nor what the hand holds. All other actuators keep their controls of ``data``.

    Args:
        model: the model that the plan was made in, which is not changed.
        data: its state, which is not changed: the simulation begins there.
        found: the plan.
        hold: how long the simulation goes on after the plan, with the arm at rest [s].
        feedforward: whether servos get what gravity and inertia need; without it they sag and lag as plain ones do.
        progress: called with (done, total) now and then, in steps.

    Raises:
        InputError: a value is malformed, the arm is not where the plan begins, or what moves it are actuators of other
            kinds, such as muscles, or too few.
        SimulationError: MuJoCo warns, or the state is not finite.
    """
    rest = float(as_floats("hold", hold, ()))
    if not 0.0 <= rest <= _LONGEST_HOLD:
        raise InputError(f"hold must be from 0 to {_LONGEST_HOLD:g} s, got {rest:g}")
    simulated, timestep = copy.deepcopy(model), float(model.opt.timestep)
    state = mujoco.MjData(simulated)
    mujoco.mj_copyData(state, simulated, data)
    state.time = 0.0
    drive = _Drive(simulated, found.arm, state, feedforward)
    drive.check_start(state, found.qpos[0])
    moving = np.arange(round(found.t[-1] / timestep)) * timestep
    rows = np.append(
        np.rint(moving / found.arm.timestep).astype(int), [len(found.t) - 1] * (1 + round(rest / timestep))
    )
    last = len(rows) - 1
    log = {
        name: np.empty((last + 1, size)) for name, size in (("qpos", model.nq), ("qvel", model.nv), ("ctrl", model.nu))
    }
    with QuietWarnings():
        mujoco.mj_forward(simulated, state)
        for k in range(last + 1):
            now, then = rows[k], rows[min(k + 1, last)]
            drive.act(state, found.qpos[now], found.qvel[now], found.qvel[then])
            for name, values in log.items():
                values[k] = getattr(state, name)
            if k < last:
                mujoco.mj_step(simulated, state)
                if state.warning.number.any() or not np.isfinite(state.qvel).all():
                    raise failure(state, "the given model", (k + 1) * timestep)
            if progress is not None and (k % _SEEN == 0 or k == last):
                progress(k, last)
    t = timestep * np.arange(last + 1, dtype=float)
    return ModelRun.of(simulated, data, found.arm, t, log, found.qpos[rows], float(found.t[-1]))


class _Drive:
    """Sets the controls and applied forces that make the arm in a model follow a plan.

    With coordinates x of the arm, and velocities B dx/dt of the model's dofs, the forces along the coordinates are
    B^T (M B a + bias - passive), with a the planned acceleration, plus feedback where no servo has its own.
    """

    def __init__(self, model: mujoco.MjModel, arm: Arm, data: mujoco.MjData, feedforward: bool) -> None:
        _, _, self._dofs, ours = shared_addresses(model, arm.model)
        self._model, self._basis = model, np.zeros((model.nv, arm.n_joints))
        self._basis[self._dofs] = tangent_basis(arm)[ours]
        self._rates = np.linalg.pinv(self._basis)
        self._actuators = actuators = ModelActuators(model, self._basis)
        transmission = actuators.transmission
        servoed = np.abs(transmission[actuators.servos]).max(axis=0, initial=0.0) > 0.0
        self._frequency = np.where(servoed, 0.0, NATURAL_FREQUENCY)
        self._fed = np.where(servoed & (not feedforward), 0.0, 1.0)
        driven = transmission.any(axis=0)
        if np.linalg.matrix_rank(transmission) < driven.sum():
            raise InputError("the model's actuators cannot move all joints of the arm independently")
        self._allocation = np.linalg.pinv(transmission.T)
        # Where no actuator is, each dof gets its own force, so that coupled stages need none from their equalities.
        self._bare = self._basis[:, ~driven].any(axis=1)
        self._applied = data.qfrc_applied[self._bare]
        self._load, self._error = np.zeros(model.nv), np.zeros(model.nv)

    def check_start(self, data: mujoco.MjData, first: Floats) -> None:
        """Raise `InputError` unless the arm is where the plan begins."""
        mujoco.mj_differentiatePos(self._model, self._error, 1.0, data.qpos, first)
        worst = int(self._dofs[np.abs(self._error[self._dofs]).argmax()])
        if abs(self._error[worst]) > _START_TOLERANCE:
            name = self._model.joint(self._model.dof_jntid[worst]).name
            raise InputError(
                f"the arm is not where the plan begins: its joint {name!r} is {abs(self._error[worst]):.3g} rad or m "
                "from there; give the data that the plan was made from"
            )

    def act(self, data: mujoco.MjData, qpos: Floats, qvel: Floats, next_qvel: Floats) -> None:
        """Set controls and forces of a step for planned positions and velocities, and the velocities at its end.

        Derived values in ``data``, such as inertias, are those of the last step.
        """
        actuators, model = self._actuators, self._model
        mujoco.mj_differentiatePos(model, self._error, 1.0, data.qpos, qpos)
        feedback = 2.0 * (self._rates @ (qvel - data.qvel)) + self._frequency * (self._rates @ self._error)
        wanted = self._rates @ (next_qvel - qvel) / model.opt.timestep + self._frequency * feedback
        mujoco.mj_mulM(model, data, self._load, self._basis @ wanted)
        load = self._load + data.qfrc_bias - data.qfrc_passive
        forces = self._allocation @ (self._fed * (self._basis.T @ load))
        servo = actuators.affine_controls(qpos, next_qvel, forces)
        direct = actuators.affine_controls(data.qpos, data.qvel, forces)
        data.ctrl[actuators.driving] = np.where(actuators.servos, servo, direct)[actuators.driving]
        data.qfrc_applied[self._bare] = self._applied + load[self._bare]
