"""Gradients of the equilibrium error in the weights and in the connection strengths.

At an equilibrium gamma x* = mu (W phi(x*) + b). With the sensitivity matrix S = I - (mu/gamma) W diag(phi'(x*)), a
change dW moves it by dx* = (mu/gamma) S^-1 dW phi(x*). For E^2/2 with delta = x* - x_d one linear solve gives every
entry at once: S^T lambda = delta, then dE/dW = (mu/gamma) lambda phi(x*)^T; for E itself divide by E.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.learning.manifold import block_view
from lieednn_sim.lie import adjoint
from lieednn_sim.network import LieEDNN
from lieednn_sim.validation import as_choice, as_floats
from lieednn_sim.values import Floats, frozen

LOSSES = ("squared", "norm")


@frozen
class Sensitivity:
    """The equilibrium error and its derivatives in the weights.

    Attributes:
        loss: E^2/2 ("squared") or E ("norm"), E = ||xi* - xi_d||_2.
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


def sensitivity(network: LieEDNN, target: ArrayLike, *, loss: str = "squared") -> Sensitivity:
    """Loss and gradients of a network whose equilibrium should be ``target`` (paper, eqs. 3.15 to 3.19).

    Args:
        network: its equilibrium is searched for from zero.
        target: ``(N - M, 6)`` xi_d of the visible neurons.
        loss: a name of `LOSSES`.

    Raises:
        InputError: no equilibrium is found, S is singular there, or the loss is the norm and E is 0.
    """
    goal = as_floats("target", target, (network.n_visible, 6))
    as_choice("loss", loss, LOSSES)
    result = network.equilibrium()
    if not result.success:
        raise InputError(f"the gradient needs an equilibrium: {result.message}")
    matrix = -network.jacobian(result.xi) / network.gamma  # the Jacobian of the vector field is -gamma S
    output = network.phi(result.xi).ravel()
    delta = np.zeros_like(result.xi)  # hidden neurons do not count
    delta[: network.n_visible] = network.visible(result.xi) - goal
    delta = delta.ravel()
    error = float(np.linalg.norm(delta))
    if loss == "norm" and error == 0.0:
        raise InputError("E = ||xi* - xi_d|| has no gradient at E = 0; use the squared loss")
    ratio = network.mu / network.gamma
    try:
        multiplier = np.asarray(np.linalg.solve(matrix.T, delta), dtype=np.float64)
        weight = weight_gradient(multiplier, output, ratio)
    except np.linalg.LinAlgError:
        raise InputError("the sensitivity matrix is singular: the equilibrium bifurcates here") from None
    if loss == "norm":
        weight /= error
    return Sensitivity(
        loss=error if loss == "norm" else 0.5 * error**2,
        equilibrium=result.xi,
        matrix=matrix,
        weight=weight,
        alpha=strength_gradient(weight, adjoint(network.rotation, network.translation)),
    )


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
