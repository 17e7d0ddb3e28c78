"""The spread of a family: Gaussian conditioning by a second way, doubt far from the demonstrations, and samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, ShapedMotion, align
from lieednn_sim.learning.demonstrations.alignment import displacement
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.synthesis.shaping.cascade import PAIRS, codes_of, switches

OPTIONS = ShapingOptions(neurons=(16,))


@pytest.fixture(scope="module")
def noisy():
    """Six bends in a plane, each with a bend of its own that its start does not tell."""
    rng, s = np.random.default_rng(4), np.linspace(0.0, 1.0, 120)
    made = []
    for _ in range(6):
        start, height, shift = rng.normal([0.5, 0.0], 0.02), rng.normal(0.2, 0.02), rng.normal(0.0, 0.02)
        x = start[0] * (1.0 - s) + shift * np.sin(np.pi * s)
        y = start[1] * (1.0 - s) + height * np.sin(np.pi * s)
        made.append(Demonstration.from_samples(np.column_stack([x, y]), 2.0 * s))
    return align(made)


@pytest.fixture(scope="module")
def learned(noisy):
    return ShapedMotion.fit(noisy, options=OPTIONS)


def change(motion, other):
    """The codes D delta ``(M, 6)`` by which another motion's differ."""
    return codes_of(motion.network, other.network.hidden_start - motion.network.hidden_start)[0]


def bump_row(tau):
    """Bumps at a network time: the pairs' input 2 g tanh'(a + c g), filtered by 1 / (1 + d/dt)."""
    return np.array(
        [
            quad(lambda t, a=a, c=c: np.exp(t - tau) * 2.0 * np.exp(-t) / np.cosh(a + c * np.exp(-t)) ** 2, 0.0, tau)[0]
            for a, c in zip(*switches(PAIRS), strict=True)
        ]
    )


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_a_via_point_is_conditioned_on(noisy, learned, noise):
    index = 90
    fraction, tau = index / 199, learned.tau[index]
    middle = learned._run(displacement(noisy.mean[:1]), np.array([0.0, tau]))[0, 1, 3:]
    via = np.add(middle, [0.02, -0.01, 0.0])
    motion = learned.condition(via, fraction=fraction, noise=noise)
    # The least squares of |z|^2 + |miss|^2 / noise^2 with the codes S z, S S^T being their covariance.
    root = np.sqrt(1.0 + 1.0 / 6.0) * learned.spread.root
    seen = np.kron(bump_row(tau), np.eye(6))[3:5] @ root
    weight = 1.0 / max(noise, 1e-6)
    rows = np.concatenate([np.eye(root.shape[1]), weight * seen])
    z = np.linalg.lstsq(rows, np.append(np.zeros(root.shape[1]), weight * np.array([0.02, -0.01])))[0]
    wanted = (root @ z).reshape(PAIRS, 6)
    np.testing.assert_allclose(change(learned, motion), wanted, atol=0.01 * np.abs(wanted).max())
    # The covariance that is left, by the inverse of the information.
    left = np.linalg.inv(rows.T @ rows)
    there = np.kron(bump_row(learned.tau[60]), np.eye(6)) @ root
    scale = (1.0 + 1.0 / 6.0) / learned.spread.scale(displacement(noisy.mean[0]) - learned.network.start_reference[0])
    found = motion.covariance(noisy.mean[0], np.array([0.0, learned.t[60]]))[1] * scale
    np.testing.assert_allclose(found, there @ left @ there.T, atol=3e-3 * found.max())
    # From the mean start as near as the noise demands, and from others, too; all arrive, by the same proof.
    t = np.array([0.0, learned.t[index], 3.0 * noisy.duration])
    ways = displacement(motion.reproduce(np.concatenate([noisy.mean[:1], noisy.twists[:, 0]]), t))[..., 3:]
    miss = np.linalg.norm(ways[:, 1] - via, axis=1)
    if noise:
        assert noise / 10.0 < miss[0] < noise
    else:
        assert miss[0] < 1e-5
        assert miss.max() < 1e-3
        assert np.abs(np.diff(learned.reproduce(noisy.twists[:2, 0], t)[:, 1], axis=0)).max() > 5e-3
        # A second via point leaves the first.
        both = motion.condition([0.1, 0.15, 0.0], fraction=0.7)
        assert np.linalg.norm(displacement(both.reproduce(noisy.mean[0], t))[1, 3:] - via) < 1e-4
    np.testing.assert_allclose(ways[:, 2], 0.0, atol=1e-5)
    assert motion.network.certificate == learned.network.certificate
    np.testing.assert_array_equal(motion.network.bias, learned.network.bias)


def test_a_pose_is_conditioned_on(posed):
    learned = ShapedMotion.fit(posed, options=OPTIONS)
    via = learned.reproduce(posed.mean[0], np.array([0.0, 1.0]))[1] + [0.02, -0.02, 0.01, 0.004, 0.004, -0.004]
    motion = learned.condition(via, fraction=np.interp(1.0, learned.t, np.linspace(0.0, 1.0, len(learned.t))))
    np.testing.assert_allclose(motion.reproduce(posed.mean[0], np.array([0.0, 1.0]))[1], via, atol=1e-5)


def test_doubt_grows_with_the_distance_from_the_demonstrations(noisy, learned):
    t = np.append(0.0, noisy.t[[50, 100, 150]])
    start = noisy.mean[0] + np.outer([0.0, 1.0, 3.0, 10.0], [0.0, 0.0, 0.0, 0.02, 0.02, 0.0])
    covariance = learned.covariance(start, t)
    np.testing.assert_array_equal(covariance[:, 0], 0.0)
    size = np.sqrt(covariance[:, 2, 4, 4])
    assert 1.1 * size[1] < size[2] < 0.6 * size[3]
    # Near them, what the response leaves of the demonstrations, and the doubt about their mean.
    left = np.sqrt(np.mean(learned.response.residuals[:, [50, 100, 150], 3:5] ** 2, axis=0) * (1.0 + 1.0 / 6.0))
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance[0], axis1=1, axis2=2)[1:, 3:5]), left, rtol=0.1)
    # 1 + 1/n + u^T (X^T X + ridge)^-1 u with starts X.
    away = (noisy.displaced[:, 0] - noisy.displaced[:, 0].mean(axis=0)) * noisy.scale
    ridge = min(learned.response.ridges[0], 10.0) * np.sum(away**2)
    u = (displacement(start[3]) - learned.network.start_reference[0]) * noisy.scale
    ratio = 1.0 + 1.0 / 6.0 + u @ np.linalg.solve(away.T @ away + ridge * np.eye(6), u)
    np.testing.assert_allclose(covariance[3], ratio * learned.spread.along(learned._network_times(t)), rtol=1e-9)


def test_samples_are_motions_drawn_from_the_distribution(noisy, learned):
    start = noisy.mean[0] + [0.0, 0.0, 0.0, 0.03, 0.0, 0.0]
    drawn = learned.sample(start, 600, seed=5)
    for count in (8, 9, 61):  # of which the sums in a product of matrices would depend
        assert drawn[7] == learned.sample(start, count, seed=5)[7]
    assert drawn[7] != drawn[8]
    t = np.append(0.0, noisy.t[[40, 100, 160]])
    basis = np.stack([bump_row(tau) for tau in np.interp(t[1:], learned.t, learned.tau)])
    moved = np.stack([basis @ change(learned, one) for one in drawn])[..., 3:5].reshape(600, -1)
    wanted = learned.covariance(start, t)[1:, 3:5, 3:5]
    for k in range(3):
        found = np.cov(moved[:, 2 * k : 2 * k + 2].T)
        np.testing.assert_allclose(found, wanted[k], atol=0.2 * np.diag(wanted[k]).max())
    # The network goes where its code says, to the same goal under the same proof.
    plain, one = (model.reproduce(start, t)[1:, 3:5] for model in (learned, drawn[0]))
    np.testing.assert_allclose(one - plain, moved[0].reshape(3, 2), atol=2e-4)
    assert np.abs(one - plain).max() > 5e-3
    assert drawn[0].network.certificate == learned.network.certificate


def test_what_cannot_be_conditioned_says_why(noisy, learned):
    alone = ShapedMotion.fit(replace(noisy, twists=noisy.twists[:1]), options=OPTIONS)
    fading = ShapedMotion.fit(noisy, options=OPTIONS, family=False)
    for motion in (alone, fading, learned.sample(noisy.mean[0], 1)[0]):
        with pytest.raises(InputError, match="has no spread: learn a family from two or more demonstrations"):
            motion.condition([0.1, 0.1, 0.0], fraction=0.5)
    for via, more, message in (
        ([0.1, 0.1, 0.0], {"fraction": 1.0}, "fraction must be between 0 and 1, got 1"),
        ([0.1, 0.1, 0.0], {"fraction": 0.5, "noise": -1.0}, "noise must not be negative, got -1"),
        ([0.1, 0.1, 0.3], {"fraction": 0.5}, "third entry of 0, got 0.3"),
        (np.zeros(6), {"fraction": 0.5}, r"via must have shape \(3,\), got \(6,\)"),
        ([1e6, 0.0, 0.0], {"fraction": 0.5}, "no code leads to the via point: the motion ends up 1e"),
    ):
        with pytest.raises(InputError, match=message):
            learned.condition(via, **more)
