"""Numerical checks of the paper's theorems on groups, projections and decoding: errors of equations."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import lie
from lieednn_sim.theory import group

Scalars = dict[str, Any]

# Compact and not, real and complex, with and without a centre.
GROUPS = ("SO(3)", "SE(2)", "SE(3)", "SU(2)", "SU(3)", "H^x", "Sim(3)", "GL(2)")
# Lengths of rotation vectors at which the Taylor form of the left Jacobian is compared.
_SMALL_ANGLES = (1e-1, 1e-2)
# A decoded pose counts as within reach of a hinge when its axis is tilted by less [rad].
_TILT = np.deg2rad(0.1)


def automorphism(samples: int) -> Scalars:
    """Ad_g on random algebra elements: does it stay in the algebra, come back, and keep brackets?"""
    rng, outside, back, bracket = np.random.default_rng(0), [], [], []
    for name in GROUPS:
        one = group(name)
        g = one.random(rng, (_each(samples),), 0.5)
        inverse = np.linalg.inv(g)
        x, y = (one.hat(rng.normal(size=(len(g), one.dimension))) for _ in range(2))
        moved, other = g @ x @ inverse, g @ y @ inverse
        # Against the basis by least squares; `vee` would refuse what lies outside.
        basis = _as_real(one.basis)
        flat = _as_real(moved)
        outside.append(_largest(flat - flat @ np.linalg.pinv(basis) @ basis, flat))
        back.append(_largest(inverse @ moved @ g - x, x))
        left, right = g @ (x @ y - y @ x) @ inverse, moved @ other - other @ moved
        bracket.append(_largest(left - right, right))
    return {"count": _each(samples) * len(GROUPS), "outside": max(outside), "back": max(back), "bracket": max(bracket)}


def closed_group(samples: int) -> Scalars:
    """L[Ad_SE(3)]: products, inverses and limits of sequences; and other matrices with R^T = R^-1."""
    rng = np.random.default_rng(0)
    r1, r2 = Rotation.random(2 * samples, rng=rng).as_matrix().reshape(2, samples, 3, 3)
    t1, t2 = rng.normal(size=(2, samples, 3))
    first, second = lie.adjoint(r1, t1), lie.adjoint(r2, t2)
    back = np.swapaxes(r1, -1, -2)
    product = first @ second - lie.adjoint(r1 @ r2, t1 + np.einsum("kab,kb->ka", r1, t2))
    inverse = np.linalg.inv(first) - lie.adjoint(back, -np.einsum("kab,kb->ka", back, t1))
    # Sequences whose limit is known by its entries alone: Richardson's extrapolation of the last two members.
    start, towards = rng.normal(size=(2, samples, 6))
    se3 = group("SE(3)")
    last, later = (se3.adjoint(se3.exp(start + step * towards)) for step in (2.0**-20, 2.0**-25))
    limit = later + (later - last) / 31.0
    # The definition asks for R^T = R^-1 only, which lets reflections in.
    reflected = first @ np.kron(np.eye(2), np.diag([1.0, 1.0, -1.0]))
    return {
        "count": samples,
        "product": float(np.abs(product).max()),
        "inverse": float(np.abs(inverse).max()),
        "limit": float(_distance(limit).max()),
        "reflections_apart": float(_distance(reflected).min()),
    }


def representation(samples: int) -> Scalars:
    """P(g X g^-1) = L[Ad_g] P(X): the printed matrix of SE(3), and least squares for the other groups."""
    rng = np.random.default_rng(0)
    pose = RigidTransform.from_components(rng.normal(size=(samples, 3)), Rotation.random(samples, rng=rng))
    twist = rng.normal(size=(samples, 6))
    moved = lie.vee(pose.as_matrix() @ lie.hat(twist) @ pose.inv().as_matrix())
    printed = np.einsum("kab,kb->ka", lie.adjoint(pose.rotation.as_matrix(), pose.translation), twist)
    found, homomorphism, slope, rank = [], [], [], []
    for name in GROUPS:
        one = group(name)
        for g, h in one.random(rng, (max(2, _each(samples) // 10), 2), 0.5):
            x = rng.normal(size=(one.dimension + 3, one.dimension))
            images = one.vee(g @ one.hat(x) @ np.linalg.inv(g))
            solution, _, order, _ = np.linalg.lstsq(x, images, rcond=None)
            matrix = one.adjoint(g)
            found.append(_largest(matrix - solution.T, matrix))
            rank.append(order == one.dimension)
            both = matrix @ one.adjoint(h)
            homomorphism.append(_largest(one.adjoint(g @ h) - both, both))
            # Smooth: its derivative along a one-parameter group, by differences, is L[Ad_g] ad.
            along = x[0] / np.linalg.norm(x[0])
            ahead, behind = (one.adjoint(g @ one.exp(s * along)) for s in (1e-5, -1e-5))
            slope.append(_largest((ahead - behind) / 2e-5 - matrix @ one.ad(along), matrix))
    return {
        "count": samples,
        "se3": float(np.abs(moved - printed).max()),
        "general": max(found),
        "unique": float(np.mean(rank)),
        "homomorphism": max(homomorphism),
        "slope": max(slope),
    }


def quotient(samples: int) -> Scalars:
    """L[Ad_G] as G modulo its centre, SU(2) over SO(3), and the image of compact groups (App. E)."""
    rng, kernel, commuting, bounded = np.random.default_rng(0), [], [], []
    for name in GROUPS:
        one = group(name)
        g = one.random(rng, (max(2, _each(samples) // 25),), 0.5)
        # An element with the same adjoint matrix, found from the matrix alone: off by a central one.
        central = np.linalg.inv(one.project_to_adjoint(one.adjoint(g))) @ g
        kernel.append(float(np.abs(one.adjoint(central) - np.eye(one.dimension)).max()))
        other = one.random(rng, (len(g),), 0.5)
        commuting.append(_largest(central @ other - other @ central, other))
        if name in ("SO(3)", "SU(2)", "SU(3)"):
            matrix = one.adjoint(one.random(rng, (_each(samples),), 10.0))
            # Bounded: inside O(d). Closed because the group is compact.
            bounded.append(float(np.abs(matrix @ np.swapaxes(matrix, -1, -2) - np.eye(one.dimension)).max()))
    spin = group("SU(2)")
    g = spin.random(rng, (samples,), 2.0)
    rotation = spin.adjoint(g)
    far = lie.adjoint(np.eye(3), np.array([1e3, 0.0, 0.0]))
    return {
        "count": samples,
        "kernel": max(kernel),
        "commuting": max(commuting),
        "two_to_one": float(np.abs(spin.adjoint(-g) - rotation).max()),
        "onto_rotations": bool(group("SO(3)").contains(rotation).all()),
        "compact": max(bounded),
        "unbounded": float(np.linalg.norm(far)),
    }


def rotation_lemma(samples: int) -> Scalars:
    """The nearest rotation by the SVD, against Davenport's q-method, and against random rotations around it."""
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(samples, 3, 3))
    nearest = lie.project_to_rotation(matrix)
    trace = np.einsum("kab,kab->k", matrix, nearest)
    # The largest tr(Pi^T R) over SO(3) is the largest eigenvalue of Davenport's matrix.
    davenport = np.zeros((samples, 4, 4))
    total = np.trace(matrix, axis1=-2, axis2=-1)
    davenport[:, :3, :3] = matrix + np.swapaxes(matrix, -1, -2) - total[:, None, None] * np.eye(3)
    davenport[:, :3, 3] = davenport[:, 3, :3] = 2.0 * lie.vee(matrix)
    davenport[:, 3, 3] = total
    best = np.linalg.eigvalsh(davenport)[:, -1]
    around = Rotation.from_rotvec(0.1 * rng.normal(size=(100, 3))).as_matrix()[:, None] @ nearest
    nearer = np.linalg.norm(matrix - around, axis=(-2, -1)) < np.linalg.norm(matrix - nearest, axis=(-2, -1)) - 1e-12
    return {
        "count": samples,
        "error": float(np.abs(trace - best).max()),
        "unbeaten": int(np.count_nonzero(~nearer.any(axis=0))),
        "reflected": float(np.mean(np.linalg.det(matrix) < 0.0)),
    }


def decoding(samples: int) -> Scalars:
    """App. L: the closed form of the retraction, its Taylor form, and which joints can take the decoded poses."""
    rng = np.random.default_rng(0)
    twist = rng.uniform(-0.8, 0.8, (samples, 6))
    omega, v = twist[:, :3], twist[:, 3:]
    rotation = Rotation.from_rotvec(omega).as_matrix()
    position = np.einsum("kab,kb->ka", printed_jacobian(omega), v)
    pose = expm(lie.hat(twist))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    errors = []
    for angle in _SMALL_ANGLES:
        wedge = lie.hat(angle * axis)
        errors.append(np.linalg.norm(printed_jacobian(angle * axis) - np.eye(3) - wedge / 2.0 - wedge @ wedge / 6.0))
    unit = rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)
    # A hinge about z with a slide leaves the z axis where it is: the tilt is out of its reach, whatever it does.
    tilt = np.arccos(np.clip(rotation[:, 2, 2], -1.0, 1.0))
    return {
        "count": samples,
        "pose": float(max(np.abs(pose[:, :3, :3] - rotation).max(), np.abs(pose[:, :3, 3] - position).max())),
        "rigid": float(max(np.abs(unit).max(), np.abs(np.linalg.det(rotation) - 1.0).max())),
        "taylor_order": float(np.log10(errors[0] / errors[1])),
        "on_hinge": float(np.mean(tilt < _TILT)),
        "tilt_deg": float(np.rad2deg(np.median(tilt))),
    }


def printed_jacobian(omega: np.ndarray) -> np.ndarray:
    """The left Jacobian of SO(3) as in App. L, ``(..., 3)`` to ``(..., 3, 3)``, for angles that are not tiny."""
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    wedge = lie.hat(omega)
    return np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * wedge + (angle - np.sin(angle)) / angle**3 * (wedge @ wedge)


def _each(samples: int) -> int:
    """Cases for each group."""
    return max(2, samples // len(GROUPS))


def _as_real(matrix: np.ndarray) -> np.ndarray:
    """``(K, m, m)`` to real rows, imaginary parts behind the real ones."""
    flat = matrix.reshape(len(matrix), -1)
    return np.concatenate([flat.real, flat.imag], axis=-1) if np.iscomplexobj(flat) else flat


def _largest(error: np.ndarray, of: np.ndarray) -> float:
    """Largest entry of an error, divided by 1 + the largest entry of the exact value."""
    return float(np.abs(error).max() / (1.0 + np.abs(of).max()))


def _distance(matrix: np.ndarray) -> np.ndarray:
    """Frobenius distance from L[Ad_SE(3)]."""
    return np.linalg.norm(lie.adjoint(*lie.project_to_adjoint_exact(matrix)) - matrix, axis=(-2, -1))
