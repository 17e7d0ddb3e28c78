"""Projections: in the group, nearest of all, and the identity on what is in the group already."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.lie import (
    adjoint,
    project_to_adjoint,
    project_to_adjoint_exact,
    project_to_rotation,
    project_to_scaled_adjoint,
)
from lieednn_sim.lie.projection import descend

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


def distance(matrix: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    return np.linalg.norm(adjoint(rotation, translation) - matrix, axis=(-2, -1))


@settings(max_examples=12)
@given(seeds, st.floats(0.1, 30.0))
def test_exact_projection_is_the_nearest_of_all(seed, lower):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(6, 6)) * np.where(np.arange(36).reshape(6, 6) // 18 * (np.arange(6) < 3), lower, 1.0)
    rotation, translation = project_to_adjoint_exact(matrix)
    assert_rotations(rotation)
    reached = distance(matrix, rotation, translation)
    assert reached <= distance(matrix, *project_to_adjoint(matrix)) + 1e-12
    around = np.concatenate([near_rotations(rotation, rng), Rotation.random(2000, rng=rng).as_matrix()])
    lever = matrix[3:, :3] @ np.swapaxes(around, -1, -2)
    moved = 0.5 * np.stack([lever[:, 2, 1] - lever[:, 1, 2], lever[:, 0, 2] - lever[:, 2, 0]], axis=-1)
    moved = np.concatenate([moved, 0.5 * (lever[:, 1, 0] - lever[:, 0, 1])[:, None]], axis=-1)
    assert reached <= distance(matrix, around, moved).min() + 1e-10


@given(seeds, st.sampled_from([1e-12, 1.0, 1e12]))
def test_exact_projection_is_idempotent(seed, reach):
    rng = np.random.default_rng(seed)
    rotation, translation = Rotation.random(rng=rng).as_matrix(), reach * rng.normal(size=3)
    again = project_to_adjoint_exact(adjoint(rotation, translation))
    np.testing.assert_allclose(again[0], rotation, atol=1e-12)
    np.testing.assert_allclose(again[1], translation, rtol=1e-10, atol=1e-10 * reach)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e150])
def test_exact_projection_of_extreme_sizes(size):
    matrix = size * np.random.default_rng(2).normal(size=(6, 6))
    rotation, translation = project_to_adjoint_exact(matrix)
    assert_rotations(rotation)
    assert np.linalg.norm(translation) <= np.linalg.norm(matrix)


@given(seeds, st.sampled_from([-1.0, 1.0]))
def test_scaled_projection_is_the_nearest_block_by_block(seed, sign):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(6, 6))
    middle = matrix[:3, :3] + matrix[3:, 3:]
    matrix *= sign * np.sign(np.linalg.det(middle))
    alpha, rotation, translation = project_to_scaled_adjoint(matrix)
    assert np.sign(alpha) == sign
    assert_rotations(rotation)

    def of_diagonal(strength, turned):
        scaled = np.asarray(strength)[..., None, None] * turned
        return np.linalg.norm(matrix[:3, :3] - scaled, axis=(-2, -1)) ** 2 + (
            np.linalg.norm(matrix[3:, 3:] - scaled, axis=(-2, -1)) ** 2
        )

    around = np.concatenate([near_rotations(rotation, rng), Rotation.random(300, rng=rng).as_matrix()])
    strengths = np.concatenate([alpha + rng.normal(size=200) * 10.0 ** rng.uniform(-4, 0.5, 200), rng.normal(size=300)])
    assert of_diagonal(alpha, rotation) <= of_diagonal(strengths, around).min() + 1e-12
    # Each of these rotations with its own best strength.
    best = np.einsum("ij,nij->n", 0.5 * (matrix[:3, :3] + matrix[3:, 3:]), around) / 3.0
    assert of_diagonal(alpha, rotation) <= of_diagonal(best, around).min() + 1e-12
    shifts = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-4.0, 0.5, size=(200, 1))
    candidates = alpha * adjoint(np.broadcast_to(rotation, (200, 3, 3)), translation + shifts)
    reached = np.linalg.norm(alpha * adjoint(rotation, translation) - matrix)
    assert reached < np.linalg.norm(candidates - matrix, axis=(-2, -1)).min()
    if sign > 0:
        np.testing.assert_allclose(rotation, project_to_adjoint(matrix)[0], atol=1e-9)


@given(seeds, st.sampled_from([-1.0, 1.0]), st.floats(1e-9, 1e9))
def test_scaled_projection_finds_strength_and_pose(seed, sign, strength):
    rng = np.random.default_rng(seed)
    rotation, translation = Rotation.random(4, rng=rng).as_matrix(), rng.normal(size=(4, 3))
    found = project_to_scaled_adjoint(sign * strength * adjoint(rotation, translation))
    np.testing.assert_allclose(found[0], sign * strength, rtol=1e-13)
    np.testing.assert_allclose(found[1], rotation, atol=1e-13)
    np.testing.assert_allclose(found[2], translation, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-320])
def test_scaled_projection_without_strength_has_no_translation(size):
    matrix = np.random.default_rng(1).normal(size=(6, 6))
    matrix[3:, 3:] = -matrix[:3, :3]
    matrix[3:, 3:] += size * np.eye(3)
    matrix[:3, :3] = -matrix[3:, 3:] + size * np.eye(3)
    alpha, rotation, translation = project_to_scaled_adjoint(matrix)
    assert abs(alpha) <= size
    assert_rotations(rotation)
    np.testing.assert_array_equal(translation, 0.0)


def test_batches_equal_one_by_one():
    matrices = np.random.default_rng(0).normal(size=(2, 3, 6, 6))
    assert (np.linalg.det(matrices[..., :3, :3] + matrices[..., 3:, 3:]) < 0).any()
    for project in (project_to_adjoint, project_to_adjoint_exact, project_to_scaled_adjoint):
        batch = project(matrices)
        for index in np.ndindex(2, 3):
            for whole, single in zip(batch, project(matrices[index]), strict=True):
                np.testing.assert_allclose(whole[index], single, atol=1e-12)


def test_wrong_input_is_named():
    with pytest.raises(InputError, match=r"matrix must have shape \(\.\.\., 3, 3\), got \(2, 3\)"):
        project_to_rotation(np.zeros((2, 3)))
    with pytest.raises(InputError, match="finite, got 9 NaN"):
        project_to_rotation(np.full((3, 3), np.nan))
    for project in (project_to_adjoint, project_to_adjoint_exact, project_to_scaled_adjoint):
        with pytest.raises(InputError, match=r"\(\.\.\., 6, 6\), got \(4, 3, 3\)"):
            project(np.zeros((4, 3, 3)))
        with pytest.raises(InputError, match="finite, got 36 NaN"):
            project(np.full((6, 6), np.nan))


def test_descent_goes_on_after_a_step_too_far():
    """sqrt(1 + (10 x)^2): from 0.2 Newton's step, cut to 1, leads up to -0.8; damped it arrives."""

    def evaluate(x, _):
        value = np.sqrt(1.0 + (10.0 * x[:, 0]) ** 2)
        return value, 100.0 * x / value[:, None], (100.0 / value**3)[:, None, None]

    points, values = descend(np.array([[0.2], [0.01]]), evaluate, lambda x, step: x + step)
    np.testing.assert_allclose(points, 0.0, atol=1e-9)
    np.testing.assert_array_equal(values, 1.0)
