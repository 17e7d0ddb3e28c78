"""Joint paths through nearly singular configurations, in which poses hardly determine the coordinates of a joint.

When the first and third of four hinges in one link align, the pose determines only the sum of their angles. To follow a
path of poses exactly that passes close by, the hinges would turn abruptly, at any speed and to any angle. There the
coordinates minimise instead

    sum_k f_k(q_k) + sum_k w_k ||q_{k+1} - 2 q_k + q_{k-1}||^2,     w_k = v^2 (r n_k)^4 (1 - s_k^2 / v^2)_+^4

where f_k is the squared distance of the poses (`nearest`), s_k the least singular value of their Jacobian, and v the
threshold below which it counts as small; n_k is the number of samples of the stretch in which it stays small, and r the
smallest fraction of a stretch that is straightened. The weights vanish smoothly at the ends of a stretch, so the path
joins the exact one without a kink. The deviation from the poses is part of the gap.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim.arm.kinematics import least_singular_value
from lieednn_sim.values import Floats

# v, for a Jacobian with columns of unit length, and r. Smaller values follow poses more closely, but turn hinges more.
# With these, 0.3 mm beside a pose where the configuration changes by 1 rad/s, hinges turn by 5 mrad at 2 rad/s^2.
NEARLY_SINGULAR, _STRAIGHTENED_FRACTION = 0.15, 0.05
_FLAT = 1e-9  # curvatures below this fraction of the largest count as zero

_Evaluate = Callable[[Floats], tuple[Floats, Floats]]


def singularity_margin(jacobian: Floats) -> Floats:
    """The ratio s / v ``(B,)`` for Jacobians ``(B, r, c)``, below 1 where these are nearly singular.

    A value of at least 1 may be only a lower bound of the ratio.
    """
    columns = jacobian / np.maximum(np.linalg.norm(jacobian, axis=-2, keepdims=True), 1e-300)
    # The eigenvalues of the Gram matrix, which has a unit diagonal, lie in Gershgorin's discs around 1. This bound
    # suffices for nearly all configurations.
    others = np.abs(np.swapaxes(columns, -1, -2) @ columns).sum(axis=-1).max(axis=-1) - 1.0
    margin = np.sqrt(np.maximum(1.0 - others, 0.0)) / NEARLY_SINGULAR
    doubtful = margin < 1.0
    margin[doubtful] = least_singular_value(jacobian[doubtful]) / NEARLY_SINGULAR
    return np.asarray(margin)


def straighten(
    evaluate: _Evaluate, exact: Floats, guess: Floats, margin: Floats, goal: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Coordinates ``(K, c)`` along a path of stacked poses ``(K, r)``, and which of them ``(K,)`` are straightened.

    Args:
        evaluate: maps coordinates ``(B, c)`` to stacked poses ``(B, r)`` and their Jacobian ``(B, r, c)``.
        exact: ``(K, c)`` coordinates that minimise the distance at each sample.
        guess: ``(K, c)`` coordinates near these that go straight on.
        margin: ``(K,)`` `singularity_margin` at the samples.
    """
    singular = margin < 1.0
    singular[[0, -1]] = False
    if not singular.any():
        return exact, singular
    # The length of each sample's stretch.
    stretch = np.cumsum(np.diff(singular, prepend=singular[:1]))
    length = np.bincount(stretch)[stretch]
    smooth = (_STRAIGHTENED_FRACTION * length) ** 4 * np.maximum(1.0 - margin**2, 0.0) ** 4
    weights = NEARLY_SINGULAR**2 * smooth[1:-1]
    shape = (len(exact) - 2, len(exact))
    bends = scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=shape, format="csr")
    # All samples that a weighted second difference involves, except the ends.
    free = np.convolve(singular, [1, 1, 1], "same").astype(bool)
    free[[0, -1]] = False
    pulls = bends[:, free].T @ scipy.sparse.diags_array(weights)
    bending = scipy.sparse.kron(pulls @ bends[:, free], np.eye(exact.shape[1]), format="csc")
    q = np.where(free[:, None], guess, exact)
    for _ in range(30):
        values, jacobian = evaluate(q[free])
        square = scipy.sparse.block_diag([scipy.sparse.coo_array(block.T @ block) for block in jacobian], format="csc")
        slope = np.einsum("kri,kr->ki", jacobian, values - goal[free]) + pulls @ (bends @ q)
        step = scipy.sparse.linalg.spsolve(square + bending, slope.ravel()).reshape(slope.shape)
        q[free] -= step
        if np.abs(step).max() < 1e-9:
            break
    return q, free


def pseudo_inverse(matrix: Floats) -> Floats:
    """Pseudo-inverses of symmetric matrices ``(B, c, c)``; inverses, in a fifth of the time, unless nearly singular."""
    try:
        inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix, rcond=_FLAT, hermitian=True), dtype=np.float64)
    # The condition number in the Frobenius norm is an upper bound of the spectral one; NaN counts as singular.
    condition = np.linalg.norm(matrix, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
    flat = ~(condition < 1.0 / _FLAT)
    if flat.any():
        inverse[flat] = np.linalg.pinv(matrix[flat], rcond=_FLAT, hermitian=True)
    return inverse
