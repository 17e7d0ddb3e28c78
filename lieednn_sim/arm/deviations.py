"""Deviations of the links' twists, and how far the joints may move if deviated twists are projected onto them.

`Deviations` is a set: each link's twist (omega, v) is off by at most a turn in omega and a shift in v, about each of K
states. Every bound here is a Lipschitz constant on a ball, proved as follows. On the ball the derivative of the
projection is bounded under the assumption that the coordinates change by at most some amount; if the bound then says
that they change by less, they cannot have left that amount on the straight way to any state of the ball. If the
argument fails, since the nearest configuration may jump, the bound is infinite. For turns and shifts of the poses see
step 3 of `docs/mathematics/tube.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm.nearest import NearestPose
from lieednn_sim.lie import exp
from lieednn_sim.values import Floats

# Coordinates, by their indices in q, and weights: bounds are of the Euclidean norm of weights times their changes.
Group = tuple[NDArray[np.int_], Floats]


@dataclass(frozen=True, eq=False)
class Deviations:
    """Sets of deviations of an arm's links about K states."""

    twist: Floats  # (K, N, 6) the links' twists [rad, m]
    q: Floats  # (K, n) the joint position onto which they are projected [rad, m]
    size: Floats  # (N, 2) largest turn [rad] and shift [m] of each link
    slack: Floats  # (K, N, 2) how far the state itself may be from the given one, in addition
    # What was computed for these states, whatever the size; `dataclasses.replace` hands it over.
    known: dict[Any, Any] = field(default_factory=dict)

    @property
    def turn(self) -> Floats:
        """``(N,)`` largest angle between the rotations of a state and of a deviated one."""
        return self.size[:, 0]

    @property
    def shift(self) -> Floats:
        """``(K, N)`` largest distance between their translations [m]."""
        return self.size[:, 1] + 0.5 * self._longest * self.turn

    @property
    def wide(self) -> Floats:
        """``(K, N)`` largest angle between the given rotation and any in the ball, slack included."""
        return self.turn + self.slack[..., 0]

    @property
    def far(self) -> Floats:
        """``(K, N)`` the same for translations [m]."""
        return self.size[:, 1] + self.slack[..., 1] + 0.5 * self._longest * self.wide

    @cached_property
    def angle(self) -> Floats:
        """``(K, N)`` largest |omega| in the ball."""
        return np.asarray(np.linalg.norm(self.twist[..., :3], axis=-1) + self.wide)

    @cached_property
    def _longest(self) -> Floats:
        """``(K, N)`` largest |v| in the ball."""
        return np.asarray(np.linalg.norm(self.twist[..., 3:], axis=-1) + self.size[:, 1] + self.slack[..., 1])


def spread_of_nearest(problem: NearestPose, links: NDArray[np.int_], deviations: Deviations, offset: Floats) -> Floats:
    """Bounds ``(K,)`` of |W dq| for least squares (`NearestPose`), W = 1 for angles and 1 / length for slides.

    The minimiser obeys dq = H^-1 J^T dY with the Jacobian J of the stacked poses F, the Hessian H of half the squared
    distance |F - Y|^2, and the goal Y, which moves on a straight line, |dY|^2 <= sum of turn^2 + (shift / length)^2. On
    the way the distance grows by at most |dY|, and the least singular value of J falls from j to no less than
    j' = j - M2 rho, when the coordinates change by at most rho and M2 bounds the second derivative of F. So

        |H - J^T J| <= e = M2 (|F - Y| + |dY|)    and    |H^-1 J^T| <= j' / (j'^2 - e).

    In a chain of T hinges and S slides with lever arms of at most l lengths, a derivative by an inner hinge is a cross
    product with its axis, and one by an inner slide is zero: the second derivative of a rotation in a direction of
    length 1 is at most T, that of a translation T l + (T S)^(1/2), and M2 the root of the sum of their squares over
    all links. The bound is infinite for ball joints and coupled hinges, and where H may become singular.

    The bound is for the minimum that is connected with the given one; a search may find another, lower one.

    The problem has the links ``(m,)``, and its coordinates the displacements ``offset`` ``(K, c)`` at the given states.
    """
    turning, sliding = problem.counts
    length, count = problem.length, len(links)
    if not np.isfinite(turning):
        return np.full(len(offset), np.inf)
    if (key := tuple(links)) not in deviations.known:
        given = exp(deviations.twist[:, links]).as_matrix()
        deviations.known[key] = problem.firmness(offset, given[..., :3, :3], given[..., :3, 3])
    least, residual, gradient, lever = deviations.known[key]

    def size(turn: Floats, shift: Floats) -> Floats:
        both = np.square(turn[..., links]) + np.square(shift[..., links] / length)
        return np.asarray(np.sqrt(both.sum(axis=-1)))

    moved = size(np.broadcast_to(deviations.turn, deviations.shift.shape), deviations.shift)
    goal = size(deviations.wide, deviations.far)

    def gain(rho: Floats) -> Floats:
        """|dW q| / |dY| for changes of the coordinates up to ``rho``; infinite where the argument fails."""
        room = 1.0 - rho * np.sqrt(turning)
        longest = (lever + rho * np.sqrt(sliding)) / np.maximum(room, 1e-3)
        second = np.sqrt(count * (turning**2 + (turning * longest + np.sqrt(turning * sliding)) ** 2))
        firm = np.maximum(least - second * rho, 0.0)
        left = firm**2 - second * (residual + goal)
        # With a larger gradient the given configuration is no minimum.
        fails = (left <= 0.0) | (room <= 0.0) | (gradient > 1e-5)
        return np.where(fails, np.inf, firm / np.where(fails, 1.0, left))

    # The least changes that the bound does not exceed, found from below.
    rho = np.zeros(len(offset))
    for _ in range(8):
        rho = np.minimum(1.02 * gain(rho) * goal, 1e3)
    result = gain(rho)
    return np.where(result * goal <= rho, result * moved, np.inf)
