"""Simulations of a compiled model that somebody else made, in which an arm follows a plan or a sequence of plans."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.view import check_data
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning.in_model import ModelPlan
from lieednn_sim.planning.sequence import PlanSequence, SequencePart
from lieednn_sim.planning.steps import Actuate, Gripping, Move
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


def run_in(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    plan: ModelPlan | PlanSequence,
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
        plan: the plan, or a sequence, whose steps of controls end by time or by their events, which may come sooner or
            later than planned.
        hold: how long the simulation goes on after the plan, with the arm at rest [s].
        feedforward: whether servos get what gravity and inertia need; without it they sag and lag as plain ones do.
        progress: called with (done, total) now and then, in steps.

    Raises:
        InputError: a value is malformed or of another model, the arm is not where the plan begins, or what moves it are
            actuators of other kinds, such as muscles, or too few.
        SimulationError: MuJoCo warns, the state is not finite, or an event of a sequence does not come in time.
    """
    rest = float(as_floats("hold", hold, ()))
    if not 0.0 <= rest <= _LONGEST_HOLD:
        raise InputError(f"hold must be from 0 to {_LONGEST_HOLD:g} s, got {rest:g}")
    check_data(model, data)
    if plan.qpos.shape[1] != model.nq:
        raise InputError(
            f"plan is of another model: it has {plan.qpos.shape[1]} positions, and this model has {model.nq}"
        )
    running = _Running(model, data, plan, feedforward, round(rest / model.opt.timestep), progress)
    with QuietWarnings():
        running.begin()
        if isinstance(plan, ModelPlan):
            running.follow(0, len(running.qpos) - 1)
        else:
            for k, part in enumerate(plan.parts):
                running.steps.append((running.time, part.step.name))
                if isinstance(part.step, Move):
                    running.follow(part.first, part.last)
                else:
                    running.grip(k, part)
        end = running.time
        for _ in range(round(rest / running.timestep)):
            running.step(len(running.qpos) - 1, len(running.qpos) - 1)
    return running.result(plan.arm, end)


class _Running:
    """A simulation of a given model on its way, whose arm follows the rows of a plan, and its log.

    Attributes:
        qpos: ``(R, nq)`` planned positions at the model's steps.
        timestep: the model's [s].
        steps: when each step of a sequence began, and its name.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        plan: ModelPlan | PlanSequence,
        feedforward: bool,
        rest: int,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self._model, self.timestep = copy.deepcopy(model), float(model.opt.timestep)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_copyData(self._data, self._model, data)
        self._data.time = 0.0
        rows = plan.rows(self.timestep) if isinstance(plan, ModelPlan) else slice(None)
        self.qpos, self._qvel = plan.qpos[rows], plan.qvel[rows]
        self._drive = _Drive(self._model, plan.arm, self._data, feedforward)
        self._drive.check_start(self._data, self.qpos[0])
        self._log: dict[str, list[Floats]] = {"qpos": [], "qvel": [], "ctrl": []}
        self._rows: list[int] = []
        self.steps: list[tuple[float, str]] = []
        self._planned, self._progress = len(self.qpos) - 1 + rest, progress

    @property
    def time(self) -> float:
        """Present time [s]."""
        return len(self._rows) * self.timestep

    def begin(self) -> None:
        """Compute what the first controls depend on."""
        mujoco.mj_forward(self._model, self._data)

    def follow(self, first: int, last: int) -> None:
        """Follow rows of the plan."""
        for row in range(first, last):
            self.step(row, row + 1)

    def grip(self, number: int, part: SequencePart) -> None:
        """Change controls, and wait until that step is over; the arm rests, so its rows are all the same."""
        assert isinstance(part.step, Actuate)
        gripping, done = Gripping(self._model, part.step, self._drive.dofs), 0
        gripping.begin(self._data)
        while True:
            self.step(min(part.first + done, part.last), min(part.first + done + 1, part.last))
            done += 1
            try:
                if gripping.over(self._data, done):
                    return
            except LookupError as error:
                raise SimulationError(
                    f"step {number + 1}, {part.step.name!r}, begun at {self.steps[-1][0]:.2f} s: its event does not "
                    f"come: {error.args[0]}"
                ) from None

    def step(self, row: int, following: int) -> None:
        """Log the present state, and do a step from one row of the plan to another."""
        data = self._data
        self._note(row, following)
        mujoco.mj_step(self._model, data)
        if data.warning.number.any() or not np.isfinite(data.qvel).all():
            raise failure(data, "the given model", self.time)
        done = len(self._rows)
        seen = 100  # steps between calls of ``progress``
        if self._progress is not None and (done % seen == 0 or done == self._planned):
            self._progress(min(done, self._planned), self._planned)

    def _note(self, row: int, following: int) -> None:
        self._drive.act(self._data, self.qpos[row], self._qvel[row], self._qvel[following])
        self._rows.append(row)
        for name, values in self._log.items():
            values.append(getattr(self._data, name).copy())

    def result(self, arm: Arm, end: float) -> ModelRun:
        """The log, with the present state as its last row."""
        self._note(len(self.qpos) - 1, len(self.qpos) - 1)
        t = self.timestep * np.arange(len(self._rows), dtype=float)
        log = {name: np.array(values) for name, values in self._log.items()}
        return ModelRun.of(self._model, self._data, arm, t, log, self.qpos[self._rows], end, tuple(self.steps))


class _Drive:
    """Sets the controls and applied forces that make the arm in a model follow a plan.

    With coordinates x of the arm, and velocities B dx/dt of the model's dofs, the forces along the coordinates are
    B^T (M B a + bias - passive), with a the planned acceleration, plus feedback where no servo has its own.

    Attributes:
        dofs: ``(m,)`` the arm's dofs in the model.
    """

    def __init__(self, model: mujoco.MjModel, arm: Arm, data: mujoco.MjData, feedforward: bool) -> None:
        self._model, self._basis, self.dofs = model, tangent_basis(arm), arm.space.rate_addresses
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
        worst = int(self.dofs[np.abs(self._error[self.dofs]).argmax()])
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
        target = self._rates @ (next_qvel - qvel) / model.opt.timestep + self._frequency * feedback
        mujoco.mj_mulM(model, data, self._load, self._basis @ target)
        load = self._load + data.qfrc_bias - data.qfrc_passive
        forces = self._allocation @ (self._fed * (self._basis.T @ load))
        servo = actuators.affine_controls(qpos, next_qvel, forces)
        direct = actuators.affine_controls(data.qpos, data.qvel, forces)
        data.ctrl[actuators.driving] = np.where(actuators.servos, servo, direct)[actuators.driving]
        data.qfrc_applied[self._bare] = self._applied + load[self._bare]
