"""Straightened ways through nearly singular postures, in which poses hardly determine the coordinates of a joint.

When the first and third of four hinges in one link align, the pose determines only the sum of their angles. To follow
exactly a way of poses that passes close by, the hinges would turn abruptly, at any speed and to any angle. There the
coordinates minimise instead

    sum_k f_k(q_k) + sum_k w_k ||q_{k+1} - 2 q_k + q_{k-1}||^2,     w_k = v^2 (r n_k)^4 (1 - s_k^2 / v^2)_+^4

where f_k is the distance of the poses (`nearest`), s_k the least singular value of their Jacobian, v the threshold
below which it counts as small, n_k the length of the stretch of samples where it is small, and r the least share of a
stretch that is straightened. The weights vanish smoothly at the ends of a stretch, so the way joins the exact one
without a kink. The deviation from the poses is part of the gap.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim.arm.kinematics import distinctness
from lieednn_sim.values import Floats

# v, for a Jacobian with columns of unit length, and r. Smaller values follow poses more closely, but turn hinges more.
# With these, 0.3 mm beside a pose where the posture changes by 1 rad/s, hinges turn by 5 mrad at 2 rad/s^2.
VAGUE, _SHARE = 0.15, 0.05
_STEPS, _SHORT = 30, 1e-9

_Evaluate = Callable[[Floats], tuple[Floats, Floats]]


def vagueness(jacobian: Floats) -> Floats:
    """The ratio s / v ``(B,)`` for Jacobians ``(B, r, c)``; values of at least 1 may be only lower bounds of it."""
    columns = jacobian / np.maximum(np.linalg.norm(jacobian, axis=-2, keepdims=True), 1e-300)
    # The eigenvalues of the Gram matrix, which has a unit diagonal, lie in Gershgorin's discs around 1. This bound
    # suffices for nearly all postures.
    others = np.abs(np.swapaxes(columns, -1, -2) @ columns).sum(axis=-1).max(axis=-1) - 1.0
    share = np.sqrt(np.maximum(1.0 - others, 0.0)) / VAGUE
    doubtful = share < 1.0
    share[doubtful] = distinctness(jacobian[doubtful]) / VAGUE
    return np.asarray(share)


def bridge(
    evaluate: _Evaluate, exact: Floats, guess: Floats, share: Floats, goal: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Coordinates ``(K, c)`` along a way, and which of them ``(K,)`` are straightened.

    Args:
        evaluate: maps coordinates ``(B, c)`` to stacked poses ``(B, r)`` and their Jacobian ``(B, r, c)``.
        exact: ``(K, c)`` coordinates that minimise the distance at each sample.
        guess: ``(K, c)`` coordinates near these that go straight on.
        share: ``(K,)`` `vagueness` at the samples.
        goal: ``(K, r)`` stacked poses of the way.
    """
    vague = share < 1.0
    vague[[0, -1]] = False
    if not vague.any():
        return exact, vague
    # The length of each sample's stretch.
    stretch = np.cumsum(np.diff(vague, prepend=vague[:1]))
    length = np.bincount(stretch)[stretch]
    weights = VAGUE**2 * ((_SHARE * length) ** 4 * np.maximum(1.0 - share**2, 0.0) ** 4)[1:-1]
    shape = (len(exact) - 2, len(exact))
    bends = scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=shape, format="csr")
    # All samples that a weighted second difference involves, except the ends.
    free = np.convolve(vague, [1, 1, 1], "same").astype(bool)
    free[[0, -1]] = False
    pulls = bends[:, free].T @ scipy.sparse.diags_array(weights)
    bending = scipy.sparse.kron(pulls @ bends[:, free], np.eye(exact.shape[1]), format="csc")
    q = np.where(free[:, None], guess, exact)
    for _ in range(_STEPS):
        values, jacobian = evaluate(q[free])
        square = scipy.sparse.block_diag([scipy.sparse.coo_array(one.T @ one) for one in jacobian], format="csc")
        slope = np.einsum("kri,kr->ki", jacobian, values - goal[free]) + pulls @ (bends @ q)
        step = scipy.sparse.linalg.spsolve(square + bending, slope.ravel()).reshape(slope.shape)
        q[free] -= step
        if np.abs(step).max() < _SHORT:
            break
    return q, free
