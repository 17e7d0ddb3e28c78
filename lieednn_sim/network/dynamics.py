"""Equilibria and trajectories of an autonomous system on (R^d)^N, given by its vector field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import BDF, DOP853, LSODA, RK45, DenseOutput, OdeSolution, OdeSolver, Radau
from scipy.interpolate import PPoly
from scipy.optimize import brentq
from scipy.special import binom

from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

# Flat vector fields ``(dN,)`` to ``(dN,)`` and their Jacobians, ``(dN,)`` to ``(dN, dN)``.
VectorField = Callable[[Floats], Floats]

# Largest number of evaluations in one integration, which take some seconds; a usual one needs a thousand.
_MAX_EVALUATIONS = 200_000

# Coefficients of s to s^7 in the polynomials s^a (1 - s)^b of DOP853's interpolants, one row for each.
_A, _B = np.arange(2, 9)[:, None] // 2, np.arange(1, 8)[:, None] // 2
_ALTERNATING = (-1.0) ** (np.arange(1, 8) - _A) * binom(_B, np.arange(1, 8) - _A)

_OVERFLOW = "the equilibrium cannot be found in double precision: weights, bias or start are too large"

INTEGRATORS: dict[str, type[OdeSolver]] = {solver.__name__: solver for solver in (RK45, DOP853, Radau, BDF, LSODA)}


@frozen
class Equilibrium:
    """Result of the search for an equilibrium.

    Attributes:
        success: whether `residual` is below the tolerance.
        message: how the search ended.
        xi: ``(N, d)`` the point found.
        residual: largest entry of the vector field there.
        spectral_abscissa: largest real part of the Jacobian's eigenvalues; negative when locally stable.
    """

    success: bool
    message: str
    xi: Floats
    residual: float
    spectral_abscissa: float


@frozen
class Trajectory:
    """A trajectory xi(t) of a network, which can be evaluated at any time within it.

    Attributes:
        t: ``(K,)`` times of the integrator's steps.
        xi: ``(K, N, d)`` states there.
    """

    t: Floats
    xi: Floats
    _dense: OdeSolution | PPoly = field(repr=False)

    def __repr__(self) -> str:
        n, d = self.xi.shape[1:]
        return f"<Trajectory: {n} neurons of {d} coordinates, {len(self.t)} steps from 0 to {self.t[-1]:g}>"

    def __call__(self, t: ArrayLike) -> Floats:
        """States ``(..., N, d)`` at times ``(...)`` inside the integrated range."""
        times = as_floats("t", t, (), batched=True)
        if times.size and (times.min() < self.t[0] or times.max() > self.t[-1]):
            raise InputError(f"t must lie in [{self.t[0]:g}, {self.t[-1]:g}], got {times.min():g} to {times.max():g}")
        flat = self._dense(times.ravel())
        return flat.T.reshape(*times.shape, *self.xi.shape[1:])


def find_equilibrium(vector_field: VectorField, jacobian: VectorField, start: Floats, *, rate: float) -> Equilibrium:
    """Find an equilibrium by damped Newton steps from ``(N, d)``; if they stall, follow the flow and try again.

    The decay rate scales residuals and times; the largest entry of the vector field is below 1e-12 rate (1 + |x|), or a
    hundred times as much if rounding keeps Newton's method from improving further. `LieEDNNError` if the numbers are so
    large that the search overflows.
    """
    x, how = start.ravel().copy(), "Newton converged"
    with np.errstate(all="ignore"):  # squares may overflow meanwhile; a result that is not finite is rejected below
        try:
            for attempt in range(3):
                x, converged = _newton(vector_field, jacobian, x, rate * 1e-12)
                if converged:
                    break
                if attempt < 2:
                    how = "Newton converged after following the flow"
                    x = _follow(vector_field, x, 50.0 * 4**attempt / rate)
            else:
                how = "no equilibrium found: Newton stalled, also after following the flow; the network may be unstable"
            residual = float(np.abs(vector_field(x)).max())
            abscissa = float(np.linalg.eigvals(jacobian(x)).real.max())
        except (np.linalg.LinAlgError, ValueError) as error:
            raise LieEDNNError(f"{_OVERFLOW} ({error})") from None
    if not (np.isfinite(x).all() and np.isfinite([residual, abscissa]).all()):
        raise LieEDNNError(_OVERFLOW)
    return Equilibrium(converged, how, x.reshape(start.shape), residual, abscissa)


def _follow(vector_field: VectorField, x: Floats, duration: float) -> Floats:
    """The state after ``duration``, or after 5000 steps, which only networks far faster than their decay need."""
    flow = RK45(lambda _, y: vector_field(y), 0.0, x, duration)
    for _ in range(5000):
        if flow.status != "running":
            break
        check_time()
        flow.step()
    y = np.asarray(flow.y, dtype=np.float64)
    vars(flow).clear()  # as in `integrate`
    return y


def _newton(vector_field: VectorField, jacobian: VectorField, x: Floats, tolerance: float) -> tuple[Floats, bool]:
    value = vector_field(x)
    for _ in range(100):
        limit = tolerance * (1.0 + np.abs(x).max())
        if np.abs(value).max() <= limit:
            return x, True
        try:
            direction = np.linalg.solve(jacobian(x), value)
        except np.linalg.LinAlgError:
            return x, False
        fraction = 1.0
        while fraction > 1e-4:
            trial = x - fraction * direction
            trial_value = vector_field(trial)
            if np.linalg.norm(trial_value) < (1.0 - 0.5 * fraction) * np.linalg.norm(value) + 1e-300:
                break
            fraction *= 0.5
        else:
            # At the rounding floor no step reduces the residual further.
            return x, bool(np.abs(value).max() <= 100.0 * limit)
        x, value = trial, trial_value
    return x, False


def runge_kutta_step(field: VectorField, x: Floats, h: float) -> Floats:
    """The state, of any shape, after a step h by the fourth-order Runge-Kutta method."""
    k1 = field(x)
    k2 = field(x + 0.5 * h * k1)
    k3 = field(x + 0.5 * h * k2)
    k4 = field(x + h * k3)
    return x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def integrate(solver: OdeSolver, away: Callable[[Floats], float] | None) -> tuple[Floats, Floats, OdeSolution | PPoly]:
    """Times ``(K,)``, states ``(K, n)`` and their interpolant, of a solver run to its end or to where ``away`` is zero.

    It is quicker than SciPy's `solve_ivp`. `ArithmeticError` if the solver fails, `LieEDNNError` if it needs too many
    evaluations, as for a stiff network.
    """
    t, x, pieces = [solver.t], [solver.y], list[DenseOutput]()
    try:
        while solver.status == "running":
            check_time()
            message = solver.step()
            if solver.status == "failed":
                raise ArithmeticError(message)
            if solver.nfev > _MAX_EVALUATIONS:
                raise LieEDNNError(
                    f"the network is too stiff for {type(solver).__name__}: more than {_MAX_EVALUATIONS} evaluations "
                    f"in a duration of {solver.t_bound:g}; use 'Radau' or 'LSODA', larger tolerances or smaller weights"
                )
            piece = solver.dense_output()
            pieces.append(piece)
            if away is not None and away(solver.y) <= 0.0:
                tiny, low, high = 4.0 * float(np.finfo(float).eps), solver.t_old, solver.t  # tiny as SciPy's own
                # `brentq` leaves its function, though not its arguments, behind in a reference cycle.
                end = brentq(lambda at, f, x: f(x(at)), low, high, (away, piece), tiny * min(1.0, high), tiny)
                t.append(end)
                x.append(piece(end))
                break
            t.append(solver.t)
            x.append(solver.y)
    finally:
        # SciPy's solvers refer to themselves, and so keep what their vector field refers to: a network, and its memory.
        vars(solver).clear()
    times = np.array(t)
    usual = isinstance(solver, RK45 | DOP853) and all(1e-40 < p.t - p.t_old < 1e40 for p in pieces)  # for h^7
    return times, np.array(x), _polynomials(times, pieces) if usual else OdeSolution(times, pieces)


def _polynomials(t: Floats, pieces: list[DenseOutput]) -> PPoly:
    """The interpolants of the steps of RK45 or DOP853 as one object, which evaluates many times at once.

    In a step h from time t they are, with s = (time - t) / h, y + h sum_k Q_k s^(k+1) or y + sum_k F_k b_k, where b_0,
    b_1, ... are s, s (1 - s), s^2 (1 - s), and so on, in turn.
    """
    steps = np.array([step.h for step in pieces])
    if hasattr(pieces[0], "Q"):
        slopes = np.array([step.Q for step in pieces]) * steps[:, None, None]
    else:
        slopes = np.swapaxes(np.array([step.F for step in pieces]), 1, 2) @ _ALTERNATING
    slopes /= (steps[:, None] ** np.arange(1.0, 1.0 + slopes.shape[-1]))[:, None]
    states = np.array([step.y_old for step in pieces])
    return PPoly(np.concatenate([slopes[..., ::-1], states[..., None]], axis=-1).transpose(1, 2, 0), t, axis=1)
