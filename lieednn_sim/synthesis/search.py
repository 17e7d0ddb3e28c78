"""Solvers for the synthesis problem: a fast feasibility search, a patient one, and the final polish."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize

from lieednn_sim.budget import check_time
from lieednn_sim.lie.se3 import skew
from lieednn_sim.synthesis.problem import Point, Problem, pairs
from lieednn_sim.values import Floats

_ROUGH = 1e-2  # the searches need to meet the equations only this well: from there the polish converges quadratically
# Fast search: weight of the equations against the eigenvalues, largest number of steps, and bounds of the damping.
_EQUATION_WEIGHT, _MOST_STEPS = 3.0, 40
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e6
_PIECE = 32  # number of problems whose eigenspaces are differentiated at once, which fit into the processor's cache
# Bound on |log S| that keeps S W S^-1 computable; only targets at the edge of what can be certified come near it.
_LOG_SCALE_BOUND = 8.0
# Bounds on quaternions in the patient search, tried in turn: most targets have moderate weights, few need large ones.
QUATERNION_BOUNDS = (3.0, 60.0)


def feasible_points(problem: Problem, start: Floats, *, aim: float, accept: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Levenberg-Marquardt on the distance to feasibility, for each problem of a stack.

    Minimises w^2 |W_R u - c|^2 + ||(A - aim I)_+||_F^2 with A = sym(S W_R S^-1), w = 3: the squared distance
    of A to the cone {A <= aim I} is differentiable, and its Gauss-Newton matrix uses the derivative of the projection
    onto that cone (Malick and Sendov, Set-Valued Analysis 14, 2006).

    Each problem has its own damping, and leaves the stack when it is solved or given up: its result does not depend on
    the others, to the last bit. It is solved when the largest eigenvalue is below ``accept`` and the equations are
    roughly met. Returns the unknowns, as the start ``(B, 4 N^2 + 3N)``, and whether they are feasible ``(B,)``.
    """
    unknowns, feasible, iterations = start.copy(), np.zeros(len(start), bool), np.zeros(len(start), int)
    # For the problems left in the stack: their indices, points, and linear least squares there.
    stack, point = np.arange(len(start)), problem.evaluate(start.copy())
    value, damping = _merit(point, aim), np.full(len(start), 1e-2)
    linear: list[_Linear] = [_NOTHING] * len(start)
    moved = np.ones(len(start), bool)
    while True:
        check_time()
        more = iterations[stack] < _MOST_STEPS
        met = (point.values[:, -1] < accept) & (np.abs(point.residual.reshape(len(stack), -1)).max(axis=-1) < _ROUGH)
        solved = moved & more & met
        kept = (~solved & more & (damping <= _MOST_DAMPING)).nonzero()[0]
        if len(kept) < len(stack):
            unknowns[stack], feasible[stack] = point.unknowns, solved
            if not len(kept):
                return unknowns, feasible
            problem, point, stack, moved = problem.of(kept), point.of(kept), stack[kept], moved[kept]
            value, damping, linear = value[kept], damping[kept], [linear[k] for k in kept]
        fresh = moved.nonzero()[0]
        if len(fresh):
            for k, entry in zip(fresh, _linearised(problem.of(fresh), point.of(fresh), aim), strict=True):
                linear[k] = entry
        steps = [item.step(weight) for item, weight in zip(linear, damping.tolist(), strict=True)]
        predicted = value - np.array([left for _, left in steps])
        there = point.unknowns + np.array([step for step, _ in steps])
        log_scale = there[:, problem.n_quaternion :]
        np.minimum(np.maximum(log_scale, -_LOG_SCALE_BOUND), _LOG_SCALE_BOUND, out=log_scale)
        trial = problem.evaluate(there)
        reached = _merit(trial, aim)
        ratio = (value - reached) / np.maximum(predicted, 1e-300)
        moved = ratio > 1e-3
        damping *= np.where(moved, np.where(ratio > 0.75, 0.2, np.where(ratio < 0.25, 2.0, 1.0)), 4.0)
        damping[moved] = np.maximum(damping[moved], _LEAST_DAMPING)
        which = moved.nonzero()[0]
        if len(which):
            value[which] = reached[which]
            point = point.moved(which, trial.of(which))
            iterations[stack[which]] += 1


def _merit(point: Point, aim: float) -> Floats:
    residual = _EQUATION_WEIGHT * point.residual.reshape(len(point.values), -1)
    excess = np.maximum(point.values - aim, 0.0)
    return 0.5 * ((residual * residual).sum(axis=-1) + (excess * excess).sum(axis=-1))


class _Linear(NamedTuple):
    """Linear least squares |residual + jacobian step|^2, with the Gram matrix of the Jacobian's rows."""

    residual: Floats
    jacobian: Floats
    gram: Floats

    def step(self, damping: float) -> tuple[Floats, float]:
        """The minimiser of |residual + jacobian step|^2 + damping |step|^2, and half the squared residual there.

        In the dual form, since there are fewer rows than unknowns: with (J J^T + damping I) y = r the step is -J^T y,
        and the residual left is damping y. Problems are solved in turn: NumPy's stacked solve, LU, takes twice as long.
        """
        damped = self.gram.copy()
        damped.ravel()[:: len(damped) + 1] += damping
        factor, failure = lapack.dpotrf(damped.T, lower=1, clean=0, overwrite_a=1)
        if failure:
            return np.zeros(self.jacobian.shape[1]), 0.0  # a zero step is rejected, and the damping raised
        y = lapack.dpotrs(factor, self.residual, lower=1)[0]
        return -(y @ self.jacobian), 0.5 * damping**2 * float(y @ y)


_NOTHING = _Linear(np.empty(0), np.empty((0, 0)), np.empty((0, 0)))


def _linearised(problem: Problem, point: Point, aim: float) -> list[_Linear]:
    """Linearisation of the vector of which `_merit` is half the square."""
    n, size, count = problem.n_neurons, problem.size, len(point.unknowns)
    equations = _EQUATION_WEIGHT * problem.equation_jacobian(point)
    residual = _EQUATION_WEIGHT * point.residual.reshape(count, -1)
    height = residual.shape[-1]
    excess = np.maximum(point.values - aim, 0.0)
    firsts = size - (excess > 0.0).sum(axis=-1)
    linear = [_NOTHING] * count
    # Grouped by the number of violated eigenvalues: nothing is padded, and no result depends on the stack.
    for first in sorted(set(firsts.tolist())):
        alike = (firsts == first).nonzero()[0]
        a, b = pairs(size, first)
        diagonal, weight = a == b, np.where(a == b, 1.0, np.sqrt(2.0))  # (a, b) also accounts for (b, a)
        for piece in (alike[k : k + _PIECE] for k in range(0, len(alike), _PIECE)):
            part, over = point.of(piece), excess[piece][:, a]
            # Divided differences of max(x - aim, 0): 1 within the violated eigenspace, a ratio across.
            gap = part.values[:, a] - part.values[:, b]
            slope = weight * np.divide(over, gap, out=np.ones_like(gap), where=b < first)
            jacobian = np.zeros((len(piece), height + len(a), point.unknowns.shape[-1]))
            rows, columns = height // n, problem.n_quaternion // n
            for i in range(n):
                jacobian[:, i * rows : (i + 1) * rows, i * columns : (i + 1) * columns] = equations[piece, i]
            np.multiply(problem.of(piece).eigenspace_jacobian(part, first), slope[..., None], out=jacobian[:, height:])
            right = np.concatenate([residual[piece], over * diagonal], axis=-1)
            gram = jacobian @ jacobian.swapaxes(-1, -2)
            for k, *item in zip(piece.tolist(), right, jacobian, gram, strict=True):
                linear[k] = _Linear(*item)
    return linear


def smallest_eigenvalue_point(
    problem: Problem, start: Floats, *, accept: float, quaternion_bound: float
) -> Floats | None:
    """Minimise a smoothed lambda_max under the equations by sequential quadratic programming (SciPy's SLSQP).

    It is slower than `feasible_points` by an order of magnitude, but it finds the large weights that targets near the
    edge of what can be certified need. Even if smaller weights suffice, a start may run off to weights in the
    thousands, with translations as large: hence a bound on every quaternion, from `QUATERNION_BOUNDS`.
    """
    unknowns = start
    bounds = [(-quaternion_bound, quaternion_bound)] * problem.n_quaternion
    bounds += [(-_LOG_SCALE_BOUND, _LOG_SCALE_BOUND)] * problem.size

    def largest(trial: Floats, sharpness: float) -> tuple[float, Floats]:
        check_time()
        return problem.smooth_largest_eigenvalue(trial, sharpness)

    equations = {"type": "eq", "fun": problem.flat_residual, "jac": problem.flat_jacobian}
    how = {"jac": True, "bounds": bounds, "constraints": equations, "options": {"maxiter": 400, "ftol": 1e-6}}
    for sharpness in (20.0, 80.0, 320.0, 1280.0):
        solution = minimize(largest, unknowns, (sharpness,), "SLSQP", **how)
        if not np.isfinite(solution.x).all():
            return None
        unknowns = solution.x
        point = problem.evaluate(unknowns)
        if point.values[-1] < accept and np.abs(point.residual).max() < _ROUGH:
            return unknowns
    return None


def polish(
    problem: Problem, unknowns: Floats, state: Floats, required: Floats, *, quaternion_weight: float = 0.05
) -> tuple[Floats, Floats]:
    """Meet all 6N equilibrium equations by Gauss-Newton steps; returns unknowns and translations ``(B, N, N, 3)``.

    Steps have the least norm. Quaternions are weighted down, so that translations do the work if they can, and the
    certificate hardly changes. If the rotations are too small to drive a translation, the quaternions change instead
    and |t| stays small: a quaternion step of the size ``quaternion_weight`` counts as much as a unit translation.

    The unknowns ``(B, 4 N^2 + 3N)`` meet the rotational equations roughly; others are as for `random_starts`.
    """
    n, count = problem.n_neurons, len(unknowns)
    best, best_translation = unknowns.copy(), np.zeros((count, n, n, 3))
    smallest = np.full(count, np.inf)
    # For the problems left in the stack: their indices and unknowns.
    stack, unknowns, translation = np.arange(count), unknowns.copy(), best_translation.copy()
    for _ in range(30):
        blocks, slope = problem.blocks(unknowns)
        parts = state.reshape(-1, n, 2, 3).swapaxes(-1, -2)  # both parts of phi(xi) as columns, (N, 3, 2)
        turned = blocks @ parts[:, None]
        spun, across = turned[..., 0], skew(translation)
        driven = np.concatenate([spun, turned[..., 1] + (across @ spun[..., None])[..., 0]], axis=-1)
        error = driven.sum(axis=2) - required
        residual = np.abs(error.reshape(len(stack), -1)).max(axis=-1)
        better = residual < smallest[stack]
        improved = stack[better]
        best[improved], best_translation[improved] = unknowns[better], translation[better]
        smallest[improved] = residual[better]
        kept = (better & (residual >= 1e-13)).nonzero()[0]
        if len(kept) < len(stack):
            if not len(kept):
                break
            problem, stack, state, required = problem.of(kept), stack[kept], state[kept], required[kept]
            unknowns, translation, error = unknowns[kept], translation[kept], error[kept]
            slope, spun, across, parts = slope[kept], spun[kept], across[kept], parts[kept]
        # (i, j, a, k) as products over b of slopes (a k, b) and parts (b, 2) of j
        change = (2.0 * slope.swapaxes(-1, -2).reshape(-1, n, n, 12, 3) @ parts[:, None]).reshape(-1, n, n, 3, 4, 2)
        spin, slide = change[..., 0], change[..., 1]
        rows = np.zeros((len(stack), n, 6, n, 7))
        by_block = rows.swapaxes(2, 3)
        by_block[..., :3, :4] = quaternion_weight * spin
        by_block[..., 3:, :4] = quaternion_weight * (slide + across @ spin)
        by_block[..., 3:, 4:] = -skew(spun)
        step = -_least_norm(rows.reshape(-1, n, 6, 7 * n), error).reshape(-1, n, n, 7)
        turn = quaternion_weight * step[..., :4]
        longest = np.abs(turn).reshape(len(stack), -1).max(axis=-1)
        fraction = np.minimum(1.0, 0.5 / np.maximum(longest, 1e-300))[:, None, None, None]
        unknowns[:, : problem.n_quaternion] += (fraction * turn).reshape(len(stack), -1)
        translation = translation + fraction * step[..., 4:]
    return best, best_translation


def _least_norm(rows: Floats, error: Floats) -> Floats:
    """Least-norm x with rows x = error, ``(..., m, n)`` and ``(..., m)``; least squares where rows are dependent.

    It uses normal equations if their condition number allows it, at a tenth of the cost; otherwise pseudo-inverses.
    """
    gram = rows @ rows.swapaxes(-1, -2)
    squares = np.diagonal(gram, axis1=-2, axis2=-1)
    largest = squares.max(axis=-1)
    length = np.sqrt(np.where(squares > 0.0, squares, 1.0))
    unit = gram / (length[..., :, None] * length[..., None, :])
    # With unit diagonal the condition number is below 4 over the determinant (Merikoski, Urpala, Virtanen, Tam and
    # Uhlig, Linear Algebra and its Applications 254, 1997). Rows of very different lengths go to pseudo-inverses too.
    independent = (np.linalg.det(unit) > 1e-6) & (squares.min(axis=-1) > 1e-12 * largest)
    unit[~independent] = np.eye(unit.shape[-1])
    weights = np.linalg.solve(unit, (error / length)[..., None])[..., 0] / length
    solution = (weights[..., None, :] @ rows)[..., 0, :]
    rest = ~independent
    if rest.any():
        solution[rest] = (np.linalg.pinv(rows[rest], rcond=1e-10) @ error[rest][..., None])[..., 0]
    return solution
