"""Projections onto SO(3) and onto the adjoint image of SE(3)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.lie.se3 import hat, vee
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

_SKEW_BASIS = hat(np.eye(3))
_LARGEST = 1e152  # largest entries; larger than elsewhere, since matrices are normalised before they are squared


def project_to_rotation(matrix: ArrayLike) -> Floats:
    """Rotation nearest to each of the ``(..., 3, 3)`` matrices in the Frobenius norm.

    It is U diag(1, 1, det(U V^T)) V^T (paper, Lemma "Metric Projection to SO(3)"), where U and V are those of the
    singular value decomposition. A matrix of rank below 2, or with a negative determinant and equal smallest singular
    values, has many nearest rotations; one of them is returned.
    """
    u, _, vt = np.linalg.svd(as_floats("matrix", matrix, (3, 3), batched=True, largest=_LARGEST))
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def project_to_adjoint(matrix: ArrayLike) -> tuple[Floats, Floats]:
    """Project matrices ``(..., 6, 6)`` block by block onto the adjoint matrices of SE(3), as the paper does.

    It is the projection of the paper's appendix F. With blocks [[A, B], [C, D]]: R is the nearest rotation to (A + D)/2
    and hat(t) the skew part of C R^T. (The paper's text says "A and B", its formula and proof use A and D.) This is not
    the Frobenius-nearest point: there R would also depend on the symmetric part of C R^T. `adjoint` puts the rotations
    ``(..., 3, 3)`` and translations ``(..., 3)`` together.
    """
    blocks = as_floats("matrix", matrix, (6, 6), batched=True, largest=_LARGEST)
    rotation = project_to_rotation(0.5 * (blocks[..., :3, :3] + blocks[..., 3:, 3:]))
    return rotation, vee(blocks[..., 3:, :3] @ np.swapaxes(rotation, -1, -2))


def project_to_adjoint_exact(matrix: ArrayLike) -> tuple[Floats, Floats]:
    """The adjoint matrix of SE(3) that is nearest to ``(..., 6, 6)`` in the Frobenius norm, as `project_to_adjoint`.

    With blocks [[A, B], [C, D]] the squared distance is |A - R|^2 + |B|^2 + |C R^T - hat(t)|^2 + |D - R|^2. The best
    hat(t) is the skew part of C R^T, which leaves |A - R|^2 + |D - R|^2 + |sym(C R^T)|^2 to minimise over R in SO(3).
    That function can have several local minima: damped Newton steps run from the block-wise R times each of the 24
    rotations of the cube, and the best result wins.
    """
    blocks = as_floats("matrix", matrix, (6, 6), batched=True, largest=_LARGEST)
    flat = blocks.reshape(-1, 6, 6)
    total, lower = flat[:, :3, :3] + flat[:, 3:, 3:], flat[:, 3:, :3]
    # What is minimised is linear in A + D and quadratic in C. Dividing by a common size keeps the squares in range.
    size = np.maximum(np.sqrt(np.abs(total).max(axis=(1, 2))), np.abs(lower).max(axis=(1, 2)))[:, None, None]
    size = np.where(size > 0.0, size, 1.0)
    total, lower = total / size / size, lower / size
    starts = project_to_rotation(total)[:, None] @ _cube()
    count = starts.shape[1]

    def evaluate(rotation: Floats, index: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        transposed = np.swapaxes(rotation, -1, -2)
        k, n = total[index // count] @ transposed, lower[index // count] @ transposed
        square = n @ n
        # |sym(N)|^2 = (|N|^2 + tr(N N)) / 2, and |N| = |C| does not depend on R.
        value = 0.5 * _trace(square) - 2.0 * _trace(k)
        # With R -> exp(hat(w)) R, that is N -> N exp(-hat(w)), to second order in w.
        gradient = 2.0 * vee(square) - 4.0 * vee(k)
        twisted = n[:, None] @ _SKEW_BASIS
        cross = np.einsum("niab,njba->nij", twisted, twisted)
        trace = (2.0 * _trace(k) - _trace(square))[:, None, None]
        rest = square - 2.0 * k
        return value, gradient, cross + 0.5 * (rest + np.swapaxes(rest, -1, -2)) + trace * np.eye(3)

    def move(rotation: Floats, step: Floats) -> Floats:
        # Projected, so that rounding does not add up over the steps.
        return project_to_rotation(scipy.spatial.transform.Rotation.from_rotvec(step).as_matrix() @ rotation)

    points, values = descend(starts.reshape(-1, 3, 3), evaluate, move)
    # Within rounding (far translations swallow A and D) the block-wise start, the first, is the one to believe.
    values = values.reshape(-1, count) - 1e-13 * (np.arange(count) == 0)
    best = values.argmin(axis=1)
    rotation = points.reshape(-1, count, 3, 3)[np.arange(len(flat)), best].reshape(*blocks.shape[:-2], 3, 3)
    return rotation, vee(blocks[..., 3:, :3] @ np.swapaxes(rotation, -1, -2))


def project_to_scaled_adjoint(matrix: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Project matrices ``(..., 6, 6)`` block by block onto scaled adjoint matrices alpha Ad, alpha of either sign.

    With blocks [[A, B], [C, D]] and M = (A + D)/2, (alpha, R) minimises |M - alpha R|: |alpha| is a third of the sum of
    the singular values of M, its sign that of det M, and R the nearest rotation to M or -M. So a block with det M < 0,
    onto which no rotation fits well, becomes a negative strength instead. alpha hat(t) is the skew part of C R^T.
    Where M is zero, alpha is zero, R some rotation and t zero. The result is alpha ``(...)``, rotations ``(..., 3, 3)``
    and translations ``(..., 3)``.
    """
    blocks = as_floats("matrix", matrix, (6, 6), batched=True, largest=_LARGEST)
    u, singular, vt = np.linalg.svd(0.5 * (blocks[..., :3, :3] + blocks[..., 3:, 3:]))
    product = u @ vt
    sign = np.sign(np.linalg.det(product))
    alpha = sign * singular.sum(axis=-1) / 3.0
    rotation = sign[..., None, None] * product
    moved = vee(blocks[..., 3:, :3] @ np.swapaxes(rotation, -1, -2))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        translation = moved / alpha[..., None]
    finite = np.isfinite(translation).all(axis=-1, keepdims=True)
    return alpha, rotation, np.where(finite, translation, 0.0)


def descend(
    points: NDArray[Any],
    evaluate: Callable[[NDArray[Any], NDArray[np.intp]], tuple[Floats, Floats, Floats]],
    move: Callable[[NDArray[Any], Floats], NDArray[Any]],
) -> tuple[NDArray[Any], Floats]:
    """The ends of a damped Newton descent of many points ``(B, ...)`` on a manifold at once, and their values.

    Beyond rounding no value ever rises. Points and their indices are evaluated to values ``(B,)``, gradients ``(B, d)``
    and Hessians ``(B, d, d)`` of the value in the coordinates of a step; points and steps ``(B, d)`` give new points.
    """
    points = points.copy()
    active = np.arange(len(points))
    value, gradient, hessian = evaluate(points, active)
    damping = np.zeros(len(points))
    for _ in range(200):
        if not active.size:
            break
        # Eigenvalues by their size: saddles repel, and directions that change nothing (the kernel) are left alone.
        eigenvalues, vectors = np.linalg.eigh(hessian[active])
        stiffness = np.abs(eigenvalues) + damping[active, None]
        scale = 1.0 + np.abs(eigenvalues).max(axis=1, keepdims=True)
        along = np.einsum("bij,bi->bj", vectors, gradient[active])
        step = -np.einsum("bij,bj->bi", vectors, along / np.maximum(stiffness, 1e-10 * scale))
        length = np.linalg.norm(step, axis=1)
        step *= (1.0 / np.maximum(length, 1.0))[:, None]  # at most 1 in the group's coordinates (rad for rotations)
        moved = move(points[active], step)
        new_value, new_gradient, new_hessian = evaluate(moved, active)
        # Near the minimum values agree to rounding; there the gradient decides.
        level = new_value <= value[active] + 1e-15 * np.abs(value[active])
        flatter = np.linalg.norm(new_gradient, axis=1) < np.linalg.norm(gradient[active], axis=1)
        better = (new_value < value[active]) | (level & flatter)
        taken = active[better]
        points[taken], value[taken] = moved[better], new_value[better]
        gradient[taken], hessian[taken] = new_gradient[better], new_hessian[better]
        damping[active] = np.where(better, 0.1 * damping[active], 10.0 * damping[active] + 1e-2 * scale[:, 0])
        active = active[(length > 1e-12) & (damping[active] < 1e8 * scale[:, 0])]
    return points, value


@cache
def _cube() -> Floats:
    """The rotations of the cube ``(24, 3, 3)``, the identity first: starts spread evenly over SO(3)."""
    group = scipy.spatial.transform.Rotation.create_group("O")
    return np.stack(sorted(group.as_matrix(), key=np.trace, reverse=True))


def _trace(matrix: Floats) -> Floats:
    return np.trace(matrix, axis1=-2, axis2=-1)
