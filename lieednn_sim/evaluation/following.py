"""Errors in following a moving target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.evaluation.frame_errors import pose_errors, settled
from lieednn_sim.simulation import Following


@dataclass(frozen=True)
class FollowingErrors:
    """Errors behind a moving target; translations in mm, rotations in degrees.

    ``rms_*`` is the end effector's error over the whole run, ``worst_*`` the largest of any link frame. ``lag_s`` is
    the delay that explains most of the end effector's distance: sum(e . v) / sum(v . v) over the steps at which the
    target does not jump, with e from the simulated to the target position and v the target's velocity; None when it
    does not move. ``settling_s`` has, for each jump of the target, the time until all frames stay within 1 mm and
    0.1 deg of it until the next jump, or None when they do not.
    """

    rms_mm: float
    rms_deg: float
    worst_mm: float
    worst_deg: float
    lag_s: float | None
    settling_s: tuple[float | None, ...]


def evaluate_following(following: Following) -> FollowingErrors:
    """Evaluate how a moving target was followed; raises `InputError` for anything but a `Following`."""
    rollout = following.rollout
    t, wanted = rollout.t, rollout.arm.link_poses(following.target)
    distance, angle = pose_errors(rollout.link_poses(), wanted)
    tip = np.asarray(wanted.translation)[:, -1]
    velocity, behind = np.diff(tip, axis=0) / np.diff(t)[:, None], (tip - rollout.link_position[:, -1])[1:]
    starts = np.searchsorted(t, np.asarray(following.jumps) - 0.5 * rollout.timestep)
    # The follower sees a jump in the next control period: it occurred at the fastest step of the previous one.
    steady = np.ones(len(velocity), dtype=bool)
    for begin in starts:
        recent = slice(max(begin - following.period, 0), begin)
        steady[recent.start + int(np.linalg.norm(velocity[recent], axis=1).argmax())] = False
    moved = float((velocity[steady] ** 2).sum())
    ends = [*starts[1:], len(t)][: len(starts)]
    spans = zip(starts, ends, strict=True)
    spans_settled = [(begin, settled(t[begin:end], distance[begin:end], angle[begin:end])) for begin, end in spans]
    return FollowingErrors(
        rms_mm=float(1e3 * np.sqrt(np.mean(distance[:, -1] ** 2))),
        rms_deg=float(np.rad2deg(np.sqrt(np.mean(angle[:, -1] ** 2)))),
        worst_mm=float(1e3 * distance.max()),
        worst_deg=float(np.rad2deg(angle.max())),
        lag_s=float((behind * velocity)[steady].sum()) / moved if moved > 0.0 else None,
        settling_s=tuple(None if time is None else time - float(t[begin]) for begin, time in spans_settled),
    )
