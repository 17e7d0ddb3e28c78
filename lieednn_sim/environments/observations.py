"""Targets, states and observations of episodes, for one or many at once: named arrays with bounds, and link frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

Observation = dict[str, Floats]
# Lower and upper bounds by name.
Bounds = dict[str, tuple[Floats, Floats]]

# Indices of the factors in a cross product: of the positive terms, then of the negative ones.
_LEFT, _RIGHT = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])
# Smallest divisor: a smaller rotation counts as none.
_TINY = 1e-100


def common_bounds(arm: Arm, frames: int) -> Bounds:
    """Bounds of the observations that all tasks have, with this number of goal frames."""
    low, high = arm.position_limits.T
    # Servos overshoot slightly, and contacts push.
    slack, velocity = 0.1 * (high - low), 5.0 * arm.velocity_limits
    span = high - low + 2.0 * slack
    # |v| <= (pi / 2) |p| for a pose with translation p, whose length is at most twice the reach.
    twist = np.tile(np.repeat([np.pi, np.pi * reach(arm)], 3), (frames, 1))
    return {
        "position": (low - slack, high + slack),
        "velocity": (-velocity, velocity),
        "command": (low.copy(), high.copy()),
        "position_error": (-span, span),
        "approach": (-np.ones_like(span), np.ones_like(span)),
        "pose_error": (-twist, twist),
    }


def reach(arm: Arm) -> float:
    """Upper bound of the distance of link frames from the base [m]: lengths between frames plus travel of slides."""
    lengths = np.linalg.norm(arm.mounts.translation, axis=-1) + np.linalg.norm(arm.tips.translation, axis=-1)
    slides = np.array([unit == "m" for unit in arm.space.units])
    return float(lengths.sum() + np.abs(arm.position_limits[slides]).max(axis=1).sum())


class Target(NamedTuple):
    """The target of an episode, which may move."""

    position: Callable[[float], Floats]  #: joint target ``(n,)`` at a time of the episode [s]
    #: After each number of control steps, from 0 to S: joint targets ``(S + 1, n)``, goal frames ``(S + 1, F, 16)`` as
    #: rows of `LinkFrames`, and a task's additional observations ``(S + 1, k)``.
    rows: tuple[Floats, ...]

    def after(self, steps: int) -> list[Floats]:
        """The rows after some control steps."""
        return [values[steps] for values in self.rows]


class State(NamedTuple):
    """The state of one episode after a control step, or of many with leading axes, without MuJoCo's physics."""

    steps: Any  #: numbers of control steps done ``(...)``
    command: Floats  #: commanded positions ``(..., n)``
    row: Floats  #: observations ``(..., size)``, see `Observations.rows`
    reward: Floats  #: rewards ``(...)`` in [0, 1]
    success: NDArray[np.bool_]  #: whether the arm is at its target ``(...)``
    distance: Floats  #: largest distance of a goal frame from its target ``(...)`` [m]
    angle: Floats  #: the same as an angle ``(...)`` [rad]
    failure: Any = ""  #: reasons ``(...)`` for which the next step failed in the simulation, or empty

    def over(self, steps: int) -> Any:
        """Whether episodes that last ``steps`` control steps are over ``(...)``."""
        return (self.failure != "") | (self.steps >= steps)

    def info(self) -> dict[str, Any]:
        """``success``, ``distance`` [m], ``angle`` [rad] of one episode; and ``failure``, the reason if it failed."""
        info = {"success": bool(self.success), "distance": float(self.distance), "angle": float(self.angle)}
        return info | {"failure": self.failure} if self.failure else info


class Observations:
    """Computes rows that hold all observations of a task, clipped to their bounds.

    Clipping and copying one row takes as long as it would for one of its arrays alone. The bounds are those of
    `common_bounds`, then those of a task's additional observations.
    """

    def __init__(self, bounds: Bounds) -> None:
        lows, highs = zip(*bounds.values(), strict=True)
        self._low, self._high = (np.concatenate([limit.ravel() for limit in limits]) for limits in (lows, highs))
        self.size = len(self._low)
        ends = np.cumsum([low.size for low in lows]).tolist()
        parts = zip(bounds, lows, ends, strict=True)
        self._parts = [(name, slice(end - low.size, end), low.shape) for name, low, end in parts]

    def rows(self, *values: Floats) -> Floats:
        """Rows ``(..., size)`` from arrays ``(..., k)``, one for each name in the order of the bounds."""
        # Twice as fast as np.clip.
        return np.minimum(np.maximum(np.concatenate(values, axis=-1), self._low), self._high)

    def split(self, rows: Floats) -> Observation:
        """The observations by name, views of rows ``(..., size)``."""
        batch = rows.shape[:-1]
        return {
            name: rows[..., part] if len(shape) == 1 else rows[..., part].reshape(*batch, *shape)
            for name, part, shape in self._parts
        }


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
        for self._qpos[:], place, turn in zip(qpos, places, turns, strict=True):
            mujoco.mj_kinematics(self._model, self._data)
            place[:], turn[:] = self._positions, self._rotations
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

    The twists (omega, v) are ``(..., F, 6)`` [rad, m]; then the largest distance ``(...)`` [m] and angle [rad].

    The same as `lie.log`, in a tenth of the time for one frame. If the relative rotation has the unit quaternion
    (c, s n), c >= 0, its angle is a = 2 atan2(s, c). With w = a n and the relative translation p,
    v = J_l^-1 p = p - w x p / 2 + (1 - (a / 2) cot(a / 2)) / a^2 w x (w x p).
    """
    place = np.vecmat(goals[..., :3] - frames[..., :3], frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3))
    own, goal = frames[..., 12:], goals[..., 12:]
    cosine = np.vecdot(own, goal)
    axis = own[..., :1] * goal[..., 1:] - goal[..., :1] * own[..., 1:] - _cross(own[..., 1:], goal[..., 1:])
    sine = np.sqrt(np.vecdot(axis, axis))
    angle = 2.0 * np.arctan2(sine, np.abs(cosine))
    omega = np.copysign(angle / np.maximum(sine, _TINY), cosine)[..., None] * axis
    turned = _cross(omega, place)
    # Cancellation at small angles does no harm: the coefficient is multiplied by the squared angle.
    half = np.maximum(0.5 * angle, _TINY)
    bend = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    twist = np.concatenate([omega, place - 0.5 * turned + bend[..., None] * _cross(omega, turned)], axis=-1)
    distance = np.sqrt(np.vecdot(place, place))
    # Array methods would call the same reductions through Python.
    return twist, np.maximum.reduce(distance, axis=-1), np.maximum.reduce(angle, axis=-1)


def _cross(first: Floats, second: Floats) -> Floats:
    products = first.take(_LEFT, axis=-1) * second.take(_RIGHT, axis=-1)
    return np.asarray(products[..., :3] - products[..., 3:])
