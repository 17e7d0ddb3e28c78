"""Numerical checks of the paper's learning rules: gradients by differences, and the projection by the manifold."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim import lie, theory
from lieednn_sim.learning import TrainingOptions, sensitivity, train
from lieednn_sim.learning.manifold import block_view
from lieednn_sim.network import LieEDNN

Scalars = dict[str, Any]

# Sizes of the translations in the weight blocks, of their standard deviation [length units].
TRANSLATIONS = (0.01, 0.1, 0.5, 1.0, 3.0, 10.0)
# Steps whose difference quotient is the direction in which projected descent sets out, relative to the weights.
_STEP = 1e-7


def weight_gradient(samples: int) -> Scalars:
    """dE/dw as printed, entry by entry, against central differences of the equilibrium solved anew."""
    rng, errors = np.random.default_rng(0), []
    for seed in range(max(2, samples // 50)):
        network, goal = random_network(seed, 0.5), np.random.default_rng([seed, 1]).uniform(-0.8, 0.8, (4, 6))
        start, weight = network.equilibrium().xi.ravel(), network.weight
        printed = _printed_gradient(weight, start, goal.ravel())
        for i, j in rng.integers(0, 24, (10, 2)):
            change = np.zeros_like(weight)
            change[i, j] = 1e-4
            ahead, behind = (
                np.linalg.norm(_solved(weight + sign * change, start, network.bias.ravel()) - goal.ravel())
                for sign in (1.0, -1.0)
            )
            errors.append(abs((ahead - behind) / 2e-4 - printed[i, j]) / np.abs(printed).max())
    return {"count": len(errors), "largest_error": float(max(errors))}


def strength_gradient(samples: int) -> Scalars:
    """dE/dalpha as printed, with w/alpha: against <dE/dW_ij, L_ij>, over the epochs from one projection to the next."""
    errors = []
    for seed in range(max(2, samples // 100)):
        goal = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, 6))
        network = train(goal, TrainingOptions(max_epochs=50), seed=seed).network
        if not isinstance(network, LieEDNN) or not network.equilibrium().success:
            continue
        weight, adjoints = network.weight.copy(), lie.adjoint(network.rotation, network.translation)
        x = network.equilibrium().xi.ravel()
        for _ in range(9):
            x = _solved(weight, x, network.bias.ravel())
            slope = np.linalg.norm(x - goal.ravel()) * _printed_gradient(weight, x, goal.ravel())
            exact = np.einsum("ijab,ijab->ij", block_view(slope, 6), adjoints)
            printed = np.einsum(
                "ijab,ijab->ij", block_view(slope, 6), block_view(weight, 6) / network.alpha[:, :, None, None]
            )
            errors.append(np.linalg.norm(printed - exact) / np.linalg.norm(exact))
            # The least rate of Algorithm 1.
            weight = weight - 0.002 * slope
    return {
        "count": len(errors),
        "on_manifold": float(np.max(errors[::9])),
        "median_error": float(np.median(errors)),
        "largest_error": float(np.max(errors)),
    }


def riemannian(samples: int) -> Scalars:
    """Cosines between the Riemannian gradient (Frobenius metric) and the first-order change by a projected step.

    The networks are random with translations of each size, and alpha is held as in Algorithm 1. Steps go along the
    gradient of E^2/2 and along a random one; they are projected block by block, and to the nearest point.
    """
    count, few = max(2, samples // 20), max(1, samples // 200)
    cosines = {name: np.empty((len(TRANSLATIONS), count)) for name in ("loss", "random")}
    nearest = np.empty((len(TRANSLATIONS), few))
    for k, size in enumerate(TRANSLATIONS):
        for seed in range(count):
            network = random_network(seed, size)
            rng = np.random.default_rng([seed, 1])
            goal = rng.uniform(-0.8, 0.8, (4, 6))
            slopes = {"loss": block_view(sensitivity(network, goal).weight, 6), "random": rng.normal(size=(4, 4, 6, 6))}
            for name, slope in slopes.items():
                slope = slope / np.linalg.norm(slope)
                wanted = tangent(network, slope)
                cosines[name][k, seed] = _cosine(_direction(network, slope, lie.project_to_adjoint), wanted)
                if name == "loss" and seed < few:
                    nearest[k, seed] = _cosine(_direction(network, slope, lie.project_to_adjoint_exact), wanted)
    return {
        "count": count,
        "loss": np.median(cosines["loss"], axis=1).tolist(),
        "random": np.median(cosines["random"], axis=1).tolist(),
        "nearest": float(nearest.min()),
        # <direction, G> = <direction, Riemannian gradient>, for the direction is tangent: below 0 the loss rises.
        "rising": np.mean(cosines["random"] < 0.0, axis=1).tolist(),
        "smallest": float(cosines["random"].min()),
    }


def tangent(network: LieEDNN, blocks: np.ndarray) -> np.ndarray:
    """Orthogonal projection of ``(N, N, 6, 6)`` onto the tangent spaces of L[Ad_SE(3)] at the network's blocks."""
    base = lie.adjoint(network.rotation, network.translation)
    generators = theory.group("SE(3)").ad(np.eye(6))
    spanning = (generators[:, None, None] @ base).reshape(6, *base.shape[:2], 36).transpose(1, 2, 3, 0)
    flat = blocks.reshape(*base.shape[:2], 36, 1)
    return (spanning @ (np.linalg.pinv(spanning) @ flat)).reshape(base.shape)


def random_network(seed: int, size: float) -> LieEDNN:
    """Four neurons with strengths small enough for one equilibrium, and translations of standard deviation ``size``."""
    rng = np.random.default_rng([seed, 0])
    rotation = Rotation.random(16, rng=rng).as_matrix().reshape(4, 4, 3, 3)
    alpha = rng.choice([-1.0, 1.0], (4, 4)) * rng.uniform(0.5, 1.0, (4, 4))
    # The rotational part decides on stability, whatever the translations are.
    core = (alpha[:, :, None, None] * rotation).transpose(0, 2, 1, 3).reshape(12, 12)
    alpha *= 0.8 / np.linalg.norm(core, 2)
    return LieEDNN(alpha, rotation, size * rng.normal(size=(4, 4, 3)), np.full((4, 6), 0.125))


def _direction(network: LieEDNN, slope: np.ndarray, project: Any) -> np.ndarray:
    """Minus the derivative of Proj(W - eta G) in eta at 0, by central differences."""
    alpha = network.alpha[:, :, None, None]
    base = lie.adjoint(network.rotation, network.translation)
    step = _STEP * (1.0 + np.abs(network.translation).max())
    ahead, behind = (alpha * lie.adjoint(*project(base - sign * step * slope / alpha)) for sign in (1.0, -1.0))
    return (behind - ahead) / (2.0 * step)


def _cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float((one * other).sum() / np.linalg.norm(one) / np.linalg.norm(other))


def _printed_gradient(weight: np.ndarray, x: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Eq. (3.16) entry by entry: phi(x_j) delta^T S^-1 e_i / E, with gamma = mu = 1."""
    inverse = np.linalg.inv(np.eye(len(x)) - weight * (1.0 - np.tanh(x) ** 2))
    delta = x - goal
    return (delta @ inverse)[:, None] * np.tanh(x) / np.linalg.norm(delta)


def _solved(weight: np.ndarray, x: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """The equilibrium near ``x``, with gamma = mu = 1."""
    for _ in range(20):
        matrix = np.eye(len(x)) - weight * (1.0 - np.tanh(x) ** 2)
        x = x - np.linalg.solve(matrix, x - weight @ np.tanh(x) - bias)
    return x
