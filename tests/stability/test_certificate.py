"""Certificates against brute force, exact criteria where there are some, the paper's norms, and trajectories."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.stability import assess, find_certificate, verify

seeds = st.integers(0, 2**32 - 1)


def certified_weight(rng: np.random.Generator, n: int = 9, gamma: float = 1.0, mu: float = 1.0):
    """A weight just inside what its own random P certifies: mostly skew, so that its norms are far outside."""
    diagonal = 10.0 ** rng.uniform(-1.5, 1.5, n)
    raw = rng.normal(size=(n, n))
    raw = 3.0 * (raw - raw.T) + rng.normal(size=(n, n))
    root = np.sqrt(diagonal)
    largest = np.linalg.eigvalsh(0.5 * (raw + raw.T))[-1]
    return diagonal, raw * root / root[:, None] * (0.999 * gamma / mu / largest)


@settings(max_examples=6)
@given(seeds, st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_no_slopes_destabilise_what_is_certified(seed, rates):
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    diagonal, weight = certified_weight(rng, gamma=gamma, mu=mu)
    assert verify(diagonal, weight, gamma=gamma, mu=mu).valid
    assert not assess(weight, gamma=gamma, mu=mu)["norm sum"].holds
    slopes = np.concatenate([rng.uniform(size=(60, 9)), rng.integers(0, 2, size=(60, 9)).astype(float)])
    open_loops = mu * weight * slopes[:, None, :]
    assert np.linalg.eigvals(open_loops - gamma * np.eye(9)).real.max() < 0.0
    # Some of them do destabilise the weight once it is too large to be certified, so the search has teeth.
    assert np.linalg.eigvals(100.0 * open_loops - gamma * np.eye(9)).real.max() > 0.0


def test_badly_scaled_weight_is_certified_where_its_norms_and_its_symmetric_part_are_not():
    weight = np.array([[0.0, 300.0], [0.0, 0.0]])
    assert not verify([1.0, 1.0], weight).valid
    assert find_certificate(weight).valid
    assert find_certificate(np.zeros((2, 2))).valid
    # Beyond the range that the descent may search, the diagonal made of weighted norms still proves it.
    assert find_certificate([[0.0, 1e8], [0.0, 0.0]]).valid


@settings(max_examples=4)
@given(seeds)
def test_certificate_of_rotations_is_the_certificate_of_everything(seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(9, rng=rng).as_matrix().reshape(3, 3, 3, 3)
    translation = rng.normal(size=(3, 3, 3)) * 3.0
    network = LieEDNN(rng.uniform(-0.4, 0.4, (3, 3)), rotation, translation, np.zeros((3, 6)))
    found = find_certificate(network.rotational_weight)
    assume(found.margin > 0.01)
    # The flat state interleaves omega and v: P = (P_R, eps P_R) neuron by neuron.
    both = np.stack([found.lyapunov_diagonal.reshape(3, 3), 1e-8 * found.lyapunov_diagonal.reshape(3, 3)], axis=1)
    whole = verify(both.ravel(), network.weight)
    assert whole.valid
    assert whole.lambda_max == pytest.approx(found.lambda_max, abs=1e-2)
    # And no diagonal does better on the whole than on the part.
    assert find_certificate(network.weight).lambda_max >= found.lambda_max - 0.05


@settings(max_examples=12)
@given(seeds, st.floats(1e-3, 1e3), st.floats(1e-6, 1e6))
def test_verdict_depends_on_neither_the_unit_of_time_nor_the_length_of_p(seed, ratio, length):
    rng = np.random.default_rng(seed)
    weight, diagonal = rng.normal(size=(5, 5)), 10.0 ** rng.uniform(-2, 2, 5)
    one = verify(diagonal, weight)
    other = verify(length * diagonal, ratio * weight, gamma=ratio)
    assert other.margin == pytest.approx(one.margin, rel=1e-9, abs=1e-12)
    np.testing.assert_allclose(other.lyapunov_diagonal, one.lyapunov_diagonal, rtol=1e-12)
    assert np.prod(one.lyapunov_diagonal) == pytest.approx(1.0)
    scaled = np.sqrt(diagonal)[:, None] * weight / np.sqrt(diagonal)
    assert one.lambda_max == pytest.approx(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1], rel=1e-12)


@pytest.mark.parametrize("size", [1.0, np.nextafter(1.0, 0.0), 1.0 - 1e-15])
def test_the_boundary_itself_is_not_certified(size):
    rotation = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    for weight in (size * np.eye(3), size * rotation):
        certificate = verify(np.ones(3), weight)
        assert not certificate.valid
        assert certificate.margin <= 0.0
        assert "not certified" in str(certificate)
    assert verify(np.ones(3), 0.999 * rotation).valid
    assert str(verify(np.ones(3), (1.0 - 1e-9) * np.eye(3))).endswith("lambda_max 1 against gamma/mu 1, below by 1e-09")


def lyapunov_function(diagonal, x, equilibrium):
    """V of the module's proof for tanh, whose integral is log cosh; by logaddexp, which large x cannot overflow."""

    def log_cosh(s):
        return np.logaddexp(s, -s) - np.log(2.0)

    return (log_cosh(x) - log_cosh(equilibrium) - np.tanh(equilibrium) * (x - equilibrium)) @ diagonal


@settings(max_examples=8)
@given(seeds, st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_lyapunov_function_falls_at_the_proven_rate_and_twice_as_fast_in_the_end(seed, rates):
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    diagonal, weight = certified_weight(rng, n=6, gamma=gamma, mu=mu)
    # Random margins; skew parts turn the state about, so that no single norm need fall.
    weight *= rng.uniform(0.3, 0.95)
    certificate = verify(diagonal, weight, gamma=gamma, mu=mu)
    assert certificate.rate == pytest.approx(gamma - mu * certificate.lambda_max, rel=1e-9)
    x_star = rng.normal(size=6)
    bias = gamma / mu * x_star - weight @ np.tanh(x_star)

    def flow(_, x):
        return -gamma * x + mu * (weight @ np.tanh(x) + bias)

    t = np.linspace(0.0, 6.0 / gamma, 60)
    start = x_star + rng.normal(size=6) * 10.0 ** rng.uniform(-1, 1.5)
    x = solve_ivp(flow, (0.0, t[-1]), start, t_eval=t, method="DOP853", rtol=1e-11, atol=1e-13).y.T
    v = lyapunov_function(certificate.lyapunov_diagonal, x, x_star)
    keep = v > 1e-9 * v[0]
    assert (np.diff(np.log(v[keep])) <= -certificate.rate * np.diff(t[keep]) + 1e-5).all()
    # In the linear range, by the exact derivative of V along the flow at a point very near x*.
    near = 1e-6 * rng.normal(size=6)
    slopes = 1.0 - np.tanh(x_star) ** 2
    closing = -gamma * near + mu * weight @ (slopes * near)
    weights = certificate.lyapunov_diagonal * slopes
    assert weights * near @ closing <= -certificate.rate * (weights * near @ near) * (1.0 - 1e-9)


def test_rate_is_gamma_at_most_and_nothing_without_a_proof():
    assert verify(np.ones(2), -5.0 * np.eye(2), gamma=3.0).rate == 3.0
    assert verify(np.ones(2), 0.5 * np.eye(2), gamma=3.0, mu=2.0).rate == pytest.approx(2.0)
    assert verify(np.ones(2), 2.0 * np.eye(2), gamma=3.0, mu=2.0).rate == 0.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: verify(np.ones(3), np.eye(4)), r"weight must have shape \(3, 3\), got \(4, 4\)"),
        (lambda: verify([1.0, 0.0], np.eye(2)), "lyapunov_diagonal must be positive, its smallest entry is 0"),
        (lambda: verify([1.0, np.nan], np.eye(2)), "lyapunov_diagonal must be finite"),
        (lambda: find_certificate(np.ones((2, 3))), r"weight must have shape \(n, n\), got \(2, 3\)"),
        (lambda: find_certificate(np.eye(2), gamma=-1.0), "gamma must be positive"),
        (lambda: find_certificate(np.eye(4), group_size=3), "group_size must divide the 4 rows of weight, got 3"),
        (lambda: find_certificate(np.eye(4), group_size=0), "group_size must be at least 1"),
        pytest.param(lambda: find_certificate(np.zeros((0, 0))), "weight", id="empty weight"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_rows_of_zeros_are_fast_and_change_nothing():
    rng = np.random.default_rng(4)
    for inner in (1.0, -5.0):
        weight = np.zeros((30, 30))
        weight[[3, 7, 20]] = rng.normal(size=(3, 30))
        weight[[3, 7, 20], [3, 7, 20]] += inner
        diagonal = np.exp(rng.normal(size=30))
        scaled = np.sqrt(diagonal)[:, None] * weight / np.sqrt(diagonal)
        expected = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1]
        assert verify(diagonal, weight).lambda_max == pytest.approx(expected, rel=1e-12)
    # Without inputs of the others what is left are zeros.
    assert verify(np.ones(5), np.diag([-1.0, -2.0, 0.0, 0.0, 0.0])).lambda_max == 0.0
