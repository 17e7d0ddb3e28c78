"""Plans for an arm in a compiled model that somebody else made, in that model's own order."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE
from lieednn_sim.budget import DEFAULT_TIME_BUDGET
from lieednn_sim.errors import InputError
from lieednn_sim.planning.goals import Goal, single_goals
from lieednn_sim.planning.motion import LIMIT_TOLERANCE
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.planners import OBSTACLE_PLANNER, plan
from lieednn_sim.planning.problem import Plan
from lieednn_sim.validation import Seed, as_choice, as_positive
from lieednn_sim.values import Floats, frozen

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


@frozen
class ModelPlan:
    """A motion of some joints of a compiled model, from `plan_in`.

    Attributes:
        t: ``(K,)`` times from 0, at the steps of the arm's model [s].
        qpos: ``(K, nq)`` generalised positions in the order of the given model; what is not the arm's stays.
        qvel: ``(K, nv)`` generalised velocities in its order; zero where they are not the arm's.
        plan: the motion of the arm, with the network that made it, if one did: its certificate is
            ``plan.network.certificate``.
        arm: the arm, which `simulate`, `evaluate` and the policies take as any other.
    """

    t: Floats
    qpos: Floats
    qvel: Floats
    plan: Plan
    arm: Arm

    def rows(self, timestep: float) -> NDArray[np.int_]:
        """The rows nearest to times at a distance of ``timestep`` [s], such as the given model's, to the end."""
        times = np.arange(round(self.t[-1] / as_positive("timestep", timestep)) + 1) * timestep
        result = np.minimum(np.rint(times / self.arm.timestep).astype(int), len(self.t) - 1)
        result[-1] = len(self.t) - 1
        return result


def plan_in(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joints: Sequence[str],
    goal: Goal,
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
    path_constraint: TaskSpaceRegion | None = None,
    holding: str | None = None,
    touching: Sequence[str] = (),
) -> ModelPlan:
    """Plan a motion of some joints of any compiled model, from its present state, around everything else in it.

    The named joints are the arm. All other bodies, such as objects, other robots and the arm's own hand, stay where
    ``data`` has them: they are obstacles, or move with the link that carries them. Neither model nor data is changed.
    Positions, velocities and accelerations keep the limits of the model (see `importer.import_arm`). An MJCF file has
    no limits of velocity: give them by ``limits``.

    Args:
        model: a compiled model.
        data: its state. The motion starts at its positions, at rest.
        joints: names of the joints, on one chain; joints that equalities tie to them are the arm's, too.
        goal: joint target ``(n,)`` in the order of ``joints`` [rad, m]: three values, a rotation vector, for a ball
            joint, and none for a joint that follows another. Or the name of a keyframe of the model, of which the arm's
            joints are taken, a pose of the tip in the world, a region of poses, or a set of goals, as of `plan`.
        tip: body or site of the end effector, by default the last body that the joints move.
        limits: ``velocity``, ``acceleration`` and ``jerk`` of coordinates by name [rad or m, s].
        clearance: distance that the motion keeps from contact, start and goal included [m].
        planner, duration, max_time_scale, seed, time_budget, options, fastest, path_constraint: as of `plan`.
        holding: name of a body with a free joint that the tip carries: it moves with the tip from where it is now. What
            holds it may touch it. It keeps the clearance from all else, except from what it stands on, that is, what it
            is nearer to now: that it may touch, but sink no deeper into than now.
        touching: names of bodies that the held one may touch as well, such as those it is put on.

    Raises:
        InputError: a value is malformed; the joints are no arm; or start or goal is beyond a limit or too near contact.
        PlanError, NotCertifiedError: there is no such motion, as of `plan`.
    """
    arm = Arm.of(model, data, joints, tip=tip, limits=limits, clearance=clearance)
    if holding is not None:
        arm = arm.holding(holding, touching)
    given = [
        k
        for joint in joints
        for k, name in enumerate(arm.joint_names)
        if re.fullmatch(f"{re.escape(joint)}(_[xyz])?", name)
    ]

    def named(item: Any) -> Any:
        """A keyframe of the model, in the order of the given joints; other goals as they are."""
        if not isinstance(item, str):
            return item
        key = as_choice("keyframe", item, [model.key(k).name for k in range(model.nkey)])
        return arm.coordinates(model.key(key).qpos)[given]

    goals = _in_order_of_arm(arm, given, [*map(named, goal)] if isinstance(goal, list | tuple) else named(goal))
    start = arm.keyframe("home")
    # Where a move ended at a limit, rounding may have left it just outside.
    inside = np.clip(start, *arm.position_limits.T)
    start = np.where(np.abs(start - inside) <= LIMIT_TOLERANCE, inside, start)
    _check_hand(model, arm, start)
    result = plan(
        arm,
        goals,
        start=start,
        planner=planner,
        duration=duration,
        max_time_scale=max_time_scale,
        seed=seed,
        time_budget=time_budget,
        options=options,
        fastest=fastest,
        path_constraint=path_constraint,
    )
    motion = result.motion
    return ModelPlan(motion.t, arm.qpos(motion.q), arm.qvel(motion.q, motion.qd), result, arm)


def _in_order_of_arm(arm: Arm, given: Sequence[int], goal: Goal) -> Goal:
    """Goals in the given order of the coordinates, in the arm's own; poses and regions as they are."""
    ordered = [
        item[np.argsort(given)] if isinstance(item, np.ndarray) else item
        for item in single_goals(arm, goal, f"the goal of {', '.join(arm.joint_names[k] for k in given)}")
    ]
    return ordered if len(ordered) > 1 else ordered[0]


def _check_hand(model: mujoco.MjModel, arm: Arm, start: Floats) -> None:
    """Raise `InputError` that tells how to hold a free body, if the arm touches one at its start."""
    free = {model.body(model.jnt_bodyid[joint]).name for joint in range(model.njnt) if model.jnt_type[joint] == _FREE}
    for pair in arm.near_contacts(start):
        if result := free.intersection(pair):
            body = min(result)
            raise InputError(
                f"start is out of reach: {pair[0]!r} would touch {pair[1]!r} there; if the hand holds it, say so by "
                f"holding={body!r}"
            )
