"""What a network says about itself: verdict, certificate, activation; the maths is tested in tests/stability."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lieednn_sim import stability
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.learning import ALGORITHMS, train
from lieednn_sim.network import ACTIVATIONS, Activation, LieEDNN
from lieednn_sim.planning import CertifiedOptions, RetargetedOptions, ShapedOptions, TrainedOptions, plan
from lieednn_sim.synthesis import ShapingOptions, shape, synthesize
from lieednn_sim.theory import GroupLieEDNN, group


def certified(seed: int) -> tuple[LieEDNN, np.ndarray]:
    target = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, 6))
    return synthesize(target, gamma=2.0, mu=0.5, seed=seed).unwrap(), target


def test_verdict_uses_the_network_s_own_proof_and_equilibrium():
    network, target = certified(0)
    verdict = network.assess()
    assert verdict.globally_stable
    np.testing.assert_array_equal(verdict.certificate.lyapunov_diagonal, network.certificate.lyapunov_diagonal)
    assert verdict["local"].rate == pytest.approx(-network.equilibrium(target).spectral_abscissa)
    assert verdict.strongest.rate <= verdict["local"].rate
    report = str(verdict)
    assert report.startswith("globally stable by the")
    assert len(report.splitlines()) == 1 + len(stability.CONDITIONS)


def test_certify_looks_at_the_rotations_of_se3_and_at_everything_of_another_group():
    network, _ = certified(1)
    bare = LieEDNN(network.alpha, network.rotation, 1e3 * network.translation, network.bias, network.gamma, network.mu)
    assert bare.certificate is None
    assert bare.certify().certificate.lyapunov_diagonal.shape == (12,)
    rotations = GroupLieEDNN(group("SO(3)"), network.alpha, network.rotation, network.bias[:, :3], 2.0, 0.5)
    assert rotations.certify().certificate.lambda_max == pytest.approx(bare.certify().certificate.lambda_max)
    strong = LieEDNN(100.0 * network.alpha, network.rotation, network.translation, network.bias)
    with pytest.raises(NotCertifiedError, match="no certificate was found"):
        strong.certify()
    assert not strong.assess().globally_stable


@pytest.fixture
def root(monkeypatch):
    """An activation of one's own, x / sqrt(1 + x^2 / 4), whose bound is 2."""
    own = Activation(lambda x: x / np.hypot(1.0, 0.5 * x), lambda x: np.hypot(1.0, 0.5 * x) ** -3.0, bound=2.0)
    monkeypatch.setitem(ACTIVATIONS, "root", own)
    return "root"


@pytest.mark.parametrize("algorithm", ["tracked", "riemannian", "stability-aware"])
def test_an_activation_of_one_s_own_learns(root, algorithm):
    target = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 6))
    options = ALGORITHMS[algorithm].load()()
    found = train(target, options, activation=root, bias=0.125 if algorithm == "tracked" else 0.2)
    assert found.success, found.message
    assert found.network.activation == root
    np.testing.assert_allclose(found.network.equilibrium(target).xi, target, atol=2e-5)
    certified = synthesize(target, activation=root, bias="sign-matched").unwrap()
    assert np.abs(certified.vector_field(target)).max() < 1e-9


@pytest.mark.parametrize("rate", [1.0, 0.4])
def test_an_activation_of_one_s_own_is_shaped_to_follow_a_curve(root, rate):
    share = np.linspace(0.0, 1.0, 100)[:, None, None]
    curve = np.sin(np.linspace(0.5, 2.0, 12).reshape(1, 2, 6) * share)
    options = ShapingOptions(rate, neurons=(32,), activation=root)
    network = shape(curve, 2e-3, units=0.5, options=options).unwrap()
    assert network.certified
    assert network.activation == root
    # From elsewhere, too.
    for start in (curve[0], curve[0] + 0.3):
        way = network.trajectory(network.start(start), 40.0 / rate, until=network.goal(curve[-1]), distance=1e-6)
        np.testing.assert_allclose(network.visible(way(way.t[-1])), curve[-1], atol=2e-6)


@pytest.mark.parametrize(
    ("planner", "options"),
    [
        ("lieednn-certified", CertifiedOptions(n_networks=4, activation="arctan")),
        ("lieednn-retargeted", RetargetedOptions(activation="arctan")),
        ("lieednn-trained", TrainedOptions(activation="arctan")),
        ("lieednn-shaped", ShapedOptions(activation="arctan")),
    ],
)
def test_planners_make_networks_of_any_activation(planner, options):
    arm = Arm.load("telescopic_pr")
    made = plan(arm, arm.keyframe("extended"), planner=planner, options=options)
    assert made.network.activation == "arctan"
    assert made.network.certified
    np.testing.assert_allclose(made.motion.q[-1], arm.keyframe("extended"), atol=1e-6)
    with pytest.raises(InputError, match=r"no activation 'relu'; allowed: .*tanh"):
        dataclasses.replace(options, activation="relu")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((lambda x: 2.0 * np.tanh(x), lambda x: 2.0 / np.cosh(x) ** 2), r"slopes .* must be in \(0, 1\], got .* to 2"),
        ((np.tanh, lambda x: 1.0 / np.cosh(x)), "its slopes must be those of its values"),
        ((np.tanh, lambda x: 1.0 / np.cosh(x) ** 2, lambda y: 1.0 - y), "its slopes must be those of its values"),
        ((np.arcsinh, lambda x: (1.0 + x * x) ** -0.5), "must not exceed its bound of 1, got 21.4"),
        ((lambda x: np.tanh(x) + 0.1, lambda x: 1.0 / np.cosh(x) ** 2), "must be odd"),
    ],
)
def test_what_no_certificate_holds_for_is_no_activation(given, message):
    with pytest.raises(InputError, match=message):
        Activation(*given)
