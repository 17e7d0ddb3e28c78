"""What the passive joints of an arm do while the arm follows a path by a time law, linearised.

The arm's own joints are where the law s(t) has them. With x the passive joints' distance from where they rest at s,

    M x'' + (D + G s') x' + (K + A s'' + C s'^2) x + a s'' + b s'^2 + d s' = 0,

whose coefficients are functions of s alone: forces of inverse dynamics, which are linear in accelerations and
quadratic in velocities, and their slopes. So all laws along one path share a table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.values import Floats

_STATIONS = 41  # of the table


def along(arm: Arm, path: Callable[[Floats, int], Floats]) -> tuple[CubicSpline, CubicSpline]:
    """Positions ``(nq,)`` of an arm's model along a path, and velocities ``(nv,)`` at unit s', over s.

    The path has joints ``(K, n)`` at fractions ``(K,)`` of its length, called as ``path(s, order)``.
    """
    s = np.linspace(0.0, 1.0, _STATIONS)
    return CubicSpline(s, arm.qpos(path(s, 0))), CubicSpline(s, arm.qvel(path(s, 0), path(s, 1)))


class SwingModel:
    """The passive joints of an arm along a path.

    Args:
        arm: the arm, which may have another load than the one that was planned for.
        qpos, rates: its path, as of `along`.

    Raises:
        NoSolutionError: as of `PassiveJoints.at_rest`.
    """

    def __init__(self, arm: Arm, qpos: CubicSpline, rates: CubicSpline) -> None:
        passive, s = PassiveJoints(arm), np.linspace(0.0, 1.0, _STATIONS)
        self._m = m = len(passive.dofs)
        rest = passive.at_rest(qpos(s))
        stiffness, damping, inertia = (passive.slopes(of, rest) for of in ("position", "velocity", "acceleration"))
        # Where it rests moves along the path so that no force arises.
        hanging, step = passive.away(rest, qpos(s)), 1e-5
        ahead, behind = (passive.forces(passive.moved(qpos(s + side), hanging)) for side in (step, -step))
        shift = -np.matvec(np.linalg.pinv(stiffness, rcond=1e-6), ahead - behind) / (2.0 * step)
        speeds, bends = rates(s), rates(s, 1)
        speeds[:, passive.dofs], bends[:, passive.dofs] = shift, CubicSpline(s, shift)(s, 1)
        still, ahead, behind = (passive.forces(rest, sign * speeds, sign**2 * bends) for sign in (0.0, 1.0, -1.0))
        # Slopes over x and x', and the forces at rest, of what is constant, and of what grows with s', s'^2 and s''.
        table = np.zeros((_STATIONS, 4, m, 2 * m + 1))
        table[:, 0, :, :m], table[:, 0, :, m:-1] = stiffness, damping
        table[:, 1, :, m:-1] = passive.slopes("velocity", rest, speeds) - damping
        table[:, 1, :, -1] = 0.5 * (ahead - behind)
        table[:, 2, :, :m] = passive.slopes("position", rest, speeds, bends) - stiffness
        table[:, 2, :, -1] = 0.5 * (ahead + behind) - still
        table[:, 3, :, :m] = passive.slopes("position", rest, 0.0, speeds) - stiffness
        table[:, 3, :, -1] = passive.forces(rest, 0.0, speeds) - still
        self._table, self._inertia = CubicSpline(s, table), CubicSpline(s, inertia)
        # Half squares of these are the energies left at the end.
        curvature, axes = np.linalg.eigh(0.5 * (stiffness[-1] + stiffness[-1].T))
        self._scales = np.sqrt(np.maximum(curvature, 0.0))[:, None] * axes.T, np.linalg.cholesky(inertia[-1]).T

    def _left(self, x: Floats, v: Floats) -> Floats:
        """Displacements and velocities ``(m, ...)`` at the end as of `left`."""
        return np.concatenate([scale @ part for scale, part in zip(self._scales, (x, v), strict=True)])

    def left(self, step: float, law: Sequence[Floats]) -> tuple[Floats, Floats]:
        """What a law leaves ``(2 m,)``, whose squares are twice energies, and its slopes ``(2 m, N)`` over N changes.

        The law is s, s' and s'', each ``(K, 1 + N)`` with the changes, at a time step [s]; by the rule of trapezoids.
        """
        (s, more), (rate, more_rate), (bend, more_bend) = ((part[:, 0], part[:, 1:]) for part in law)
        one, none, m = np.ones_like(s), np.zeros_like(s), self._m
        table, inertia = self._table(s), self._inertia(s)

        def sums(*drives: Floats, of: Floats = table) -> Floats:
            return np.einsum("kj,kjab->kab", np.stack(drives, axis=1), of)

        whole = sums(one, rate, rate**2, bend)
        equation = step, inertia, whole[..., m:-1], whole[..., :m]
        x, v, acceleration = (each[..., 0] for each in _trapezoids(*equation, -whole[..., -1:]))
        state = np.concatenate([x, v, one[:, None]], axis=1)
        over_s = np.matvec(sums(one, rate, rate**2, bend, of=self._table(s, 1)), state)
        over_s += np.matvec(self._inertia(s, 1), acceleration)
        over_rate = np.matvec(sums(none, one, 2.0 * rate, none), state)
        over_bend = np.matvec(sums(none, none, none, one), state)
        changes = ((over_s, more), (over_rate, more_rate), (over_bend, more_bend))
        force = -sum(slope[:, :, None] * change[:, None, :] for slope, change in changes)
        slopes = _trapezoids(*equation, force)
        return self._left(x[-1], v[-1]), self._left(slopes[0][-1], slopes[1][-1])


def _trapezoids(
    step: float, inertia: Floats, damping: Floats, stiffness: Floats, force: Floats
) -> tuple[Floats, Floats, Floats]:
    """Solutions x, x', x'' ``(K, m, N)`` from rest of M x'' + D x' + K x = F with matrices ``(K, m, m)``."""
    inverse = np.linalg.inv(inertia + 0.5 * step * damping + 0.25 * step**2 * stiffness)
    x, v, acceleration = (np.zeros_like(force) for _ in range(3))
    acceleration[0] = np.linalg.solve(inertia[0], force[0])
    for k in range(1, len(force)):
        speed = v[k - 1] + 0.5 * step * acceleration[k - 1]
        place = x[k - 1] + step * v[k - 1] + 0.25 * step**2 * acceleration[k - 1]
        acceleration[k] = inverse[k] @ (force[k] - damping[k] @ speed - stiffness[k] @ place)
        v[k] = speed + 0.5 * step * acceleration[k]
        x[k] = place + 0.25 * step**2 * acceleration[k]
    return x, v, acceleration
