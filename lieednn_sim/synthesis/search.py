"""Solvers for the synthesis problem: a fast feasibility search, a patient one, and the final polish."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from lieednn_sim.budget import check_time
from lieednn_sim.lie import hat
from lieednn_sim.synthesis.problem import Point, Problem
from lieednn_sim.values import Floats

# Equations need only be met this well by the searches: the polish then takes quadratic steps.
_ROUGH = 1e-2
# Of the fast search: weight of the equations against the eigenvalues, and steps.
_EQUATION_WEIGHT, _MOST_STEPS = 3.0, 40
# Bounds that keep S W S^-1 computable; only targets at the very edge of what can be certified come near them.
_LOG_SCALE_BOUND = 8.0
# Of the quaternions in the patient search, tried in turn: most targets have moderate weights, few need large ones.
QUATERNION_BOUNDS = (3.0, 60.0)


def feasible_point(problem: Problem, start: Floats, *, aim: float, accept: float) -> tuple[Point | None, int]:
    """Levenberg-Marquardt on the distance to feasibility.

    Minimises w^2 |W_R u - c|^2 + ||(A - aim I)_+||_F^2 with A = sym(S W_R S^-1), w = 3: the squared distance
    of A to the cone {A <= aim I} is differentiable, and its Gauss-Newton matrix uses the derivative of the projection
    onto that cone (Malick and Sendov, Set-Valued Analysis 14, 2006).

    Args:
        problem: what to solve, bound 1.
        start: unknowns to begin from.
        aim: eigenvalue bound of the residual.
        accept: stop as soon as the largest eigenvalue is below this and the equations are roughly met.

    Returns:
        The feasible point or None, and the number of iterations.
    """
    n_quaternion = problem.n_quaternion
    point = problem.evaluate(start)
    damping = 1e-2
    for iteration in range(_MOST_STEPS):
        check_time()
        if point.values[-1] < accept and np.abs(point.residual).max() < _ROUGH:
            return point, iteration
        value = _merit(point, aim)
        gradient, normal = _normal_equations(problem, point, aim)
        while True:
            damped = normal.copy()
            damped[np.diag_indices_from(damped)] += damping
            factor, _ = lapack.dpotrf(damped, lower=1)
            step = -lapack.dpotrs(factor, gradient, lower=1)[0]
            unknowns = point.unknowns + step
            unknowns[n_quaternion:] = np.clip(unknowns[n_quaternion:], -_LOG_SCALE_BOUND, _LOG_SCALE_BOUND)
            trial = problem.evaluate(unknowns)
            predicted = -(gradient @ step + 0.5 * step @ normal @ step)
            ratio = (value - _merit(trial, aim)) / max(predicted, 1e-300)
            if ratio > 1e-3:
                point = trial
                if ratio > 0.75:
                    damping = max(damping / 5.0, 1e-6)
                elif ratio < 0.25:
                    damping *= 2.0
                break
            damping *= 4.0
            if damping > 1e6:
                return None, iteration
    return None, _MOST_STEPS


def _merit(point: Point, aim: float) -> float:
    excess = np.maximum(point.values - aim, 0.0)
    residual = _EQUATION_WEIGHT * point.residual.ravel()
    return 0.5 * float(residual @ residual + excess @ excess)


def _normal_equations(problem: Problem, point: Point, aim: float) -> tuple[Floats, Floats]:
    """Gradient of `_merit` and its Gauss-Newton matrix."""
    rows = _EQUATION_WEIGHT * problem.full_jacobian(problem.equation_jacobian(point))
    gradient = rows.T @ (_EQUATION_WEIGHT * point.residual.ravel())
    normal = rows.T @ rows
    excess = np.maximum(point.values - aim, 0.0)
    first = problem.size - int(np.count_nonzero(excess))
    if first < problem.size:
        # Divided differences of max(x - aim, 0): 1 within the violated eigenspace, a ratio across.
        slope = np.ones((problem.size - first, problem.size))
        gap = point.values[first:, None] - point.values[None, :first]
        slope[:, :first] = np.sqrt(2.0) * excess[first:, None] / gap
        moves = problem.eigenspace_jacobian(point, first)
        violated = np.arange(problem.size - first)
        gradient += moves[violated, first + violated].T @ excess[first:]
        moves *= slope[:, :, None]
        flat = moves.reshape(-1, moves.shape[-1])
        normal += flat.T @ flat
    return gradient, normal


def smallest_eigenvalue_point(
    problem: Problem, start: Floats, *, accept: float, quaternion_bound: float
) -> tuple[Point | None, int]:
    """Minimise a smoothed lambda_max under the equations by sequential quadratic programming (SciPy's SLSQP).

    Slower than `feasible_point` by an order of magnitude; it finds the large weights that targets near the edge of
    what can be certified at all need. Where smaller ones do, a start may still run off to weights in the thousands,
    whose translations are as large: hence a bound on every quaternion, of `QUATERNION_BOUNDS`.
    """
    unknowns, iterations = start, 0
    bounds = [(-quaternion_bound, quaternion_bound)] * problem.n_quaternion
    bounds += [(-_LOG_SCALE_BOUND, _LOG_SCALE_BOUND)] * problem.size

    def largest(trial: Floats, sharpness: float) -> tuple[float, Floats]:
        check_time()
        return problem.smooth_largest_eigenvalue(trial, sharpness)

    for sharpness in (20.0, 80.0, 320.0, 1280.0):
        found = minimize(
            largest,
            unknowns,
            args=(sharpness,),
            jac=True,
            method="SLSQP",
            bounds=bounds,
            constraints={"type": "eq", "fun": problem.flat_residual, "jac": problem.flat_jacobian},
            options={"maxiter": 400, "ftol": 1e-6},
        )
        iterations += found.nit
        if not np.isfinite(found.x).all():
            return None, iterations
        unknowns = found.x
        point = problem.evaluate(unknowns)
        if point.values[-1] < accept and np.abs(point.residual).max() < _ROUGH:
            return point, iterations
    return None, iterations


def polish(
    problem: Problem, point: Point, state: Floats, required: Floats, *, quaternion_weight: float = 0.05
) -> tuple[Point, Floats]:
    """Meet all 6N equilibrium equations by Gauss-Newton steps of least norm in quaternions and translations.

    Quaternions are weighted down, so that translations do the work where they can and the certificate hardly moves;
    where the rotations are too small to carry a translation, the quaternions step in and |t| stays small.

    Args:
        problem: gives the blocks as functions of the quaternions.
        point: a point that meets the rotational equations roughly.
        state: phi(xi) of the target, ``(N, 6)``.
        required: what W phi(xi) must be, ``(N, 6)``.
        quaternion_weight: length of a unit quaternion step in the norm, against a unit translation.

    Returns:
        The point and the translations ``(N, N, 3)``.
    """
    n = problem.n_neurons
    translation = np.zeros((n, n, 3))
    omega, velocity = state[:, :3], state[:, 3:]
    best = (point, translation, np.inf)
    for _ in range(30):
        spun = np.einsum("ijab,jb->ija", point.blocks, omega)
        slid = np.einsum("ijab,jb->ija", point.blocks, velocity)
        error = np.concatenate([spun, slid + np.cross(translation, spun)], axis=-1).sum(axis=1) - required
        residual = float(np.abs(error).max())
        if residual >= best[2]:
            break
        best = (point, translation, residual)
        if residual < 1e-13:
            break
        spin = 2.0 * np.einsum("ijabk,jb->ijak", point.slope, omega)
        slide = 2.0 * np.einsum("ijabk,jb->ijak", point.slope, velocity)
        jacobian = np.zeros((n, n, 6, 7))
        jacobian[..., :3, :4] = quaternion_weight * spin
        jacobian[..., 3:, :4] = quaternion_weight * (slide + np.cross(translation[..., None], spin, axis=2))
        jacobian[..., 3:, 4:] = -hat(spun)
        rows = jacobian.transpose(0, 2, 1, 3).reshape(n, 6, 7 * n)
        step = -(np.linalg.pinv(rows, rcond=1e-10) @ error[..., None]).reshape(n, n, 7)
        turn = quaternion_weight * step[..., :4]
        fraction = min(1.0, 0.5 / max(float(np.abs(turn).max()), 1e-300))
        unknowns = point.unknowns.copy()
        unknowns[: problem.n_quaternion] += fraction * turn.ravel()
        translation = translation + fraction * step[..., 4:]
        point = problem.evaluate(unknowns)
    return best[:2]
