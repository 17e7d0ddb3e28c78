"""Projections: in the group, nearest of all, and the identity on what is in the group already."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.lie import adjoint, project_to_adjoint, project_to_rotation

seeds = st.integers(0, 2**32 - 1)


def near_rotations(rotation: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rotations all around, from 1e-4 rad away to anywhere."""
    turns = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-4.0, 0.5, size=(200, 1))
    return rotation @ Rotation.from_rotvec(turns).as_matrix()


def assert_rotations(matrices: np.ndarray) -> None:
    gram = matrices @ np.swapaxes(matrices, -1, -2)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(matrices), 1.0, atol=1e-14)


@given(seeds, st.sampled_from([-1.0, 1.0]), st.integers(0, 3))
def test_rotation_is_in_the_group_and_the_nearest_one(seed, sign, rank):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, rank)) @ rng.normal(size=(rank, 3))
    if rank == 3:
        matrix *= sign * np.sign(np.linalg.det(matrix))
        assert np.sign(np.linalg.det(matrix)) == sign
    rotation = project_to_rotation(matrix)
    assert_rotations(rotation)
    others = np.linalg.norm(near_rotations(rotation, rng) - matrix, axis=(-2, -1))
    assert np.linalg.norm(rotation - matrix) <= others.min() + 1e-12


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 0, 0]), -np.eye(3), np.diag([1.0, 1, -1])])
def test_degenerate_matrices_still_give_a_rotation(matrix):
    assert_rotations(project_to_rotation(matrix))


@given(seeds, st.floats(1e-12, 1e12))
def test_rotations_stay_and_length_does_not_matter(seed, length):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    np.testing.assert_allclose(project_to_rotation(length * rotation), rotation, atol=1e-14)


@given(seeds)
def test_adjoint_projection_is_the_nearest_block_by_block(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(6, 6))
    rotation, translation = project_to_adjoint(matrix)
    assert_rotations(rotation)
    around = near_rotations(rotation, rng)
    diagonal = [np.linalg.norm(block - around, axis=(-2, -1)) ** 2 for block in (matrix[:3, :3], matrix[3:, 3:])]
    reached = sum(np.linalg.norm(block - rotation) ** 2 for block in (matrix[:3, :3], matrix[3:, 3:]))
    assert reached <= sum(diagonal).min() + 1e-12
    # With R held, no other translation comes nearer.
    shifts = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-4.0, 0.5, size=(200, 1))
    candidates = adjoint(np.broadcast_to(rotation, (200, 3, 3)), translation + shifts)
    distances = np.linalg.norm(candidates - matrix, axis=(-2, -1))
    assert np.linalg.norm(adjoint(rotation, translation) - matrix) < distances.min()


@given(seeds)
def test_adjoint_projection_is_idempotent(seed):
    first = project_to_adjoint(np.random.default_rng(seed).normal(size=(6, 6)))
    second = project_to_adjoint(adjoint(*first))
    for before, after in zip(first, second, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-14)


def test_batches_equal_one_by_one():
    matrices = np.random.default_rng(0).normal(size=(2, 3, 6, 6))
    rotation, translation = project_to_adjoint(matrices)
    assert (np.linalg.det(matrices[..., :3, :3] + matrices[..., 3:, 3:]) < 0).any()
    for index in np.ndindex(2, 3):
        one_rotation, one_translation = project_to_adjoint(matrices[index])
        np.testing.assert_allclose(rotation[index], one_rotation, atol=1e-15)
        np.testing.assert_allclose(translation[index], one_translation, atol=1e-15)


def test_wrong_input_is_named():
    with pytest.raises(InputError, match=r"matrix must have shape \(\.\.\., 3, 3\), got \(2, 3\)"):
        project_to_rotation(np.zeros((2, 3)))
    with pytest.raises(InputError, match="finite, got 9 NaN"):
        project_to_rotation(np.full((3, 3), np.nan))
    with pytest.raises(InputError, match=r"\(\.\.\., 6, 6\), got \(4, 3, 3\)"):
        project_to_adjoint(np.zeros((4, 3, 3)))
