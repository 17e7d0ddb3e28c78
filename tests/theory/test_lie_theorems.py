"""The paper's theorems on groups and projections, each under its name, with its limits where we found some."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from lieednn_sim import lie
from lieednn_sim.theory import MatrixLieGroup

# Whole numbers q with sqrt(2) q within 1/(2 q) of a whole number and a half.
HALF_WAY = [q for q in range(1, 200_000) if abs((np.sqrt(2.0) * q) % 1.0 - 0.5) < 0.5 / q]


def distance_to_image(matrix: np.ndarray) -> np.ndarray:
    """Frobenius distance from L[Ad_SE(3)]."""
    return np.linalg.norm(lie.adjoint(*lie.project_to_adjoint_exact(matrix)) - matrix, axis=(-2, -1))


def plane(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_metric_projection_to_so3_is_not_always_unique():
    """The "if and only if" of the proof needs distinct singular values: around -I every half turn is as near."""
    turns = Rotation.from_rotvec(np.pi * np.array([[1.0, 0, 0], [0, 0.6, 0.8]])).as_matrix()
    nearest = np.linalg.norm(lie.project_to_rotation(-np.eye(3)) + np.eye(3))
    np.testing.assert_allclose(np.linalg.norm(turns + np.eye(3), axis=(-2, -1)), nearest, atol=1e-14)


def test_block_wise_metric_projection_is_not_the_frobenius_nearest():
    """By hand: A = D = I, C = diag(4, 4, 0). Turned by phi about z the rest is 8 (1 - cos phi) + 32 cos^2 phi."""
    matrix = np.eye(6)
    matrix[3:, :3] = np.diag([4.0, 4.0, 0.0])
    block_wise = lie.adjoint(*lie.project_to_adjoint(matrix))
    np.testing.assert_allclose(block_wise, np.eye(6), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(block_wise - matrix) ** 2, 32.0)
    rotation, _ = lie.project_to_adjoint_exact(matrix)
    np.testing.assert_allclose(distance_to_image(matrix) ** 2, 7.5, atol=1e-12)
    np.testing.assert_allclose([rotation[0, 0], rotation[2, 2]], [0.125, 1.0], atol=1e-9)


def test_a_closed_group_can_have_an_adjoint_image_that_is_not_closed():
    """App. E rightly asks for closedness "in addition": here G is closed in GL(6, R), but L[Ad_G] is not.

    R acts on the plane twice, with angles s and sqrt(2) s; a last entry e^(s / 10^5) keeps G closed, and the adjoint
    action does not see it.
    """
    basis = np.zeros((5, 6, 6))
    basis[0, :4, :4] = np.kron(np.diag([1.0, np.sqrt(2.0)]), plane(np.pi / 2))
    basis[0, 5, 5] = 1e-5
    for k in range(4):
        basis[1 + k, k, 4] = 1.0
    one = MatrixLieGroup("two planes", basis)
    limit = np.diag([1.0, 1.0, 1.0, -1.0, -1.0])
    turns = [one.exp([2.0 * np.pi * q, 0, 0, 0, 0]) for q in HALF_WAY]
    gaps = [np.linalg.norm(one.adjoint(g) - limit) for g in turns]
    assert gaps[-1] < 1e-4 < 0.5 < gaps[0]
    # No g has this adjoint matrix: its first plane needs s = 2 pi q, and then sqrt(2) q would be a whole number and a
    # half. In G itself the sequence has no limit: the last entry runs away.
    assert [g[5, 5] for g in turns] == sorted(g[5, 5] for g in turns)
    assert turns[-1][5, 5] > 1.5
    np.testing.assert_allclose(expm(one.ad(np.eye(5)[0] * np.pi))[1:3, 1:3], -np.eye(2), atol=1e-12)
