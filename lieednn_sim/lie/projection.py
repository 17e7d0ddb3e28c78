"""Projections onto SO(3) and onto the adjoint image of SE(3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.lie.se3 import vee
from lieednn_sim.validation import as_floats

Floats = NDArray[np.float64]


def project_to_rotation(matrix: ArrayLike) -> Floats:
    """Frobenius-nearest rotation of ``(..., 3, 3)`` matrices (paper, Lemma "Metric Projection to SO(3)").

    U diag(1, 1, det(U V^T)) V^T of the singular value decomposition. A matrix of rank below 2, or with a negative
    determinant and equal smallest singular values, has many nearest rotations; one of them is returned.

    Raises:
        InputError: wrong shape or entries that are not finite.
    """
    u, _, vt = np.linalg.svd(as_floats("matrix", matrix, (3, 3), batched=True))
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def project_to_adjoint(matrix: ArrayLike) -> tuple[Floats, Floats]:
    """Block-wise projection of ``(..., 6, 6)`` onto the adjoint matrices of SE(3) (paper, App. F).

    With blocks [[A, B], [C, D]]: R is the nearest rotation to (A + D)/2 and hat(t) the skew part of C R^T. (The paper's
    text says "A and B", its formula and proof use A and D.) This is not the Frobenius-nearest point: there R would
    also depend on the symmetric part of C R^T.

    Returns:
        Rotations ``(..., 3, 3)`` and translations ``(..., 3)``; `adjoint` puts them together.
    """
    blocks = as_floats("matrix", matrix, (6, 6), batched=True)
    rotation = project_to_rotation(0.5 * (blocks[..., :3, :3] + blocks[..., 3:, 3:]))
    return rotation, vee(blocks[..., 3:, :3] @ np.swapaxes(rotation, -1, -2))
