"""The best diagonal Lyapunov matrix by the method of centres, which needs only NumPy and has no local minima.

A level lambda is feasible when some positive diagonal P makes F(P) = 2 lambda P - P W - W^T P positive definite. F is
linear in P, so the set of such P is convex, with the barrier -log det F. Its analytic centre, the minimum of the
barrier within bounds on P, is found by Newton's method, and leaves room to lower lambda; so centre and level follow
each other down to the least lambda (Boyd and El Ghaoui, Linear Algebra and its Applications 188, 1993). Each lowering
first follows the tangent of the path of centres, which saves most of the Newton steps.

In relative changes d of P the barrier's derivatives need three products of matrices. With M = S W S^-1, S = P^(1/2),
A = lambda I - M and G = (A + A^T)^-1 the gradient is -2 (A G)_ii, the Hessian 2 (G o (A G A^T) + (A G) o (A G)^T), o
entry by entry, and the gradient's derivative in lambda -2 (G - 2 A G G)_ii.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim.stability.norms import scale
from lieednn_sim.values import Floats

_LOG_SCALE_BOUND = 8.0  # exp(+-_LOG_SCALE_BOUND) bounds S, so that S W S^-1 stays accurate
_LEAST, _MOST = np.exp(-2.0 * _LOG_SCALE_BOUND), np.exp(2.0 * _LOG_SCALE_BOUND)


def minimise_by_centres(weight: Floats, group_size: int, start: Floats) -> Floats:
    """Log S ``(n / group_size,)`` that makes the largest eigenvalue of sym(S W S^-1) smallest, with |log S| <= 8.

    Nothing about it is guaranteed: pass it to `stability.verify`. Entries of S are equal within consecutive groups of
    ``group_size``. Of the initial log S, ``start``, a common factor is removed, and the rest is clipped to the bounds.
    """
    inside = 0.99 * _LOG_SCALE_BOUND
    start = np.clip(start - start.mean(), -inside, inside)
    magnitude = float(np.linalg.norm(scale(weight, np.repeat(start, group_size)), 2))
    if magnitude == 0.0 or len(start) == 1:
        return start
    search = _CentreSearch(weight / magnitude, group_size)
    entries = np.exp(2.0 * start)
    # Gaps above the eigenvalue are in units of |S W S^-1|_2; in the end it is within about n gaps of the least.
    level = search.largest(entries) + 0.03
    try:
        for _ in range(100):
            entries, hessian, slope = search.centre(entries, level)
            gap = level - search.largest(entries)
            if not gap > 1e-8:
                break
            tangent = np.asarray(np.linalg.solve(hessian, slope), np.float64)
            entries, level = search.lower(entries, tangent, level, gap)
    except np.linalg.LinAlgError:
        pass  # so near the least level that F is singular up to rounding
    return 0.5 * np.log(search.best)


class _CentreSearch:
    """The steps of the search, and the best diagonal so far."""

    def __init__(self, weight: Floats, group_size: int) -> None:
        self._weight, self._size = weight, group_size
        self._least = np.inf
        self.best = np.ones(len(weight) // group_size)

    def largest(self, entries: Floats) -> float:
        """Largest eigenvalue of sym(S W S^-1) for the entries ``(g,)`` of P."""
        scaled = self._scaled(entries)
        value = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1])
        if value < self._least:
            self._least, self.best = value, entries
        return value

    def centre(self, entries: Floats, level: float) -> tuple[Floats, Floats, Floats]:
        """The analytic centre of a level feasible for ``entries``, the Hessian there and the gradient's rate in it."""
        for _ in range(30):
            a = level * np.eye(len(self._weight)) - self._scaled(entries)
            g = np.linalg.inv(a + a.T)
            ag = a @ g
            low, high = entries / (entries - _LEAST), entries / (_MOST - entries)
            gradient = self._summed(-2.0 * np.diag(ag)) - low + high
            second = 2.0 * (g * (ag @ a.T) + ag * ag.T)
            hessian = self._summed(self._summed(second).T) + np.diag(low**2 + high**2)
            direction = -np.linalg.solve(hessian, gradient)
            decrement = float(np.sqrt(max(-gradient @ direction, 0.0)))
            if not decrement > 0.3:  # the barrier can then fall by no more than about half the square
                break
            # The damped step of a self-concordant function never leaves its domain.
            entries = entries * (1.0 + direction / (1.0 + decrement))
        return entries, hessian, self._summed(-2.0 * np.diag(g - 2.0 * ag @ g))

    def lower(self, entries: Floats, tangent: Floats, level: float, gap: float) -> tuple[Floats, float]:
        """Entries and level further down the path of centres: most of the longest feasible step along the tangent."""
        step = 64.0 * gap
        while step > 0.5 * gap and not self._has(entries * (1.0 + step * tangent), level - step):
            step *= 0.6
        moved, lower = entries * (1.0 + 0.8 * step * tangent), level - 0.8 * step
        if step > 0.5 * gap and self._has(moved, lower):
            return moved, lower
        return entries, level - 0.9 * gap  # without a step the level falls by less than the gap

    def _has(self, entries: Floats, level: float) -> bool:
        within = bool(entries.min() > _LEAST and entries.max() < _MOST)
        return within and self.largest(entries) < level

    def _scaled(self, entries: Floats) -> Floats:
        return scale(self._weight, np.repeat(0.5 * np.log(entries), self._size))

    def _summed(self, values: Floats) -> Floats:
        """Sums over each group of the first axis."""
        return values.reshape(-1, self._size, *values.shape[1:]).sum(axis=1)
