"""Tracking metrics of a rollout: planned against simulated link frames, and the arrival at the target."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from lieednn_sim import storage
from lieednn_sim.simulation import Disturbances, Following, Push, Rollout
from lieednn_sim.versions import versions

Floats = NDArray[np.float64]

# A frame has settled when it stays this close to its target.
SETTLED_TRANSLATION = 1e-3
SETTLED_ROTATION = np.deg2rad(0.1)


@dataclass(frozen=True)
class FrameErrors:
    """Errors of one link frame; translations in mm, rotations in degrees.

    ``final_*`` compares the last simulated frame with the target, ``rms_*`` and ``max_*`` the simulated with the
    planned frame of the same instant over the whole rollout. ``settling_time`` [s] is the time from which the frame
    stays within 1 mm and 0.1 deg of its target, None when it does not.
    """

    name: str
    final_translation_mm: float
    final_rotation_deg: float
    rms_translation_mm: float
    rms_rotation_deg: float
    max_translation_mm: float
    max_rotation_deg: float
    settling_time: float | None


@dataclass(frozen=True)
class JointUse:
    """Peak velocity and actuator force of one joint against its limits (rad/s, N m or m/s, N).

    ``peak_constraint_force`` is what contacts, joint limits and welds exert on it; it has no limit.
    """

    name: str
    peak_velocity: float
    velocity_limit: float
    peak_force: float
    force_limit: float
    peak_constraint_force: float


@dataclass(frozen=True)
class Recovery:
    """What a push did, up to the next push or the end of the rollout.

    ``peak_deviation_*`` is the largest error of any link frame against its reference since the push began.
    ``recovery_time`` [s] counts from the push's end to when all frames stay within 1 mm and 0.1 deg of their reference,
    None when they do not.
    """

    body: str
    start: float
    end: float
    peak_deviation_mm: float
    peak_deviation_deg: float
    recovery_time: float | None


@dataclass(frozen=True)
class FollowingErrors:
    """Errors behind a moving target; translations in mm, rotations in degrees.

    ``rms_*`` is the end effector's, over the whole run; ``worst_*`` the largest of any link frame. ``lag`` [s] is the
    delay that explains most of the end effector's distance: sum(e . v) / sum(v . v) over the steps at which the target
    does not jump, e from its simulated to its target position and v the target's velocity; None when it does not move.
    ``settling_times`` [s] has for each jump of the target the time until all frames stay within 1 mm and 0.1 deg of it
    until the next one, None when they do not.
    """

    rms_translation_mm: float
    rms_rotation_deg: float
    worst_translation_mm: float
    worst_rotation_deg: float
    lag: float | None
    settling_times: tuple[float | None, ...]


@dataclass(frozen=True)
class Evaluation:
    """Metrics of one rollout.

    Attributes:
        frames: one entry a link, the last one being the end effector.
        joints: one entry a joint.
        travel: length of the end effector's simulated path [m].
        displacement: distance between its first and last position [m].
        max_gap_translation_mm: largest mechanism gap of the plan; it is no tracking error. None without a motion.
        max_gap_rotation_deg: the same as an angle.
        network_residual: distance to the equilibrium at which the plan ends.
        contacts: largest number of simultaneous contacts.
        peak_contact_force: largest normal force of a contact [N].
        peak_weld_force: largest force between a link and its mocap body [N]; zero without.
        peak_weld_torque: largest torque between them [N m].
        recoveries: one entry a push.
        motion_end: time at which the reference comes to rest [s].
        duration: of the rollout [s].
        hold: time of it after the motion [s].
        controller: that drove the arm.
        reference_rate: at which it saw samples of the motion [Hz], None for every step.
        disturbances: what it did not know of.
    """

    frames: tuple[FrameErrors, ...]
    joints: tuple[JointUse, ...]
    travel: float
    displacement: float
    max_gap_translation_mm: float | None
    max_gap_rotation_deg: float | None
    network_residual: float | None
    contacts: int
    peak_contact_force: float
    peak_weld_force: float
    peak_weld_torque: float
    recoveries: tuple[Recovery, ...]
    motion_end: float
    duration: float
    hold: float
    controller: str
    reference_rate: float | None
    disturbances: Disturbances

    @property
    def end_effector(self) -> FrameErrors:
        """Errors of the last link frame."""
        return self.frames[-1]

    def save_json(self, path: str | os.PathLike[str], made_from: Mapping[str, str] | None = None) -> None:
        """Write all metrics and conditions as JSON; unlimited joints have limit null.

        Args:
            path: of the file.
            made_from: fingerprints of the files that were evaluated, by name.
        """
        value = {**asdict(self), "versions": versions(), "made_from": dict(made_from or {})}
        for joint in value["joints"]:
            for name in ("velocity_limit", "force_limit"):
                joint[name] = joint[name] if np.isfinite(joint[name]) else None
        storage.save_json(path, value)

    def save_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the frames' errors as one CSV row a frame."""
        with storage.atomic_text(path) as stream:
            rows = [asdict(frame) for frame in self.frames]
            writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def pose_errors(actual: RigidTransform, wanted: RigidTransform) -> tuple[Floats, Floats]:
    """Distance [m] and angle [rad] between poses whose shapes broadcast."""
    difference = wanted.inv() * actual
    return np.linalg.norm(difference.translation, axis=-1), np.asarray(difference.rotation.magnitude())


def evaluate(rollout: Rollout) -> Evaluation:
    """Evaluate a rollout: its arm against its reference, its target and its limits."""
    arm, motion = rollout.arm, rollout.motion
    simulated = rollout.link_poses()
    tracking = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    arrival = pose_errors(simulated, arm.link_poses(rollout.target))
    tip = rollout.link_position[:, -1]
    return Evaluation(
        frames=tuple(_frame_errors(i, name, rollout.t, tracking, arrival) for i, name in enumerate(arm.link_names)),
        joints=tuple(
            JointUse(
                name=name,
                peak_velocity=float(np.abs(rollout.qd[:, j]).max()),
                velocity_limit=float(arm.velocity_limits[j]),
                peak_force=float(np.abs(rollout.force[:, j]).max()),
                force_limit=float(arm.force_limits[j]),
                peak_constraint_force=float(np.abs(rollout.constraint_force[:, j]).max()),
            )
            for j, name in enumerate(arm.joint_names)
        ),
        travel=float(np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()),
        displacement=float(np.linalg.norm(tip[-1] - tip[0])),
        max_gap_translation_mm=None if motion is None else float(1e3 * motion.gap_translation.max()),
        max_gap_rotation_deg=None if motion is None else float(np.rad2deg(motion.gap_rotation.max())),
        network_residual=None if motion is None else motion.residual,
        contacts=int(rollout.contacts.max()),
        peak_contact_force=float(rollout.contact_force.max()),
        peak_weld_force=_peak(rollout, "weld_force"),
        peak_weld_torque=_peak(rollout, "weld_torque"),
        recoveries=_recoveries(rollout, tracking),
        motion_end=rollout.motion_end,
        duration=float(rollout.t[-1]),
        hold=rollout.hold,
        controller=rollout.controller,
        reference_rate=rollout.reference_rate,
        disturbances=rollout.disturbances,
    )


def _frame_errors(
    i: int, name: str, t: Floats, tracking: tuple[Floats, Floats], arrival: tuple[Floats, Floats]
) -> FrameErrors:
    distance, angle = 1e3 * tracking[0][:, i], np.rad2deg(tracking[1][:, i])
    settled = _settled(t, arrival[0][:, i : i + 1], arrival[1][:, i : i + 1])
    return FrameErrors(
        name=name,
        final_translation_mm=float(1e3 * arrival[0][-1, i]),
        final_rotation_deg=float(np.rad2deg(arrival[1][-1, i])),
        rms_translation_mm=float(np.sqrt(np.mean(distance**2))),
        rms_rotation_deg=float(np.sqrt(np.mean(angle**2))),
        max_translation_mm=float(distance.max()),
        max_rotation_deg=float(angle.max()),
        settling_time=settled,
    )


def _settled(t: Floats, distance: Floats, angle: Floats) -> float | None:
    """Time from which errors ``(K, N)`` stay within the bounds, None when they do not."""
    outside = np.flatnonzero(((distance > SETTLED_TRANSLATION) | (angle > SETTLED_ROTATION)).any(axis=1))
    if outside.size == 0:
        return float(t[0])
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None


def _peak(rollout: Rollout, channel: str) -> float:
    return float(rollout.channels.get(channel, np.zeros(1)).max())


def _recoveries(rollout: Rollout, tracking: tuple[Floats, Floats]) -> tuple[Recovery, ...]:
    """A push that begins after the end of the rollout leaves no entry."""
    pushes = [push for push in rollout.disturbances.pushes if push.start <= rollout.t[-1]]
    # Pushes that begin together share what follows.
    untils = [min((other.start for other in pushes if other.start > push.start), default=np.inf) for push in pushes]
    return tuple(_recovery(push, until, rollout.t, tracking) for push, until in zip(pushes, untils, strict=True))


def _recovery(push: Push, until: float, t: Floats, tracking: tuple[Floats, Floats]) -> Recovery:
    # Samples belong to a push by the step that begins there, whatever the rounding of the times.
    half = 0.5 * float(t[1] - t[0])
    since, after = ((t > begin - half) & (t < until - half) for begin in (push.start, push.end))
    distance, angle = tracking
    settled = _settled(t[after], distance[after], angle[after]) if after.any() else None
    return Recovery(
        body=push.body,
        start=push.start,
        end=push.end,
        peak_deviation_mm=float(1e3 * distance[since].max(initial=0.0)),
        peak_deviation_deg=float(np.rad2deg(angle[since].max(initial=0.0))),
        recovery_time=None if settled is None else max(settled - push.end, 0.0),
    )


def evaluate_following(following: Following) -> FollowingErrors:
    """Evaluate how a moving target was followed."""
    rollout = following.rollout
    t, wanted = rollout.t, rollout.arm.link_poses(following.target)
    distance, angle = pose_errors(rollout.link_poses(), wanted)
    tip = np.asarray(wanted.translation)[:, -1]
    velocity, behind = np.diff(tip, axis=0) / np.diff(t)[:, None], (tip - rollout.link_position[:, -1])[1:]
    starts = np.searchsorted(t, np.asarray(following.jumps) - 0.5 * rollout.timestep)
    # The follower sees a jump at the next control period: it happened at the fastest step of the last one.
    steady = np.ones(len(velocity), dtype=bool)
    for begin in starts:
        recent = slice(max(begin - following.period, 0), begin)
        steady[recent.start + int(np.linalg.norm(velocity[recent], axis=1).argmax())] = False
    moved = float((velocity[steady] ** 2).sum())
    ends = [*starts[1:], len(t)][: len(starts)]
    spans = zip(starts, ends, strict=True)
    settled = [(begin, _settled(t[begin:end], distance[begin:end], angle[begin:end])) for begin, end in spans]
    return FollowingErrors(
        rms_translation_mm=float(1e3 * np.sqrt(np.mean(distance[:, -1] ** 2))),
        rms_rotation_deg=float(np.rad2deg(np.sqrt(np.mean(angle[:, -1] ** 2)))),
        worst_translation_mm=float(1e3 * distance.max()),
        worst_rotation_deg=float(np.rad2deg(angle.max())),
        lag=float((behind * velocity)[steady].sum()) / moved if moved > 0.0 else None,
        settling_times=tuple(None if time is None else time - float(t[begin]) for begin, time in settled),
    )
