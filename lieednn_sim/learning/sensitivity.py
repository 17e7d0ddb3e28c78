"""Equilibria, and gradients of their error in the weights and in the connection strengths.

At an equilibrium gamma x* = mu (W phi(x*) + b). With the sensitivity matrix S = I - (mu/gamma) W diag(phi'(x*)), a
change dW moves it by dx* = (mu/gamma) S^-1 dW phi(x*). For E^2/2 with delta = x* - x_d one linear solve gives every
entry at once: S^T lambda = delta, then dE/dW = (mu/gamma) lambda phi(x*)^T; for E itself divide by E.

`EquilibriumSolver` follows an equilibrium from one epoch of learning to the next, by Newton steps or by running the
network; `dynamics.find_equilibrium` is the more careful method.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import RK45
from scipy.linalg.lapack import dgetrf, dgetrs

from lieednn_sim.errors import InputError
from lieednn_sim.learning.manifold import block_view
from lieednn_sim.lie import adjoint
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

_TOLERANCE = 1e-12
_LONGEST_STEP = 1.0
_AT_REST = 1e-6  # a tenth of the paper's tau, and far above the integrator's own error


@frozen
class Sensitivity:
    """The equilibrium error and its derivatives in the weights.

    Attributes:
        loss: E^2/2 with E = ||xi* - xi_d||_2.
        equilibrium: ``(N, 6)`` xi*.
        matrix: ``(6N, 6N)`` S = I - (mu/gamma) W diag(phi'(xi*)).
        weight: ``(6N, 6N)`` derivative of the loss in W.
        alpha: ``(N, N)`` derivative in alpha at fixed theta, <dE/dW_ij, Ad(theta_ij)>.
    """

    loss: float
    equilibrium: Floats
    matrix: Floats
    weight: Floats
    alpha: Floats


def sensitivity(network: LieEDNN, target: ArrayLike) -> Sensitivity:
    """Loss and gradients of a network whose equilibrium should be ``target`` (paper, eqs. 3.15 to 3.19).

    Args:
        network: its equilibrium is searched for from zero.
        target: ``(N - M, 6)`` xi_d of the visible neurons.

    Raises:
        InputError: no equilibrium is found, or S is singular there.
    """
    goal = as_floats("target", target, (network.n_visible, 6))
    result = network.equilibrium()
    if not result.success:
        raise InputError(f"the gradient needs an equilibrium: {result.message}")
    matrix = -network.jacobian(result.xi) / network.gamma  # the Jacobian of the vector field is -gamma S
    output = network.phi(result.xi).ravel()
    delta = np.zeros_like(result.xi)  # hidden neurons do not count
    delta[: network.n_visible] = network.visible(result.xi) - goal
    try:
        multiplier = np.asarray(np.linalg.solve(matrix.T, delta.ravel()), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise InputError("the sensitivity matrix is singular: the equilibrium bifurcates here") from None
    weight = weight_gradient(multiplier, output, network.mu / network.gamma)
    alpha = strength_gradient(weight, adjoint(network.rotation, network.translation))
    return Sensitivity(0.5 * float(np.linalg.norm(delta)) ** 2, result.xi, matrix, weight, alpha)


def weight_gradient(multiplier: Floats, output: Floats, ratio: float) -> Floats:
    """Gradient of E^2/2 in W: (mu/gamma) lambda phi^T with S^T lambda = delta; `ratio` is mu/gamma."""
    return (ratio * multiplier)[:, None] * output


def strength_gradient(weight: Floats, adjoints: Floats) -> Floats:
    """Gradient in alpha from the gradient in W: <dE/dW_ij, L_ij> with L_ij the adjoint blocks ``(N, N, d, d)``.

    The paper writes w/alpha for L_ij (eq. 3.19), which is the same on the manifold, but not between projections.
    """
    return np.einsum("ijab,ijab->ij", block_view(weight, adjoints.shape[-1]), adjoints)


def gauss_newton_direction(matrix: Floats, output: Floats, delta: Floats, ratio: float) -> Floats:
    """Smallest change of W that moves the equilibrium by delta to first order: (gamma/mu) S delta phi^T / ||phi||^2.

    Unlike the gradient it needs no inverse of S, so it does not blow up near a bifurcation.
    """
    return (matrix @ (delta / ratio))[:, None] * (output / (output @ output))


class FlatEquilibrium(NamedTuple):
    """A state x ``(n,)`` where gamma x = mu (W phi(x) + b), or a failed attempt to find one; phi(x) and phi'(x)."""

    x: Floats
    output: Floats
    slope: Floats
    success: bool


class SensitivityMatrix:
    """S = I - (mu/gamma) W diag(phi'(x)), factored once for several right-hand sides; ``ratio`` is mu/gamma.

    Calls LAPACK directly: NumPy's and SciPy's checks cost more than a solve with 24 unknowns.
    """

    def __init__(self, weight: Floats, slope: Floats, ratio: float) -> None:
        self.matrix = _identity(len(weight)) - weight * (ratio * slope)
        # The transpose of a C-ordered matrix is Fortran-ordered, as LAPACK wants it.
        self._lu, self._pivots, info = dgetrf(self.matrix.T)
        self.singular = info != 0

    def solve(self, right: Floats) -> Floats:
        """X with S x = right, ``(n,)``."""
        return dgetrs(self._lu, self._pivots, right, trans=1)[0]

    def solve_transposed(self, right: Floats) -> Floats:
        """X with S^T x = right, ``(n,)``."""
        return dgetrs(self._lu, self._pivots, right)[0]

    def stable(self) -> bool:
        """Whether every eigenvalue of the Jacobian -gamma S has a negative real part."""
        return bool(np.linalg.eigvals(self.matrix).real.min() > 0.0)


class EquilibriumSolver:
    """Finds the equilibrium near a given state; ``ratio`` is mu/gamma."""

    def __init__(self, bias: Floats, ratio: float, activation: str) -> None:
        self.ratio = ratio
        self._drive = ratio * bias.ravel()
        self._phi, self._slope = ACTIVATIONS[activation].phi, ACTIVATIONS[activation].slope_at

    def sensitivity(self, weight: Floats, equilibrium: FlatEquilibrium) -> SensitivityMatrix:
        """S for these weights at their equilibrium."""
        return SensitivityMatrix(weight, equilibrium.slope, self.ratio)

    def newton(
        self,
        weight: Floats,
        x: Floats,
        nearby: SensitivityMatrix | None = None,
        *,
        tolerance: float = _TOLERANCE,
        steps: int = 8,
    ) -> FlatEquilibrium:
        """At most ``steps`` Newton steps, none of them longer than 1 in a coordinate.

        The first ones use S at nearby weights and state, if given. The tolerance is on the length of
        x - (mu/gamma) (W phi(x) + b).
        """
        chord_steps = 4  # steps with the matrix of the previous epoch, which is almost right and already factored
        for step in range(steps + 1):
            output = self._phi(x)
            residual = x - self.ratio * weight.dot(output) - self._drive
            # `dot`, since `@` and reductions have more overhead than all the rest for so few numbers.
            length = math.sqrt(residual.dot(residual))
            if not length >= tolerance or step == steps:
                break
            factored = nearby if nearby is not None and step < chord_steps else None
            if factored is None:
                factored = SensitivityMatrix(weight, self._slope(x, output), self.ratio)
            if factored.singular:
                break
            move = factored.solve(residual)
            far = math.sqrt(move.dot(move))
            x = x - (move if far <= _LONGEST_STEP else move * (_LONGEST_STEP / max(np.abs(move).max(), _LONGEST_STEP)))
        # Rounding may leave a residual of 1e-9.
        return FlatEquilibrium(x, output, self._slope(x, output), length < max(tolerance, 1e-9))

    def first(self, weight: Floats) -> FlatEquilibrium:
        """The equilibrium found from zero by more Newton steps, or by running the network where these fail."""
        result = self.newton(weight, np.zeros(len(weight)), steps=50)
        return result if result.success else self.flow(weight, np.zeros(len(weight)))

    def settled(self, weight: Floats, x: Floats, *, tolerance: float = _TOLERANCE) -> FlatEquilibrium:
        """The equilibrium to which the network itself runs from ``x``: slow, for where Newton steps fail.

        The equilibrium may lie far from ``x``, beyond a bifurcation; unlike one found by Newton's method, it is stable.
        """
        rest = self.flow(weight, x)
        if not rest.success:
            return rest
        polished = self.newton(weight, rest.x, tolerance=tolerance)
        # If the result is further away, the Newton steps have found another equilibrium.
        near = polished.success and np.abs(polished.x - rest.x).max() < 1e-2
        return polished if near else rest

    def flow(self, weight: Floats, x: Floats) -> FlatEquilibrium:
        """Runge-Kutta 4(5) in the time unit 1/gamma until the network rests, for at most 150 units.

        A network that is far faster than its decay is given up after 4000 steps; a hundred are usual for 15 units.
        """
        coupling, speed, left = self.ratio * weight, np.inf, 4000

        def field(_: float, state: Floats) -> Floats:
            return coupling @ self._phi(state) - state + self._drive

        horizon = 15.0  # Algorithm 1 only says "solve by RK45": we repeat runs of this length until the network rests
        for _ in range(10):
            speed = np.abs(field(0.0, x)).max()
            if speed < _AT_REST or left == 0:
                break
            run = RK45(field, 0.0, x, horizon, rtol=1e-7, atol=1e-9)
            while run.status == "running" and left > 0:
                run.step()
                left -= 1
            x = run.y
        output = self._phi(x)
        return FlatEquilibrium(x, output, self._slope(x, output), success=bool(speed < _AT_REST))


_identity = functools.cache(np.eye)
