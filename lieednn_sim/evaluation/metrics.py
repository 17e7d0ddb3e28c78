"""Metrics of a rollout: each number once, under one name, for prints, tables, files and pages."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from lieednn_sim import filesystem, storage
from lieednn_sim.evaluation import display
from lieednn_sim.evaluation.causes import causes
from lieednn_sim.evaluation.frame_errors import (
    SETTLED_ROTATION,
    SETTLED_TRANSLATION,
    FrameErrors,
    frame_errors,
    pose_errors,
    settled,
)
from lieednn_sim.evaluation.motion_metrics import MotionMetrics, least_clearance, motion_metrics, violations
from lieednn_sim.simulation import Disturbances, Push, Rollout
from lieednn_sim.values import Floats
from lieednn_sim.versions import versions

if TYPE_CHECKING:
    from rich.console import Group


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
    ``recovery_s`` counts from the push's end to when all frames stay within 1 mm and 0.1 deg of their reference, None
    when they do not.
    """

    body: str
    start_s: float
    end_s: float
    peak_deviation_mm: float
    peak_deviation_deg: float
    recovery_s: float | None


@dataclass(frozen=True)
class Evaluation:
    """Metrics of one rollout; `print` shows them as tables.

    Conditions are called as the arguments of `simulate`. The attributes that are not listed are columns of a
    comparison: what they mean stands at `rows.Row`, once.

    Attributes:
        arm: that was simulated.
        scene: around it.
        controller: that drove it.
        reference_rate: at which it saw samples of the motion [Hz], None for every step.
        disturbances: what it did not know of.
        hold: time of the rollout after the motion [s].
        duration_s: of the rollout.
        motion_s: time at which the reference comes to rest.
        plan: of the motion that was followed, None without one.
        frames: one entry a link, the last one being the end effector.
        joints: one entry a joint.
        displacement_m: distance between the end effector's first and last position.
        clearance_mm: as the column; None where nothing can collide or nobody looked.
        contacts: largest number of simultaneous contacts.
        peak_contact_force_n: largest normal force of a contact.
        peak_weld_force_n: largest force between a link and its mocap body; zero without.
        peak_weld_torque_n_m: largest torque between them.
        recoveries: one entry a push.
        causes: of an arm that does not end at its target, what its model says of the reasons, see `causes.causes`.
    """

    arm: str
    scene: str
    controller: str
    reference_rate: float | None
    disturbances: Disturbances
    hold: float
    duration_s: float
    motion_s: float
    plan: MotionMetrics | None
    frames: tuple[FrameErrors, ...]
    joints: tuple[JointUse, ...]
    path_m: float
    displacement_m: float
    clearance_mm: float | None
    contacts: int
    peak_contact_force_n: float
    peak_weld_force_n: float
    peak_weld_torque_n_m: float
    recoveries: tuple[Recovery, ...]
    position_violations: int
    position_excess: float
    velocity_violations: int
    velocity_excess: float
    acceleration_violations: int
    acceleration_excess: float
    causes: tuple[str, ...] = ()
    settling_s: float | None = field(init=False)
    final_effector_mm: float = field(init=False)
    final_effector_deg: float = field(init=False)
    final_worst_mm: float = field(init=False)
    final_worst_deg: float = field(init=False)
    tracking_rms_mm: float = field(init=False)
    tracking_rms_deg: float = field(init=False)
    tracking_max_mm: float = field(init=False)
    tracking_max_deg: float = field(init=False)
    velocity_share: float = field(init=False)
    force_share: float = field(init=False)

    def __post_init__(self) -> None:
        times = [frame.settling_s for frame in self.frames if frame.settling_s is not None]
        found = {
            "settling_s": max(times) if len(times) == len(self.frames) else None,
            "velocity_share": max(joint.peak_velocity / joint.velocity_limit for joint in self.joints),
            "force_share": max(joint.peak_force / joint.force_limit for joint in self.joints),
        }
        for unit in ("mm", "deg"):
            found[f"final_effector_{unit}"] = getattr(self.end_effector, f"final_{unit}")
            for name, of_frame in (("final_worst", "final"), ("tracking_rms",) * 2, ("tracking_max",) * 2):
                found[f"{name}_{unit}"] = max(getattr(frame, f"{of_frame}_{unit}") for frame in self.frames)
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def __rich__(self) -> Group:
        return display.of_evaluation(self)

    def __str__(self) -> str:
        return display.as_text(self)

    @property
    def end_effector(self) -> FrameErrors:
        """Errors of the last link frame."""
        return self.frames[-1]

    @property
    def shortfall(self) -> str:
        """Why the rollout is no success, or an empty string: a contact, or a link that does not end at its target."""
        if self.contacts:
            return f"contact: up to {self.contacts} at a time"
        for frame in self.frames:
            if not frame.arrived:
                return f"arrival: {frame.name} ends {frame.final_mm:.3g} mm and {frame.final_deg:.3g} deg off"
        return ""

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
        with filesystem.atomic_text(path) as stream:
            rows = [asdict(frame) for frame in self.frames]
            writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def evaluate(rollout: Rollout, *, clearance: bool = True) -> Evaluation:
    """Evaluate a rollout: its arm against its reference, its target, its obstacles and its limits.

    Args:
        rollout: what was simulated.
        clearance: whether to look for the least clearance, which takes longer than all else.
    """
    arm, motion = rollout.arm, rollout.motion
    simulated = rollout.link_poses()
    tracking = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    arrival = pose_errors(simulated, arm.link_poses(rollout.target))
    tip = rollout.link_position[:, -1]
    least = least_clearance(rollout) if clearance else np.inf
    frames = tuple(frame_errors(i, name, rollout.t, tracking, arrival) for i, name in enumerate(arm.link_names))
    arrived = all(frame.arrived for frame in frames)
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
        path_m=float(np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()),
        displacement_m=float(np.linalg.norm(tip[-1] - tip[0])),
        clearance_mm=1e3 * least if np.isfinite(least) else None,
        contacts=int(rollout.contacts.max()),
        peak_contact_force_n=float(rollout.contact_force.max()),
        peak_weld_force_n=_peak(rollout, "weld_force"),
        peak_weld_torque_n_m=_peak(rollout, "weld_torque"),
        recoveries=_recoveries(rollout, tracking),
        causes=() if arrived else causes(rollout, SETTLED_TRANSLATION, SETTLED_ROTATION),
        **violations(rollout),
    )


def _peak(rollout: Rollout, channel: str) -> float:
    return float(rollout.channels.get(channel, np.zeros(1)).max())


def _recoveries(rollout: Rollout, tracking: tuple[Floats, Floats]) -> tuple[Recovery, ...]:
    """A push that begins at the end of the rollout or later leaves no entry."""
    # No step begins at the last sample; times are rounded to the nearest step.
    end = 0.5 * (rollout.t[-2] + rollout.t[-1])
    pushes = [push for push in rollout.disturbances.pushes if push.start < end]
    # Pushes that begin together share what follows.
    untils = [min((other.start for other in pushes if other.start > push.start), default=np.inf) for push in pushes]
    return tuple(_recovery(push, until, rollout.t, tracking) for push, until in zip(pushes, untils, strict=True))


def _recovery(push: Push, until: float, t: Floats, tracking: tuple[Floats, Floats]) -> Recovery:
    # Samples belong to a push by the step that begins there, whatever the rounding of the times.
    half = 0.5 * float(t[1] - t[0])
    since, after = ((t > begin - half) & (t < until - half) for begin in (push.start, push.end))
    distance, angle = tracking
    recovered = settled(t[after], distance[after], angle[after]) if after.any() else None
    return Recovery(
        body=push.body,
        start_s=push.start,
        end_s=push.end,
        peak_deviation_mm=float(1e3 * distance[since].max(initial=0.0)),
        peak_deviation_deg=float(np.rad2deg(angle[since].max(initial=0.0))),
        recovery_s=None if recovered is None else max(recovered - push.end, 0.0),
    )
