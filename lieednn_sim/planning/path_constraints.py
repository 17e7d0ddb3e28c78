"""Regions in which the end effector stays on its way: projecting joint positions onto them, and checking motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.errors import PlanError
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats, distances

# How far a motion may be outside its region [m, rad], as `TaskSpaceRegion.distance` measures it.
KEPT_DISTANCE, KEPT_ANGLE = 5e-4, np.deg2rad(0.1)


def _end_poses(arm: Arm, q: Floats) -> RigidTransform:
    """Poses ``(K,)`` of the end effector in the world at q ``(K, n)``."""
    matrix = arm.link_poses(q).as_matrix()[..., -1, :, :]
    return transforms(matrix[..., :3, :3], matrix[..., :3, 3])


def excess_and_slopes(arm: Arm, q: Floats, *regions: TaskSpaceRegion) -> tuple[Floats, Floats]:
    """Excess ``(K, 6 R)`` of the end effector over R regions at joints ``(K, n)``, and its slopes ``(K, 6 R, n)``."""
    pose = _end_poses(arm, q)
    excess = np.concatenate([region.excess(pose) for region in regions], axis=1)
    return excess, np.concatenate([region.excess_slopes(pose) for region in regions], axis=1) @ arm.jacobian(q)


def projected(arm: Arm, q: Floats, *regions: TaskSpaceRegion) -> Floats:
    """Project joint positions ``(K, n)`` onto all regions, within the limits; some may stay outside the regions.

    Newton's method takes the least step, in units of the joints' ranges, so that a smooth path stays smooth. Joints
    that it would lead out of their limits stay where they are.
    """
    low, high = arm.position_limits.T
    q = q.copy()
    left = np.arange(len(q))
    for _ in range(30):
        excess, slopes = excess_and_slopes(arm, q[left], *regions)
        off = np.abs(excess).max(axis=1) > 1e-11
        left, excess, slopes = left[off], excess[off], slopes[off] * arm.ranges
        if not len(left):
            break
        step = _least_step(excess, slopes)
        new = q[left] + arm.ranges * step
        blocked = (new < low) | (new > high)
        if blocked.any():
            step = _least_step(excess, np.where(blocked[:, None], 0.0, slopes))
        # No joint moves by more than a fifth of its range in a step.
        step *= np.minimum(1.0, 0.2 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        q[left] = arm.within_angles(np.clip(q[left] + arm.ranges * step, low, high))
    return q


def _least_step(excess: Floats, slopes: Floats) -> Floats:
    """The least steps ``(K, n)`` that undo an excess ``(K, C)`` with slopes ``(K, C, n)``."""
    # Damping, for poses that do not determine the joints; it is small against slopes of about 1 m or rad per range.
    square = slopes @ np.swapaxes(slopes, -1, -2) + 1e-9 * np.eye(excess.shape[1])
    return -np.einsum("kcn,kc->kn", slopes, np.linalg.solve(square, excess[..., None])[..., 0])


def reached(arm: Arm, start: Floats, goal: TaskSpaceRegion, path_constraint: TaskSpaceRegion) -> Floats | None:
    """The joint position ``(n,)`` in a goal that the arm reaches from a start in small steps within a region, if any.

    The goal's bounds are first widened until they contain the start, and then drawn in step by step.
    """
    inset = 1e-6
    goal, path_constraint, q = goal.within(inset), path_constraint.within(inset), start[None]
    beyond = goal.excess(arm.link_poses(start)[-1])
    for left in np.linspace(1.0, 0.0, 33)[1:]:
        wide = replace(
            goal, lower=goal.lower + left * np.minimum(beyond, 0.0), upper=goal.upper + left * np.maximum(beyond, 0.0)
        )
        q = projected(arm, q, wide, path_constraint)
        if np.abs(excess_and_slopes(arm, q, wide, path_constraint)[0]).max() > inset:
            return None
    return q[0]


def outside(arm: Arm, region: TaskSpaceRegion, q: Floats) -> float:
    """Largest distance or angle by which the end effector at q ``(K, n)`` leaves a region, as a fraction of the bound.

    The bounds are `KEPT_DISTANCE` and `KEPT_ANGLE`.
    """
    distance, angle = region.distance(_end_poses(arm, q))
    return float(max((distance / KEPT_DISTANCE).max(), (angle / KEPT_ANGLE).max()))


def check_path_constraint(arm: Arm, region: TaskSpaceRegion | None, motion: Motion) -> None:
    """Check that the end effector is in a region, up to `KEPT_DISTANCE` and `KEPT_ANGLE`, at every sample of a motion.

    `PlanError` if it is not; the message has the largest distance or angle, and its time.
    """
    if region is None:
        return
    distance, angle = region.distance(_end_poses(arm, motion.q))
    k = int(np.maximum(distance / KEPT_DISTANCE, angle / KEPT_ANGLE).argmax())
    if distance[k] > KEPT_DISTANCE or angle[k] > KEPT_ANGLE:
        raise PlanError(
            f"the end effector would be {distances(distance[k], angle[k])} outside the region to keep at "
            f"t = {motion.t[k]:.2f} s; allowed are {distances(KEPT_DISTANCE, KEPT_ANGLE)}"
        )


def end_outside(arm: Arm, region: TaskSpaceRegion | None, q: Floats) -> str | None:
    """How far the end effector at an end of a motion, q ``(n,)``, is outside a region, in words; None if inside."""
    if region is None:
        return None
    distance, angle = region.distance(arm.link_poses(q)[-1])
    # Start and target lie in it up to the accuracy of inverse kinematics [m, rad].
    return None if max(distance, angle) <= 1e-4 else distances(float(distance), float(angle))
