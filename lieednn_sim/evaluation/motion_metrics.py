"""Metrics of a plan by itself, and how close a rollout came to obstacles and limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion, rms_jerk
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import as_floats, as_positive

# Fraction by which a simulated rate may exceed its limit, for the ripple of the control loop.
RATE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class MotionMetrics:
    """Metrics of a planned motion before it is simulated; those not listed here are explained in `studies.Row`.

    Attributes:
        curvature: see `rms_curvature`; None where the end effector does not move.
        network_residual: distance from the equilibrium at the end of the motion [network coordinates].
    """

    motion_s: float
    gap_mm: float
    gap_deg: float
    gap_end_mm: float
    gap_end_deg: float
    path_ranges: float
    jerk_joints: float
    jerk_effector: float
    curvature: float | None
    network_residual: float


def motion_metrics(arm: Arm, motion: Motion) -> MotionMetrics:
    """Evaluate a plan."""
    tip = arm.tip(motion.q)
    tip_jerk = np.diff(tip, n=3, axis=0) / motion.timestep**3
    return MotionMetrics(
        motion_s=float(motion.t[-1]),
        gap_mm=float(1e3 * motion.gap_translation.max()),
        gap_deg=float(np.rad2deg(motion.gap_rotation.max())),
        gap_end_mm=float(1e3 * motion.gap_translation[-1].max()),
        gap_end_deg=float(np.rad2deg(motion.gap_rotation[-1].max())),
        path_ranges=float(np.linalg.norm(np.diff(motion.q / arm.ranges, axis=0), axis=1).sum()),
        jerk_joints=rms_jerk(arm, motion),
        jerk_effector=float(np.sqrt(np.mean(np.sum(tip_jerk**2, axis=1)))) if len(tip_jerk) else 0.0,
        curvature=rms_curvature(tip, motion.timestep),
        network_residual=motion.residual,
    )


def rms_curvature(path: ArrayLike, timestep: float) -> float | None:
    """Root mean square of kappa = |p' x p''| / |p'|^3 along the arc [1/m], where |p'| exceeds 5 % of its peak.

    Args:
        path: ``(K, 3)`` positions [m] at constant time steps.
        timestep: [s].

    Returns:
        None for a path that does not move.

    Raises:
        InputError: the path is malformed or the timestep is not positive.
    """
    points, step = as_floats("path", path, ("K", 3)), as_positive("timestep", timestep)
    if len(points) < 3:
        return None
    # Central differences, both at the inner samples, so that both belong to one instant.
    velocity = (points[2:] - points[:-2]) / (2.0 * step)
    acceleration = (points[2:] - 2.0 * points[1:-1] + points[:-2]) / step**2
    speed = np.linalg.norm(velocity, axis=1)
    # At rest [m/s].
    if speed.max() < 1e-9:
        return None
    # Near rest the direction of the path is noise.
    moving = speed > 0.05 * speed.max()
    speed = speed[moving]
    kappa = np.linalg.norm(np.cross(velocity[moving], acceleration[moving]), axis=1) / speed**3
    return float(np.sqrt((kappa**2 * speed).sum() / speed.sum()))


def least_clearance(rollout: Rollout) -> float:
    """Least clearance along the simulated motion [m]; negative in penetration, infinite where nothing can collide.

    In a view, everything is where the simulation had it; a free body between fingers is touched.

    It is measured at every fifth sample (10 ms at the arms' step), and at all samples with a contact.
    """
    chosen = np.union1d(np.arange(0, len(rollout.t), 5), np.flatnonzero(rollout.contacts))
    return Collisions(rollout.arm).least_clearance_at(rollout.qpos[chosen])


def violations(rollout: Rollout) -> dict[str, Any]:
    """Samples at which a joint is beyond its position, velocity or acceleration limit, and the worst excess.

    Positions are in units of the joint's range, velocities and accelerations in units of their limits.
    """
    arm = rollout.arm
    outside = arm.limit_excess(rollout.q)[:, : arm.n_joints]
    velocity = np.abs(rollout.qd) / arm.velocity_limits - 1.0
    acceleration = np.abs(np.diff(rollout.qd, axis=0) / rollout.timestep) / arm.acceleration_limits - 1.0
    excesses = {
        "position": (outside / arm.ranges, outside > LIMIT_TOLERANCE),
        "velocity": (velocity, velocity > RATE_TOLERANCE),
        "acceleration": (acceleration, acceleration > RATE_TOLERANCE),
    }
    values: dict[str, Any] = {}
    for name, (excess, beyond) in excesses.items():
        values[f"{name}_violations"] = int(beyond.any(axis=1).sum())
        values[f"{name}_excess"] = float(excess[beyond].max()) if beyond.any() else 0.0
    return values
