"""Sequences of plans in a user's model: an arm moves, a gripper closes, the arm carries what it holds, and so on."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import actuator_moments
from lieednn_sim.arm.limits import largest_inertia
from lieednn_sim.errors import InputError, LieEDNNError, PlanError
from lieednn_sim.planning.goals import resolved
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.planners import OBSTACLE_PLANNER, plan
from lieednn_sim.planning.problem import USUAL_DURATION, Duration, Plan
from lieednn_sim.planning.settling import SettlingOptions
from lieednn_sim.planning.steps import Actuate, Gripping, Move
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats, frozen

# Inertia added to each joint of the arm, as a multiple of its own, so that the arm rests while the gripper moves. With
# a far more rigid arm, fingers would fling away what they release.
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
        if self.plan is None:
            return "controls"
        return f"{self.plan.planner}: {self.plan.certificate}; {self.plan.clearance.at()}"


@frozen
class PlanSequence:
    """A sequence of planned steps in a view of a model, made by `plan_sequence`; `simulate` runs it.

    Attributes:
        t: ``(K,)`` times from 0, at the model's steps [s].
        qpos: ``(K, nq)`` positions in the model's order. What is held moves with the hand; while a gripper moves,
            everything but the arm is simulated; otherwise everything else stays in place.
        qvel: ``(K, nv)`` velocities in the model's order.
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
        """Return one line for each step: its times, its name, its proof, and its clearance."""
        width = max(len(part.step.name) for part in self.parts)
        return "\n".join(
            f"{self.t[part.first]:6.2f} to {self.t[part.last]:6.2f} s  {part.step.name:{width}}  {part}"
            for part in self.parts
        )


def plan_sequence(
    arm: Arm,
    steps: Sequence[Move | Actuate],
    *,
    planner: str = OBSTACLE_PLANNER,
    duration: Duration = USUAL_DURATION,
    seed: Seed = 0,
    options: PlannerOptions | None = None,
    fastest: bool = False,
    settle: str | SettlingOptions | None = None,
) -> PlanSequence:
    """Plan a sequence of steps in a view of a model, each of which starts at rest where the one before ended.

    Moves are planned by `plan`, each with its own proof. After controls have changed, the model is simulated with the
    arm held still, to find out where fingers and objects end up: a held object is then carried as the fingers grasped
    it, and a released one stands where it came to rest.

    Args:
        arm: a view (`Arm.of`), from whose state the first step starts, at rest.
        steps: the steps.
        planner, duration, options, fastest, settle: as for `plan`, for each move that does not set its own.
        seed: seed of all moves.

    Raises:
        InputError: a value is malformed, or start or goal of a move cannot be used; the message names the step.
        PlanError, NotCertifiedError: a motion is not found, or an event does not come; the message names the step.
    """
    if not steps or not all(isinstance(step, Move | Actuate) for step in steps):
        raise InputError("steps must be a list of Move and Actuate, with at least one")
    common = {"planner": planner, "duration": duration, "options": options, "fastest": fastest, "settle": settle}
    common["seed"] = as_seed("seed", seed)
    planned = _Planned(arm)
    # Bad steps are refused before any work is done.
    gripping = {k: Gripping(arm, arm.model, step) for k, step in enumerate(steps) if isinstance(step, Actuate)}
    parts = []
    for k, step in enumerate(steps):
        first = planned.last
        try:
            plan = None if isinstance(step, Actuate) else planned.move(step, common)
            if k in gripping:
                planned.grip(gripping[k])
        except LieEDNNError as error:
            error.args = (f"step {k + 1}, {step.name!r}: {error}",)
            raise
        parts.append(SequencePart(step, first, planned.last, plan))
    qpos, qvel = np.vstack(planned.qpos), np.vstack(planned.qvel)
    return PlanSequence(arm.timestep * np.arange(len(qpos), dtype=float), qpos, qvel, tuple(parts), arm)


class _Planned:
    """The rows of a sequence so far, and the state in which it ends."""

    def __init__(self, arm: Arm) -> None:
        self._arm, self._state = arm, arm.data()
        self._state.qvel[:] = 0.0
        self._places, self._dofs = arm.space.addresses, arm.space.rate_addresses
        # A copy of the model in which the arm has extra inertia, and no actuators.
        self._heavy, dofs = copy.deepcopy(arm.model), self._dofs
        inertia = largest_inertia(arm.model, self._state.qpos[None], np.eye(arm.model.nv)[:, dofs])
        self._heavy.dof_armature[dofs] += _HELD * inertia
        driving = actuator_moments(arm.model)[:, dofs].any(axis=1)
        self._heavy.actuator_gainprm[driving] = self._heavy.actuator_biasprm[driving] = 0.0
        self.qpos, self.qvel = [self._state.qpos[None].copy()], [np.zeros((1, arm.model.nv))]
        self.last = 0

    def move(self, step: Move, common: Mapping[str, Any]) -> Plan:
        """Plan a move, and add its rows."""
        arm = self._arm.at(self._state)
        if step.clearance is not None:
            arm = replace(arm, clearance=step.clearance)
        if step.holding is not None:
            arm = arm.holding(step.holding, step.touching)
        # The keyframe ``home`` means the state in which the sequence begins, not the present one.
        own = {name: getattr(step, name) for name in (*common, "path_constraint")}
        own = {name: value for name, value in own.items() if value is not None}
        result = plan(arm, resolved(self._arm, step.goal), **{**common, **own})
        self._add(result.qpos[1:], result.qvel[1:])
        return result

    def grip(self, gripping: Gripping) -> None:
        """Simulate a step of controls with the arm at rest, and add its rows."""
        state, qpos, qvel = self._state, [], []
        rest = state.qpos[self._places]
        gripping.begin(state)
        applied = state.qfrc_applied[self._dofs]
        with QuietWarnings():
            mujoco.mj_forward(self._heavy, state)
            while True:
                # The force against gravity, from the last step, in which the arm was in the same place.
                state.qfrc_applied[self._dofs] = (state.qfrc_bias - state.qfrc_passive)[self._dofs]
                mujoco.mj_step(self._heavy, state)
                if state.warning.number.any() or not np.isfinite(state.qvel).all():
                    raise PlanError("the simulation of the gripper diverged")
                state.qpos[self._places], state.qvel[self._dofs] = rest, 0.0
                qpos.append(state.qpos.copy())
                qvel.append(state.qvel.copy())
                if gripping.over(state, len(qpos)):
                    break
                if gripping.late:
                    raise PlanError(f"its event does not come: {gripping.late}")
        state.qfrc_applied[self._dofs] = applied
        self._add(np.array(qpos), np.array(qvel))

    def _add(self, qpos: Floats, qvel: Floats) -> None:
        self.qpos.append(qpos)
        self.qvel.append(qvel)
        self.last += len(qpos)
        self._state.qpos[:], self._state.qvel[:] = qpos[-1], 0.0
        self._state.qacc_warmstart[:] = 0.0
