"""The network: two forms of one equation, its equilibrium and flow, and the file that keeps it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.lie import adjoint
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.stability import find_certificate

seeds = st.integers(0, 2**32 - 1)
ARRAYS = ("alpha", "rotation", "translation", "bias")


def random_network(seed: int, n: int = 3, strength: float = 1.0, **settings) -> LieEDNN:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3)
    alpha = strength * rng.normal(size=(n, n))
    return LieEDNN(alpha, rotation, 2.0 * rng.normal(size=(n, n, 3)), rng.normal(size=(n, 6)), **settings)


def certified_network(seed: int, n: int = 3, **settings) -> LieEDNN:
    network = random_network(seed, n, **settings)
    ratio = network.gamma / network.mu
    largest = find_certificate(network.rotational_weight).lambda_max
    network = dataclasses.replace(network, alpha=network.alpha * (0.6 * ratio / largest))
    certificate = find_certificate(network.rotational_weight, gamma=network.gamma, mu=network.mu)
    network = dataclasses.replace(network, lyapunov_diagonal=certificate.lyapunov_diagonal)
    assert network.certified
    return network


@given(seeds, st.sampled_from(sorted(ACTIVATIONS)))
def test_block_form_is_flat_form_is_the_sum_of_the_paper(seed, activation):
    network = random_network(seed, gamma=2.0, mu=0.7, activation=activation)
    xi = np.random.default_rng(seed).normal(size=(2, 5, 3, 6)) * 2.0
    block = network.vector_field(xi)
    assert block.shape == xi.shape
    phi = ACTIVATIONS[activation].phi
    for index in np.ndindex(2, 5):
        expected = -2.0 * xi[index] + 0.7 * network.bias
        for i, j in np.ndindex(3, 3):
            ad = adjoint(network.rotation[i, j], network.translation[i, j])
            expected[i] += 0.7 * network.alpha[i, j] * ad @ phi(xi[index][j])
        np.testing.assert_allclose(block[index], expected, atol=1e-12)
        np.testing.assert_allclose(network.flat_vector_field(xi[index].ravel()), expected.ravel(), atol=1e-12)


@given(seeds, st.sampled_from(sorted(ACTIVATIONS)))
def test_jacobian_against_finite_differences(seed, activation):
    network = random_network(seed, n=2, gamma=0.5, mu=3.0, activation=activation)
    xi, step = np.random.default_rng(seed).normal(size=(2, 2, 6)), 1e-5
    moves = step * np.eye(12).reshape(12, 1, 2, 6)
    numeric = (network.vector_field(xi + moves) - network.vector_field(xi - moves)) / (2.0 * step)
    # (12 moved, 2 batch, 12 responses) to (2, 12 responses, 12 moved)
    numeric = numeric.reshape(12, 2, 12).transpose(1, 2, 0)
    np.testing.assert_allclose(network.jacobian(xi), numeric, atol=1e-7)


@pytest.mark.parametrize("name", sorted(ACTIVATIONS))
def test_activations_are_what_the_certificate_assumes(name):
    phi, slope = ACTIVATIONS[name].phi, ACTIVATIONS[name].slope
    x = np.concatenate([[0.0, 1e-300, 1e3, 1e8], np.logspace(-12, 2, 200)])
    assert np.array_equal(phi(-x), -phi(x))
    assert np.abs(phi(x)).max() <= 1.0
    assert slope(0.0) == 1.0
    assert (slope(x) <= 1.0).all()
    assert (slope(x[x < 300.0]) > 0.0).all()


@given(seeds)
def test_translations_move_no_eigenvalue_and_rotation_hears_nothing_of_v(seed):
    network = random_network(seed)
    rng = np.random.default_rng(seed)
    moved = dataclasses.replace(network, translation=10.0 * rng.normal(size=(3, 3, 3)))
    xi = rng.normal(size=(3, 6))
    # P = diag(1, eps) of the cascade scales the far-from-normal coupling away, so that eigenvalues keep their digits.
    balance = np.tile(np.repeat([1.0, 1e-8], 3), 3)
    one, two = (np.linalg.eigvals(balance[:, None] * n.jacobian(xi) / balance) for n in (network, moved))
    apart = np.abs(one[:, None] - two)
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-5
    assert np.array_equal(network.rotational_weight, moved.rotational_weight)
    other = xi.copy()
    other[:, 3:] = rng.normal(size=(3, 3))
    assert np.array_equal(network.vector_field(xi)[:, :3], moved.vector_field(other)[:, :3])


@settings(max_examples=8)
@given(seeds, st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_equilibrium_is_where_every_far_start_ends(seed, rates):
    network = certified_network(seed, gamma=rates[0], mu=rates[1])
    found = network.equilibrium()
    assert found.success
    assert found.residual < 1e-9
    assert found.spectral_abscissa < 0.0
    assert "Newton converged" in found.message
    start = np.random.default_rng(seed).uniform(-30.0, 30.0, (3, 6))
    ended = network.trajectory(start, 200.0 / rates[0], rtol=1e-10, atol=1e-12).xi[-1]
    np.testing.assert_allclose(ended, found.xi, atol=1e-6)
    np.testing.assert_allclose(network.equilibrium(start).xi, found.xi, atol=1e-9)


def test_unstable_equilibrium_is_told_by_its_abscissa():
    network = LieEDNN([[5.0]], np.eye(3)[None, None], np.zeros((1, 1, 3)), np.zeros((1, 6)))
    found = network.equilibrium()
    assert found.success
    assert found.spectral_abscissa == pytest.approx(4.0)
    assert not network.certified


def test_a_search_without_success_says_so():
    results = []
    for seed in range(12):
        network = random_network(seed, n=2, strength=10.0)
        found = network.equilibrium(np.random.default_rng(seed).normal(size=(2, 6)) * 3.0)
        residual = np.abs(network.vector_field(found.xi)).max()
        assert found.residual == pytest.approx(residual, abs=1e-12)
        assert found.success == (residual < 1e-8)
        assert ("no equilibrium found" in found.message) == (not found.success)
        results.append(found.success)
    # Both happen, or this test shows nothing.
    assert 0 < sum(results) < len(results)


def test_trajectory_without_weights_is_the_exponential():
    bias = np.arange(12.0).reshape(2, 6)
    network = LieEDNN(
        np.zeros((2, 2)), np.broadcast_to(np.eye(3), (2, 2, 3, 3)), np.zeros((2, 2, 3)), bias, gamma=2.0, mu=0.5
    )
    start = np.ones((2, 6))
    trajectory = network.trajectory(start, 3.0)
    times = np.linspace(0.0, 3.0, 12).reshape(3, 4)
    decay = np.exp(-2.0 * times)[..., None, None]
    states = trajectory(times)
    assert states.shape == (3, 4, 2, 6)
    np.testing.assert_allclose(states, decay * start + (1.0 - decay) * 0.25 * bias, atol=1e-6)
    np.testing.assert_allclose(trajectory(trajectory.t), trajectory.xi, atol=1e-12)
    assert trajectory(0.5).shape == (2, 6)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "BDF", "LSODA"])
def test_every_method_follows_the_linearised_flow(method):
    network = certified_network(0).retarget(np.full((3, 6), 0.3))
    small = 1e-4 * np.random.default_rng(0).normal(size=(3, 6))
    ended = network.trajectory(0.3 + small, 2.0, method=method, rtol=1e-10, atol=1e-14).xi[-1]
    linear = expm(2.0 * network.jacobian(np.full((3, 6), 0.3))) @ small.ravel()
    np.testing.assert_allclose(ended.ravel() - 0.3, linear, atol=1e-6)
    assert np.abs(linear).max() > 1e-5


def test_trajectory_stops_near_its_goal():
    network = certified_network(1)
    goal = network.equilibrium().xi
    trajectory = network.trajectory(np.full((3, 6), 5.0), 1e4, until=goal, distance=1e-3)
    assert np.abs(trajectory.xi[-1] - goal).max() == pytest.approx(1e-3, rel=1e-3)
    assert np.abs(trajectory.xi[:-1] - goal).max(axis=(1, 2)).min() > 1e-3
    np.testing.assert_allclose(trajectory(trajectory.t), trajectory.xi, atol=1e-12)
    assert network.trajectory(goal, 1e3, until=goal, distance=1e-3).t[-1] < 1.0


@given(seeds, st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_retarget_is_exact_and_keeps_the_proof(seed, rates):
    network = random_network(seed, gamma=rates[0], mu=rates[1], lyapunov_diagonal=np.arange(1.0, 10.0))
    target = np.random.default_rng(seed).uniform(-3.0, 3.0, (3, 6))
    retargeted = network.retarget(target)
    size = rates[0] * 3.0 + rates[1] * np.abs(network.weight).sum(axis=1).max()
    assert np.abs(retargeted.vector_field(target)).max() < 1e-14 * size
    assert np.array_equal(retargeted.weight, network.weight)
    assert retargeted.certificate.lambda_max == network.certificate.lambda_max
    # No weights with this equilibrium and this bias undercut the bound, these neither.
    smallest = retargeted.smallest_one_norm(target)
    required = rates[0] / rates[1] * target - retargeted.bias
    assert smallest == pytest.approx(np.abs(required).sum() / np.abs(np.tanh(target)).sum())
    assert np.linalg.norm(network.weight, 1) >= smallest * (1.0 - 1e-12)


def test_a_network_owns_its_arrays():
    source = {name: np.array(getattr(random_network(0), name)) for name in ARRAYS}
    network = LieEDNN(**source)
    before = network.vector_field(np.ones((3, 6)))
    for array in source.values():
        array[...] = 7.0
    assert np.array_equal(network.vector_field(np.ones((3, 6))), before)


@pytest.mark.parametrize("name", [*ARRAYS, "weight", "rotational_weight", "blocks"])
def test_no_array_of_a_network_can_be_written(name):
    """Written weights would leave the two forms of the equation, and the certificate, in disagreement."""
    network = random_network(0)
    with pytest.raises(ValueError, match="read-only"):
        getattr(network, name)[...] = 0.0


@pytest.mark.parametrize("certified", [True, False])
def test_save_and_load_are_bit_exact(tmp_path, certified):
    make = certified_network if certified else random_network
    network = make(5, gamma=0.1 + 0.2, mu=1.0 / 3.0, activation="arctan")
    network.save(tmp_path / "n.npz")
    loaded = LieEDNN.load(tmp_path / "n.npz")
    assert loaded == network
    assert loaded.certified == certified
    assert loaded.certificate == network.certificate


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": lambda a: 50.0 * a}, "certificate that does not hold for its weights"),
        ({"mu": lambda mu: 50.0 * mu}, "certificate that does not hold for its weights"),
        ({"lyapunov_diagonal": lambda p: 1e6 ** np.arange(9.0) ** 0.5}, "certificate that does not hold"),
        # What the certificate refuses, and what the network does.
        ({"lyapunov_diagonal": lambda p: np.full(9, 5e-324)}, "not a valid network: lyapunov_diagonal must have entr"),
        ({"rotation": lambda r: 1.01 * r}, "not a valid network: rotation must hold rotation matrices"),
        ({"alpha": None}, "has no array 'alpha'; it holds: .*bias"),
        ({"gamma": None}, "not a valid network: .*gamma"),
    ],
)
def test_tampered_files_are_refused(tmp_path, change, words):
    path = tmp_path / "n.npz"
    certified_network(6).save(path)
    arrays, meta = io.load_arrays(path, "network")
    for name, function in change.items():
        values = arrays if name in arrays else meta
        if function is None:
            del values[name]
        else:
            values[name] = function(values[name])
    io.save_arrays(path, "network", arrays, meta)
    with pytest.raises(FileError, match=words):
        LieEDNN.load(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": np.zeros((0, 0))}, r"\(n, n\) with n >= 1"),
        ({"alpha": np.ones((3, 2))}, r"alpha must have shape \(n, n\), got \(3, 2\)"),
        ({"rotation": np.eye(3)}, r"rotation must have shape \(3, 3, 3, 3\), got \(3, 3\)"),
        ({"rotation": np.broadcast_to(-np.eye(3), (3, 3, 3, 3))}, "differs from I .* project with .*_to_rotation"),
        ({"translation": np.full((3, 3, 3), 1.7e308)}, r"translation must not exceed 1e\+100 in size"),
        (
            {"translation": np.full((3, 3, 3), 9e99), "alpha": np.full((3, 3), 1e99)},
            r"alpha times translation must not exceed 1e\+100",
        ),
        ({"gamma": 0.0}, "gamma must be positive, got 0"),
        ({"activation": "relu"}, "allowed: .*tanh"),
        ({"lyapunov_diagonal": np.ones(18)}, r"lyapunov_diagonal must have shape \(9,\), got \(18,\)"),
    ],
)
def test_wrong_parts_are_named(change, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(random_network(0), **change)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda n: n.vector_field(np.zeros(18)), r"xi must have shape \(\.\.\., 3, 6\), got \(18,\)"),
        (lambda n: n.equilibrium(np.full((3, 6), np.nan)), "start must be finite"),
        (lambda n: n.retarget(np.zeros((2, 6))), r"xi must have shape \(3, 6\), got \(2, 6\)"),
        (lambda n: n.trajectory(np.zeros((3, 6)), 0.0), "duration must be positive"),
        (lambda n: n.trajectory(np.zeros((3, 6)), 1.0, method="Euler"), "no method 'Euler'; allowed: .*RK45"),
        (lambda n: n.trajectory(np.zeros((3, 6)), 1.0, until=np.zeros(6)), r"until must have shape \(3, 6\)"),
        (lambda n: n.trajectory(np.zeros((3, 6)), 1.0)(1.5), r"t must lie in \[0, 1\], got 1\.5"),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(InputError, match=words):
        call(random_network(0))
