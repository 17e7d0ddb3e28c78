"""Tracking metrics of a rollout: planned against simulated link frames, and the arrival at the target."""

from __future__ import annotations

import csv
import os
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from lieednn_sim import storage
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.motion import Motion
from lieednn_sim.simulate import Rollout

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
        motion_end: time at which the reference comes to rest [s].
        duration: of the rollout [s].
        controller: that drove the arm.
    """

    frames: tuple[FrameErrors, ...]
    joints: tuple[JointUse, ...]
    travel: float
    displacement: float
    max_gap_translation_mm: float | None
    max_gap_rotation_deg: float | None
    network_residual: float | None
    contacts: int
    motion_end: float
    duration: float
    controller: str

    @property
    def end_effector(self) -> FrameErrors:
        """Errors of the last link frame."""
        return self.frames[-1]

    def save_json(self, path: str | os.PathLike[str]) -> None:
        """Write all metrics as JSON; unlimited joints have limit null."""
        value = asdict(self)
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


def evaluate(arm: Arm, rollout: Rollout, target: ArrayLike, motion: Motion | None = None) -> Evaluation:
    """Evaluate a rollout.

    Args:
        arm: the arm of the rollout.
        rollout: what was simulated.
        target: joint target ``(2N,)``.
        motion: the plan behind it, for the mechanism gap.

    Raises:
        InputError: rollout and arm do not belong together.
    """
    if rollout.arm != arm.name or rollout.q.shape[1] != arm.n_joints:
        raise InputError(f"the rollout is of arm {rollout.arm!r}, not of {arm.name!r}")
    simulated = rollout.link_poses()
    tracking = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    arrival = pose_errors(simulated, arm.link_poses(arm.check_position(target, "target")))
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
        motion_end=rollout.motion_end,
        duration=float(rollout.t[-1]),
        controller=rollout.controller,
    )


def _frame_errors(
    i: int, name: str, t: Floats, tracking: tuple[Floats, Floats], arrival: tuple[Floats, Floats]
) -> FrameErrors:
    distance, angle = 1e3 * tracking[0][:, i], np.rad2deg(tracking[1][:, i])
    outside = np.flatnonzero((arrival[0][:, i] > SETTLED_TRANSLATION) | (arrival[1][:, i] > SETTLED_ROTATION))
    if outside.size == 0:
        settled: float | None = float(t[0])
    else:
        settled = float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None
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
