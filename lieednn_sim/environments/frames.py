"""Poses of link frames as arrays, and the errors between them, for one environment or many at once."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Indices of the factors in a cross product: of the positive terms, then of the negative ones.
_LEFT, _RIGHT = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])
# Smallest divisor: a rotation by less is none.
_TINY = 1e-100


class LinkFrames:
    """Reads link frames from MuJoCo's data as rows ``(F, 16)``: position, rotation matrix by rows, quaternion."""

    def __init__(self, arm: Arm, model: mujoco.MjModel, data: mujoco.MjData, frames: slice) -> None:
        self._model, self._data, self._frames = model, data, arm.frames[frames]
        # Views are kept, since asking MuJoCo for one takes as long as reading it.
        self._qpos, self._positions, self._rotations = data.qpos, data.xpos, data.xmat

    def __call__(self) -> Floats:
        """Return the frames at the data's positions in a new array."""
        mujoco.mj_kinematics(self._model, self._data)
        return self._rows(self._positions, self._rotations)

    def at(self, qpos: Floats) -> Floats:
        """Frames ``(B, F, 16)`` at MuJoCo's positions ``(B, nq)``, to which the data is set one after the other."""
        # All bodies are copied, since a choice of a few takes longer.
        places, turns = (np.empty((len(qpos), *view.shape)) for view in (self._positions, self._rotations))
        for row, own_place, own_turn in zip(qpos, places, turns, strict=True):
            self._qpos[:] = row
            mujoco.mj_kinematics(self._model, self._data)
            own_place[:], own_turn[:] = self._positions, self._rotations
        return self._rows(places, turns)

    def _rows(self, xpos: Floats, xmat: Floats) -> Floats:
        places, turns = self._frames.poses(xpos, xmat)
        return _rows(places, turns.reshape(*places.shape[:-1], 9))


def goal_frames(arm: Arm, q: Floats, frames: slice) -> Floats:
    """Frames ``(..., F, 16)`` in the format of `LinkFrames` at joint positions ``(..., n)``, without MuJoCo's data."""
    matrices = arm.link_poses(q).as_matrix()[..., frames, :, :]
    return _rows(matrices[..., :3, 3], matrices[..., :3, :3].reshape(*matrices.shape[:-2], 9))


def _rows(positions: Floats, rotations: Floats) -> Floats:
    rows = np.concatenate([positions, rotations, np.empty((*rotations.shape[:-1], 4))], axis=-1)
    for frame in rows.reshape(-1, 16):
        mujoco.mju_mat2Quat(frame[12:], frame[3:12])
    return rows


def pose_error_twists(frames: Floats, goals: Floats) -> tuple[Floats, Floats, Floats]:
    """Pose errors Log(T^-1 T_goal) as twists, for frames and goals in the format of `LinkFrames`.

    The same as `lie.log`, in a tenth of the time for one frame. If the relative rotation has the unit quaternion
    (c, s n), c >= 0, its angle is a = 2 atan2(s, c). With w = a n and the relative translation p,
    v = J_l^-1 p = p - w x p / 2 + (1 - (a / 2) cot(a / 2)) / a^2 w x (w x p).

    Returns:
        Twists (omega, v) ``(..., F, 6)`` [rad, m], and the largest distance ``(...)`` [m] and angle ``(...)`` [rad].
    """
    place = np.vecmat(goals[..., :3] - frames[..., :3], frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3))
    own, goal = frames[..., 12:], goals[..., 12:]
    cosine = np.vecdot(own, goal)
    axis = own[..., :1] * goal[..., 1:] - goal[..., :1] * own[..., 1:] - _cross(own[..., 1:], goal[..., 1:])
    sine = np.sqrt(np.vecdot(axis, axis))
    angle = 2.0 * np.arctan2(sine, np.abs(cosine))
    omega = np.copysign(angle / np.maximum(sine, _TINY), cosine)[..., None] * axis
    turned = _cross(omega, place)
    # What cancels here for small angles is multiplied by their squares.
    half = np.maximum(0.5 * angle, _TINY)
    bend = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    twist = np.concatenate([omega, place - 0.5 * turned + bend[..., None] * _cross(omega, turned)], axis=-1)
    distance = np.sqrt(np.vecdot(place, place))
    # Array methods would call the same reductions through Python.
    return twist, np.maximum.reduce(distance, axis=-1), np.maximum.reduce(angle, axis=-1)


def _cross(first: Floats, second: Floats) -> Floats:
    products = first.take(_LEFT, axis=-1) * second.take(_RIGHT, axis=-1)
    return np.asarray(products[..., :3] - products[..., 3:])
