"""What a network says about itself: verdict, invariant box, smoothness; the maths is tested in tests/stability."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim import stability
from lieednn_sim.errors import NotCertifiedError
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import synthesize
from lieednn_sim.theory import GroupLieEDNN, group, smoothness_bounds


def certified(seed: int) -> tuple[LieEDNN, np.ndarray]:
    target = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, 6))
    return synthesize(target, gamma=2.0, mu=0.5, seed=seed).unwrap(), target


def test_verdict_uses_the_network_s_own_proof_and_equilibrium():
    network, target = certified(0)
    verdict = network.assess()
    assert verdict.globally_stable
    np.testing.assert_array_equal(verdict.certificate.lyapunov_diagonal, network.certificate.lyapunov_diagonal)
    assert verdict["local"].rate == pytest.approx(-network.equilibrium(target).spectral_abscissa)
    assert verdict.best_rate <= verdict["local"].rate
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


def test_no_trajectory_leaves_the_invariant_box_and_the_smoothness_bounds_hold_on_it():
    network, target = certified(2)
    starts = np.random.default_rng(0).uniform(-0.5, 0.5, (6, 4, 6))
    lower, upper = network.invariant_box(starts)
    assert lower.shape == upper.shape == (4, 6)
    assert (lower <= np.minimum(starts.min(axis=0), target)).all()
    assert (upper >= np.maximum(starts.max(axis=0), target)).all()
    bounds = smoothness_bounds(
        network.weight, network.bias.ravel(), max(-lower.min(), upper.max()), gamma=network.gamma, mu=network.mu
    )
    for start in starts:
        trajectory = network.trajectory(start, 20.0)
        states = trajectory(np.linspace(0.0, 20.0, 400))
        assert (states >= lower).all()
        assert (states <= upper).all()
        velocity = network.vector_field(states)
        acceleration = np.einsum("kab,kb->ka", network.jacobian(states), velocity.reshape(400, -1))
        assert np.abs(velocity).max() <= bounds.velocity
        assert np.abs(acceleration).max() <= bounds.acceleration
    alone = network.invariant_box(np.zeros((4, 6)))
    assert (alone[0] >= lower - 1e-9).all()
