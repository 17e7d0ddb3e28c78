"""The catalogue of matrix Lie groups, and the affine group over each real one.

In the adjoint of ``affine(C^x)`` the block that acts on the translations is complex multiplication, and in that of
``affine(H^x)`` left quaternion multiplication: see `networks`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.lie import se3
from lieednn_sim.lie.projection import project_to_adjoint_exact, project_to_rotation
from lieednn_sim.theory.matrix_group import Booleans, Matrices, MatrixLieGroup
from lieednn_sim.validation import as_count, quoted
from lieednn_sim.values import Floats

# The generator of SO(2), and Pauli's matrices.
_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
_PAULI = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
_LARGEST_GENERAL_LINEAR = 8  # GL(n) has n^6 structure constants: beyond this n the arrays become too large
_LARGEST_DIMENSION = 128  # the same for affine groups of affine groups


def group(name: str) -> MatrixLieGroup:
    """The group of a name: one of `GROUPS`, "GL(n)" with n up to 8, or "affine(...)" of these; else `InputError`."""
    if isinstance(name, str):
        if name in GROUPS:
            return GROUPS[name]()
        if general := re.fullmatch(r"GL\(([0-9]{1,4})\)", name):
            return general_linear(int(general[1]))
        if over := re.fullmatch(r"affine\((.{1,200})\)", name):
            return affine(group(over[1]))
    raise InputError(f"no group {quoted(name)}; allowed: {', '.join(GROUPS)}, GL(n), affine(...)")


def catalogue_name(item: MatrixLieGroup) -> str:
    """The name for files, for which `group` returns the same group; `InputError` for a group of the user's own."""
    try:
        known = group(item.name)
    except InputError:
        known = None
    if known is None or not np.array_equal(known.basis, item.basis):
        raise InputError(f"only a group of lieednn_sim.theory.groups can be saved, and {item.name!r} is none")
    return item.name


def so2() -> MatrixLieGroup:
    """Rotations of the plane; abelian."""
    return MatrixLieGroup("SO(2)", _TURN[None], partial(_identities, 2), _is_special_orthogonal)


def so3() -> MatrixLieGroup:
    """Rotations, coordinates omega: L[Ad_R] = R."""
    return MatrixLieGroup("SO(3)", se3.hat(np.eye(3)), project_to_rotation, _is_special_orthogonal)


def se2() -> MatrixLieGroup:
    """Planar rigid motions, twists (omega, v)."""
    return replace(affine(so2()), name="SE(2)", projection=_project_se2)


def rigid_motions() -> MatrixLieGroup:
    """SE(3), twists (omega, v): its adjoint matrices are those of `lieednn_sim.lie.adjoint`."""
    return replace(affine(so3()), name="SE(3)", projection=_project_se3)


def su2() -> MatrixLieGroup:
    """Unit quaternions as complex 2 x 2 matrices, basis -i sigma_k / 2.

    So SU(2) and SO(3) share structure constants and have the same adjoint matrices, the rotations; -I is in the kernel.
    """
    return MatrixLieGroup("SU(2)", -0.5j * _PAULI, _project_su2, _is_special_unitary)


def su3() -> MatrixLieGroup:
    """Basis -i lambda_k / 2 with the Gell-Mann matrices lambda_k, in their usual order; the kernel has 3 elements."""
    gell_mann = np.zeros((8, 3, 3), dtype=np.complex128)
    for k, (i, j) in ((0, (0, 1)), (3, (0, 2)), (5, (1, 2))):
        gell_mann[k, i, j] = gell_mann[k, j, i] = 1.0
        gell_mann[k + 1, i, j], gell_mann[k + 1, j, i] = -1j, 1j
    gell_mann[2] = np.diag([1.0, -1.0, 0.0])
    gell_mann[7] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(3.0)
    return MatrixLieGroup("SU(3)", -0.5j * gell_mann, None, _is_special_unitary)


def nonzero_complex() -> MatrixLieGroup:
    """C^x: a + bi as [[a, -b], [b, a]], coordinates (log modulus, angle); abelian."""
    basis = np.stack([np.eye(2), _TURN])
    return MatrixLieGroup("C^x", basis, partial(_identities, 2), partial(_is_nonzero_in, basis))


def nonzero_quaternion() -> MatrixLieGroup:
    """H^x: q as the real matrix of p -> q p, basis 1, i, j, k: L[Ad_q] = diag(1, R(q)); the kernel is R^x."""
    basis = _left_multiplication(np.eye(4))
    return MatrixLieGroup("H^x", basis, _project_quaternion, partial(_is_nonzero_in, basis))


def similarities() -> MatrixLieGroup:
    """Sim(3): rotation, positive scale and translation; coordinates (omega, log scale, v)."""
    basis = np.concatenate([se3.hat(np.eye(3)), np.eye(3)[None]])
    scaled_rotations = MatrixLieGroup("R+ x SO(3)", basis, None, _is_scaled_rotation)
    return replace(affine(scaled_rotations), name="Sim(3)")


@cache
def general_linear(n: int) -> MatrixLieGroup:
    """Invertible real n x n matrices, coordinates in row-major order; the kernel is the multiples of the identity.

    Elements with det < 0 are included: they act on the algebra like others, but are not exponentials. n is 1 to 8.
    """
    if (size := as_count("n", n)) > _LARGEST_GENERAL_LINEAR:
        raise InputError(f"n must be at most {_LARGEST_GENERAL_LINEAR} for GL(n), got {n}")
    basis = np.eye(size * size).reshape(-1, size, size)
    projection = partial(_identities, 1) if size == 1 else None
    return MatrixLieGroup(f"GL({size})", basis, projection, _is_invertible)


#: Functions that construct the groups, by name; each group is constructed when it is first used.
GROUPS: dict[str, Callable[[], MatrixLieGroup]] = {
    "SO(2)": cache(so2),
    "SO(3)": cache(so3),
    "SE(2)": cache(se2),
    "SE(3)": cache(rigid_motions),
    "SU(2)": cache(su2),
    "SU(3)": cache(su3),
    "C^x": cache(nonzero_complex),
    "H^x": cache(nonzero_quaternion),
    "Sim(3)": cache(similarities),
}


def affine(linear: MatrixLieGroup) -> MatrixLieGroup:
    """The affine group of a real matrix group G <= GL(m, R): maps p -> A p + b with A in G, as (m+1, m+1) matrices.

    The basis of G comes first, then the translations: SE(3) = affine(SO(3)) has twists (omega, v). Its adjoint matrix
    is [[L[Ad_A], 0], [K, A]]: unlike that of G, it contains A. `InputError` for complex G, or above 128 dimensions.
    """
    if np.iscomplexobj(linear.basis):
        raise InputError(f"affine needs a real matrix group, got {linear.name}")
    d, m = linear.dimension, linear.size
    if d + m > _LARGEST_DIMENSION:
        raise InputError(f"an affine group may have up to {_LARGEST_DIMENSION} dimensions, this one has {d + m}")
    basis = np.zeros((d + m, m + 1, m + 1))
    basis[:d, :m, :m] = linear.basis
    basis[d:, :m, m] = np.eye(m)
    return MatrixLieGroup(f"affine({linear.name})", basis, None, partial(_is_affine, linear))


def _identities(size: int, theta: Floats) -> Matrices:
    """The projection of an abelian group, whose only adjoint matrix is the identity."""
    return np.broadcast_to(np.eye(size), (*theta.shape[:-2], size, size)).copy()


def _project_se2(theta: Floats) -> Matrices:
    """L[Ad] = [[1, 0], [(t_y, -t_x), R]]: rotation and translation do not compete."""
    angle = np.arctan2(theta[..., 2, 1] - theta[..., 1, 2], theta[..., 1, 1] + theta[..., 2, 2])
    g = np.zeros((*theta.shape[:-2], 3, 3))
    g[..., :2, :2] = np.cos(angle)[..., None, None] * np.eye(2) + np.sin(angle)[..., None, None] * _TURN
    g[..., 0, 2], g[..., 1, 2], g[..., 2, 2] = -theta[..., 2, 0], theta[..., 1, 0], 1.0
    return g


def _project_se3(theta: Floats) -> Matrices:
    g = np.zeros((*theta.shape[:-2], 4, 4))
    g[..., :3, :3], g[..., :3, 3] = project_to_adjoint_exact(theta)
    g[..., 3, 3] = 1.0
    return g


def _project_su2(theta: Floats) -> Matrices:
    parts = _quaternion(theta)
    vector = np.tensordot(parts[..., 1:], _PAULI, axes=1)
    return parts[..., 0, None, None] * np.eye(2) - 1j * vector


def _project_quaternion(theta: Floats) -> Matrices:
    return _left_multiplication(_quaternion(theta[..., 1:, 1:]))


def _quaternion(theta: Floats) -> Floats:
    """Unit quaternions (w, x, y, z) of the nearest rotations."""
    return Rotation.from_matrix(project_to_rotation(theta)).as_quat(canonical=True, scalar_first=True)


def _left_multiplication(quaternion: Floats) -> Matrices:
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w]
    return np.stack(rows, axis=-1).reshape(*quaternion.shape[:-1], 4, 4)


def _is_special_orthogonal(g: Matrices, tolerance: float) -> Booleans:
    return _close(g @ np.swapaxes(g, -1, -2), np.eye(g.shape[-1]), tolerance) & (np.linalg.det(g) > 0.0)


def _is_special_unitary(g: Matrices, tolerance: float) -> Booleans:
    unitary = _close(g @ np.swapaxes(g, -1, -2).conj(), np.eye(g.shape[-1]), tolerance)
    return unitary & (np.abs(np.linalg.det(g) - 1.0) <= tolerance)


def _is_scaled_rotation(g: Matrices, tolerance: float) -> Booleans:
    """Tolerance relative to the scale."""
    scale = np.cbrt(np.linalg.det(g))
    positive = scale > 0.0
    return positive & _is_special_orthogonal(g / np.where(positive, scale, 1.0)[..., None, None], tolerance)


def _is_nonzero_in(basis: Floats, g: Matrices, tolerance: float) -> Booleans:
    """In the span of an orthogonal basis whose nonzero combinations are all invertible; tolerance relative to size."""
    length = np.linalg.norm(g, axis=(-2, -1), keepdims=True)
    unit = g / np.where(length > 0.0, length, 1.0)
    part = np.tensordot(np.tensordot(unit, basis, axes=([-2, -1], [1, 2])), basis, axes=1) / basis.shape[1]
    return _close(unit, part, tolerance) & (length[..., 0, 0] > 0.0)


def _is_invertible(g: Matrices, tolerance: float) -> Booleans:
    """Smallest singular value above the tolerance, relative to the largest."""
    singular = np.linalg.svd(g, compute_uv=False)
    return singular[..., -1] > tolerance * singular[..., 0]


def _is_affine(linear: MatrixLieGroup, g: Matrices, tolerance: float) -> Booleans:
    last_row = np.abs(g[..., -1, :] - np.eye(g.shape[-1])[-1]).max(axis=-1) <= tolerance
    return last_row & linear.contains(g[..., :-1, :-1], tolerance)


def _close(a: Matrices, b: Matrices, tolerance: float) -> Booleans:
    return (np.abs(a - b) <= tolerance).all(axis=(-2, -1))
