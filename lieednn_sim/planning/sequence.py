"""Plans in a row in a compiled model: an arm moves, a gripper closes, the arm carries what it holds, and so on."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE
from lieednn_sim.arm.forces import actuator_moments
from lieednn_sim.budget import DEFAULT_TIME_BUDGET
from lieednn_sim.errors import InputError, LieEDNNError, PlanError
from lieednn_sim.planning.in_model import plan_in
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.planners import OBSTACLE_PLANNER
from lieednn_sim.planning.problem import Plan
from lieednn_sim.planning.steps import Actuate, Gripping, Move
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats, frozen

# What is added to the inertia of each joint of the arm, as a multiple of it, so that the arm rests while the gripper
# moves. A far more rigid arm lets fingers fling what they release.
_HELD = 10.0


@frozen
class SequencePart:
    """One step of a sequence, planned.

    Attributes:
        step: the step.
        first, last: its first and last row in the sequence.
        plan: the motion of a move, whose certificate is ``plan.network.certificate``; None for other steps.
    """

    step: Move | Actuate
    first: int
    last: int
    plan: Plan | None = None

    def __str__(self) -> str:
        """Return what is done and what is proved."""
        if self.plan is None:
            return "controls"
        network = self.plan.network
        proof = "no network, no proof" if network is None else str(network.certificate)
        return f"{self.plan.planner}: {proof}"


@frozen
class PlanSequence:
    """Steps in a row of an arm in a compiled model, from `plan_sequence`; `run_in` simulates them.

    Attributes:
        t: ``(K,)`` times from 0, at the model's steps [s].
        qpos: ``(K, nq)`` positions in the model's order. What is held moves with the hand; while a gripper moves,
            all but the arm obeys physics; everything else stays.
        qvel: ``(K, nv)`` velocities in its order.
        parts: the steps, with the plan of each move.
        arm: the arm, without what it holds.
    """

    t: Floats
    qpos: Floats
    qvel: Floats
    parts: tuple[SequencePart, ...]
    arm: Arm

    def __repr__(self) -> str:
        return f"<PlanSequence: {len(self.parts)} steps in {self.t[-1]:g} s, {self.arm.n_joints} joints>"

    def __str__(self) -> str:
        """Return one line for each step: its times, its name, and its proof."""
        width = max(len(part.step.name) for part in self.parts)
        return "\n".join(
            f"{self.t[part.first]:6.2f} to {self.t[part.last]:6.2f} s  {part.step.name:{width}}  {part}"
            for part in self.parts
        )


def plan_sequence(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joints: Sequence[str],
    steps: Sequence[Move | Actuate],
    *,
    tip: str | None = None,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    clearance: float = PLANNED_CLEARANCE,
    planner: str = OBSTACLE_PLANNER,
    duration: float = 4.0,
    max_time_scale: float = 3.0,
    seed: Seed = 0,
    time_budget: float = DEFAULT_TIME_BUDGET,
    options: PlannerOptions | None = None,
    fastest: bool = False,
) -> PlanSequence:
    """Plan steps in a row in a compiled model, each from where the one before ended, at rest.

    Moves are planned by `plan_in`, each with its own proof. Where the fingers and the objects are after controls have
    changed is found by simulating the model with the arm held still; so a held object is carried as the fingers grasped
    it, and stands afterwards where it came to rest. Neither model nor data is changed.

    Args:
        model: a compiled model.
        data: its state, from which the first step starts, at rest.
        joints: names of the arm's joints, as of `plan_in`.
        steps: the steps.
        tip, limits: as of `plan_in`.
        clearance, planner, duration, max_time_scale, time_budget, options, fastest: as of `plan_in`, for each move that
            has no other.
        seed: seed of all moves.

    Raises:
        InputError: a value is malformed, or start or goal of a move cannot be used; the message names the step.
        PlanError, NotCertifiedError: there is no such motion, or an event does not come; the message names the step.
    """
    if not steps or not all(isinstance(step, Move | Actuate) for step in steps):
        raise InputError("steps must be a list of Move and Actuate, with at least one")
    common = {
        **{"tip": tip, "limits": limits, "clearance": clearance, "planner": planner, "duration": duration},
        **{"max_time_scale": max_time_scale, "time_budget": time_budget, "options": options, "fastest": fastest},
        "seed": as_seed("seed", seed),
    }
    arm = Arm.of(model, data, joints, tip=tip, limits=limits)
    planned = _Planned(model, data, arm)
    # Refused before the work.
    gripping = {k: Gripping(model, step, planned.dofs) for k, step in enumerate(steps) if isinstance(step, Actuate)}
    parts = []
    for k, step in enumerate(steps):
        first = planned.last
        try:
            plan = None if isinstance(step, Actuate) else planned.move(joints, step, common)
            if k in gripping:
                planned.grip(gripping[k])
        except LieEDNNError as error:
            error.args = (f"step {k + 1}, {step.name!r}: {error}",)
            raise
        parts.append(SequencePart(step, first, planned.last, plan))
    qpos, qvel = np.vstack(planned.qpos), np.vstack(planned.qvel)
    return PlanSequence(model.opt.timestep * np.arange(len(qpos), dtype=float), qpos, qvel, tuple(parts), arm)


class _Planned:
    """The rows of a sequence so far, and the state in which it ends."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: Arm) -> None:
        self._model, self._state = copy.deepcopy(model), mujoco.MjData(model)
        mujoco.mj_copyData(self._state, model, data)
        self._state.qvel[:] = 0.0
        self._places, self.dofs = arm.space.addresses, arm.space.rate_addresses
        self._heavy = _heavier(self._model, self._state, self.dofs)
        self.qpos, self.qvel = [data.qpos[None].copy()], [np.zeros((1, model.nv))]
        self.last = 0

    def move(self, joints: Sequence[str], step: Move, common: Mapping[str, Any]) -> Plan:
        """Plan a move, and add its rows."""
        result = plan_in(self._model, self._state, joints, step.goal, **step.arguments(common))
        rows = result.rows(self._model.opt.timestep)[1:]
        self._add(result.qpos[rows], result.qvel[rows])
        return result.plan

    def grip(self, gripping: Gripping) -> None:
        """Simulate a step of controls with the arm at rest, and add its rows."""
        state, qpos, qvel = self._state, [], []
        rest = state.qpos[self._places]
        gripping.begin(state)
        applied = state.qfrc_applied[self.dofs]
        with QuietWarnings():
            mujoco.mj_forward(self._heavy, state)
            while True:
                # Against gravity; of the last step, in which the arm was in the same place.
                state.qfrc_applied[self.dofs] = (state.qfrc_bias - state.qfrc_passive)[self.dofs]
                mujoco.mj_step(self._heavy, state)
                if state.warning.number.any() or not np.isfinite(state.qvel).all():
                    raise PlanError("the simulation of the gripper diverged")
                state.qpos[self._places], state.qvel[self.dofs] = rest, 0.0
                qpos.append(state.qpos.copy())
                qvel.append(state.qvel.copy())
                try:
                    if gripping.over(state, len(qpos)):
                        break
                except LookupError as error:
                    raise PlanError(f"its event does not come: {error.args[0]}") from None
        state.qfrc_applied[self.dofs] = applied
        self._add(np.array(qpos), np.array(qvel))

    def _add(self, qpos: Floats, qvel: Floats) -> None:
        self.qpos.append(qpos)
        self.qvel.append(qvel)
        self.last += len(qpos)
        self._state.qpos[:], self._state.qvel[:] = qpos[-1], 0.0
        self._state.qacc_warmstart[:] = 0.0


def _heavier(model: mujoco.MjModel, data: mujoco.MjData, dofs: NDArray[np.int_]) -> mujoco.MjModel:
    """A copy of a model in which some dofs have more inertia than in a state, and no actuators."""
    heavy, state = copy.deepcopy(model), mujoco.MjData(model)
    mujoco.mj_copyData(state, model, data)
    mujoco.mj_fwdPosition(model, state)
    column, unit = np.zeros(model.nv), np.zeros(model.nv)
    for dof in dofs:
        unit[:] = 0.0
        unit[dof] = 1.0
        mujoco.mj_mulM(model, state, column, unit)
        heavy.dof_armature[dof] += _HELD * column[dof]
    driving = actuator_moments(model)[:, dofs].any(axis=1)
    heavy.actuator_gainprm[driving] = heavy.actuator_biasprm[driving] = 0.0
    return heavy
