"""Targets, states and observations of episodes, for one or many at once: named arrays with bounds, and link frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_along, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.lie.se3 import bend, skew
from lieednn_sim.values import Floats

Observation = dict[str, Floats]
# Lower and upper bounds by name.
Bounds = dict[str, tuple[Floats, Floats]]


def common_bounds(arm: Arm, frames: int) -> Bounds:
    """Bounds of the observations that all tasks have, with this number of goal frames."""
    low, high = arm.position_limits.T
    # Servos overshoot slightly, and contacts push.
    slack, velocity = 0.1 * (high - low), 5.0 * arm.velocity_limits
    span = high - low + 2.0 * slack
    # |v| <= (pi / 2) |p| for a pose with translation p, whose length is at most twice the reach.
    twist = np.tile(np.repeat([np.pi, np.pi * arm.reach], 3), (frames, 1))
    return {
        "position": (low - slack, high + slack),
        "velocity": (-velocity, velocity),
        "command": (low.copy(), high.copy()),
        "position_error": (-span, span),
        "approach": (-np.ones_like(span), np.ones_like(span)),
        "pose_error": (-twist, twist),
    }


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
    """The state of one episode after a control step, or of many with leading axes; without the state in MuJoCo."""

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
        """Info of one episode: ``success``, ``distance`` [m], ``angle`` [rad]; and ``failure``, the reason for one."""
        info = {"success": bool(self.success), "distance": float(self.distance), "angle": float(self.angle)}
        return info | {"failure": self.failure} if self.failure else info


class Observations:
    """Computes rows that hold all observations of a task, clipped to their bounds.

    Clipping and copying a whole row takes as long as it would for a single one of its arrays. The bounds are those of
    `common_bounds`, followed by those of a task's additional observations.
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
        # Views are kept, since getting one from MuJoCo takes as long as reading it.
        self._positions, self._rotations = data.xpos, data.xmat

    def __call__(self) -> Floats:
        """Return the frames at the data's positions in a new array."""
        mujoco.mj_kinematics(self._model, self._data)
        return self._rows(self._positions, self._rotations)

    def at(self, qpos: Floats) -> Floats:
        """Frames ``(B, F, 16)`` at MuJoCo's positions ``(B, nq)``, to which the data are set in turn."""
        # All bodies are copied, since selecting a few of them takes longer.
        return self._rows(*kinematics_along(self._model, qpos, "xpos", "xmat", data=self._data))

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

    The same as `lie.log`, in half its time for one frame, by MuJoCo's difference of quaternions and few calls.
    """
    twist = np.empty((*frames.shape[:-1], 6))
    ends = twist.reshape(-1, 6), goals.reshape(-1, 16), frames.reshape(-1, 16)
    for row, goal, own in zip(*ends, strict=True):
        mujoco.mju_subQuat(row[:3], goal[12:], own[12:])
    omega, place = twist[..., :3], goals[..., :3] - frames[..., :3]
    place = np.vecmat(place, frames[..., 3:12].reshape(*frames.shape[:-1], 3, 3))
    square, turn = np.vecdot(omega, omega), skew(omega)
    turned = np.matvec(turn, place)
    twist[..., 3:] = place - 0.5 * turned + bend(square)[..., None] * np.matvec(turn, turned)
    # Array methods would call the same reductions through Python.
    distance, angle = np.sqrt(np.vecdot(place, place)), np.sqrt(square)
    return twist, np.maximum.reduce(distance, axis=-1), np.maximum.reduce(angle, axis=-1)
