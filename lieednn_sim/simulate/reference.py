"""What a controller is to follow, at the simulation's steps, and as much of it as is known at each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats, as_positive

Floats = NDArray[np.float64]


class Reference:
    """Joint positions and velocities, row k for the time k * timestep.

    Rows become known by `extend`: all at once for a motion, bit by bit for a target that is followed while it moves.
    Beyond the last one the motion goes on with its last velocity.

    A held reference is sampled every so-many-th row, and a controller that asks at a row between sees the sample.

    Attributes:
        q: ``(K, n)`` joint coordinates [rad, m].
        qd: ``(K, n)`` their rates [rad/s, m/s].
        qpos: ``(K, nq)`` the same in MuJoCo's coordinates.
        qvel: ``(K, nv)``.
        timestep: [s].
        hold: rows for which a sample is held, 1 for all rows of its own.
        known: number of rows that are known.
    """

    def __init__(self, arm: Arm, rows: int, *, hold: int = 1) -> None:
        self._arm, self._model = arm, arm.model
        self.timestep = float(arm.model.opt.timestep)
        self.hold = hold
        self.known = 0
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
        """Make the next rows ``(m, n)`` known; what does not fit is dropped."""
        count = min(len(q), len(self.q) - self.known)
        rows = slice(self.known, self.known + count)
        self.q[rows], self.qd[rows] = q[:count], qd[:count]
        self.qpos[rows], self.qvel[rows] = self._arm.qpos(q[:count]), self._arm.qvel(q[:count], qd[:count])
        self.known += count

    def row(self, step: int) -> int:
        """The row that a controller sees at a step."""
        return step - step % self.hold

    def rates(self, step: int) -> tuple[Floats, Floats]:
        """Velocity and acceleration ``(nv,)`` with which semi-implicit steps land on every position exactly.

        q_{k+1} = q_k (+) h v_{k+1} and v_{k+1} = v_k + h a_k, from rest, where (+) is MuJoCo's integration of
        positions: quaternions turn by the exponential map.
        """
        k = self.row(step)
        velocity, ahead = self._velocity(k), self._velocity(k + 1)
        return velocity, (ahead - velocity) / self.timestep

    def ahead(self, step: int, lead: float) -> Floats:
        """Position ``(nq,)`` a time ``lead`` [s] after what is seen at a step, by cubic interpolation between rows."""
        at = self.row(step) + lead / self.timestep
        k = int(np.floor(at + 1e-6))
        share = max(at - k, 0.0) if at - k > 1e-6 else 0.0
        last = self.known - 1
        if k >= last:
            q = self.q[last] + (at - last) * self.timestep * self.qd[last]
            return self._arm.qpos(q)
        if share == 0.0:
            return self.qpos[k]
        s, rest = share, 1.0 - share
        q = rest**2 * ((1.0 + 2.0 * s) * self.q[k] + s * self.timestep * self.qd[k])
        q += s**2 * ((1.0 + 2.0 * rest) * self.q[k + 1] - rest * self.timestep * self.qd[k + 1])
        return self._arm.qpos(q)

    def _velocity(self, k: int) -> Floats:
        velocity = np.zeros(self._model.nv)
        k = min(k, self.known - 1)
        if k > 0:
            mujoco.mj_differentiatePos(self._model, velocity, self.timestep, self.qpos[k - 1], self.qpos[k])
        return velocity


def steps_in(what: str, period: float, timestep: float) -> int:
    """Number of simulation steps in a control period [s], or `InputError` when it is no whole number."""
    ratio = as_positive(what, period) / timestep
    if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise InputError(
            f"{what} must be a whole number of simulation steps of {timestep:g} s, got {period:g} s = {ratio:.6g} steps"
        )
    return round(ratio)


def steps_of_rate(what: str, rate: float, timestep: float) -> int:
    """The same for a control rate [Hz], which must divide the rate of the simulation."""
    ratio = 1.0 / (as_positive(what, rate) * timestep)
    if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise InputError(
            f"{what} must divide the simulation's {1.0 / timestep:.6g} Hz, got {rate:g} Hz; "
            f"for example {1.0 / (timestep * max(1, round(ratio))):.6g} Hz"
        )
    return round(ratio)
