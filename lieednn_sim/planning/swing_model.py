"""A linear model of the passive joints of an arm while the arm follows a path by a time law.

The arm's own joints are where the law s(t) puts them. Let x be the passive joints' displacement from their rest at s:

    M x'' + (D + G s') x' + (K + A s'' + C s'^2) x + a s'' + b s'^2 + d s' = 0.

The coefficients are functions of s alone: forces of inverse dynamics, which are linear in accelerations and quadratic
in velocities, and their slopes. So all laws along one path share one table of coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from lieednn_sim.arm import Arm, Mode
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.values import Floats

_INSTANTS = 401  # at which the path is known
_STATIONS = 41  # of the table


def longest_step(modes: Sequence[Mode]) -> float:
    """The longest time step with which the given modes are integrated accurately enough [s]."""
    return min(0.1 / modes[0].frequency, 0.3 / modes[-1].frequency) / (2.0 * np.pi)


class SwingModel:
    """The passive joints of an arm along a path, with each of L loads.

    Args:
        arms: the arm, and the same arm with the other loads (`with_load`).
        path: joints ``(K, n)`` and their slopes at parameters ``(K,)`` in [0, 1], called as ``path(s, order)``.

    Raises:
        NoSolutionError: as for `PassiveJoints.at_rest`.
    """

    def __init__(self, arms: Sequence[Arm], path: Callable[[Floats, int], Floats]) -> None:
        self._passive, fine = PassiveJoints(arms[0]), np.linspace(0.0, 1.0, _INSTANTS)
        self._m, s, q = len(self._passive.dofs), np.linspace(0.0, 1.0, _STATIONS), path(fine, 0)
        rates = arms[0].qvel(q, path(fine, 1))
        self._qpos, way = CubicSpline(fine, arms[0].qpos(q)), CubicSpline(fine, rates)
        tables, hanging, shifts = zip(*(self._along(PassiveJoints(arm), way) for arm in arms), strict=True)
        self._table, self._hanging = CubicSpline(s, np.stack(tables, axis=1)), CubicSpline(s, hanging[0])
        rates[:, self._passive.dofs] = CubicSpline(s, shifts[0])(fine)
        self._rates = CubicSpline(fine, rates)
        # Half the squares of the scaled states are the energies left at the end.
        stiffness, inertia = (self._table(1.0)[:, part, :, : self._m] for part in (0, 4))
        curvature, axes = np.linalg.eigh(0.5 * (stiffness + np.swapaxes(stiffness, 1, 2)))
        self._scales = np.zeros((len(arms), 2 * self._m, 2 * self._m))
        roots = np.sqrt(np.maximum(curvature, 0.0))[:, :, None] * np.swapaxes(axes, 1, 2)
        self._scales[:, : self._m, : self._m] = roots
        self._scales[:, self._m :, self._m :] = np.swapaxes(np.linalg.cholesky(inertia), 1, 2)

    def _along(self, passive: PassiveJoints, rates: CubicSpline) -> tuple[Floats, Floats, Floats]:
        """The table ``(S, 5, m, 2 m + 1)`` of a load, its position of rest ``(S, m)``, and the rate of that at unit s'.

        The table has slopes of forces over x and x', and the forces at rest: of what is constant, and of what grows
        with s', s'^2 and s''; and at last the inertia.
        """
        s, m, qpos = np.linspace(0.0, 1.0, _STATIONS), self._m, self._qpos
        rest = passive.at_rest(qpos(s))
        stiffness, damping, inertia = (passive.slopes(of, rest) for of in ("position", "velocity", "acceleration"))
        # The position of rest moves along the path such that no force arises.
        hanging, step = passive.away(rest, qpos(s)), 1e-5
        ahead, behind = (passive.forces(passive.moved(qpos(s + side), hanging)) for side in (step, -step))
        shift = -np.matvec(np.linalg.pinv(stiffness, rcond=1e-6), ahead - behind) / (2.0 * step)
        speeds, bends = rates(s), rates(s, 1)
        speeds[:, passive.dofs], bends[:, passive.dofs] = shift, CubicSpline(s, shift)(s, 1)
        still, ahead, behind = (passive.forces(rest, sign * speeds, sign**2 * bends) for sign in (0.0, 1.0, -1.0))
        table = np.zeros((_STATIONS, 5, m, 2 * m + 1))
        table[:, 0, :, :m], table[:, 0, :, m:-1], table[:, 4, :, :m] = stiffness, damping, inertia
        table[:, 1, :, m:-1] = passive.slopes("velocity", rest, speeds) - damping
        table[:, 1, :, -1] = 0.5 * (ahead - behind)
        table[:, 2, :, :m] = passive.slopes("position", rest, speeds, bends) - stiffness
        table[:, 2, :, -1] = 0.5 * (ahead + behind) - still
        table[:, 3, :, :m] = passive.slopes("position", rest, 0.0, speeds) - stiffness
        table[:, 3, :, -1] = passive.forces(rest, 0.0, speeds) - still
        return table, hanging, shift

    def swing(self, law: CubicHermiteSpline, step: float, after: float) -> tuple[Floats, Floats, Floats]:
        """How the first load swings while the arm follows a law of time, and for some time after it [s].

        The linear model's motion is corrected twice, by its response to the forces that it lacks by MuJoCo's inverse
        dynamics. The error left is of second order in the second correction, its estimate.

        Returns:
            Times ``(K,)`` in about equal steps [s], positions ``(K, nq)``, and largest last corrections ``(K, m)``.
        """
        end = float(law.x[-1])
        t = np.linspace(0.0, end + after, 2 + int((end + after) / step))
        step, m = float(t[1]), self._m
        middle = np.minimum(t[1:] - 0.5 * step, end)
        s, rate, bend = (law(middle, k) * (k == 0 or middle < end) for k in range(3))
        drives = np.stack([np.ones_like(s), rate, rate**2, bend], axis=1)
        change, push, force = self._steps(step, self._table(s)[:, :1], drives)
        states = _marched(change, np.matvec(push, force))[:, 0]
        for _ in range(2):  # corrections of the linear model's motion
            missing = self._missing(step, (s, rate, bend), states)
            correction = _marched(change, np.matvec(push, -missing))[:, 0]
            states = states + correction
        off = np.maximum.accumulate(abs(correction[:, :m]))
        return t, self.hung(law(np.minimum(t, end)), states[:, :m]), off

    def hung(self, s: Floats, away: Floats | float = 0.0) -> Floats:
        """Positions ``(K, nq)`` along the path, with the first load ``away`` ``(K, m)`` from where it rests."""
        return self._passive.moved(self._qpos(s), self._hanging(s) + away)

    def _missing(self, step: float, law: Sequence[Floats], states: Floats) -> Floats:
        """Forces ``(K, 1, m)`` missing for the first load to have states ``(K + 1, 2 m)``, in the steps [s] between."""
        (s, rate, bend), passive, m = law, self._passive, self._m
        place, speed = np.split(0.5 * (states[1:] + states[:-1]), 2, axis=1)
        velocities = self._rates(s) * rate[:, None]
        accelerations = self._rates(s, 1) * rate[:, None] ** 2 + self._rates(s) * bend[:, None]
        velocities[:, passive.dofs] += speed
        accelerations[:, passive.dofs] += np.diff(states[:, m:], axis=0) / step
        return passive.forces(self.hung(s, place), velocities, accelerations)[:, None]

    def _steps(self, step: float, table: Floats, drives: Floats) -> tuple[Floats, Floats, Floats]:
        """The time steps [s] of the implicit midpoint rule for x and x'.

        The mean x' of a step is S (M x' + (F - K x) step / 2) with S = (M + D step / 2 + K step^2 / 4)^-1. Returns the
        matrices ``(K, L, 2 m, 2 m)`` that map x and x' over each step, those ``(K, L, 2 m, m)`` that map a force F in
        it to a change of x and x', and the forces ``(K, L, m)``.
        """
        m, inertia = self._m, table[:, :, 4, :, : self._m]
        whole = np.einsum("kj,kljab->klab", drives, table[:, :, :4])
        stiffness, damping = whole[..., :m], whole[..., m:-1]
        solved = np.linalg.inv(inertia + 0.5 * step * damping + 0.25 * step**2 * stiffness)
        mean, push = solved @ np.concatenate([-0.5 * step * stiffness, inertia], axis=-1), 0.5 * step * solved
        change = np.concatenate([step * mean, 2.0 * mean], axis=-2) + np.diag(np.repeat([1.0, -1.0], m))
        return change, np.concatenate([step * push, 2.0 * push], axis=-2), -whole[..., -1]

    def left(self, step: float, law: Sequence[Floats], *, corrected: bool = False) -> tuple[Floats, Floats]:
        """Scaled states ``(L, 2 m)`` at the end of a law, whose squares are twice energies, and slopes ``(L, 2 m, N)``.

        The law is s, s' and s'' in the middle of K time steps [s], each ``(K, 1 + N)`` with the N changes.
        The states can be ``corrected`` as in `swing`, once and by the first load's forces; the slopes are not.
        """
        (s, more), (rate, more_rate), (bend, more_bend) = ((part[:, 0], part[:, 1:]) for part in law)
        one, none, m, table, slope = np.ones_like(s), np.zeros_like(s), self._m, self._table(s), self._table(s, 1)
        drives = np.stack([one, rate, rate**2, bend], axis=1)
        change, push, force = self._steps(step, table, drives)
        states = _marched(change, np.matvec(push, force))
        ending = states[-1]
        if corrected:
            ending = ending + _marched(change, np.matvec(push, -self._missing(step, (s, rate, bend), states[:, 0])))[-1]
        middle, accelerated = 0.5 * (states[1:] + states[:-1]), np.diff(states[..., m:], axis=0) / step
        state = np.concatenate([middle, np.ones_like(middle[..., :1])], axis=-1)
        # How a force in each step changes the states at the end, found backwards in time.
        onward = np.empty_like(change)
        onward[-1] = self._scales
        for k in range(len(change) - 1, 0, -1):
            np.matmul(onward[k], change[k], out=onward[k - 1])
        onward = onward @ push
        slopes = np.zeros((*states[0].shape, more.shape[1]))
        rates, bends = np.stack([none, one, 2.0 * rate, none], axis=1), np.stack([none, none, none, one], axis=1)
        parts = ((slope, drives, more), (table, rates, more_rate), (table, bends, more_bend))
        for k, (of, by, changed) in enumerate(parts):
            over = np.einsum("kj,kljab,klb->kla", by, of[:, :, :4], state, optimize=True)
            if k == 0:
                over += np.matvec(of[:, :, 4, :, :m], accelerated)
            slopes -= np.tensordot(np.matvec(onward, over), changed, axes=(0, 0))
        return np.matvec(self._scales, ending), slopes


def _marched(change: Floats, push: Floats) -> Floats:
    """States z ``(K + 1, L, n)`` from zero on with ``z[k + 1] = change[k] z[k] + push[k]``."""
    states = np.zeros((len(push) + 1, *push.shape[1:]))
    for k, (matrix, more) in enumerate(zip(change, push, strict=True)):
        states[k + 1] = np.matvec(matrix, states[k]) + more
    return states
