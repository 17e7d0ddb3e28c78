"""Learning on the weight manifold: its derivatives by finite differences, its promises on whole trainings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.budget import reporting
from lieednn_sim.errors import InputError
from lieednn_sim.learning import RiemannianOptions, StopReason, train
from lieednn_sim.learning.manifold import SE3Weights
from lieednn_sim.learning.riemannian import (
    RowEquations,
    differential,
    loss_gradient,
    retract,
    rotational_weight,
    smoothed_eigenvalue,
)
from lieednn_sim.learning.sensitivity import EquilibriumSolver
from lieednn_sim.lie import adjoint

seeds = st.integers(0, 2**32 - 1)
ratios = st.sampled_from([1.0, 0.5, 2.5])
STEP = 1e-6


def random_point(rng: np.random.Generator, n: int = 3, size: float = 1.0):
    rotation = Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3)
    elements = {"rotation": rotation, "translation": rng.normal(size=(n, n, 3))}
    return SE3Weights().point(size * rng.normal(size=(n, n)), elements)


def stable_case(seed: int, ratio: float, n: int = 3):
    """Weights small enough for one equilibrium, the equilibrium, and its solver."""
    rng = np.random.default_rng(seed)
    point = random_point(rng, n, 0.05 / ratio)
    solver = EquilibriumSolver(rng.uniform(-0.5, 0.5, (n, 6)) / ratio, ratio, "tanh")
    equilibrium = solver.newton(point.weight, np.zeros(6 * n), steps=50)
    assert equilibrium.success
    return rng, point, solver, equilibrium


def derivative(function, point, step):
    """Central difference along a step of the retraction."""
    return (function(retract(point, STEP * step)) - function(retract(point, -STEP * step))) / (2.0 * STEP)


@given(seeds, st.sampled_from([0.0, 1e-12, 1e-6, 1.0, np.pi - 1e-9, np.pi, 40.0]))
def test_the_retraction_stays_on_the_manifold_and_follows_the_step(seed, angle):
    rng = np.random.default_rng(seed)
    point, step = random_point(rng), rng.normal(size=(3, 3, 7))
    step[..., 1:4] *= angle / np.linalg.norm(step[..., 1:4], axis=-1, keepdims=True)
    moved = retract(point, step)
    rotation = moved.elements["rotation"]
    np.testing.assert_allclose(
        rotation @ rotation.swapaxes(-1, -2), np.broadcast_to(np.eye(3), (3, 3, 3, 3)), atol=1e-14
    )
    assert (np.linalg.det(rotation) > 0.0).all()
    np.testing.assert_array_equal(moved.alpha, point.alpha + step[..., 0])
    np.testing.assert_allclose(moved.adjoints, adjoint(rotation, moved.elements["translation"]))
    turned = Rotation.from_matrix(
        (rotation @ point.elements["rotation"].swapaxes(-1, -2)).reshape(-1, 3, 3)
    ).magnitude()
    # The angle, wound up.
    np.testing.assert_allclose(turned, abs((angle + np.pi) % (2.0 * np.pi) - np.pi), atol=1e-7)


@given(seeds, st.booleans())
def test_differential_of_the_weighted_output(seed, vanishing):
    rng = np.random.default_rng(seed)
    point, output, step = random_point(rng), rng.normal(size=18), rng.normal(size=(3, 3, 7))
    if vanishing:
        point = SE3Weights().point(np.zeros((3, 3)), point.elements)
    rows = differential(point, output)
    expected = derivative(lambda p: p.weight @ output, point, step)
    np.testing.assert_allclose((rows @ step.reshape(3, 21, 1)).ravel(), expected, rtol=1e-6, atol=1e-7)


@settings(max_examples=30)
@given(seeds, ratios)
def test_riemannian_gradient_of_the_loss(seed, ratio):
    """Against E^2/2 of the equilibrium solved anew for the moved weights."""
    rng, point, solver, equilibrium = stable_case(seed, ratio)
    goal, step = rng.uniform(-0.8, 0.8, 18), rng.normal(size=(3, 3, 7))

    def loss(moved):
        delta = solver.newton(moved.weight, equilibrium.x, tolerance=1e-14).x - goal
        return 0.5 * delta @ delta

    nearby = solver.sensitivity(point.weight, equilibrium)
    gradient = loss_gradient(differential(point, equilibrium.output), nearby, equilibrium.x - goal, ratio)
    assert np.vdot(gradient, step) == pytest.approx(derivative(loss, point, step), rel=1e-5, abs=1e-7)


@settings(max_examples=30)
@given(seeds, ratios)
def test_gradients_of_the_smoothed_eigenvalue(seed, ratio):
    rng = np.random.default_rng(seed)
    point, log_scale, step = random_point(rng), 0.5 * rng.normal(size=9), rng.normal(size=(3, 3, 7))
    value, in_point, in_log_scale = smoothed_eigenvalue(point, log_scale, ratio, 4.0)
    factor = np.exp(log_scale)
    scaled = ratio * factor[:, None] * rotational_weight(point) / factor
    largest = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1]
    assert largest - 1e-9 <= value <= largest + np.log(9) / 4.0 + 1e-9
    expected = derivative(lambda p: smoothed_eigenvalue(p, log_scale, ratio, 4.0)[0], point, step)
    assert np.vdot(in_point, step) == pytest.approx(expected, rel=1e-5, abs=1e-5)
    turn = STEP * rng.normal(size=9)
    ends = [smoothed_eigenvalue(point, log_scale + sign * turn, ratio, 4.0)[0] for sign in (1.0, -1.0)]
    assert in_log_scale @ turn == pytest.approx(0.5 * (ends[0] - ends[1]), rel=1e-4, abs=1e-10)


@settings(max_examples=30)
@given(seeds)
def test_the_shortest_solution_is_the_pseudoinverse_and_the_neutral_part_its_complement(seed):
    rng = np.random.default_rng(seed)
    rows, right, step = rng.normal(size=(3, 6, 21)), rng.normal(size=18), rng.normal(size=(3, 3, 7))
    equations = RowEquations(rows, 1e-12)
    expected = np.linalg.pinv(rows) @ right.reshape(3, 6, 1)
    np.testing.assert_allclose(equations.shortest(right).reshape(3, 21, 1), expected, atol=1e-8)
    neutral = equations.neutral(step)
    np.testing.assert_allclose(rows @ neutral.reshape(3, 21, 1), 0.0, atol=1e-8)
    assert np.vdot(neutral, step - neutral) == pytest.approx(0.0, abs=1e-8)


def target(seed: int, n: int = 4):
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (n, 6))


@pytest.mark.parametrize(
    ("seed", "network"),
    [
        (0, {}),
        (1, {}),
        (2, {"gamma": 2.0, "mu": 0.5, "bias": 0.5}),
        (3, {"activation": "arctan"}),
    ],
)
def test_certified_training_ends_with_a_certificate(seed, network):
    goal = target(seed)
    result = train(goal, RiemannianOptions(certified=True), seed=seed, **network)
    assert result.success, result.message
    assert result.reason is StopReason.CONVERGED
    assert result.network.certified
    assert result.error < 1e-5
    assert result.structure_error < 1e-12
    # Global stability, seen from far away by another solver.
    far = np.random.default_rng(seed).uniform(-20.0, 20.0, goal.shape)
    end = result.network.trajectory(far, 400.0, until=goal, distance=2e-5).xi[-1]
    assert np.abs(end - goal).max() < 1e-4


def test_the_same_seed_gives_the_same_network_and_another_one_another():
    options = RiemannianOptions(certified=True)
    first, again, other = (train(target(0), options, seed=seed).network for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.weight, again.weight)
    np.testing.assert_array_equal(first.lyapunov_diagonal, again.lyapunov_diagonal)
    assert np.abs(first.weight - other.weight).max() > 1e-3


def test_gauss_newton_arrives_at_a_stable_equilibrium_along_a_path_without_jumps():
    options = RiemannianOptions(max_jump=0.07)
    results = [train(target(seed), options, seed=seed) for seed in range(6)]
    arrived = [result for result in results if result.success]
    assert arrived
    for result in arrived:
        field = result.network.jacobian(result.history.equilibrium[-1])
        assert np.linalg.eigvals(field).real.max() < 0.0
        assert result.network.lyapunov_diagonal is None
    for result in results:
        moves = np.abs(np.diff(result.history.equilibrium, axis=0)).max(axis=(1, 2))
        assert moves.max() <= options.max_jump
        assert (np.diff(result.history.epoch) >= 1).all()
        assert result.structure_error < 1e-12
        assert result.success == (result.reason is StopReason.CONVERGED)


def test_every_gradient_step_lowers_the_error():
    seen = []
    options = RiemannianOptions(direction="gradient", restarts=0, max_start_epochs=150)
    with reporting(lambda *epochs: seen.append(epochs)):
        result = train(target(1), options, seed=1)
    assert (np.diff(result.history.error) < 0.0).all()
    assert result.history.error[-1] < 0.7 * result.history.error[0]
    assert result.reason is StopReason.EPOCHS_SPENT
    assert not result.success
    assert result.structure_error < 1e-12
    assert seen == [(epoch, 150) for epoch in [*range(1, 151), 150]]


def test_one_neuron_keeps_the_pitch_and_says_so():
    """omega . v / |omega|^2 is the same for y and alpha Ad(theta) y: one block does not make every twist of another."""
    result = train(target(0, 1), RiemannianOptions(certified=True, restarts=1, max_start_epochs=100))
    assert not result.success
    assert result.starts == 2
    assert result.reason in (StopReason.STEP_VANISHED, StopReason.EPOCHS_SPENT)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"direction": "gradient", "certified": True}, "certified training needs the direction 'gauss-newton'"),
        ({"stability_interval": 2.5}, "stability_interval must be a whole number, got 2.5"),
        ({"shrink": 1.0}, "shrink must be below 1 and grow at least 1, got 1 and 1.3"),
    ],
)
def test_bad_options_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        RiemannianOptions(**changes)


def test_bad_targets_are_refused():
    with pytest.raises(InputError, match=r"target must have shape \(N, 6\), got \(4, 3\)"):
        train(np.zeros((4, 3)), RiemannianOptions())
    with pytest.raises(InputError, match="mu must be positive"):
        train(np.zeros((4, 6)), RiemannianOptions(), mu=0.0)
