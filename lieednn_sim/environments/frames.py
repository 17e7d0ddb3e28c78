"""Errors of link frames, of many environments at once: each is rounded as it is alone."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Half the sine of an angle [rad] below which the coefficients are the first terms of their series.
_SMALL = 1e-4
_NEXT_AND_AFTER = [1, 2, 0, 2, 0, 1]


def site_frames(arm: Arm, data: mujoco.MjData, frames: slice) -> Floats:
    """Link frames where MuJoCo has them, ``(F, 16)``: position, rotation matrix row by row, quaternion."""
    sites = arm.site_ids[frames]
    found = np.empty((len(sites), 16))
    found[:, :3], found[:, 3:12] = data.site_xpos[sites], data.site_xmat[sites]
    for frame in found:
        mujoco.mju_mat2Quat(frame[12:], frame[3:12])
    return found


def to_go(frames: Floats, goals: Floats) -> tuple[Floats, Floats, Floats]:
    """Log(T^-1 T_goal) of frames, with rows as of `site_frames`, to goals that are given alike.

    With the unit quaternion (c, s n) of the relative rotation, c >= 0, the angle is a = 2 atan2(s, c), and of the
    translation p the twist has v = J_l^-1 p = p - w x p / 2 + (1 - (a / 2) cot(a / 2)) / a^2 w x (w x p), w = a n.

    Returns:
        Twists (omega, v) ``(..., F, 6)`` [rad, m], and the largest distance ``(...)`` [m] and angle ``(...)`` [rad].
    """
    rotation = frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3)
    place = (np.swapaxes(rotation, -1, -2) @ (goals[..., :3] - frames[..., :3])[..., None])[..., 0]
    own, other = frames[..., 12:], goals[..., 12:]
    cosine = _dot(own, other)
    axis = own[..., :1] * other[..., 1:] - other[..., :1] * own[..., 1:] - _cross(own[..., 1:], other[..., 1:])
    sine, c = np.sqrt(_dot(axis, axis)), np.abs(cosine)
    angle, small = 2.0 * np.arctan2(sine, c), sine < _SMALL
    safe = np.where(small, 1.0, sine)
    scale = np.where(small, 2.0 / np.maximum(c, 0.5) * (1.0 - sine * sine / 3.0), angle / safe)
    omega = np.where(cosine < 0.0, -scale, scale)[..., None] * axis
    square = np.where(small, 1.0, angle * angle)
    bend = np.where(small, 1.0 / 12.0 + angle * angle / 720.0, (1.0 - 0.5 * angle * c / safe) / square)
    turned = _cross(omega, place)
    twist = np.concatenate([omega, place - 0.5 * turned + bend[..., None] * _cross(omega, turned)], axis=-1)
    return twist, np.sqrt(_dot(place, place)).max(axis=-1), angle.max(axis=-1)


def closeness(error: Floats | float, allowed: Floats | float, margin: Floats | float) -> Floats:
    """1 up to the allowed error, 1 / (1 + 9 x^2) beyond it by x margins; dm_control's tolerance with a long tail."""
    beyond = np.maximum(error - allowed, 0.0) / margin
    return np.asarray(1.0 / (1.0 + 9.0 * beyond * beyond))


def _dot(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.vecdot(one, other))


def _cross(one: Floats, other: Floats) -> Floats:
    one, other = one[..., _NEXT_AND_AFTER], other[..., _NEXT_AND_AFTER]
    return one[..., :3] * other[..., 3:] - one[..., 3:] * other[..., :3]
