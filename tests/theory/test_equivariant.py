"""The equivariant network, and App. N, "Group Equivariance of LieEDNN": what holds, and what is printed wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim import stability
from lieednn_sim.errors import FileError, InputError, NotCertifiedError
from lieednn_sim.lie import adjoint
from lieednn_sim.network import LieEDNN
from lieednn_sim.theory import EquivariantLieEDNN

seeds = st.integers(0, 2**32 - 1)
angles = st.one_of(st.just(0.0), st.floats(-300.0, -1.0).map(lambda k: 10.0**k), st.floats(0.0, 10.0))


def random_network(seed: int, n: int = 3, strength: float = 0.5, gamma=1.2, mu=0.8) -> EquivariantLieEDNN:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3)
    alpha = strength * rng.normal(size=(n, n))
    return EquivariantLieEDNN(alpha, rotation, rng.normal(size=(n, n, 3)), rng.normal(size=(n, 6)), gamma, mu)


def certified_network(seed: int, n: int = 3, **settings) -> EquivariantLieEDNN:
    network = random_network(seed, n, **settings)
    largest = stability.find_certificate(network.rotational_weight, group_size=3).lambda_max
    alpha = network.alpha * (0.6 * network.gamma / network.mu / largest)
    return dataclasses.replace(network, alpha=alpha).certify()


def twist_of(angle: float, seed: int):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(size=3)])


@given(seeds, angles)
def test_activation_scales_the_twist_and_is_the_identity_at_rest(seed, angle):
    x = twist_of(angle, seed)
    phi = random_network(0).phi(x)
    size = np.linalg.norm(x[:3])
    factor = np.tanh(size) / size if size > 0.0 else 1.0
    np.testing.assert_allclose(phi, factor * x, rtol=1e-15)
    if angle < 1e-9:
        assert np.array_equal(phi[3:], x[3:])


@pytest.mark.parametrize("angle", [0.01, 0.0999, 0.1001, 0.3, 2.0])
def test_series_and_closed_form_agree_with_more_digits(angle):
    x, r = np.array([angle, 0.0, 0.0, 1.0, 2.0, 3.0]), np.longdouble(angle)
    # d/dr of tanh(r)/r in extended precision, where the cancellation is harmless.
    slope = (1.0 / np.cosh(r) ** 2 - np.tanh(r) / r) / r
    network = random_network(0)
    np.testing.assert_allclose(network.phi_jacobian(x)[3:, 0], float(slope) * x[3:], rtol=1e-12)
    assert network.phi(x)[3] == pytest.approx(float(np.tanh(r) / r), rel=4e-16)


def test_extreme_twists_neither_overflow_nor_vanish():
    network = random_network(0)
    for size in (1e-320, 1e-200, 1e200):
        x = np.array([size, size, 0.0, 1.0, 0.0, 0.0])
        assert np.isfinite(network.phi_jacobian(x)).all()
        assert network.phi(x)[0] == pytest.approx(min(size, np.sqrt(0.5)), rel=1e-9)


@given(seeds, angles)
def test_jacobian_against_finite_differences_also_at_rest(seed, angle):
    network = random_network(seed, n=2, gamma=0.5, mu=3.0)
    xi, step = np.stack([[twist_of(angle, seed + k), twist_of(0.0, seed + k + 1)] for k in (0, 2)]), 1e-5
    moves = step * np.eye(12).reshape(12, 1, 2, 6)
    numeric = (network.vector_field(xi + moves) - network.vector_field(xi - moves)) / (2.0 * step)
    numeric = numeric.reshape(12, 2, 12).transpose(1, 2, 0)
    np.testing.assert_allclose(network.jacobian(xi), numeric, atol=3e-8 * (1.0 + np.abs(numeric).max()))
    flat = network.flat_vector_field(xi[0].ravel())
    np.testing.assert_allclose(flat, network.vector_field(xi[0]).ravel(), atol=1e-12)


@settings(max_examples=8)
@given(seeds, st.sampled_from([(1.0, 1.0), (0.3, 4.0)]))
def test_certificate_holds_for_the_componentwise_network_too(seed, rates):
    network = certified_network(seed, gamma=rates[0], mu=rates[1])
    parts = (network.alpha, network.rotation, network.translation, network.bias, *rates)
    known = LieEDNN(*parts, lyapunov_diagonal=np.repeat(network.lyapunov_diagonal, 3))
    assert known.certified
    assert known.certificate.lambda_max == network.certificate.lambda_max
    assert network.retarget(np.ones((3, 6))).certified


def test_a_diagonal_that_tells_axes_apart_proves_nothing_here():
    """Found by maximising the spectral abscissa: globally stable with tanh on each axis, unstable with Phi."""
    vectors = [[0.09, -1.37, -2.31], [-1.79, 1.4, 0.99], [1.69, 0.73, -1.62], [0.27, 2.06, 0.89]]
    rotation = Rotation.from_rotvec(vectors).as_matrix().reshape(2, 2, 3, 3)
    alpha = 0.5 * np.array([[1.75, -6.53], [1.28, 1.54]])
    diagonal = np.exp([-2.06, 0.02, -0.36, 2.96, -0.6, 0.6])
    known = LieEDNN(alpha, rotation, np.zeros((2, 2, 3)), np.zeros((2, 6)), lyapunov_diagonal=diagonal)
    assert known.certified
    network = EquivariantLieEDNN(alpha, rotation, known.translation, known.bias)
    target = np.zeros((2, 6))
    target[1, :3] = [1.53, 1.36, -0.42]
    assert network.retarget(target).equilibrium(target).spectral_abscissa > 0.1
    with pytest.raises(NotCertifiedError):
        network.certify()


def test_an_unstable_network_gets_no_certificate():
    network = EquivariantLieEDNN([[1.5]], np.eye(3)[None, None], np.zeros((1, 1, 3)), np.zeros((1, 6)))
    with pytest.raises(NotCertifiedError, match=r"no certificate .*lambda_max 1\.5"):
        network.certify()
    assert not network.certified
    assert network.equilibrium().spectral_abscissa == pytest.approx(0.5)


def test_save_and_load_are_bit_exact_and_checked(tmp_path):
    network = certified_network(4, gamma=0.1 + 0.2, mu=1.0 / 3.0)
    network.save(tmp_path / "n.npz")
    loaded = EquivariantLieEDNN.load(tmp_path / "n.npz")
    for name in ("alpha", "rotation", "translation", "bias", "lyapunov_diagonal"):
        assert getattr(loaded, name).tobytes() == getattr(network, name).tobytes()
    assert loaded.certificate.lambda_max == network.certificate.lambda_max
    dataclasses.replace(network, alpha=50.0 * network.alpha).save(tmp_path / "bad.npz")
    with pytest.raises(FileError, match="certificate that does not hold"):
        EquivariantLieEDNN.load(tmp_path / "bad.npz")
    with pytest.raises(FileError, match="holds 'equivariant-network', expected 'network'"):
        LieEDNN.load(tmp_path / "n.npz")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda n: dataclasses.replace(n, lyapunov_diagonal=np.ones(9)), r"must have shape \(3,\), got \(9,\)"),
        (lambda n: dataclasses.replace(n, bias=np.ones((3, 3))), r"bias must have shape \(3, 6\)"),
        (lambda n: n.transform(2.0 * np.eye(3), np.zeros(3)), "rotation must hold rotation matrices"),
        (lambda n: n.transform(np.eye(4), np.zeros(3)), r"rotation must have shape \(3, 3\), got \(4, 4\)"),
        (lambda n: n.transform(np.eye(3), np.zeros((2, 3))), r"translation must have shape \(3, 3\)"),
        (lambda n: n.equilibrium(np.zeros((3, 3))), r"start must have shape \(3, 6\)"),
        (lambda n: n.vector_field(np.zeros((3, 5))), r"xi must have shape \(\.\.\., 3, 6\)"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call(random_network(0))


def random_frames(seed: int, *shape: int):
    rng = np.random.default_rng(seed + 1)
    rotation = Rotation.random(int(np.prod(shape)), rng=rng).as_matrix().reshape(*shape, 3, 3)
    return rotation, 2.0 * rng.normal(size=(*shape, 3))


def moved(frames, xi):
    return np.einsum("...ab,...b->...a", np.broadcast_to(adjoint(*frames), (*xi.shape, 6)), xi)


@given(seeds, st.one_of(st.just(0.0), st.floats(-12.0, 1.0).map(lambda k: 10.0**k)))
def test_the_corrected_activation_is_equivariant(seed, size):
    rng, network = np.random.default_rng(seed), random_network(0)
    xi = rng.normal(size=(3, 6)) * [size, size, size, 1.0, 1.0, 1.0]
    frames = random_frames(seed, 1)
    np.testing.assert_allclose(network.phi(moved(frames, xi)), moved(frames, network.phi(xi)), atol=1e-12)


@given(seeds)
def test_transformed_weights_are_conjugated_by_the_adjoint(seed):
    network, (q, s) = random_network(seed), random_frames(seed)
    ad = adjoint(q, s)
    blocks = network.transform(q, s).blocks
    np.testing.assert_allclose(blocks, ad @ network.blocks @ np.linalg.inv(ad), atol=1e-11)


@settings(max_examples=3)
@given(seeds)
def test_with_the_frames_of_sender_and_receiver_each_neuron_may_have_its_own(seed):
    """Beyond the paper: theta_ij -> h_i theta_ij h_j^-1 is a symmetry for independent h_i."""
    network, frames = random_network(seed), random_frames(seed, 3)
    start = np.random.default_rng(seed).normal(size=(3, 6))
    one = network.trajectory(start, 4.0, rtol=1e-10, atol=1e-12).xi[-1]
    other = network.transform(*frames).trajectory(moved(frames, start), 4.0, rtol=1e-10, atol=1e-12).xi[-1]
    expected = moved(frames, one)
    np.testing.assert_allclose(other, expected, atol=1e-6 * (1.0 + np.abs(expected).max()))


@settings(max_examples=6)
@given(seeds, st.booleans())
def test_the_certificate_is_as_invariant_as_the_network(seed, common):
    network = certified_network(seed)
    frames = random_frames(seed) if common else random_frames(seed, 3)
    seen = network.transform(*frames)
    assert seen.certified
    assert seen.certificate.lambda_max == pytest.approx(network.certificate.lambda_max, abs=1e-12)
    found, expected = seen.equilibrium().xi, moved(frames, network.equilibrium().xi)
    np.testing.assert_allclose(found, expected, atol=1e-8 * (1.0 + np.abs(expected).max()))


@settings(max_examples=4)
@given(seeds)
def test_stability_by_the_cascade(seed):
    """Every start of a certified network ends at the one equilibrium, far ones and pure translations included."""
    network = certified_network(seed)
    found = network.equilibrium()
    assert found.success
    assert found.spectral_abscissa < 0.0
    rng = np.random.default_rng(seed)
    starts = [rng.uniform(-20.0, 20.0, (3, 6)), rng.normal(size=(3, 6)) * [0.0, 0.0, 0.0, 1e3, 1e3, 1e3]]
    for start in starts:
        ended = network.trajectory(start, 90.0 / -found.spectral_abscissa, rtol=1e-8, atol=1e-10).xi[-1]
        np.testing.assert_allclose(ended, found.xi, atol=1e-5 * (1.0 + np.abs(found.xi).max()))
