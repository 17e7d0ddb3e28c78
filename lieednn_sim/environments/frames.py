"""Errors of link frames, of many environments at once: each is rounded as it is alone."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.simulation.quaternions import quaternions
from lieednn_sim.values import Floats

# Half the sine of an angle [rad] below which the coefficients are the first terms of their series.
_SMALL = 1e-4
# Entries of two vectors whose products make the cross product: the first three count, the others are taken away.
_LEFT, _RIGHT = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])
# Entries of two rows of `site_frames` whose products make the vector part of the quaternions' conj(p) q: with p_0 and
# with q_0, and of the cross product as above.
_OWN, _GOAL = 12 + np.array([0, 0, 0, 1, 2, 3, *1 + _LEFT]), 12 + np.array([1, 2, 3, 0, 0, 0, *1 + _RIGHT])


def site_frames(arm: Arm, data: mujoco.MjData, frames: slice) -> Floats:
    """Link frames where MuJoCo has them, ``(F, 16)``: position, rotation matrix row by row, quaternion."""
    sites = arm.site_ids[frames]
    found = np.empty((len(sites), 16))
    found[:, :3], found[:, 3:12] = data.site_xpos[sites], data.site_xmat[sites]
    for frame in found:
        mujoco.mju_mat2Quat(frame[12:], frame[3:12])
    return found


def frames_at(arm: Arm, model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats, frames: slice) -> Floats:
    """What `site_frames` gives at each of MuJoCo's positions ``(B, nq)``, ``(B, F, 16)``; they are set in the data."""
    place, rotation, position = data.site_xpos, data.site_xmat, data.qpos
    places, rotations = np.empty((len(qpos), *place.shape)), np.empty((len(qpos), *rotation.shape))
    for row, own_place, own_rotation in zip(qpos, places, rotations, strict=True):
        position[:] = row
        mujoco.mj_kinematics(model, data)
        own_place[:], own_rotation[:] = place, rotation
    sites = arm.site_ids[frames]
    rotations = rotations[:, sites]
    turns = quaternions(rotations.reshape(*rotations.shape[:-1], 3, 3))
    return np.concatenate([places[:, sites], rotations, turns], axis=-1)


def to_go(frames: Floats, goals: Floats) -> tuple[Floats, Floats, Floats]:
    """Log(T^-1 T_goal) of frames, with rows as of `site_frames`, to goals that are given alike.

    With the unit quaternion (c, s n) of the relative rotation, c >= 0, the angle is a = 2 atan2(s, c), and of the
    translation p the twist has v = J_l^-1 p = p - w x p / 2 + (1 - (a / 2) cot(a / 2)) / a^2 w x (w x p), w = a n.

    Returns:
        Twists (omega, v) ``(..., F, 6)`` [rad, m], and the largest distance ``(...)`` [m] and angle ``(...)`` [rad].
    """
    rotation = frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3)
    place = (rotation.swapaxes(-1, -2) @ (goals[..., :3] - frames[..., :3])[..., None])[..., 0]
    cosine = np.vecdot(frames[..., 12:], goals[..., 12:])
    products = frames.take(_OWN, axis=-1) * goals.take(_GOAL, axis=-1)
    axis = products[..., :3] - products[..., 3:6] - (products[..., 6:9] - products[..., 9:])
    sine, c = np.sqrt(np.vecdot(axis, axis)), np.abs(cosine)
    angle, safe = 2.0 * np.arctan2(sine, c), np.maximum(sine, _SMALL)
    scale = angle / safe
    bend = (1.0 - 0.5 * angle * c / safe) / np.maximum(angle * angle, _SMALL * _SMALL)
    small = sine < _SMALL
    if small.any():
        scale = np.where(small, 2.0 / np.maximum(c, 0.5) * (1.0 - sine * sine / 3.0), scale)
        bend = np.where(small, 1.0 / 12.0 + angle * angle / 720.0, bend)
    omega = np.copysign(scale, cosine)[..., None] * axis
    turned = _cross(omega, place)
    twist = np.concatenate([omega, place - 0.5 * turned + bend[..., None] * _cross(omega, turned)], axis=-1)
    # The reductions of ufuncs: methods of arrays come to them through Python.
    distance = np.sqrt(np.maximum.reduce(np.vecdot(place, place), axis=-1))
    return twist, distance, np.maximum.reduce(angle, axis=-1)


def closeness(error: Floats | float, allowed: Floats | float, margin: Floats | float) -> Floats:
    """1 up to the allowed error, 1 / (1 + 9 x^2) beyond it by x margins; dm_control's tolerance with a long tail."""
    beyond = np.maximum(error - allowed, 0.0) / margin
    return np.asarray(1.0 / (1.0 + 9.0 * beyond * beyond))


def _cross(one: Floats, other: Floats) -> Floats:
    products = one.take(_LEFT, axis=-1) * other.take(_RIGHT, axis=-1)
    return np.asarray(products[..., :3] - products[..., 3:])
