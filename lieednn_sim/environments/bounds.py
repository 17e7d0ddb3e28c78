"""Bounds of observations."""

from __future__ import annotations

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Lower and upper bounds by name.
Bounds = dict[str, tuple[Floats, Floats]]

# Share of their range by which observed positions may exceed their limits, and the largest observed velocity as a
# multiple of its limit: servos overshoot slightly, and contacts push.
_POSITION_SLACK, _VELOCITY_SLACK = 0.1, 5.0


def common_bounds(arm: Arm, frames: int) -> Bounds:
    """Bounds of the observations that all tasks have, with this number of goal frames."""
    low, high = arm.position_limits.T
    slack = _POSITION_SLACK * (high - low)
    velocity = _VELOCITY_SLACK * arm.velocity_limits
    span = high - low + 2.0 * slack
    # |v| <= (pi / 2) |p| for a pose with translation p, whose length is at most twice the reach.
    twist = np.tile(np.repeat([np.pi, np.pi * reach(arm)], 3), (frames, 1))
    return {
        "position": (low - slack, high + slack),
        "velocity": (-velocity, velocity),
        "command": (low.copy(), high.copy()),
        "position_error": (-span, span),
        "pose_error": (-twist, twist),
    }


def reach(arm: Arm) -> float:
    """Upper bound of the distance of link frames from the base [m]: lengths between frames plus travel of slides."""
    lengths = np.linalg.norm(arm.mounts.translation, axis=-1) + np.linalg.norm(arm.tips.translation, axis=-1)
    slides = np.array([unit == "m" for unit in arm.space.units])
    return float(lengths.sum() + np.abs(arm.position_limits[slides]).max(axis=1).sum())
