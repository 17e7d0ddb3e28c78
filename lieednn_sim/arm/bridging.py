"""Straightened ways through nearly singular postures, where poses hardly determine the coordinates of a joint.

When the first and third of four hinges in one link come into line, the pose determines only the sum of their angles.
To follow a way of poses that passes close by exactly, the hinges would turn abruptly, at any speed and to any angle.
There the coordinates minimise instead

    sum_k f_k(q_k) + sum_k w_k ||q_{k+1} - 2 q_k + q_{k-1}||^2,     w_k = v^2 (r n_k)^4 (1 - s_k^2 / v^2)_+^4

with the distance f_k of the poses (`nearest`), the least singular value s_k of the poses' Jacobian, the threshold v
below which it counts as small, the length n_k of the stretch of samples where it is small, and r, the least share of a
stretch that is straightened. The weights fall off steeply enough for the way to join the exact one without a kink. The
deviation from the poses is part of the gap.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim.arm.kinematics import distinctness
from lieednn_sim.values import Floats

# v, for a Jacobian with columns of unit length, and r. Smaller values follow the poses more closely, and turn the
# hinges more. With these, 0.3 mm beside a pose where the posture changes by 1 rad/s, they turn by 5 mrad at 2 rad/s^2.
VAGUE, _SHARE = 0.15, 0.05
_STEPS, _SHORT = 30, 1e-9

_Evaluate = Callable[[Floats], tuple[Floats, Floats]]


def vagueness(jacobian: Floats) -> Floats:
    """The share s / v ``(B,)`` of Jacobians ``(B, r, c)``; where it is 1 or more, a lower bound that is 1 or more."""
    columns = jacobian / np.maximum(np.linalg.norm(jacobian, axis=-2, keepdims=True), 1e-300)
    # The eigenvalues of the Gram matrix, whose diagonal is 1, are within Gershgorin's discs around 1. For nearly all
    # postures that bound suffices.
    others = np.abs(np.swapaxes(columns, -1, -2) @ columns).sum(axis=-1).max(axis=-1) - 1.0
    share = np.sqrt(np.maximum(1.0 - others, 0.0)) / VAGUE
    doubtful = share < 1.0
    share[doubtful] = distinctness(jacobian[doubtful]) / VAGUE
    return np.asarray(share)


def bridge(
    evaluate: _Evaluate, exact: Floats, guess: Floats, share: Floats, goal: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Coordinates ``(K, c)`` along one way, and which of them ``(K,)`` do not minimise the distance alone.

    Args:
        evaluate: maps coordinates ``(B, c)`` to stacked poses ``(B, r)`` and their Jacobian ``(B, r, c)``.
        exact: ``(K, c)`` coordinates that minimise the distance of each sample.
        guess: ``(K, c)`` coordinates near these that continue straight on.
        share: ``(K,)`` their `vagueness`.
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
