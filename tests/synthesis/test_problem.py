"""Derivatives of the synthesis problem against finite differences."""

import numpy as np
import pytest

from lieednn_sim.synthesis.problem import Problem, pairs

STEP = 1e-6


@pytest.fixture(params=[(2, 1), (3, 2), (4, 1)], ids=lambda p: f"N={p[0]}, {p[1]} columns")
def case(request):
    neurons, columns = request.param
    rng = np.random.default_rng(neurons)
    signs = np.where(rng.random((neurons, neurons)) < 0.5, 1.0, -1.0)
    problem = Problem(rng.normal(size=(neurons, 3, columns)), rng.normal(size=(neurons, 3, columns)), signs)
    return problem, 0.7 * rng.normal(size=problem.n_quaternion + problem.size)


def numeric(function, unknowns):
    steps = STEP * np.eye(unknowns.size)
    return np.stack([(function(unknowns + h) - function(unknowns - h)) / (2 * STEP) for h in steps], axis=-1)


def test_blocks_are_scaled_rotations(case):
    problem, unknowns = case
    blocks = problem.evaluate(unknowns).blocks
    length = np.sum(unknowns[: problem.n_quaternion].reshape(*problem.signs.shape, 4) ** 2, axis=-1)
    gram = blocks @ np.swapaxes(blocks, -1, -2)
    np.testing.assert_allclose(gram, (length**2)[..., None, None] * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(blocks), problem.signs * length**3, rtol=1e-9)


def test_jacobian_of_the_equations(case):
    problem, unknowns = case
    np.testing.assert_allclose(
        problem.flat_jacobian(unknowns), numeric(problem.flat_residual, unknowns), rtol=1e-6, atol=1e-7
    )


def test_gradient_of_the_smoothed_eigenvalue(case):
    problem, unknowns = case
    value, gradient = problem.smooth_largest_eigenvalue(unknowns, 5.0)
    expected = numeric(lambda x: problem.smooth_largest_eigenvalue(x, 5.0)[0], unknowns)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-6)
    assert value >= problem.evaluate(unknowns).values[-1]


def test_derivative_of_the_scaled_matrix_in_its_own_eigenvectors(case):
    problem, unknowns = case
    point = problem.evaluate(unknowns)

    def in_eigenvectors(x):
        scaled = problem.evaluate(x).scaled
        return point.vectors.T @ (0.5 * (scaled + scaled.T)) @ point.vectors

    for first in (0, problem.size - 2):
        a, b = pairs(problem.size, first)
        assert sorted(zip(a, b, strict=True)) == [(i, j) for i in range(first, problem.size) for j in range(i + 1)]
        expected = numeric(in_eigenvectors, unknowns)[a, b]
        np.testing.assert_allclose(problem.eigenspace_jacobian(point, first), expected, rtol=1e-5, atol=1e-6)
