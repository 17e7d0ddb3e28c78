"""Synthesis: what it returns is certified and has the target, and what it cannot make it does not return."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import LieEDNN
from lieednn_sim.stability import verify
from lieednn_sim.synthesis import BIAS_RULES, RESIDUAL_TOLERANCE, certified, synthesize


def random_target(seed: int, n: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (n, 6))


def arm_target(seed: int, angles: np.ndarray) -> np.ndarray:
    """Poses of revolute-prismatic joints: a turn about one axis, a slide along another, seen in the joint's frame."""
    rng = np.random.default_rng(seed)
    xi = np.zeros((len(angles), 6))
    for i, angle in enumerate(angles):
        axis, slide = np.eye(3)[rng.permutation(3)[:2]]
        xi[i, :3] = angle * axis
        xi[i, 3:] = rng.uniform(0.0, 0.3) * slide + np.cross(rng.uniform(-0.2, 0.2, 3), xi[i, :3])
    return xi


def check(result, xi: np.ndarray) -> LieEDNN:
    """Everything that a success promises, computed anew from the raw parts."""
    assert result.success, result.message
    assert result.message == "certified"
    network = result.unwrap()
    assert verify(network.lyapunov_diagonal, network.rotational_weight, gamma=network.gamma, mu=network.mu).valid
    residual = np.abs(network.vector_field(xi)).max()
    assert residual < RESIDUAL_TOLERANCE * network.gamma
    assert result.residual == residual
    assert result.largest_translation == np.linalg.norm(network.translation, axis=-1).max() < 20.0
    return network


def check_failure(result, words: str) -> None:
    assert not result.success
    assert result.network is None
    assert result.certificate is None
    assert result.residual == np.inf
    assert words in result.message
    with pytest.raises(NotCertifiedError, match=words):
        result.unwrap()


@pytest.mark.parametrize("seed", range(40))
def test_random_targets_with_the_bias_of_the_paper(seed):
    xi = random_target(seed)
    network = check(synthesize(xi, seed=seed), xi)
    assert (network.bias == 0.125).all()


@pytest.mark.parametrize("rule", BIAS_RULES)
@pytest.mark.parametrize("n", [3, 8, 12])
def test_other_numbers_of_neurons(n, rule):
    xi = random_target(100 + n, n)
    assert check(synthesize(xi, bias=rule), xi).n_neurons == n


def test_two_neurons_are_certified_or_refused_never_in_between():
    outcomes = []
    for seed in range(8):
        xi = random_target(seed, 2)
        result = synthesize(xi, seed=seed, max_attempts=5)
        outcomes.append(result.success)
        if result.success:
            check(result, xi)
        else:
            check_failure(result, "not certified")
    assert sum(outcomes) >= 5


@pytest.mark.parametrize("index", [12, 33])
def test_hard_targets_of_two_neurons_are_found_among_moderate_weights(index):
    """Without a bound the patient search runs off to weights in the thousands, with translations as large."""
    xi = np.random.default_rng(0).uniform(-0.8, 0.8, (200, 2, 6))[index]
    check(synthesize(xi, seed=index, max_attempts=6), xi)


@pytest.mark.parametrize("rule", BIAS_RULES)
@pytest.mark.parametrize("rates", [(2.0, 0.5), (0.1, 3.0), (1.0, 10.0)])
@pytest.mark.parametrize("activation", ["tanh", "arctan"])
def test_other_rates_and_activations(rates, activation, rule):
    xi = random_target(7)
    network = check(synthesize(xi, bias=rule, gamma=rates[0], mu=rates[1], activation=activation), xi)
    assert (network.gamma, network.mu, network.activation) == (*rates, activation)


@pytest.mark.parametrize("seed", range(5))
def test_every_far_start_ends_at_the_target(seed):
    xi = random_target(seed)
    network = synthesize(xi, seed=seed).unwrap()
    start = np.random.default_rng(seed).uniform(-50.0, 50.0, (4, 6))
    ended = network.trajectory(start, 2000.0, until=xi, distance=1e-7).xi[-1]
    np.testing.assert_allclose(ended, xi, atol=1.1e-7)
    found = network.equilibrium(start)
    assert found.success
    assert found.spectral_abscissa < 0.0
    np.testing.assert_allclose(found.xi, xi, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "angles",
    [
        (0.7, -0.4, 1.1, -0.2),
        (-0.7, -0.4, -1.1, -0.2),
        (0.5, 0.0, -0.5, 0.0),
        (1e-9, -1e-12, 1e-15, 0.0),
        (0.0, 0.0, 0.0, 0.0),
        (2.9, -2.5, 2.0, -3.1),
        (1e-3, -2e-3, 0.049, 0.0),
        (0.051, 0.0, 0.0, -0.01),
    ],
    ids=["mixed", "negative", "some zero", "rounding", "pure extension", "wide", "small", "just carrying"],
)
def test_sign_matched_bias_serves_arms(angles, seed):
    xi = arm_target(seed, np.array(angles))
    check(synthesize(xi, bias="sign-matched", seed=seed), xi)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    shrunk=st.lists(st.floats(-12.0, 0.0), min_size=4, max_size=4),
    magnitude=st.sampled_from([0.125, 0.25, 0.5]),
)
def test_sign_matched_bias_serves_angles_of_every_size_at_once(seed, shrunk, magnitude):
    angles = np.random.default_rng(seed).uniform(-2.9, 2.9, 4) * 10.0 ** np.array(shrunk)
    xi = arm_target(seed, angles)
    # Four starts take tens of milliseconds; the patient search after them takes seconds.
    check(synthesize(xi, bias="sign-matched", bias_magnitude=magnitude, seed=seed, max_attempts=4), xi)


@pytest.mark.parametrize("magnitude", [0.125, 0.25, 0.5])
@pytest.mark.parametrize("angle", [0.0, 2e-6, 1e-4, 1e-3, 1e-2, 0.1])
def test_a_tiny_angle_does_not_stand_in_for_those_that_carry_the_certificate(angle, magnitude):
    xi = np.zeros((4, 6))
    xi[:, [2, 3]] = np.array([[2.1, 0.3], [angle, 0.2], [-1.5, 0.1], [1.5, 0.2]])
    result = synthesize(xi, bias="sign-matched", bias_magnitude=magnitude, max_attempts=4)
    network = check(result, xi)
    assert np.abs(network.bias[1, 2] - angle) < 1e-15
    # The sign of the target at one strength, which is raised far enough for 1.5 - b < tanh(1.5).
    strength = network.bias.max()
    assert strength == network.bias[0, 2] == network.bias[3, 2] == -network.bias[2, 2]
    assert 1.5 - np.tanh(1.5) < strength < 2.1 - 0.85 * np.tanh(2.1)


@pytest.mark.parametrize("turn", [0.0, 0.06, 0.3])
@pytest.mark.parametrize("length", [0.0, 0.2, 0.9, 2.0])
def test_sign_matched_bias_serves_sliding_joints_of_which_none_or_one_turns(turn, length):
    """The rows of joints that do not turn force alpha_i0 R_i0 u_0 = 0, so no t carries their translations."""
    xi = np.zeros((4, 6))
    xi[:, 3], xi[0, 2] = length, turn
    check(synthesize(xi, bias="sign-matched"), xi)


def test_target_at_rest_is_certified_with_the_solved_bias():
    check(synthesize(np.zeros((4, 6)), bias="solved"), np.zeros((4, 6)))


def test_solved_rule_serves_what_the_uniform_one_cannot():
    xi = -np.abs(random_target(0)) - 1.0
    check_failure(synthesize(xi), "no diagonal Lyapunov matrix can exist")
    network = check(synthesize(xi, bias="solved"), xi)
    assert network.certificate.margin > 0.4
    np.testing.assert_allclose(network.retarget(xi).bias, network.bias, atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_a_bias_of_ones_own_is_kept(seed):
    xi = random_target(seed)
    bias = np.random.default_rng(seed).uniform(0.05, 0.3, (4, 6)) * np.sign(xi)
    network = check(synthesize(xi, bias=bias, seed=seed), xi)
    assert np.array_equal(network.bias, bias)


def test_impossible_targets_say_why_at_once():
    extension = np.zeros((4, 6))
    extension[:, 3] = 0.2
    result = synthesize(extension)
    check_failure(result, "every rotational coordinate of the target is zero")
    assert "use the sign-matched bias" in result.message
    assert result.attempts == 0
    result = synthesize(-np.abs(random_target(1)) - 0.1)
    check_failure(result, "no rotational coordinate has a bias large enough on the side of its target")
    assert result.attempts == 0


def test_impossible_extension_says_why_at_once():
    """Without rotation W_R has to meet the translational equations as well, under the same inequality."""
    xi, bias = np.zeros((4, 6)), np.zeros((4, 6))
    xi[:, 3], bias[:, 3] = 0.5, -0.1
    result = synthesize(xi, bias=bias)
    check_failure(result, "no diagonal Lyapunov matrix can exist")
    assert result.attempts == 0


def test_giving_up_says_how_often_it_tried(monkeypatch):
    monkeypatch.setattr(certified, "_LARGEST_TRANSLATION", 1e-3)
    result = synthesize(random_target(2), max_attempts=3)
    check_failure(result, "no feasible weights found from 3 starts")
    assert result.attempts == 3


@pytest.mark.parametrize("rule", BIAS_RULES)
def test_same_seed_gives_the_same_bits_and_another_seed_others(rule):
    xi = random_target(3)
    one, same, other, drawn = (
        synthesize(xi, bias=rule, seed=seed).unwrap() for seed in (5, 5, 6, np.random.default_rng(5))
    )
    for field in dataclasses.fields(LieEDNN):
        assert np.array_equal(getattr(one, field.name), getattr(same, field.name))
        assert np.array_equal(getattr(one, field.name), getattr(drawn, field.name))
    assert not np.array_equal(one.alpha, other.alpha)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"xi": np.zeros((4, 5))}, r"xi must have shape \(N, 6\), got \(4, 5\)"),
        ({"xi": np.zeros((0, 6))}, "N >= 1"),
        ({"xi": np.full((4, 6), np.nan)}, "xi must be finite, got 24 NaN"),
        ({"bias": "random"}, "no bias rule 'random'; allowed: sign-matched, solved, uniform"),
        ({"bias": np.zeros((3, 6))}, r"bias must have shape \(4, 6\), got \(3, 6\)"),
        ({"bias_magnitude": 0.0}, "bias_magnitude must be positive"),
        ({"mu": np.nan}, "mu must be finite"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_input_is_named(arguments, words):
    with pytest.raises(InputError, match=words):
        synthesize(**({"xi": random_target(0)} | arguments))
