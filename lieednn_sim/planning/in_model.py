"""Plans for an arm in a compiled model that somebody else made, in that model's own order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder, moved_by
from lieednn_sim.arm.importer.compiled import shared_addresses
from lieednn_sim.budget import DEFAULT_TIME_BUDGET
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.goals import single_goals
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Plan
from lieednn_sim.planning.registry import OBSTACLE_PLANNER, plan
from lieednn_sim.validation import Seed, as_floats
from lieednn_sim.values import Floats, frozen

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from lieednn_sim.planning.goals import Goal


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


def plan_in(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joints: Sequence[str],
    goal: ArrayLike | str | RigidTransform | TaskSpaceRegion | Sequence[Any],
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
    keep: TaskSpaceRegion | None = None,
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
            joint, and none for a joint that follows another. Or a pose of the tip in the world, a region of poses, or a
            set of goals, as of `plan`.
        tip: body or site of the end effector, by default the last body that the joints move.
        limits: ``velocity``, ``acceleration`` and ``jerk`` of coordinates by name [rad or m, s].
        clearance: distance that the motion keeps from contact, start and goal included [m].
        planner, duration, max_time_scale, seed, time_budget, options, fastest, keep: as of `plan`.

    Raises:
        InputError: a value is malformed; the joints are no arm; or start or goal is beyond a limit or too near contact.
        PlanError, NotCertifiedError: there is no such motion, as of `plan`.
    """
    arm = Arm.from_model(model, data, joints=joints, tip=tip, limits=limits)
    arm = replace(arm, clearance=float(as_floats("clearance", clearance, ())))
    theirs, ours, their_rates, our_rates = shared_addresses(model, arm.model)
    now = arm.qpos(np.zeros(arm.n_joints))
    now[ours] = data.qpos[theirs]
    found = plan(
        arm,
        _in_order_of_arm(arm, joints, goal),
        start=arm.coordinates(now),
        planner=planner,
        duration=duration,
        max_time_scale=max_time_scale,
        seed=seed,
        time_budget=time_budget,
        options=options,
        fastest=fastest,
        keep=keep,
    )
    motion = found.motion
    qpos, qvel = np.tile(data.qpos, (len(motion.t), 1)), np.zeros((len(motion.t), model.nv))
    qpos[:, theirs] = arm.qpos(motion.q)[:, ours]
    qvel[:, their_rates] = arm.qvel(motion.q, motion.qd)[:, our_rates]
    _check_contacts(model, data, qpos, their_rates)
    return ModelPlan(motion.t, qpos, qvel, found, arm)


def _in_order_of_arm(arm: Arm, joints: Sequence[str], goal: Goal) -> Goal:
    """Goals in the order of the given joints, in that of the arm's coordinates; poses and regions as they are."""
    names = arm.joint_names
    given = [k for joint in joints for k, name in enumerate(names) if name in (joint, *(f"{joint}_{a}" for a in "xyz"))]
    ordered = [
        one[np.argsort(given)] if isinstance(one, np.ndarray) else one
        for one in single_goals(arm, goal, f"the goal of {', '.join(names[k] for k in given)}")
    ]
    return ordered if len(ordered) > 1 else ordered[0]


def _check_contacts(model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats, moving: NDArray[np.int_]) -> None:
    """Look for contacts of the arm with other trees of bodies in the given model itself, apart from those at the start.

    Raises:
        PlanError: there are any, so that the arm's model is not like the given one.
    """
    arm = {body for body in range(model.nbody) if moved_by(model, body)[moving].any()}
    finder = ContactFinder(model, mocap=data)

    def touching(positions: Floats) -> set[tuple[int, int]]:
        pairs = (tuple(map(int, model.geom_bodyid[geoms])) for geoms in finder.geoms(positions)[1])
        return {(a, b) for a, b in pairs if (a in arm) != (b in arm) and model.body_rootid[a] != model.body_rootid[b]}

    before = touching(data.qpos)
    for positions in qpos:
        if found := touching(positions) - before:
            one, other = (model.body(body).name or f"body {body}" for body in min(found))
            raise PlanError(
                f"in the given model {one!r} would touch {other!r}, which the arm's own model does not show"
            )
