"""Numerical checks of the paper's formulas, and of its statements on stability, frames and other number systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim import stability
from lieednn_sim.lie import adjoint, hat, project_to_adjoint, project_to_adjoint_exact
from lieednn_sim.network import LieEDNN
from lieednn_sim.theory import (
    EquivariantLieEDNN,
    complex_network,
    complex_state,
    complex_values,
    quaternion_network,
    quaternion_state,
    quaternion_values,
)
from lieednn_sim.theory.groups import group

Scalars = dict[str, Any]


def projection(samples: int) -> Scalars:
    """Random 6x6 blocks, and their pieces of rank 3: how much nearer is the Frobenius-nearest adjoint matrix?"""
    rng = np.random.default_rng(0)
    blocks = rng.normal(size=(samples, 6, 6))

    def distance(pair: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return np.linalg.norm(blocks - adjoint(*pair), axis=(1, 2))

    paper, exact = distance(project_to_adjoint(blocks)), distance(project_to_adjoint_exact(blocks))
    middle = 0.5 * (blocks[:, :3, :3] + blocks[:, 3:, 3:])
    return {
        "count": samples,
        "farther": float(np.mean(paper > exact * (1.0 + 1e-9))),
        "median_excess": float(np.median(paper / exact - 1.0)),
        "largest_excess": float((paper / exact).max() - 1.0),
        "negative": float(np.mean(np.linalg.det(middle) < 0.0)),
    }


def algebras(samples: int) -> Scalars:
    """Complex and quaternion products as adjoint actions: of C^x and H^x, and of their affine groups."""
    rng = np.random.default_rng(0)
    planar, quaternions = group("C^x"), group("H^x")
    # The Lie algebras of C^x and H^x are C and H themselves.
    z, q = rng.normal(size=(2, samples, 2)), rng.normal(size=(2, samples, 4))
    literal_complex = np.abs(_act(planar, z[0], z[1]) - _product(planar, z[0], z[1])).max(axis=-1)
    literal_quaternion = np.abs(_act(quaternions, q[0], q[1]) - _product(quaternions, q[0], q[1])).max(axis=-1)
    w, b, x = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=3)
    weights = w + 1j * rng.normal(size=(3, 3))
    found = complex_values(complex_network(weights, b).vector_field(complex_state(x)))
    worst = [float(np.abs(found - (weights @ np.tanh(x) + b - x)).max())]
    weights, b, x = rng.normal(size=(3, 3, 4)), rng.normal(size=(3, 4)), rng.normal(size=(3, 4))
    expected = b - x + sum(_product(quaternions, weights[:, j], np.tanh(x[j])) for j in range(3))
    network = quaternion_network(weights, b)
    worst.append(float(np.abs(quaternion_values(network.vector_field(quaternion_state(x))) - expected).max()))
    return {
        "count": samples,
        "complex_identity": float(np.abs(_act(planar, z[0], z[1]) - z[1]).max()),
        "complex_apart": float(np.mean(literal_complex > 1e-6)),
        "quaternion_apart": float(np.mean(literal_quaternion > 1e-6)),
        "affine_error": max(worst),
    }


def _act(algebra: Any, w: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.einsum("kab,kb->ka", algebra.adjoint(algebra.hat(w)), p)


def _product(algebra: Any, w: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The product w p: the matrices of the algebra are those of the product."""
    matrix = algebra.hat(w)
    return np.einsum("kab,...b->ka", matrix, p) if p.ndim == 1 else np.einsum("kab,kb->ka", matrix, p)


def activation(samples: int) -> Scalars:
    """Equivariance under random frames: of tanh, of the activation in App. N as printed, and of the corrected one."""
    rng = np.random.default_rng(0)
    twist = rng.normal(size=(samples, 6))
    frame = adjoint(Rotation.random(samples, rng=rng).as_matrix(), rng.normal(size=(samples, 3)))
    moved = np.einsum("kab,kb->ka", frame, twist)
    still = np.eye(3)[None, None], np.zeros((1, 1, 3))
    network = EquivariantLieEDNN(np.ones((1, 1)), *still, np.zeros((1, 6)))

    def printed(x: np.ndarray, epsilon: float = 1e-6) -> np.ndarray:
        size = np.linalg.norm(x[..., :3], axis=-1, keepdims=True)
        return np.tanh(size) / (size + epsilon) * x

    def apart(phi: Callable[[np.ndarray], np.ndarray]) -> float:
        return float(np.abs(phi(moved) - np.einsum("kab,kb->ka", frame, phi(twist))).max())

    trace = np.trace(hat(twist) @ hat(twist), axis1=-2, axis2=-1)
    pure = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    return {
        "count": samples,
        "tanh": apart(np.tanh),
        "printed": apart(printed),
        "corrected": apart(lambda x: network.phi(x[:, None])[:, 0]),
        "negative_trace": float(np.mean(trace < 0.0)),
        "printed_pure_translation": float(printed(pure)[3]),
        "corrected_pure_translation": float(network.phi(pure[None])[0, 3]),
    }


def norm_conditions(samples: int) -> Scalars:
    """Random W just inside both norm conditions: is each certified by a diagonal Lyapunov matrix?"""
    rng = np.random.default_rng(0)
    count = max(1, samples // 10)
    certified = 0
    for _ in range(count):
        weight = rng.normal(size=(24, 24))
        weight *= 0.99 / max(np.linalg.norm(weight, 1), np.linalg.norm(weight, np.inf))
        certified += stability.find_certificate(weight, gamma=1.0, mu=1.0).valid
    return {"count": count, "certified": certified}


def single_norms(samples: int) -> Scalars:
    """Random W that meet only one of the conditions: does a diagonal Lyapunov matrix prove one global equilibrium?"""
    rng, count = np.random.default_rng(0), max(2, samples // 10)
    columns, sums, violating, beyond = 0, 0, 0, 0
    for _ in range(count):
        # Rows of very different size: columns below gamma/mu = 1, and a row far above.
        weight = rng.normal(size=(24, 24)) * np.where(np.arange(24) == 0, 20.0, 1.0)[:, None]
        weight *= 0.99 / np.linalg.norm(weight, 1)
        violating += bool(stability.log_norms(weight).norm_sum >= 2.0)
        norm = stability.weighted_norm(weight)
        columns += stability.verify(norm.left / norm.right, weight, gamma=1.0, mu=1.0).valid
        # Row plus column below 2, a column above 1: one large column and the rest small.
        weight = rng.normal(size=(24, 24)) * np.where(np.arange(24) == 0, 20.0, 1.0)
        weight *= 1.98 / stability.log_norms(weight).norm_sum
        beyond += bool(np.linalg.norm(weight, 1) > 1.0)
        sums += stability.verify(np.ones(24), weight, gamma=1.0, mu=1.0).valid
    return {"count": count, "columns": columns, "sums": sums, "violating": violating, "beyond": beyond}


def equivariance(samples: int) -> Scalars:
    """Networks seen from another frame: trajectories with the equivariant activation, and with tanh by coordinates."""
    rng = np.random.default_rng(0)
    errors, ordinary, own = [], [], []
    times = np.linspace(0.0, 4.0, 9)
    for _ in range(max(2, samples // 100)):
        rotation = Rotation.random(16, rng=rng).as_matrix().reshape(4, 4, 3, 3)
        blocks = 0.3 * rng.normal(size=(4, 4)), rotation, rng.normal(size=(4, 4, 3)), rng.normal(size=(4, 6))
        start, frame = rng.normal(size=(4, 6)), (Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
        one = EquivariantLieEDNN(*blocks)
        other = one.transform(*frame)
        moved = start @ adjoint(*frame).T
        errors.append(_apart(one, start, other, moved, frame, times))
        seen = LieEDNN(other.alpha, other.rotation, other.translation, other.bias)
        ordinary.append(_apart(LieEDNN(*blocks), start, seen, moved, frame, times))
        # The paper's rule theta -> h theta h^-1 with a frame of its own for every neuron: the weighted outputs.
        frames = adjoint(Rotation.random(4, rng=rng).as_matrix(), rng.normal(size=(4, 3)))
        turned = frames[:, None] @ one.blocks @ np.linalg.inv(frames)[:, None]
        left = np.einsum("ijab,jb->ia", turned, np.einsum("jab,jb->ja", frames, one.phi(start)))
        right = np.einsum("iab,ijbc,jc->ia", frames, one.blocks, one.phi(start))
        own.append(np.abs(left - right).max() / (1.0 + np.abs(right).max()))
    return {"count": len(errors), "largest": max(errors), "tanh": float(np.median(ordinary)), "own": float(min(own))}


def _apart(
    one: Any, start: np.ndarray, other: Any, moved: np.ndarray, frame: tuple[np.ndarray, np.ndarray], times: np.ndarray
) -> float:
    """Largest difference of a trajectory moved to the other frame and the one that runs there, relative to its size."""
    expected = one.trajectory(start, times[-1], rtol=1e-10, atol=1e-12)(times) @ adjoint(*frame).T
    found = other.trajectory(moved, times[-1], rtol=1e-10, atol=1e-12)(times)
    return float(np.abs(found - expected).max() / (1.0 + np.abs(expected).max()))
