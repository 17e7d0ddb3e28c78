"""Inverse kinematics: joint positions from an end effector pose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import daqp
import numpy as np
import scipy
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import mujoco, scratch_data
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.regions import TaskSpaceRegion
from lieednn_sim.budget import report
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.validation import Seed, as_floats, as_generator
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

_TOLERANCE = 1e-6  # error at which the pose counts as reached [m, rad]
_ATTEMPTS, _MOST, _STEPS = 8, 32, 60  # attempts if none comes near a solution, and at most; steps of each


def solve_ik(
    arm: Arm, position: ArrayLike, rotation: Rotation | None = None, *, start: ArrayLike | str = "home", seed: Seed = 0
) -> Floats:
    """Find a joint position, within the limits and free of contact, that puts the end effector at a pose.

    Before each attempt `reporting` gets the number of attempts done and the largest number.

    Args:
        arm: the arm.
        position: ``(3,)`` of the end effector, world [m].
        rotation: orientation of the end effector; free when omitted.
        start: joint coordinates ``(n,)`` to stay near, or a keyframe's name.
        seed: seed of the random starts that are tried when the first one fails.

    Raises:
        NoSolutionError: no such joint position was found; the message says how close the search came.
    """
    search = _Search(arm, _Point(position, rotation), None, arm.check_start(start))
    return next(search.solutions(seed, several=False))


def ik_candidates(
    arm: Arm,
    pose: RigidTransform | TaskSpaceRegion,
    *,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    path_constraint: TaskSpaceRegion | None = None,
) -> list[Floats]:
    """Several joint positions ``(n,)`` as from `solve_ik`, the one that is reached soonest first.

    The measure is the time that the slowest joint needs at its velocity limit or, without one, at its range in a
    second. The search ends with four different positions, or after 32 attempts; after 8 if none of them came near.

    Args:
        arm: the arm.
        pose: of the end effector in the world, or a region of poses.
        start: joint coordinates ``(n,)`` from which they are to be reached, or a keyframe's name.
        seed: seed of the random starts of the search.
        path_constraint: a region in which the end effector is, too.

    Raises:
        NoSolutionError: none was found; the message says how close the search came.
    """
    rest = arm.check_start(start)
    pace = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges)
    goal = pose if isinstance(pose, TaskSpaceRegion) else _Point(pose.translation, pose.rotation)
    result: list[Floats] = []
    for q in _Search(arm, goal, path_constraint, rest).solutions(seed, several=True):
        # Different solutions differ by more than a thousandth of a joint's range.
        if all(np.abs((q - other) / arm.ranges).max() > 1e-3 for other in result):
            result.append(q)
        if len(result) == 4:
            break
    return sorted(result, key=lambda q: float(np.abs((q - rest) / pace).max()))


class _Point:
    """A position of the end effector, with an orientation or without."""

    def __init__(self, position: ArrayLike, rotation: Rotation | None) -> None:
        self.place = as_floats("position", position, (3,))
        # No arm reaches further, and squares stay far from overflow.
        if np.abs(self.place).max() > 1e6:
            raise InputError(f"position must be within 1e+06 m of the origin, got {np.abs(self.place).max():g} m")
        self._rotation = rotation
        self._quaternion = None if rotation is None else as_floats("rotation", rotation.as_quat(), (4,))[[3, 0, 1, 2]]

    def error(self, place: Floats, turn: Floats) -> Floats:
        """Offset of a position ``(3,)`` [m], then rotation vector from the orientation, if any, to ``(3, 3)`` [rad]."""
        if self._quaternion is None:
            return place - self.place
        quaternion, turned = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        mujoco.mju_subQuat(turned, self._quaternion, quaternion)
        return np.concatenate([place - self.place, -turn @ turned])

    def __str__(self) -> str:
        place = ", ".join(f"{x:g}" for x in self.place)
        return f"({place}) m" + ("" if self._rotation is None else " with this orientation")

    def distance(self, pose: RigidTransform) -> tuple[Floats, Floats | None]:
        """Distance of a pose from the position [m], and the angle from the rotation, if there is one [rad]."""
        angle = None if self._rotation is None else (self._rotation.inv() * pose.rotation).magnitude()
        return np.asarray(np.linalg.norm(pose.translation - self.place)), angle


class _Search:
    """Searches joint positions, from a start ``(n,)``, with the end effector at a goal and in a region to keep."""

    def __init__(
        self, arm: Arm, goal: _Point | TaskSpaceRegion, path_constraint: TaskSpaceRegion | None, start: Floats
    ) -> None:
        self._arm, self._goal, self._path_constraint, self._start = arm, goal, path_constraint, start
        # Solutions are sought a little inside of a region, so that they are in it in spite of the tolerance.
        self._regions = [r.within(2.0 * _TOLERANCE) for r in (goal, path_constraint) if isinstance(r, TaskSpaceRegion)]
        self._data, self._tip, self._basis = scratch_data(arm.model), arm.frames[-1:], tangent_basis(arm.space)
        self._zero = np.zeros(arm.model.nq)
        self._zero[arm.space.ball_addresses[:, 0]] = 1.0

    def solutions(self, seed: Seed, *, several: bool) -> Iterator[Floats]:
        """Solutions near the start or, where several are wanted, near a random position each after the first one.

        Raises as `solve_ik` if there is none.
        """
        rng, (low, high) = as_generator("seed", seed), self._arm.position_limits.T
        best, closest, refused, solved = np.inf, self._start, "", False
        for attempt in range(_MOST):
            if not several:
                report(attempt, _MOST)
            q = self._start if attempt == 0 else rng.uniform(low, high)
            # If what is near the start is refused, the next ones are near random positions, too.
            q, distance = self._descend(q, q if several or refused else self._start)
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

    def _evaluate(self) -> tuple[Floats, Floats]:
        """The error ``(E,)`` at the positions in the data, zero at solutions, and its slopes ``(E, n)``.

        Those of ball joints are along the axes of their bodies; that of a rotation vector is the angular Jacobian, up
        to terms that vanish at the goal, and do not change the gradient of its square.
        """
        model, data = self._arm.model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        (place,), (turn,) = self._tip.poses(data.xpos, data.xmat)
        jacobian = self._tip.jacobian(model, data, 0)
        slopes, parts = jacobian.reshape(6, -1) @ self._basis, list[tuple[Floats, Floats]]()
        if isinstance(self._goal, _Point):
            error = self._goal.error(place, turn)
            parts.append((error, slopes[: len(error)]))
        if self._regions:
            pose, twist = transforms(turn, place), np.roll(slopes, 3, axis=0)
            parts += [(region.excess(pose), region.excess_slopes(pose) @ twist) for region in self._regions]
        errors, derivatives = zip(*parts, strict=True)
        return np.concatenate(errors), np.concatenate(derivatives)

    def _descend(self, q: Floats, near: Floats) -> tuple[Floats, float]:
        """The joint coordinates of least error next to ``q``, drawn near others on the way; and their largest error.

        Levenberg-Marquardt steps in units of the joints' ranges, within the limits, each the optimum of a quadratic
        program. The damping is the squared error (Sugihara, IEEE T-RO 27(5), 2011): convergence is quadratic.
        """
        arm, data, balls, spread = self._arm, self._data, self._arm.space.balls, self._arm.ranges
        # The coordinates, then the angles of ball joints, which have the limits of their first coordinates.
        which = np.append(np.arange(len(q)), balls[:, 0])
        (low, high), widths = arm.position_limits.T[:, which], spread[which]
        rows, rates, own = np.zeros((len(balls), len(q))), np.empty(arm.model.nv), arm.space.own_rate_addresses
        each, n = np.arange(len(balls))[:, None], len(q)
        q, distance = arm.within_angles(q), np.inf
        angles = arm.space.angles(q)
        # Only the chain's joints are set: others do not move the end effector.
        data.qpos[:] = arm.space.to_qpos(q)
        for _ in range(_STEPS):
            error, slopes = self._evaluate()
            distance, square = float(np.abs(error).max()), float(error @ error)
            if distance < _TOLERANCE:
                break
            slopes = slopes * spread
            # The damping is at most that of an error of 3 m or rad, so that steps to distant goals are long.
            hessian, gradient, damping = slopes.T @ slopes, slopes.T @ error, min(square, 9.0) + 1e-9
            hessian.flat[:: n + 1] += damping
            # To find a solution of a redundant arm near ``near``, part of the damping pulls there until a solution is
            # close; without this pull, the last steps lead to the nearest solution.
            if square > 1e-4:
                gradient += 0.3 * damping * (q - near) / spread
            bounded = q
            if len(balls):
                # An angle changes by the step along its axis.
                rows[each, balls] = q[balls] / np.maximum(angles, 1e-9)[:, None]
                bounded = np.concatenate([q, angles])
            step, *_ = daqp.solve(hessian, gradient, rows, (high - bounded) / widths, (low - bounded) / widths)
            left = error + slopes @ step
            # There is no solution ahead if a step leaves nearly all of the error.
            if square - left @ left < 1e-3 * square:
                break
            mujoco.mj_integratePos(arm.model, data.qpos, self._basis @ (spread * step), 1.0)
            # The coordinates, at a tenth of the cost of `from_qpos` with ball joints.
            mujoco.mj_differentiatePos(arm.model, rates, 1.0, self._zero, data.qpos)
            moved = rates[own]
            q = np.minimum(np.maximum(moved, low[:n]), high[:n])
            if len(balls) and ((angles := arm.space.angles(q)) > high[n:]).any():
                q = arm.within_angles(q)
                angles = arm.space.angles(q)
            if (q != moved).any():
                data.qpos[:] = arm.space.to_qpos(q)
        return q, distance

    def _refusal(self, q: Floats) -> str:
        """Why the arm cannot be at a solution ``(n,)``; empty if it can."""
        # Only what follows the joints can exceed its range; they themselves are within their limits.
        excess = self._arm.limit_excess(q)
        if excess.max() > 0.0:
            return f"; at the solutions found {self._arm.describe_excess(q, int(excess.argmax()))}"
        near = self._arm.near_contacts(q)
        contacts = near and self._arm.contacts(q)
        how = " touches " if contacts else f" is nearer than the clearance of {1e3 * self._arm.clearance:g} mm to "
        return f"; at the solutions found {how.join(map(repr, (contacts or near)[0]))}" if near else ""

    def _nearest(self, closest: Floats) -> Floats:
        """The coordinates ``(n,)`` of least error, without ball joints; `_descend` gives up where no solution is."""

        def square(q: Floats) -> tuple[float, Floats]:
            self._data.qpos[:] = self._arm.space.to_qpos(q)
            error, slopes = self._evaluate()
            return float(error @ error), 2.0 * error @ slopes

        how = {"jac": True, "bounds": self._arm.position_limits, "tol": 1e-10}
        ends = [scipy.optimize.minimize(square, q, **how) for q in (closest, self._start)]
        return np.asarray(min(ends, key=lambda end: float(end.fun)).x)

    def _failure(self, closest: Floats, refused: str) -> str:
        """The message that nothing was found, with the closest configuration ``(n,)``, or why solutions are refused."""
        arm, goal = self._arm, self._goal
        if isinstance(goal, _Point) and not refused and not len(arm.space.balls):
            # If the position is out of reach however the end effector is turned, that is said.
            nearest = _Search(arm, point := _Point(goal.place, None), None, self._start)._nearest(closest)
            if point.distance(arm.link_poses(nearest)[-1])[0] > 1e-3:
                closest, goal = nearest, point
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
