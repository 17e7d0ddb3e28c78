"""Stability and equivariance as the paper states them, on random networks."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim import stability
from lieednn_sim.lie import adjoint
from lieednn_sim.network import LieEDNN
from lieednn_sim.theory import EquivariantLieEDNN

Scalars = dict[str, Any]


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
    """Random W that meet one condition and not the other: what does each prove alone?

    The certificate, a diagonal Lyapunov matrix checked by eigenvalues, is independent of both: with it there is one
    equilibrium, and it attracts every start.
    """
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
