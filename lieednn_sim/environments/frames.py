"""Pose errors of link frames, for many environments at once, with the same rounding as for a single one."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Sine of half an angle below which the first terms of series are used.
_SMALL = 1e-4
# Indices of the factors in a cross product: of the positive terms, then of the negative ones.
_LEFT, _RIGHT = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])
# Indices of the factors, in two rows of `SiteFrames`, of the vector part of conj(p) q: terms with p_0, terms with q_0,
# and the cross product as above.
_OWN, _GOAL = 12 + np.array([0, 0, 0, 1, 2, 3, *1 + _LEFT]), 12 + np.array([1, 2, 3, 0, 0, 0, *1 + _RIGHT])


class SiteFrames:
    """Reads link frames from MuJoCo's data as rows ``(F, 16)``: position, rotation matrix by rows, quaternion."""

    def __init__(self, arm: Arm, model: mujoco.MjModel, data: mujoco.MjData, frames: slice) -> None:
        self._model, self._data, self._sites = model, data, arm.site_ids[frames]
        # Views are kept, since asking MuJoCo for one takes as long as reading it.
        self._qpos, self._positions, self._rotations = data.qpos, data.site_xpos, data.site_xmat

    def __call__(self) -> Floats:
        """Return the frames at the data's positions in a new array."""
        mujoco.mj_kinematics(self._model, self._data)
        found = np.empty((len(self._sites), 16))
        found[:, :3] = self._positions.take(self._sites, axis=0)
        found[:, 3:12] = self._rotations.take(self._sites, axis=0)
        for frame in found:
            mujoco.mju_mat2Quat(frame[12:], frame[3:12])
        return found

    def at(self, qpos: Floats) -> Floats:
        """Frames ``(B, F, 16)`` at MuJoCo's positions ``(B, nq)``, to which the data is set one after the other."""
        # All sites are copied, since a choice of a few takes longer.
        places, turns = (np.empty((len(qpos), *view.shape)) for view in (self._positions, self._rotations))
        for row, own_place, own_turn in zip(qpos, places, turns, strict=True):
            self._qpos[:] = row
            mujoco.mj_kinematics(self._model, self._data)
            own_place[:], own_turn[:] = self._positions, self._rotations
        return _rows(places[:, self._sites], turns[:, self._sites])


def goal_frames(arm: Arm, q: Floats, frames: slice) -> Floats:
    """Frames ``(..., F, 16)`` in the format of `SiteFrames` at joint positions ``(..., n)``, without MuJoCo's data."""
    matrices = arm.link_poses(q).as_matrix()[..., frames, :, :]
    return _rows(matrices[..., :3, 3], matrices[..., :3, :3].reshape(*matrices.shape[:-2], 9))


def _rows(positions: Floats, rotations: Floats) -> Floats:
    found = np.concatenate([positions, rotations, np.empty((*rotations.shape[:-1], 4))], axis=-1)
    for frame in found.reshape(-1, 16):
        mujoco.mju_mat2Quat(frame[12:], frame[3:12])
    return found


def pose_error_twists(frames: Floats, goals: Floats) -> tuple[Floats, Floats, Floats]:
    """Pose errors Log(T^-1 T_goal) as twists, for frames and goals in the format of `SiteFrames`.

    If the relative rotation has the unit quaternion (c, s n), c >= 0, its angle is a = 2 atan2(s, c). With w = a n and
    the relative translation p, v = J_l^-1 p = p - w x p / 2 + (1 - (a / 2) cot(a / 2)) / a^2 w x (w x p).

    Returns:
        Twists (omega, v) ``(..., F, 6)`` [rad, m], and the largest distance ``(...)`` [m] and angle ``(...)`` [rad].
    """
    rotation = frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3)
    place = np.vecmat(goals[..., :3] - frames[..., :3], rotation)
    cosine = np.vecdot(frames[..., 12:], goals[..., 12:])
    products = frames.take(_OWN, axis=-1) * goals.take(_GOAL, axis=-1)
    axis = products[..., :3] - products[..., 3:6] - (products[..., 6:9] - products[..., 9:])
    sine, c = np.sqrt(np.vecdot(axis, axis)), np.abs(cosine)
    angle, safe = 2.0 * np.arctan2(sine, c), np.maximum(sine, _SMALL)
    scale = angle / safe
    bend = (1.0 - 0.5 * angle * c / safe) / np.maximum(angle * angle, _SMALL * _SMALL)
    small = sine < _SMALL
    # Array methods would call the same reduction through Python.
    if np.logical_or.reduce(small, axis=None):
        scale = np.where(small, 2.0 / np.maximum(c, 0.5) * (1.0 - sine * sine / 3.0), scale)
        bend = np.where(small, 1.0 / 12.0 + angle * angle / 720.0, bend)
    omega = np.copysign(scale, cosine)[..., None] * axis
    turned = _cross(omega, place)
    twist = np.concatenate([omega, place - 0.5 * turned + bend[..., None] * _cross(omega, turned)], axis=-1)
    return twist, np.sqrt(_largest(np.vecdot(place, place))), _largest(angle)


def _largest(values: Floats) -> Floats:
    """Largest value along the last axis; a single one is taken in a tenth of the time of a reduction."""
    # Array methods would call the same reduction through Python.
    return values[..., 0] if values.shape[-1] == 1 else np.asarray(np.maximum.reduce(values, axis=-1))


def _cross(one: Floats, other: Floats) -> Floats:
    products = one.take(_LEFT, axis=-1) * other.take(_RIGHT, axis=-1)
    return np.asarray(products[..., :3] - products[..., 3:])
