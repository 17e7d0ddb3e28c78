"""Twists, the adjoint representation and the left Jacobians of SO(3) and SE(3)."""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

_LARGEST = 1e300  # largest entry where entries are only copied, or halved and added
_LARGEST_TWIST = 1e60  # largest entry of a twist where five of them are multiplied
# Rows: hat(e_k), flat; its columns are e_k x e_j.
_GENERATORS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(-1, -2).reshape(3, 9)


def hat(vector: ArrayLike) -> Floats:
    """Matrix form of so(3) vectors ``(..., 3)`` or of twists ``(..., 6)``.

    These are skew-symmetric matrices ``(..., 3, 3)``, or ``(..., 4, 4)`` matrices ``[[hat(omega), v], [0, 0]]``.
    """
    array = as_floats("vector", vector, (), batched=True, largest=_LARGEST)
    if array.shape[-1:] not in ((3,), (6,)):
        raise InputError(f"hat needs vectors of shape (..., 3) or (..., 6), got {array.shape}")
    if array.shape[-1] == 3:
        return skew(array)
    matrix = np.zeros((*array.shape[:-1], 4, 4))
    matrix[..., :3, :3] = skew(array[..., :3])
    matrix[..., :3, 3] = array[..., 3:]
    return matrix


def vee(matrix: ArrayLike) -> Floats:
    """Inverse of `hat`: ``(..., 3, 3)`` to ``(..., 3)``, ``(..., 4, 4)`` to ``(..., 6)``.

    The antisymmetric part is read, so rounding in a matrix that is skew up to rounding is averaged out.
    """
    array = as_floats("matrix", matrix, (), batched=True, largest=_LARGEST)
    if array.shape[-2:] not in ((3, 3), (4, 4)):
        raise InputError(f"vee needs matrices of shape (..., 3, 3) or (..., 4, 4), got {array.shape}")
    omega = 0.5 * (array[..., [2, 0, 1], [1, 2, 0]] - array[..., [1, 2, 0], [2, 0, 1]])
    return omega if array.shape[-1] == 3 else np.concatenate([omega, array[..., :3, 3]], axis=-1)


def exp(twist: ArrayLike) -> RigidTransform:
    """Exponential map: the poses (R, p) of twists (omega, v), ``(..., 6)`` [rad, m].

    R = Exp(omega) is SciPy's, and p = J(omega) v. J is the left Jacobian, p = v + (1 - cos a)/a^2 omega x v + (a - sin
    a)/a^3 omega x (omega x v) with the angle a.
    """
    array = as_floats("twist", twist, (6,), batched=True)
    # SciPy's compiled code refuses arrays that are read-only, as those of results are, and takes one leading axis; for
    # more it computes the same in NumPy, many times as slowly. Its own map of twists takes twice the time of this one.
    flat = np.require(array.reshape(-1, 6), requirements="W")
    omega, v = flat.T.copy().reshape(2, 3, -1)
    # Cancellation in the coefficients costs nothing here, where they multiply as small products; nor does underflow.
    square = np.maximum(np.add.reduce(omega * omega), 1e-200)
    angle = np.sqrt(square)
    half_sine, turned = np.sin(0.5 * angle), _cross(omega, v)
    b, c = 2.0 * half_sine * half_sine / square, (1.0 - np.sin(angle) / angle) / square
    matrix = np.zeros((len(flat), 4, 4))
    matrix[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(flat[:, :3]).as_matrix()
    matrix[:, :3, 3] = (v + b * turned + c * _cross(omega, turned)).T
    matrix[:, 3, 3] = 1.0
    return scipy.spatial.transform.RigidTransform(matrix.reshape(*array.shape[:-1], 4, 4), normalize=False, copy=False)


def log(pose: RigidTransform) -> Floats:
    """Principal logarithm ``(..., 6)`` of poses, the inverse of `exp` for rotation angles up to pi [rad, m]."""
    matrix = pose.as_matrix()
    return logarithm(matrix[..., :3, :3], matrix[..., :3, 3])


def logarithm(rotation: Floats, translation: Floats) -> Floats:
    """`log` of rotations ``(..., 3, 3)`` and translations ``(..., 3)``: unchecked, in half of the time of SciPy's."""
    turn = scipy.spatial.transform.Rotation.from_matrix(rotation.reshape(-1, 3, 3), assume_valid=True)
    omega, p = rotation_vectors(turn).T.copy(), translation.reshape(-1, 3).T.copy()
    return np.concatenate([omega, linear_part(omega, p, p)]).T.reshape(*translation.shape[:-1], 6)


def rotation_vectors(rotation: Rotation) -> Floats:
    """`Rotation.as_rotvec`, ``(..., 3)`` [rad], in a tenth of its time, by modified Rodrigues parameters n tan(a/4)."""
    parameters = rotation.as_mrp()
    size = np.sqrt(np.vecdot(parameters, parameters))
    return np.asarray(parameters * (4.0 * np.arctan(size) / np.maximum(size, 1e-150))[..., None])


def quaternion_parts(angle: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """Real and vector parts of unit quaternions, from rotation vectors and their norms, of shapes that broadcast."""
    return np.cos(0.5 * angle), np.sin(0.5 * angle) / np.maximum(angle, 1e-150) * turn


def turn_of(turns: Floats) -> Floats:
    """The rotation vectors ``(3, M)``, up to half a turn, of products of T rotations by ``(T, 3, M)``; unchecked."""
    angles = np.sqrt(np.add.reduce(turns * turns, axis=1, keepdims=True))
    if len(turns) == 1:
        return np.asarray((1.0 - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)) / np.maximum(angles, 1.0)) * turns)[0]
    (real, part), *others = zip(*quaternion_parts(angles, turns), strict=True)
    for cosine, sine in others:
        dot = np.add.reduce(part * sine)
        real, part = real * cosine - dot, real * sine + cosine * part + _cross(part, sine)
    size = np.sqrt(np.add.reduce(part * part))
    return np.copysign(2.0, real) * np.arctan2(size, np.abs(real)) / np.maximum(size, 1e-150) * part


def linear_part(omega: Floats, total: Floats, difference: Floats) -> Floats:
    """The v with J(omega) v = p + R q, in inner loops, from p + q and p - q; components ``(3, M)``, unchecked.

    J^-1 = I - hat(omega) / 2 + k hat(omega)^2, with k of `bend`; in J^-1 R omega has the other sign.
    """
    square = np.add.reduce(omega * omega)
    twice = np.add.reduce(omega * total) * omega - square * total
    return np.asarray(total - 0.5 * _cross(omega, difference) + bend(square) * twice)


def bend(square: Floats) -> Floats:
    """The factor (1 - a/2 cot(a/2)) / a^2 from a^2; callers multiply by a^2, so that cancellation does no harm."""
    safe = np.maximum(square, 1e-8)
    half = 0.5 * np.sqrt(safe)
    return np.asarray((1.0 - half / np.tan(half)) / safe)


def continued(twists: Floats) -> Floats:
    """Make the logarithms ``(K, ..., 6)`` along paths of poses continuous where these turn by more than half a turn.

    The axis -n and the angle 2 pi - a give the same rotation as n and a, and v = J_l^-1 p there the same translation,
    in any unit. Near a turn of 2 pi there is no continuous logarithm.
    """
    steps = twists[1:, ..., :3] - twists[:-1, ..., :3]
    turned = np.vecdot(steps, steps) > np.pi**2
    if not turned.any():
        return twists
    beyond = np.concatenate([np.zeros_like(turned[:1]), np.cumsum(turned, axis=0) % 2 == 1])
    result, given = twists.copy(), twists[beyond]
    other = given[:, :3] * (1.0 - 2.0 * np.pi / np.linalg.norm(given[:, :3], axis=-1, keepdims=True))
    place = left_jacobian_so3(given[:, :3]) @ given[:, 3:, None]
    result[beyond] = np.concatenate([other, np.linalg.solve(left_jacobian_so3(other), place)[..., 0]], axis=-1)
    return result


def turns_near(turns: Floats, others: Floats) -> Floats:
    """Of all rotation vectors ``(..., 3)`` of the same rotations, full turns apart on their axes, those near others."""
    axes = turns / np.maximum(np.linalg.norm(turns, axis=-1, keepdims=True), 1e-150)
    return np.asarray(turns + 2.0 * np.pi * np.round(np.vecdot(others - turns, axes)[..., None] / (2.0 * np.pi)) * axes)


def twist_of(displaced: Floats) -> Floats:
    """Twists ``(..., 6)`` of rotation vectors and positions ``(..., 6)``, by J^-1 of SO(3); unchecked."""
    turn, position = displaced[..., :3], displaced[..., 3:]
    return np.concatenate([turn, np.linalg.solve(left_jacobian_so3(turn), position[..., None])[..., 0]], axis=-1)


def same_signs(quaternions: Floats) -> Floats:
    """Unit quaternions ``(K, ..., 4)`` along paths, of which each has the sign that is nearer to the one before it.

    q and -q are one rotation, but whoever interpolates between samples of both passes through zero.
    """
    along = np.vecdot(quaternions[1:], quaternions[:-1]) < 0.0
    turned = np.concatenate([np.zeros_like(along[:1]), np.cumsum(along, axis=0) % 2 == 1])
    return np.where(turned[..., None], -quaternions, quaternions)


def rotations(matrix: Floats) -> Rotation:
    """`Rotation.from_matrix` of ``(..., 3, 3)`` orthogonal up to rounding, unchecked; compiled code as in `exp`."""
    quaternions = scipy.spatial.transform.Rotation.from_matrix(matrix.reshape(-1, 3, 3), assume_valid=True).as_quat()
    return scipy.spatial.transform.Rotation(quaternions.reshape(*matrix.shape[:-2], 4), normalize=False)


def transforms(rotation: Floats, translation: Floats) -> RigidTransform:
    """`RigidTransform` of shape ``(...)`` from translations ``(..., 3)`` and matrices as for `rotations`."""
    turns = scipy.spatial.transform.Rotation.from_matrix(rotation.reshape(-1, 3, 3), assume_valid=True).as_matrix()
    matrix = np.zeros((*translation.shape[:-1], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = turns.reshape(rotation.shape), translation, 1.0
    return scipy.spatial.transform.RigidTransform(matrix, normalize=False, copy=False)


def adjoint(rotation: RigidTransform | ArrayLike, translation: ArrayLike | None = None) -> Floats:
    """Adjoint matrices ``(..., 6, 6)`` of SE(3), [[R, 0], [hat(t) R, R]] on twists: exp(Ad_T xi) = T exp(xi) T^-1.

    Args:
        rotation: ``(..., 3, 3)`` rotation matrices; or poses of shape ``(...)``, such as `exp` makes, alone.
        translation: ``(..., 3)`` translations [m].
    """
    if translation is None:
        if not isinstance(rotation, scipy.spatial.transform.RigidTransform):
            raise InputError("adjoint needs a pose, or a rotation and a translation")
        rotation, translation = rotation.rotation.as_matrix(), rotation.translation
    matrix = as_floats("rotation", rotation, (3, 3), batched=True)
    offset = as_floats("translation", translation, (3,), batched=True)
    if matrix.shape[:-2] != offset.shape[:-1]:
        shapes = f"{matrix.shape} and {offset.shape}"
        raise InputError(f"rotation and translation must share their leading axes, got {shapes}")
    result = np.zeros((*matrix.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = matrix
    result[..., 3:, :3] = skew(offset) @ matrix
    return result


def left_jacobian_so3(omega: ArrayLike) -> Floats:
    """Left Jacobian of SO(3), ``(..., 3)`` to ``(..., 3, 3)``: Exp(omega + d) = Exp(J d) Exp(omega) to first order.

    J = I + (1 - cos theta)/theta^2 hat(omega) + (theta - sin theta)/theta^3 hat(omega)^2
    (Barfoot, State Estimation for Robotics, 2017, eq. 7.77).
    """
    vector = as_floats("omega", omega, (3,), batched=True)
    b, c = _coefficients(np.linalg.norm(vector, axis=-1), 2, 3)
    matrix = skew(vector)
    return np.eye(3) + b[..., None, None] * matrix + c[..., None, None] * (matrix @ matrix)


def left_jacobian_se3(twist: ArrayLike) -> Floats:
    """Left Jacobian of SE(3), ``(..., 6)`` to ``(..., 6, 6)``, for twists (omega, v).

    Exp(xi + d) = Exp(J d) Exp(xi) to first order, J = [[J_so3, 0], [Q, J_so3]]
    with Q of Barfoot 2017, eq. 7.86, rewritten for this order of the twist.
    """
    vector = as_floats("twist", twist, (6,), batched=True, largest=_LARGEST_TWIST)[..., None, :]
    shape = (*vector.shape[:-2], 6, 6)
    # Its columns are the spatial twists at unit rates.
    columns = spatial_twist(np.broadcast_to(vector, shape), np.broadcast_to(np.eye(6), shape))
    return np.swapaxes(columns, -1, -2)


def spatial_twist(twist: ArrayLike, rate: ArrayLike) -> Floats:
    """Spatial twist ``(..., 6)`` of Exp(xi) where xi ``(..., 6)`` changes at a rate ``(..., 6)``: J xi'.

    J is that of `left_jacobian_se3`, here without any matrix; components of all vectors are contiguous, for speed.
    """
    vector = as_floats("twist", twist, (6,), batched=True, largest=_LARGEST_TWIST)
    change = as_floats("rate", rate, vector.shape)
    w, v = vector.reshape(-1, 6).T.copy().reshape(2, 3, -1)
    plain = change.reshape(-1, 6).T.copy().reshape(2, 3, -1)
    b, c, d, e = _coefficients(np.sqrt(np.add.reduce(w * w)), 2, 3, 4, 5)
    f = 0.5 * (d - 3.0 * e)
    # Both parts of the rate, multiplied by hat(omega) not at all, once and twice.
    once = _cross(w, plain)
    twice = _cross(w, once)
    turned = plain + b * once + c * twice
    # Q omega', with its left factor hat(omega) taken out of the sum.
    slid = _cross(v, np.stack([plain[0], once[0], twice[0]]))
    back = _cross(w, slid[:2])
    inner = c * slid[0] + (c - 3.0 * d) * slid[1] + f * slid[2] + d * back[0] + f * back[1]
    turned[1] += 0.5 * slid[0] + c * slid[1] + d * slid[2] + _cross(w, inner)
    return np.asarray(turned.reshape(6, -1).T.reshape(vector.shape))


def skew(vector: Floats) -> Floats:
    """`hat` of vectors ``(..., 3)`` in inner loops: unchecked, in one product."""
    return (vector @ _GENERATORS).reshape(*vector.shape, 3)


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products, in the shape of b, of vectors ``(..., 3, M)`` with contiguous parts: ten times NumPy's speed."""
    product = np.empty(b.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[..., i, :] = a[..., j, :] * b[..., k, :] - a[..., k, :] * b[..., j, :]
    return product


def _coefficients(angle: Floats, *orders: int) -> list[Floats]:
    """f_n(theta) = sum_k (-1)^k theta^2k / (2k + n)!, the coefficients of the Jacobians.

    f_2 = (1 - cos)/theta^2, f_3 = (theta - sin)/theta^3, f_4 = (theta^2/2 + cos - 1)/theta^4,
    f_5 = (theta^3/6 + sin - theta)/theta^5, and f_n = 1/n! - theta^2 f_(n+2).
    """
    # Small angles [rad] are summed as Taylor series: the closed forms lose digits, that of f_5 all of them at 1e-3.
    big = angle > 1.0
    square = np.where(big, 0.0, angle) ** 2
    x = np.where(big, angle, 1.0)
    closed = {
        2: lambda: (1.0 - np.cos(x)) / x**2,
        3: lambda: (x - np.sin(x)) / x**3,
        4: lambda: (0.5 * x**2 + np.cos(x) - 1.0) / x**4,
        5: lambda: (x**3 / 6.0 + np.sin(x) - x) / x**5,
    }
    result: dict[int, Floats] = {}
    for order in sorted(orders, reverse=True):
        if order + 2 in result:
            result[order] = 1.0 / factorial(order) - angle**2 * result[order + 2]
            continue
        series = np.zeros_like(square)
        for k in reversed(range(10)):
            series = series * square + (-1.0) ** k / factorial(2 * k + order)
        result[order] = np.where(big, closed[order](), series)
    return [result[order] for order in orders]
