"""Metrics of rollouts, of arms that follow moving targets, and of plans by themselves."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.evaluation.diagnosis import error_causes
from lieednn_sim.evaluation.evaluation import (
    SETTLED_ROTATION,
    SETTLED_TRANSLATION,
    Evaluation,
    FrameErrors,
    JointUse,
    MotionMetrics,
    Recovery,
)
from lieednn_sim.evaluation.load import load_metrics
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion
from lieednn_sim.planning.statics import exerted_use, force_use
from lieednn_sim.simulation import Following, Rollout
from lieednn_sim.simulation.rollout import SLIP
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, rounded

# Fraction by which a simulated rate may exceed its limit, for the ripple of the control loop.
RATE_TOLERANCE = 1e-3


def evaluate(rollout: Rollout, *, clearance: bool = True) -> Evaluation:
    """Compute the metrics of a rollout: tracking error, final error, clearance, contacts, and use of the limits.

    Args:
        rollout: the simulated run.
        clearance: whether to compute the least clearance, which takes longer than everything else. In a view, all
            bodies are where the simulation had them.
    """
    arm, motion = rollout.arm, rollout.motion
    simulated = rollout.link_poses()
    tracking = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    arrival = pose_errors(simulated, arm.link_poses(rollout.target))
    tip = rollout.link_position[:, -1]
    # Every fifth sample (10 ms at the arms' step), and all samples with a contact.
    chosen = np.union1d(np.arange(0, len(rollout.t), 5), np.flatnonzero(rollout.contacts))
    least = Collisions(arm.unsupported).nearest_at(rollout.qpos[chosen])[0] if clearance else np.inf
    proof = rollout.clearance if clearance else None
    weld_force, weld_torque = (rollout.channels.get(f"weld_{load}", np.zeros(1)) for load in ("force", "torque"))
    speeds, forces, held = (np.abs(x).max(axis=0) for x in (rollout.qd, rollout.force, rollout.constraint_force))
    frames = tuple(frame_errors(i, name, rollout.t, tracking, arrival) for i, name in enumerate(arm.link_names))
    uses = zip(arm.joint_names, speeds, arm.velocity_limits, forces, arm.force_limits, held, strict=True)
    return Evaluation(
        arm=arm.name,
        scene=arm.scene,
        controller=rollout.controller,
        reference_rate=rollout.reference_rate,
        disturbances=rollout.disturbances,
        hold=rollout.hold,
        duration_s=float(rollout.t[-1]),
        motion_s=rollout.motion_end,
        plan=None if motion is None else motion_metrics(arm, motion),
        frames=frames,
        joints=tuple(JointUse(name, *map(float, numbers)) for name, *numbers in uses),
        path_m=float(np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()),
        displacement_m=float(np.linalg.norm(tip[-1] - tip[0])),
        clearance_mm=1e3 * least if np.isfinite(least) else None,
        proof="; ".join(filter(None, (str(proof or ""), rollout.outside if clearance else ""))),
        proved=proof is not None and proof.proved and not rollout.contacts.any(),
        contacts=int(rollout.contacts.max()),
        sequence=bool(rollout.steps),
        slip_mm=1e3 * float(rollout.channels.get(SLIP, np.zeros(1)).max()),
        peak_contact_force_n=float(rollout.contact_force.max()),
        peak_weld_force_n=float(weld_force.max()),
        peak_weld_torque_n_m=float(weld_torque.max()),
        recoveries=_recoveries(rollout, tracking),
        force_fraction=exerted_use(arm, rollout.qpos, rollout.qd, rollout.force),
        planned_force_fraction=None if motion is None else force_use(arm, motion.t, motion.q, motion.qd),
        causes=() if all(frame.arrived for frame in frames) else error_causes(rollout),
        load=load_metrics(rollout, clearance=clearance),
        **violations(rollout),
    )


def _recoveries(rollout: Rollout, tracking: tuple[Floats, Floats]) -> tuple[Recovery, ...]:
    """The effect of each push; a push that begins at the end of the rollout or later is left out."""
    t, (distance, angle) = rollout.t, tracking
    # No step begins at the last sample; times are rounded to the nearest step.
    pushes = [push for push in rollout.disturbances.pushes if push.start < 0.5 * (t[-2] + t[-1])]
    # A sample belongs to a push by the step that begins at it; half a step allows for the rounding of times.
    half = 0.5 * float(t[1] - t[0])
    result = []
    for push in pushes:
        # Pushes that begin together share the time that follows.
        until = min((other.start for other in pushes if other.start > push.start), default=np.inf)
        since, after = ((t > begin - half) & (t < until - half) for begin in (push.start, push.end))
        recovered = settled(t[after], distance[after], angle[after]) if after.any() else None
        peak_mm = float(1e3 * distance[since].max(initial=0.0))
        peak_deg = float(np.rad2deg(angle[since].max(initial=0.0)))
        wait = None if recovered is None else max(recovered - push.end, 0.0)
        result.append(Recovery(push.body, push.start, push.end, peak_mm, peak_deg, wait))
    return tuple(result)


@dataclass(frozen=True)
class FollowingErrors:
    """Errors of an arm that follows a moving target; translations in mm, rotations in degrees.

    ``rms_*`` is the end effector's error over the whole run, ``worst_*`` the largest of any link frame. ``lag_s`` is
    the delay that explains most of the end effector's distance: sum(e . v) / sum(v . v) over the steps at which the
    target does not jump, with e from the simulated to the target position and v the target's velocity; None when it
    does not move. ``settling_s`` has, for each jump of the target, the time after which all frames stay within 1 mm and
    0.1 deg of it up to the next jump, or None when they do not; ``arrives_s`` is when they do so up to the end.
    """

    rms_mm: float
    rms_deg: float
    worst_mm: float
    worst_deg: float
    lag_s: float | None
    settling_s: tuple[float | None, ...]
    arrives_s: float | None

    def __str__(self) -> str:
        lag = "never arrives" if self.arrives_s is None else f"arrives after {self.arrives_s:.3g} s"
        lag = f"{lag}; on the way" if self.lag_s is None else f"{1e3 * self.lag_s:.3g} ms behind the target"
        off = f"end effector {rounded(self.rms_mm)} mm and {rounded(self.rms_deg)} degrees off (RMS)"
        worst = f"a link at most {rounded(self.worst_mm)} mm and {rounded(self.worst_deg)} degrees"
        waits = ", ".join("never" if wait is None else f"in {wait:.2f} s" for wait in self.settling_s)
        return f"{lag}, {off}, {worst}" + (f", settles after its jumps: {waits}" if waits else "")


def evaluate_following(following: Following) -> FollowingErrors:
    """Compute how far the arm lagged behind a moving target; raises `InputError` for anything but a `Following`."""
    rollout = following.rollout
    t, target = rollout.t, rollout.arm.link_poses(following.target)
    distance, angle = pose_errors(rollout.link_poses(), target)
    tip = np.asarray(target.translation)[:, -1]
    velocity, behind = np.diff(tip, axis=0) / np.diff(t)[:, None], (tip - rollout.link_position[:, -1])[1:]
    starts = np.searchsorted(t, np.asarray(following.jumps) - 0.5 * rollout.timestep)
    # The follower sees a jump in the next control period: it occurred at the fastest step of the previous one.
    steady = np.ones(len(velocity), dtype=bool)
    for begin in starts:
        recent = slice(max(begin - following.period, 0), begin)
        steady[recent.start + int(np.linalg.norm(velocity[recent], axis=1).argmax())] = False
    moved = float((velocity[steady] ** 2).sum())
    spans = [(a, settled(t[a:b], distance[a:b], angle[a:b])) for a, b in pairwise([*starts, len(t)])]
    return FollowingErrors(
        rms_mm=float(1e3 * np.sqrt(np.mean(distance[:, -1] ** 2))),
        rms_deg=float(np.rad2deg(np.sqrt(np.mean(angle[:, -1] ** 2)))),
        worst_mm=float(1e3 * distance.max()),
        worst_deg=float(np.rad2deg(angle.max())),
        lag_s=float((behind * velocity)[steady].sum()) / moved if moved > 0.0 else None,
        settling_s=tuple(None if time is None else time - float(t[begin]) for begin, time in spans),
        arrives_s=settled(t, distance, angle),
    )


def pose_errors(actual: RigidTransform, wanted: RigidTransform) -> tuple[Floats, Floats]:
    """Distance [m] and angle [rad] between poses whose shapes broadcast."""
    difference = wanted.inv() * actual
    return np.linalg.norm(difference.translation, axis=-1), np.asarray(difference.rotation.magnitude())


def frame_errors(
    i: int, name: str, t: Floats, tracking: tuple[Floats, Floats], arrival: tuple[Floats, Floats]
) -> FrameErrors:
    """Errors of link ``i`` at times ``(K,)``; both pairs are distances [m] and angles [rad] ``(K, N)``."""
    distance, angle = 1e3 * tracking[0][:, i], np.rad2deg(tracking[1][:, i])
    return FrameErrors(
        name=name,
        final_mm=float(1e3 * arrival[0][-1, i]),
        final_deg=float(np.rad2deg(arrival[1][-1, i])),
        tracking_rms_mm=float(np.sqrt(np.mean(distance**2))),
        tracking_rms_deg=float(np.sqrt(np.mean(angle**2))),
        tracking_max_mm=float(distance.max()),
        tracking_max_deg=float(angle.max()),
        settling_s=settled(t, arrival[0][:, i : i + 1], arrival[1][:, i : i + 1]),
    )


def settled(t: Floats, distance: Floats, angle: Floats) -> float | None:
    """Time from which errors ``(K, N)`` stay within the bounds, None when they do not."""
    outside = np.flatnonzero(((distance > SETTLED_TRANSLATION) | (angle > SETTLED_ROTATION)).any(axis=1))
    first = outside[-1] + 1 if outside.size else 0
    return float(t[first]) if first < len(t) else None


def motion_metrics(arm: Arm, motion: Motion) -> MotionMetrics:
    """Evaluate a plan."""
    tip = arm.tip(motion.q)
    tip_jerk = np.diff(tip, n=3, axis=0) / motion.timestep**3
    jerk = np.diff(motion.qd / arm.ranges, n=2, axis=0) / motion.timestep**2
    return MotionMetrics(
        motion_s=float(motion.t[-1]),
        gap_mm=float(1e3 * motion.gap_translation.max()),
        gap_deg=float(np.rad2deg(motion.gap_rotation.max())),
        gap_end_mm=float(1e3 * motion.gap_translation[-1].max()),
        gap_end_deg=float(np.rad2deg(motion.gap_rotation[-1].max())),
        path_ranges=float(np.linalg.norm(np.diff(motion.q / arm.ranges, axis=0), axis=1).sum()),
        jerk_joints=float(np.sqrt(np.mean(jerk**2))),
        jerk_effector=float(np.sqrt(np.mean(np.sum(tip_jerk**2, axis=1)))) if len(tip_jerk) else 0.0,
        curvature=rms_curvature(tip, motion.timestep),
        network_residual=motion.residual,
    )


def rms_curvature(path: ArrayLike, timestep: float) -> float | None:
    """Root mean square of kappa = |p' x p''| / |p'|^3 along the arc [1/m], where |p'| exceeds 5 % of its peak.

    The path ``(K, 3)`` [m] has constant time steps [s]. None if it does not move; `InputError` if it is malformed.
    """
    points, step = as_floats("path", path, ("K", 3)), as_positive("timestep", timestep)
    if len(points) < 3:
        return None
    # Central differences, both at the inner samples, so that both belong to one instant.
    velocity = (points[2:] - points[:-2]) / (2.0 * step)
    acceleration = (points[2:] - 2.0 * points[1:-1] + points[:-2]) / step**2
    speed = np.linalg.norm(velocity, axis=1)
    if speed.max() < 1e-9:  # at rest [m/s]
        return None
    moving = speed > 0.05 * speed.max()  # near rest the path's direction is noise
    speed = speed[moving]
    kappa = np.linalg.norm(np.cross(velocity[moving], acceleration[moving]), axis=1) / speed**3
    return float(np.sqrt((kappa**2 * speed).sum() / speed.sum()))


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
