"""References for controllers at the simulation's steps, which may be known only in part."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

_Steps = TypeVar("_Steps", int, NDArray[np.int_])
# Number of steps computed at once: more would gain little, and their data would not stay in the cache.
AHEAD = 256


class Reference:
    """Joint positions and velocities; row k is for the time k * timestep.

    Rows become known by `extend`: all at once for a motion, step by step for a target that is followed while it moves.
    Beyond the last row the motion continues with its last velocity.

    A held reference is sampled every ``hold`` rows, and keeps its value in between.

    Attributes:
        q: ``(K, n)`` joint coordinates [rad, m].
        qd: ``(K, n)`` their rates [rad/s, m/s].
        qpos: ``(K, nq)`` positions in MuJoCo's coordinates.
        qvel: ``(K, nv)`` velocities in MuJoCo's coordinates.
        timestep: time between rows [s].
        hold: number of rows for which a sample is held; 1 if every row is a sample.
        known: number of known rows.
        revision: counter that increases when rows become known.
    """

    def __init__(self, arm: Arm, rows: int, *, hold: int = 1) -> None:
        self._arm, self._model = arm, arm.model
        self.timestep = arm.timestep
        self.hold = hold
        self.known = self.revision = 0
        self.q, self.qd = np.zeros((rows, arm.n_joints)), np.zeros((rows, arm.n_joints))
        self.qpos, self.qvel = np.zeros((rows, arm.model.nq)), np.zeros((rows, arm.model.nv))

    @classmethod
    def of(cls, arm: Arm, q: ArrayLike, qd: ArrayLike, *, hold: int = 1) -> Reference:
        """A reference of which all rows ``(K, n)`` are known."""
        positions = as_floats("q", q, ("K", arm.n_joints))
        reference = cls(arm, len(positions), hold=hold)
        reference.extend(positions, as_floats("qd", qd, positions.shape))
        return reference

    def extend(self, q: Floats, qd: Floats) -> None:
        """Make the next rows ``(m, n)`` known; rows beyond the last one are dropped."""
        count = min(len(q), len(self.q) - self.known)
        rows = slice(self.known, self.known + count)
        self.q[rows], self.qd[rows] = q[:count], qd[:count]
        self.qpos[rows], self.qvel[rows] = self._arm.qpos(q[:count]), self._arm.qvel(q[:count], qd[:count])
        self.known += count
        self.revision += 1

    def forget(self, count: int) -> None:
        """Drop the first known rows, as many as ``count``: what was row k becomes row k - count."""
        for rows in (self.q, self.qd, self.qpos, self.qvel):
            rows[: self.known - count] = rows[count : self.known].copy()
        self.known -= count
        self.revision += 1

    def row(self, step: _Steps) -> _Steps:
        """The row that a controller sees at a step, or the rows of an array of steps."""
        return step - step % self.hold

    def rates_at(self, rows: NDArray[np.int_]) -> Floats:
        """Velocities and accelerations ``(2, m, nv)`` with which semi-implicit steps land on ascending rows exactly.

        q_{k+1} = q_k (+) h v_{k+1} and v_{k+1} = v_k + h a_k, from rest, where (+) is MuJoCo's integration of
        positions: quaternions turn by the exponential map.
        """
        velocity, at = self._velocities(np.arange(rows[0], rows[-1] + 2)), rows - rows[0]
        return np.stack([velocity[at], (velocity[at + 1] - velocity[at]) / self.timestep])

    def ahead(self, steps: range, lead: float) -> Floats:
        """Positions ``(m, nq)`` a time ``lead`` [s] after the rows seen at some steps; cubic between rows."""
        last, at = self.known - 1, self.row(np.array(steps)) + lead / self.timestep
        k = np.floor(at + 1e-6).astype(int)
        qpos = self.qpos[np.minimum(k, last)]
        if (beyond := k >= last).any():
            time = (at[beyond] - last) * self.timestep
            qpos[beyond] = self._arm.qpos(self.q[last] + time[:, None] * self.qd[last])
        if (between := ~beyond & (at - k > 1e-6)).any():
            rows = np.arange(k[between][0], k[between][-1] + 2)
            cubic = CubicHermiteSpline(self.timestep * rows, self.q[rows], self.qd[rows])
            qpos[between] = self._arm.qpos(cubic(self.timestep * at[between]))
        return qpos

    def _velocities(self, rows: NDArray[np.int_]) -> Floats:
        """Velocities ``(m, nv)`` that lead from the preceding rows to the given ones; zero for the first row."""
        k = np.minimum(rows, self.known - 1)
        before, now = self.qpos[np.maximum(k - 1, 0)], self.qpos[k]
        if self._model.nq == self._model.nv:
            return (now - before) / self.timestep
        velocity = np.zeros((len(rows), self._model.nv))
        for i in np.flatnonzero(k):
            mujoco.mj_differentiatePos(self._model, velocity[i], self.timestep, before[i], now[i])
        return velocity


def runs(rows: Floats) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """The indices at which runs of equal rows ``(m, ...)`` begin, and the number of each row's run ``(m,)``."""
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.flatnonzero(new), np.cumsum(new) - 1


class Foreseen:
    """Rows, one per step, that depend on a reference; they are computed many steps ahead, until more of it is known."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self._revision, self._steps = -1, range(0)
        self._rows: Any = ()

    def row(self, step: int, make: Callable[[range], Any]) -> Any:
        """The row of a step; ``make`` computes the rows of a range of steps, an array or a list."""
        reference = self._reference
        if self._revision != reference.revision or step not in self._steps:
            # The last known row serves as the goal of the step before it.
            end = max(min(step + AHEAD, reference.known - 1), step + 1)
            self._revision, self._steps = reference.revision, range(step, end)
            self._rows = make(self._steps)
        return self._rows[step - self._steps.start]


def interpolator(period: float, steps: int) -> Callable[[Floats, Floats, Floats, Floats], tuple[Floats, Floats]]:
    """A function from q, qd ``(n,)`` at both ends of a control period [s] to q and qd ``(m, n)`` after each of m steps.

    It is a cubic polynomial.
    """
    ends, times = np.eye(4), period * np.arange(1, steps + 1) / steps
    spline = CubicHermiteSpline([0.0, period], ends[[0, 2]], ends[[1, 3]])
    factors = np.concatenate([spline(times), spline(times, 1)])

    def between(*given: Floats) -> tuple[Floats, Floats]:
        rows = factors @ np.array(given)
        return rows[:steps], rows[steps:]

    return between
