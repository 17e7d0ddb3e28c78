"""Inverse kinematics: joint positions from an end effector pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import daqp
import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.regions import TaskSpaceRegion
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.lie import transforms
from lieednn_sim.validation import Seed, as_floats, as_generator
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

# Error at which the pose counts as reached [m, rad].
_TOLERANCE = 1e-6
# Attempts, unless one comes near a solution and several are wanted.
_ATTEMPTS = 8
# Steps of an attempt. An error beyond this length [m, rad] counts as one of it, as if the goal were drawn nearer.
_STEPS, _FAR = 60, 3.0


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
    search = _Search(arm, _Point(position, rotation), None, arm.check_start(start))
    return next(search.solutions(seed, _ATTEMPTS, several=False, progress=progress))


def ik_candidates(
    arm: Arm,
    pose: RigidTransform | TaskSpaceRegion,
    *,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    path_constraint: TaskSpaceRegion | None = None,
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
        path_constraint: a region in which the end effector is, too.

    Raises:
        InputError: a value is malformed.
        NoSolutionError: none was found; the message says how close the search came.
    """
    rest = arm.check_start(start)
    pace = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges)
    goal = pose if isinstance(pose, TaskSpaceRegion) else _Point(pose.translation, pose.rotation)
    result: list[Floats] = []
    for q in _Search(arm, goal, path_constraint, rest).solutions(seed, 32, several=True):
        # Others differ by more than a thousandth of a joint's range.
        if all(np.abs((q - other) / arm.ranges).max() > 1e-3 for other in result):
            result.append(q)
        if len(result) == 4:
            break
    return sorted(result, key=lambda q: float(np.abs((q - rest) / pace).max()))


class _Point:
    """A position of the end effector, with an orientation or without: its error.

    Attributes:
        size: number of the error's entries; the derivatives of these are the end effector's Jacobian, [v; omega]. That
            of a rotation vector differs from it by terms that vanish at the goal, and has the same product with it.
    """

    def __init__(self, position: ArrayLike, rotation: Rotation | None) -> None:
        self._place = as_floats("position", position, (3,))
        # No arm reaches further, and squares stay far from overflow.
        if np.abs(self._place).max() > 1e6:
            raise InputError(f"position must be within 1e+06 m of the origin, got {np.abs(self._place).max():g} m")
        self._rotation, self.size = rotation, 3 if rotation is None else 6
        self._quaternion = None if rotation is None else rotation.as_quat(scalar_first=True)

    def error(self, place: Floats, turn: Floats) -> Floats:
        """Zero at the goal: the offset from it [m] and, with an orientation, the rotation vector from it, world [rad].

        Args:
            place: position ``(3,)`` of the end effector.
            turn: its rotation ``(3, 3)``.
        """
        away = place - self._place
        if self._quaternion is None:
            return away
        quaternion, turned = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        mujoco.mju_subQuat(turned, self._quaternion, quaternion)
        return np.concatenate([away, -turn @ turned])

    def __str__(self) -> str:
        place = ", ".join(f"{x:g}" for x in self._place)
        return f"({place}) m" + ("" if self._rotation is None else " with this orientation")

    def distance(self, pose: RigidTransform) -> tuple[Floats, Floats | None]:
        """Distance of a pose from the position [m], and the angle from the rotation, if there is one [rad]."""
        angle = None if self._rotation is None else (self._rotation.inv() * pose.rotation).magnitude()
        return np.asarray(np.linalg.norm(pose.translation - self._place)), angle


class _Search:
    """Searches joint positions with the end effector at a goal and, if there is one, in a region to keep.

    Args:
        arm: the arm.
        goal: of the end effector.
        path_constraint: a region in which it is, too.
        start: ``(n,)`` joint coordinates from which the first search begins.
    """

    def __init__(
        self, arm: Arm, goal: _Point | TaskSpaceRegion, path_constraint: TaskSpaceRegion | None, start: Floats
    ) -> None:
        self._arm, self._goal, self._path_constraint, self._start = arm, goal, path_constraint, start
        # Solutions are sought a little inside of a region, so that they are in it.
        self._regions = [r.within(2.0 * _TOLERANCE) for r in (goal, path_constraint) if isinstance(r, TaskSpaceRegion)]
        self._data, self._tip, self._basis = arm.moving_data, arm.frames[-1:], tangent_basis(arm.space)

    def solutions(
        self, seed: Seed, attempts: int, *, several: bool, progress: Callable[[int, int], None] | None = None
    ) -> Iterator[Floats]:
        """Solutions near the start or, where several are wanted, near one random position each after the first one.

        Raises as `solve_ik` if there is none.
        """
        rng, (low, high) = as_generator("seed", seed), self._arm.position_limits.T
        best, closest, refused, solved = np.inf, self._start, "", False
        for attempt in range(attempts):
            if progress is not None:
                progress(attempt, attempts)
            q = self._start if attempt == 0 else rng.uniform(low, high)
            q, distance = self._descend(q, q if several else self._start)
            if distance < _TOLERANCE:
                refusal = self._refusal(q)
                if not refusal:
                    solved = True
                    yield q
                refused = refusal or refused
            if distance < best:
                best, closest = distance, q
            # If the first attempts come nowhere near, no more are made.
            if attempt + 1 >= _ATTEMPTS and best > 0.1:
                break
        if not solved:
            raise NoSolutionError(self._failure(closest, refused))

    def _error(self) -> Floats:
        """Zero at solutions, ``(E,)``, at the positions in the data, to which the end effector is moved."""
        mujoco.mj_kinematics(self._arm.model, self._data)
        place, turn = self._pose
        parts = [self._goal.error(place, turn)] if isinstance(self._goal, _Point) else []
        return np.concatenate([*parts, *(region.excess(transforms(turn, place)) for region in self._regions)])

    def _slopes(self) -> Floats:
        """Derivatives ``(E, n)`` of the error where the end effector is; ball joints turn about the body's axes."""
        arm, data, jacobian = self._arm, self._data, np.empty((2, 3, self._arm.model.nv))
        mujoco.mj_comPos(arm.model, data)
        self._tip.jacobian(arm.model, data, 0, jacobian)
        slopes = jacobian.reshape(6, -1) @ self._basis
        parts = [slopes[: self._goal.size]] if isinstance(self._goal, _Point) else []
        if self._regions:
            (place, turn), twist = self._pose, np.roll(slopes, 3, axis=0)
            parts += [region.excess_slopes(transforms(turn, place)) @ twist for region in self._regions]
        return np.vstack(parts)

    @property
    def _pose(self) -> tuple[Floats, Floats]:
        """Position ``(3,)`` and rotation ``(3, 3)`` of the end effector."""
        (place,), (turn,) = self._tip.poses(self._data.xpos, self._data.xmat)
        return place, turn

    def _descend(self, q: Floats, near: Floats) -> tuple[Floats, float]:
        """The joint coordinates of least error next to ``q``, drawn near others on the way; and their largest error.

        Levenberg-Marquardt steps in units of the joints' ranges, within the limits, each the optimum of a quadratic
        program. The damping is the squared error (Sugihara, IEEE Trans. Robotics 27(5), 2011), so that convergence is
        quadratic at solutions.
        """
        arm, (low, high), spread = self._arm, self._arm.position_limits.T, self._arm.ranges
        none, kinds, diagonal = np.zeros((0, len(q))), np.zeros(len(q), dtype=np.int32), np.diag_indices(len(q))
        q, distance, data = np.clip(q, low, high), np.inf, self._data
        # Of the chain alone: other joints do not move the end effector.
        data.qpos[:] = arm.space.to_qpos(q)
        for _ in range(_STEPS):
            error = self._error()
            distance, square = float(np.abs(error).max()), float(error @ error)
            if distance < _TOLERANCE:
                break
            if square > _FAR**2:
                error, square = error * (_FAR / np.sqrt(square)), _FAR**2
            slopes = self._slopes() * spread
            hessian, gradient, damping = slopes.T @ slopes, slopes.T @ error, square + 1e-9
            hessian[diagonal] += damping
            # Of the many solutions of a redundant arm, one that is near: until it is close, part of the damping is from
            # there. Without that, the last steps lead to the next solution.
            if square > 1e-4:
                gradient += 0.3 * damping * (q - near) / spread
            step, *_ = daqp.solve(hessian, gradient, none, (high - q) / spread, (low - q) / spread, kinds)
            left = error + slopes @ step
            # No solution lies ahead where a step leaves nearly all of the error.
            if square - left @ left < 1e-3 * square:
                break
            mujoco.mj_integratePos(arm.model, data.qpos, self._basis @ (spread * step), 1.0)
            moved = arm.space.from_qpos(data.qpos)
            q = np.clip(moved, low, high)
            if (q != moved).any():
                data.qpos[:] = arm.space.to_qpos(q)
        return q, distance

    def _refusal(self, q: Floats) -> str:
        """Why the arm cannot be at a solution ``(n,)``; empty if it can."""
        # The box that bounds a ball joint's rotation vector has corners beyond its largest angle.
        excess = self._arm.limit_excess(q)
        if excess.max() > 0.0:
            return f"; at the solutions found {self._arm.describe_excess(q, int(excess.argmax()))}"
        contacts = self._arm.near_contacts(q)
        return f"; at the solutions found {contacts[0][0]!r} touches {contacts[0][1]!r}" if contacts else ""

    def _failure(self, closest: Floats, refused: str) -> str:
        """The message that nothing was found, with the closest configuration ``(n,)``, or why solutions are refused."""
        arm, goal = self._arm, self._goal
        where = str(goal) if isinstance(goal, _Point) else "the region"
        within = "" if self._path_constraint is None else " within the region of the path constraint"
        reach = f"the end effector cannot reach {where}{within}"
        if refused:
            return reach + refused
        near = arm.limit_excess(closest)[: arm.n_joints] > -1e-4 * arm.ranges
        names = dict.fromkeys(name for name, at in zip(arm.joint_names, near, strict=True) if at)
        at_limits = f", with {', '.join(map(repr, names))} at the limit" if names else ""
        distance, angle = goal.distance(arm.link_poses(closest)[-1])
        miss = f"{distance:.3g} m" + ("" if angle is None else f" and {np.rad2deg(angle):.3g} degrees")
        return f"{reach}: the closest configuration found is {miss} away{at_limits}"
