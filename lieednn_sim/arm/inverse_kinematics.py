"""Inverse kinematics: joint positions from an end effector pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.regions import TaskSpaceRegion
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.lie import hat, poses
from lieednn_sim.validation import Seed, as_floats, as_generator
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

# Error at which the pose counts as reached [m, rad], and the numbers of starts.
_TOLERANCE = 1e-6
_ATTEMPTS, _MOST_ATTEMPTS = 8, 32
# Least error of the first attempts [m, rad] after which no more are made.
_FAR = 0.1
# Candidates for a target, and the fraction of a joint's range by which they differ.
_CANDIDATES, _SAME = 4, 1e-3
# No arm reaches further [m], and squares stay far from overflow.
_FARTHEST = 1e6
# Distance from a limit, as a fraction of the joint's range, at which the joint counts as being there.
_AT_LIMIT = 1e-4
# Weight of the pull towards the start, which picks one of the many solutions of a redundant arm.
_CONFIGURATION_WEIGHT = 1e-3
# How far inside a region its solutions are sought, so that they are in it [m, rad].
_INSET = 2.0 * _TOLERANCE


def solve_ik(
    arm: Arm,
    position: ArrayLike,
    rotation: Rotation | None = None,
    *,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Floats:
    """Find a joint position, within the limits and free of contact, that puts the end effector at a pose.

    Args:
        arm: the arm.
        position: ``(3,)`` of the end effector, world [m].
        rotation: orientation of the end effector; free when omitted.
        start: joint coordinates ``(n,)`` to stay near, or a keyframe's name.
        seed: seed of the random starts that are tried when the first one fails.
        progress: called before each attempt with the number of those done and the largest one; an exception of it ends
            the search.

    Raises:
        InputError: a value is malformed.
        NoSolutionError: no such joint position was found; the message says how close the search came.
    """
    return next(_solutions(arm, _Point(position, rotation), None, start, seed, progress))


def ik_candidates(
    arm: Arm,
    pose: RigidTransform | TaskSpaceRegion,
    *,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    keep: TaskSpaceRegion | None = None,
) -> list[Floats]:
    """Several joint positions ``(n,)`` as of `solve_ik`, the one that is reached soonest first.

    The measure is the time that the slowest joint needs at its velocity limit, or at its range in a second where it has
    none. The search ends with four different positions, or after 32 attempts; after 8 if
    none of them came near.

    Args:
        arm: the arm.
        pose: of the end effector in the world, or a region of poses.
        start: joint coordinates ``(n,)`` from which they are to be reached, or a keyframe's name.
        seed: seed of the random starts of the search.
        keep: a region in which the end effector is, too.

    Raises:
        InputError: a value is malformed.
        NoSolutionError: none was found; the message says how close the search came.
    """
    rest = arm.check_position(start, "start")
    pace = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges)
    found: list[Floats] = []
    goal = pose if isinstance(pose, TaskSpaceRegion) else _Point(pose.translation, pose.rotation)
    for q in _solutions(arm, goal, keep, rest, seed, several=True):
        if all(np.abs((q - other) / arm.ranges).max() > _SAME for other in found):
            found.append(q)
        if len(found) == _CANDIDATES:
            break
    return sorted(found, key=lambda q: float(np.abs((q - rest) / pace).max()))


class _Point:
    """A position of the end effector, with an orientation or without: errors and slopes as of a region."""

    def __init__(self, position: ArrayLike, rotation: Rotation | None) -> None:
        self._place = as_floats("position", position, (3,))
        if np.abs(self._place).max() > _FARTHEST:
            raise InputError(
                f"position must be within {_FARTHEST:g} m of the origin, got {np.abs(self._place).max():g} m"
            )
        self._rotation = rotation

    def error(self, place: Floats, turn: Floats) -> Floats:
        """Zero at the goal, for a position ``(3,)`` and a matrix ``(3, 3)`` of the end effector."""
        if self._rotation is None:
            return place - self._place
        return np.concatenate([place - self._place, (self._rotation.as_matrix().T @ turn - np.eye(3)).ravel()])

    def slopes(self, turn: Floats, linear: Floats, angular: Floats) -> Floats:
        """Derivatives ``(E, n)`` of the error, from those ``(3, n)`` of the position and the rotation."""
        if self._rotation is None:
            return linear
        turned = self._rotation.as_matrix().T @ hat(angular.T) @ turn
        return np.vstack([linear, turned.reshape(-1, 9).T])

    def __str__(self) -> str:
        place = ", ".join(f"{x:g}" for x in self._place)
        return f"({place}) m" + ("" if self._rotation is None else " with this orientation")

    def miss(self, pose: RigidTransform) -> str:
        """Distance of a pose from the position [m], and the angle from the rotation."""
        distance = f"{np.linalg.norm(pose.translation - self._place):.3g} m"
        if self._rotation is None:
            return distance
        return f"{distance} and {np.rad2deg((self._rotation.inv() * pose.rotation).magnitude()):.3g} degrees"


def _solutions(
    arm: Arm,
    goal: _Point | TaskSpaceRegion,
    keep: TaskSpaceRegion | None,
    start: ArrayLike | str,
    seed: Seed,
    progress: Callable[[int, int], None] | None = None,
    *,
    several: bool = False,
) -> Iterator[Floats]:
    """Solutions near the start or, where several are wanted, near one random position each after the first one.

    Raises as `solve_ik` if there is none.
    """
    attempts = _MOST_ATTEMPTS if several else _ATTEMPTS
    rest = arm.check_position(start, "start")
    low, high = arm.position_limits.T
    spread = arm.ranges
    rng = as_generator("seed", seed)
    regions = [one.within(_INSET) for one in (goal, keep) if isinstance(one, TaskSpaceRegion)]

    data = mujoco.MjData(arm.model)
    site = int(arm.site_ids[-1])

    def error(q: Floats) -> Floats:
        data.qpos[:] = arm.qpos(q)
        mujoco.mj_kinematics(arm.model, data)
        place, turn = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        parts = [goal.error(place, turn)] if isinstance(goal, _Point) else []
        return np.concatenate([*parts, *(region.excess(poses(turn, place)) for region in regions)])

    def jacobian(q: Floats) -> Floats:
        data.qpos[:] = arm.qpos(q)
        mujoco.mj_kinematics(arm.model, data)
        mujoco.mj_comPos(arm.model, data)
        linear, angular = np.zeros((3, arm.model.nv)), np.zeros((3, arm.model.nv))
        mujoco.mj_jacSite(arm.model, data, linear, angular, site)
        to_rates = arm.qvel(q, np.eye(arm.n_joints)).T
        linear, angular = linear @ to_rates, angular @ to_rates
        place, turn = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        parts = [goal.slopes(turn, linear, angular)] if isinstance(goal, _Point) else []
        twist = np.vstack([angular, linear])
        return np.vstack([*parts, *(region.excess_slopes(poses(turn, place)) @ twist for region in regions)])

    best, closest, refused, solved = np.inf, rest, "", False
    for attempt in range(attempts):
        if progress is not None:
            progress(attempt, attempts)
        q = rest if attempt == 0 else rng.uniform(low, high)
        near = q if several else rest
        # First with the configuration term, for a solution near the start; then without it, for an exact one.
        for weight in (_CONFIGURATION_WEIGHT, 0.0):
            pull = np.diag(weight / spread)
            q = scipy.optimize.least_squares(
                lambda x, pull=pull, near=near: np.concatenate([error(x), pull @ (x - near)]),
                np.clip(q, low + 1e-9 * spread, high - 1e-9 * spread),
                jac=lambda x, pull=pull: np.vstack([jacobian(x), pull]),
                bounds=(low, high),
                x_scale=spread,
                xtol=1e-12,
                ftol=1e-12,
                gtol=1e-12,
                max_nfev=200,
            ).x
        distance = float(np.abs(error(q)).max())
        if distance < _TOLERANCE:
            # The box that bounds a ball joint's rotation vector has corners beyond its largest angle.
            excess = arm.limit_excess(q)
            contacts = arm.near_contacts(q)
            if excess.max() <= 0.0 and not contacts:
                solved = True
                yield q
            elif excess.max() > 0.0:
                refused = f"; at the solutions found {arm.describe_excess(q, int(excess.argmax()))}"
            else:
                refused = f"; at the solutions found {contacts[0][0]!r} touches {contacts[0][1]!r}"
        if distance < best:
            best, closest = distance, q
        if attempt + 1 >= _ATTEMPTS and best > _FAR:
            break
    if solved:
        return
    where = str(goal) if isinstance(goal, _Point) else "the region"
    away = refused or f": the closest configuration found is {_miss(arm.link_poses(closest)[-1], goal)} away"
    raise NoSolutionError(
        f"the end effector cannot reach {where}{'' if keep is None else ' within the region to keep'}{away}"
        + ("" if refused else _at_limits(arm, closest))
    )


def _at_limits(arm: Arm, q: Floats) -> str:
    """Which joints are at their limits at q ``(n,)``, in words; empty if none are."""
    near = arm.limit_excess(q) > -_AT_LIMIT * arm.ranges
    names = list(dict.fromkeys(name for name, at in zip(arm.joint_names, near, strict=True) if at))
    return f", with {', '.join(map(repr, names))} at the limit" if names else ""


def _miss(pose: RigidTransform, goal: _Point | TaskSpaceRegion) -> str:
    """Distance of the end effector's pose from a goal [m], and the angle where the goal has orientations."""
    if isinstance(goal, _Point):
        return goal.miss(pose)
    distance, angle = goal.distance(pose)
    return f"{distance:.3g} m and {np.rad2deg(angle):.3g} degrees"
