"""Complex and quaternion networks against integrations that know nothing of Lie groups."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from lieednn_sim import stability
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.theory import (
    complex_network,
    complex_state,
    complex_values,
    quaternion_network,
    quaternion_state,
    quaternion_values,
)

seeds = st.integers(0, 2**32 - 1)


def split_tanh(z):
    return np.tanh(z.real) + 1j * np.tanh(z.imag)


def hamilton(p, q):
    """Product from i^2 = j^2 = k^2 = ijk = -1, as scalar and vector parts."""
    scalar = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)


def random_complex(seed: int, n: int = 3, strength: float = 1.0):
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, n, n))
    weights = strength * (parts[0] + 1j * parts[1])
    # A missing link and a real one, which have no and a special phase.
    weights[0, 1], weights[1, 2] = 0.0, -abs(weights[1, 2])
    return weights, rng.normal(size=n) + 1j * rng.normal(size=n), rng.normal(size=n) - 1j * rng.normal(size=n)


def real_form(weights):
    """The matrix of z -> w z on (Re z_1, Im z_1, Re z_2 ...)."""
    blocks = np.array([[weights.real, -weights.imag], [weights.imag, weights.real]])
    return blocks.transpose(2, 0, 3, 1).reshape(2 * len(weights), -1)


@settings(max_examples=20)
@given(seeds, st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_complex_network_is_the_complex_equation(seed, rates):
    (weights, bias, start), (gamma, mu) = random_complex(seed), rates
    network = complex_network(weights, bias, gamma=gamma, mu=mu)

    def field(_, z):
        return -gamma * z + mu * (weights @ split_tanh(z) + bias)

    np.testing.assert_allclose(complex_values(network.vector_field(complex_state(start))), field(0, start), atol=1e-12)
    reference = solve_ivp(field, (0.0, 3.0), start, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    ended = network.trajectory(complex_state(start), 3.0, rtol=1e-10, atol=1e-12).xi[-1]
    np.testing.assert_allclose(complex_values(ended), reference, atol=1e-6 * (1.0 + np.abs(reference).max()))
    assert np.abs(ended[:, :2]).max() == 0.0


@settings(max_examples=8)
@given(seeds, st.sampled_from([(1.0, 1.0), (0.3, 4.0)]))
def test_quaternion_network_is_the_hamilton_product(seed, rates):
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weights, bias, start = rng.normal(size=(3, 3, 4)), rng.normal(size=(3, 4)), rng.normal(size=(3, 4))
    weights[2, 0] = 0.0
    network = quaternion_network(weights, bias, gamma=gamma, mu=mu)

    def field(_, flat):
        q = flat.reshape(3, 4)
        drive = hamilton(weights, np.broadcast_to(np.tanh(q), (3, 3, 4))).sum(axis=1)
        return (-gamma * q + mu * (drive + bias)).ravel()

    found = quaternion_values(network.vector_field(quaternion_state(start)))
    np.testing.assert_allclose(found.ravel(), field(0, start.ravel()), atol=1e-12)
    reference = solve_ivp(field, (0.0, 3.0), start.ravel(), "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    ended = network.trajectory(quaternion_state(start), 3.0, rtol=1e-10, atol=1e-12).xi[-1]
    tolerance = 1e-6 * (1.0 + np.abs(reference).max())
    np.testing.assert_allclose(quaternion_values(ended).ravel(), reference, atol=tolerance)
    assert np.abs(ended[:, :4]).max() < 1e-12


@settings(max_examples=12)
@given(seeds, st.booleans(), st.sampled_from([(1.0, 1.0), (0.3, 4.0)]))
def test_certificate_exists_exactly_when_the_complex_network_has_one(seed, inside, rates):
    (weights, bias, _), (gamma, mu) = random_complex(seed), rates
    largest = stability.find_certificate(real_form(weights)).lambda_max
    weights = weights * ((0.95 if inside else 1.05) * gamma / mu / largest)
    network = complex_network(weights, bias, gamma=gamma, mu=mu)
    if inside:
        assert network.certify().certified
    else:
        with pytest.raises(NotCertifiedError, match="scale alpha or mu down"):
            network.certify()


def test_a_rotating_complex_network_is_certified_where_its_moduli_are_not():
    weights = np.array([[0.0, 2.0], [-2.0, 0.0]])
    network = complex_network(weights, [0.3, 1.0j]).certify()
    assert not stability.find_certificate(np.abs(weights)).valid
    ended = network.trajectory(complex_state([5.0 - 5.0j, 4.0j]), 80.0).xi[-1]
    # The other coordinates decay from anywhere, so nothing outside the subspace disturbs it.
    disturbed = network.trajectory(np.full((2, 4), 3.0), 80.0).xi[-1]
    found = network.equilibrium()
    assert found.success
    np.testing.assert_allclose(ended, found.xi, atol=1e-6)
    np.testing.assert_allclose(disturbed, found.xi, atol=1e-6)


@given(seeds)
def test_states_and_numbers_are_inverse(seed):
    rng = np.random.default_rng(seed)
    z, q = rng.normal(size=(5, 3)) + 1j * rng.normal(size=(5, 3)), rng.normal(size=(5, 3, 4))
    assert np.array_equal(complex_values(complex_state(z)), z)
    assert np.array_equal(quaternion_values(quaternion_state(q)), q)
    assert complex_state(z).shape == (5, 3, 4)
    assert quaternion_state(q).shape == (5, 3, 8)


def test_no_links_at_all():
    network = complex_network(np.zeros((2, 2)), [1.0, 2.0j], gamma=2.0)
    np.testing.assert_allclose(complex_values(network.equilibrium().xi), [0.5, 1.0j], atol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: complex_network(np.ones((2, 3)), np.ones(2)), "weights must have shape"),
        (lambda: complex_network(np.ones((2, 2)), np.ones(3)), r"bias must have shape \(2, 2\)"),
        (lambda: complex_network([[np.nan]], [0.0]), "weights must be finite"),
        (lambda: quaternion_network(np.ones((2, 2)), np.ones((2, 4))), r"weights must have shape \(N, N, 4\)"),
        (lambda: quaternion_network(np.ones((2, 2, 4)), np.ones((2, 4)), activation="relu"), "no activation 'relu'"),
        (lambda: quaternion_values(np.ones((2, 4))), r"xi must have shape \(\.\.\., 8\)"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()
