"""Levenberg-Marquardt descent on the distance of a cascade's path from a curve.

Foot points on the curve are found anew at every step, so that only deviations across the curve count in full. A visible
neuron's readouts move that neuron alone, so the normal matrix has an arrow shape: the switches' shared part, and a
diagonal block for each visible neuron. Deviations along the curve count little; they couple all neurons by a low-rank
term, one row for each instant. Steps include the second-order correction of geodesic acceleration (Transtrum and
Sethna, arXiv:1201.5885), without which sums of soft switches need ten times as many steps.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from lieednn_sim.budget import check_time
from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters
from lieednn_sim.synthesis.shaping.curve import Curve
from lieednn_sim.values import Floats, frozen

# Weight of deviations along the curve, which the time law decides later.
_TANGENTIAL_WEIGHT = 0.05
# Bound on a and c: the steepest switch spans a sixtieth of the path, the resolution of `cascade`.
LARGEST_SLOPE = 60.0
# Ridge on the parameters, in squared lengths of the curve; it shrinks where it exceeds this fraction of the cost.
_RIDGE, _RIDGE_FRACTION = 1e-9, 0.3
_LEAST_RIDGE = 1e-14
# Initial damping, and the damping at which the descent gives up.
_DAMPING, _LARGEST_DAMPING = 1e-3, 1e8
# Fraction of a step with which its curvature is probed, and the largest relative correction, by Transtrum and Sethna.
_PROBE_FRACTION, _LARGEST_CORRECTION = 0.1, 0.375
# Steps from one check to the next whether the goal can still be reached at the pace of the last such steps.
_STEPS_PER_CHECK = 10


@frozen
class Fit:
    """Result of a descent.

    Attributes:
        parameters: parameters of the cascade.
        worst: largest deviation across the curve at the clock's instants [m].
        iterations: number of steps.
    """

    parameters: Parameters
    worst: float
    iterations: int


@frozen
class _Place:
    """Flat parameters and the states, feet, errors ``(K, 6 N)`` [m], directions, cost and worst that they give."""

    flat: Floats
    x: Floats
    feet: Floats
    error: Floats
    along: Floats
    cost: float
    worst: float


class Descent:
    """The least-squares problem of one curve and one cascade.

    Args:
        cascade: a cascade from the curve's start to its target.
        curve: the curve to follow.
    """

    def __init__(self, cascade: Cascade, curve: Curve) -> None:
        self.cascade, self.curve = cascade, curve
        self._n = len(cascade.target)
        self._decay = _RIDGE * curve.length**2

    def run(self, start: Parameters, iterations: int, goal: float) -> Fit:
        """Descend until the deviation is below ``goal`` [m], seems unable to get there, or iterations are used up."""
        bounded = 12 * len(start.a)
        place = self._place(start.flat, np.append(1.0 - self.cascade.clock.g, 1.0))
        damping, growth, count = _DAMPING, 2.0, 0
        history = [place.worst]
        while count < iterations and place.worst >= goal and not self._hopeless(history, iterations, goal):
            check_time()
            system = NormalEquations(self, place)
            while True:
                step, expected = system.step(damping)
                trial = self._place(_clipped(place.flat + step, bounded), place.feet)
                if trial.cost < place.cost or damping > _LARGEST_DAMPING:
                    break
                damping, growth = growth * damping, 2.0 * growth
            if trial.cost >= place.cost:
                break
            # Nielsen's rule: less damping where the prediction was good.
            gain = min((place.cost - trial.cost) / max(expected, 1e-300), 1.0)
            damping, growth = max(damping * max(0.2, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12), 2.0
            place = trial
            while self._decay * (place.flat @ place.flat) > _RIDGE_FRACTION * place.cost and self._decay > _LEAST_RIDGE:
                self._decay *= 0.3
                place = self._place(place.flat, place.feet)
            count += 1
            history.append(place.worst)
        return Fit(Parameters.of(place.flat, self._n), place.worst, count)

    @staticmethod
    def _hopeless(history: list[float], iterations: int, goal: float) -> bool:
        made = len(history) - 1
        if made < 2 * _STEPS_PER_CHECK or made % _STEPS_PER_CHECK:
            return False
        pace = history[-1] / history[-1 - _STEPS_PER_CHECK]
        return pace >= 1.0 or history[-1] * pace ** ((iterations - made) / _STEPS_PER_CHECK) > goal

    def _place(self, flat: Floats, feet: Floats) -> _Place:
        x = self.cascade.states(Parameters.of(flat, self._n))
        feet = self.curve.feet(x, feet)
        point, tangent = self.curve.at(feet)
        units = self.units(feet)
        k = len(x)
        error = ((x - point) * units).reshape(k, -1)
        along = (tangent * units).reshape(k, -1)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        # The tail counts in all directions.
        along[-1] = 0.0
        shared = np.einsum("kp,kp->k", along, error)
        across = np.maximum(np.einsum("kp,kp->k", error, error) - shared**2, 0.0)
        cost = float(np.mean(across + (_TANGENTIAL_WEIGHT * shared) ** 2) + self._decay * (flat @ flat))
        worst = np.sqrt((across[:-1] / self.curve.weight(feet[:-1]) ** 2).max())
        return _Place(flat, x, feet, error, along, cost, float(worst))

    def units(self, feet: Floats) -> Floats:
        """Factors ``(K, N, 6)`` of deviations at foot points ``(K,)``: units times weights."""
        return np.asarray(self.curve.units * self.curve.weight(feet)[:, None, None])


class NormalEquations:
    """The Gauss-Newton normal equations at a place.

    Args:
        descent: the problem.
        place: the point of linearisation.

    Attributes:
        matrix: ``(p, p)`` normal matrix, including the ridge; only its lower triangle is valid.
        gradient: ``(p,)`` half the gradient of the cost.
    """

    def __init__(self, descent: Descent, place: _Place) -> None:
        self._descent, self._place = descent, place
        n = descent._n
        parameters = Parameters.of(place.flat, n)
        _, shared, own = descent.cascade.linearised(parameters)
        k, first, each = shared.shape[1], shared.shape[-1], own.shape[-1]
        # The cost is the mean over the instants.
        self._units = descent.units(place.feet).transpose(1, 0, 2) / np.sqrt(k)
        rows = np.concatenate([shared, own], axis=3) * self._units[..., None]
        self._rows = rows.reshape(n, 6 * k, -1)
        self._slices = [slice(first + i * each, first + (i + 1) * each) for i in range(n)]
        self._first = first
        size = first + n * each
        matrix, along = np.zeros((size, size)), np.zeros((k, size))
        directions = place.along.reshape(k, n, 6)
        for i, mine in enumerate(self._slices):
            square = self._rows[i].T @ self._rows[i]
            matrix[:first, :first] += square[:first, :first]
            matrix[mine, :first] = square[first:, :first]
            matrix[mine, mine] = square[first:, first:]
            projected = (directions[:, i, None] @ rows[i])[:, 0]
            along[:, :first] += projected[:, :first]
            along[:, mine] = projected[:, first:]
        matrix -= (1.0 - _TANGENTIAL_WEIGHT**2) * (along.T @ along)
        matrix[np.diag_indices(size)] += descent._decay
        # Only the lower triangle is looked at.
        self.matrix, self._diagonal = matrix, matrix.diagonal().copy()
        self.gradient = self._pulled(place.error) + descent._decay * place.flat

    def step(self, damping: float) -> tuple[Floats, float]:
        """The step ``(p,)`` at a damping, and the decrease of the cost that the linear model predicts."""
        scale = self._diagonal + 1e-14
        factor = None
        while factor is None:
            try:
                damped = self.matrix.copy()
                damped[np.diag_indices(len(damped))] += damping * scale
                factor = cho_factor(damped, lower=True, overwrite_a=True, check_finite=False)
            except LinAlgError:
                damping *= 10.0
        step = -cho_solve(factor, self.gradient, check_finite=False)
        place, cascade = self._place, self._descent.cascade
        probed = cascade.states(Parameters.of(place.flat + _PROBE_FRACTION * step, self._descent._n)) - place.x
        moved = probed.transpose(1, 0, 2) * self._units / _PROBE_FRACTION
        bend = (2.0 / _PROBE_FRACTION) * (moved - self._pushed(step))
        second = -0.5 * cho_solve(factor, self._gathered(bend), check_finite=False)
        fraction = float(np.sqrt((scale @ second**2) / max(float(scale @ step**2), 1e-300)))
        expected = -float(step @ self.gradient) + damping * float(scale @ step**2)
        return step + min(1.0, _LARGEST_CORRECTION / max(fraction, 1e-300)) * second, expected

    def _pushed(self, step: Floats) -> Floats:
        """The linear response ``(N, K, 6)`` of the rows to a step."""
        parts = [np.concatenate([step[: self._first], step[mine]]) for mine in self._slices]
        return np.asarray(self._rows @ np.array(parts)[..., None]).reshape(self._units.shape)

    def _pulled(self, error: Floats) -> Floats:
        """The transposed rows times an error ``(K, 6 N)`` in metres."""
        n, k, _ = self._units.shape
        return self._gathered(error.reshape(k, n, 6).transpose(1, 0, 2) / np.sqrt(k))

    def _gathered(self, error: Floats) -> Floats:
        n, k, _ = error.shape
        flat = error.transpose(1, 0, 2).reshape(k, -1)
        along = self._place.along
        flat = flat - (1.0 - _TANGENTIAL_WEIGHT**2) * np.einsum("kp,kp->k", along, flat)[:, None] * along
        pulled = self._rows.transpose(0, 2, 1) @ flat.reshape(k, n, 6).transpose(1, 0, 2).reshape(n, -1, 1)
        pulled = pulled[..., 0]
        return np.concatenate([pulled[:, : self._first].sum(axis=0), pulled[:, self._first :].ravel()])


def _clipped(flat: Floats, bounded: int) -> Floats:
    flat[:bounded] = np.clip(flat[:bounded], -LARGEST_SLOPE, LARGEST_SLOPE)
    return flat
