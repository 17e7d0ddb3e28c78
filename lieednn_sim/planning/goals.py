"""Where a motion may end: joint targets, keyframes, poses, regions, and sets of these, as joint positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from numbers import Number
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm import Arm, TaskSpaceRegion, ik_candidates
from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.planning.motion import least_duration
from lieednn_sim.planning.path_constraints import reached
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

#: A goal or a set of goals, as `plan` takes them.
Goal: TypeAlias = "ArrayLike | str | RigidTransform | TaskSpaceRegion | Sequence[Any]"
Single: TypeAlias = "Floats | str | RigidTransform | TaskSpaceRegion"


def resolved(arm: Arm, target: Goal) -> Any:
    """A goal or a set of goals with joint positions in place of the names of keyframes."""
    if isinstance(target, list | tuple):
        return [resolved(arm, item) for item in target]
    return arm.keyframe(target) if isinstance(target, str) else target


def _single(arm: Arm, target: Goal, what: str, *, outermost: bool = True) -> Iterator[Single]:
    """The goals of a set, or the only one: joint positions ``(n,)``, keyframes, poses and regions."""
    if isinstance(target, str):
        arm.keyframe(target)
        yield target
    elif isinstance(target, TaskSpaceRegion):
        yield target
    elif isinstance(target, RigidTransform):
        shape = target.as_matrix().shape[:-2]
        if len(shape) > 1:
            raise InputError(f"{what} must be a pose or poses of shape (m,), got {shape}")
        yield from target if shape else [target]
    elif outermost and isinstance(target, list | tuple) and not all(isinstance(item, Number) for item in target):
        for number, entry in enumerate(target):
            yield from _single(arm, entry, f"{what} {number}", outermost=False)
    elif not (isinstance(target, list | tuple) and len(target) == 0):
        # The message lists the joints, since a view's user may have named them in another order.
        named = what if arm.state is None else f"{what} of {', '.join(arm.joint_names)}"
        several = outermost and isinstance(target, np.ndarray) and target.ndim == 2
        try:
            positions = as_floats(named, target, ("m", arm.n_joints) if several else (arm.n_joints,))
        except InputError as error:
            raise InputError(f"{error}; a pose is a scipy RigidTransform, a position a TaskSpaceRegion.box") from None
        yield from positions if several else [positions]


def candidates(
    arm: Arm, target: Goal, start: Floats, seed: int = 0, path_constraint: TaskSpaceRegion | None = None
) -> Iterator[Floats]:
    """Joint positions ``(n,)`` with one of the goals, the one that is reached soonest (`least_duration`) first.

    For poses and regions they are those of `ik_candidates`. Goals of a set that the arm cannot reach are left out. If a
    region is to be kept, the joint positions that the arm reaches in small steps within it
    (`path_constraints.reached`) come first.

    Args:
        arm: the arm, in its scene.
        target: a goal or a set of goals.
        start: ``(n,)`` where the motion begins.
        seed: seed of the inverse kinematics.
        path_constraint: a region in which the end effector must be, too.

    Raises:
        InputError: a goal is malformed; or the only one is a joint position that cannot be used.
        NoSolutionError: the only pose or region cannot be reached, or no goal of a set can.
    """
    goals = list(_single(arm, target, "target"))
    if not goals:
        raise InputError(f"target must hold at least one goal, got an empty {type(target).__name__}")
    near = [] if path_constraint is None else list(_reached(arm, goals, start, path_constraint))
    yield from sorted(near, key=lambda q: least_duration(arm, start, q))
    result, refusals = list[Floats](), list[str]()
    for goal in goals:
        check_time()
        try:
            if isinstance(goal, np.ndarray | str):
                result.append(arm.check_reachable(arm.nearest_turn(arm.configuration(goal, "target"), start), "target"))
            else:
                result += ik_candidates(arm, goal, start=start, seed=seed, path_constraint=path_constraint)
        except (InputError, NoSolutionError) as error:
            if not near and len(goals) == 1:
                raise
            refusals.append(str(error))
    yield from sorted(result, key=lambda q: least_duration(arm, start, q))
    if not near and not result:
        raise NoSolutionError(f"none of {len(goals)} goals can be reached; the first one: {refusals[0]}")


def _reached(arm: Arm, goals: Sequence[Single], start: Floats, path_constraint: TaskSpaceRegion) -> Iterator[Floats]:
    """Contact-free joint positions ``(n,)`` that are reached within a region, for goals that are poses or regions."""
    for goal in goals:
        check_time()
        if isinstance(goal, np.ndarray | str):
            continue
        region = goal if isinstance(goal, TaskSpaceRegion) else TaskSpaceRegion(goal, np.zeros(6), np.zeros(6))
        q = reached(arm, start, region, path_constraint)
        if q is not None and arm.limit_excess(q).max() <= 0.0 and not arm.near_contacts(q):
            yield q
