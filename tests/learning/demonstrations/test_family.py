"""Families of motions: the regression by hand, the network that realises it, and what its starts cannot touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.alignment import displacement
from lieednn_sim.learning.demonstrations.family import RIDGES, one_standard_error, response_to_start
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.network import LieEDNN
from lieednn_sim.studies.demonstrations import models as paths
from lieednn_sim.studies.demonstrations.models import attraction, compare_models, random_starts
from lieednn_sim.synthesis import ShapingOptions, shape

OPTIONS = ShapingOptions(neurons=(16,))


@pytest.fixture(scope="module")
def learned(posed):
    return ShapedMotion.fit(posed, options=OPTIONS)


def motions_in_one(seed=0):
    """Three motions with bends of their own from starts of their own, two demonstrations each, to one goal."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, 150)[:, None]
    law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    starts = np.array([[0.3, 0.1], [0.3, -0.1], [0.4, 0.05]])
    bends = np.array([[0.02, 0.12], [0.05, -0.1], [-0.06, 0.1]])
    made = []
    for start, bend in zip(starts, bends, strict=True):
        for _ in range(2):
            begin, by = start + rng.normal(scale=3e-3, size=2), bend + rng.normal(scale=3e-3, size=2)
            wave = np.sin(2.0 * np.pi * law) * np.roll(by, 1) * 0.5
            made.append(
                Demonstration.from_samples((1.0 - law) * begin + np.sin(np.pi * law) * by + wave, 2.0 * s[:, 0])
            )
    return align(made)


@pytest.mark.parametrize("goals", [False, True])
def test_left_out_errors_and_the_ridge_are_those_of_regressions_without_a_demonstration(goals):
    rng = np.random.default_rng(3)
    shown = np.cumsum(rng.normal(size=(5, 8, 3)), axis=1)
    found = response_to_start(shown, goals)
    share = np.linspace(0.0, 1.0, 8)[:, None]
    inputs = shown[:, [0, -1]].reshape(5, 6)[:, : 6 if goals else 3]

    def straight(u):
        """What is expected without any regression: the start's part that fades, and the goal's that grows."""
        return (1.0 - share) * u[..., None, :3] + (share * u[..., None, 3:] if goals else 0.0)

    def fitted(some, given, penalty):
        mean, u = some.mean(axis=0), given - given.mean(axis=0)
        rest = (some - mean - straight(u)).reshape(len(some), -1)
        gain = np.linalg.solve(u.T @ u + penalty * np.eye(len(u.T)), u.T @ rest)
        return mean, gain.reshape(len(gain), 8, 3)

    away = inputs - inputs.mean(axis=0)
    # The same penalty for all of them; an infinite one is a very large one.
    penalties = np.minimum(RIDGES, 1e12) * np.sum(away**2)
    wanted = np.empty((len(RIDGES), 5))
    for k in range(5):
        for row, penalty in enumerate(penalties):
            others = np.delete(inputs, k, axis=0)
            mean, gain = fitted(np.delete(shown, k, axis=0), others, penalty)
            u = inputs[k] - others.mean(axis=0)
            guess = mean + straight(u) + np.einsum("i,ikj->kj", u, gain)
            wanted[row, k] = np.linalg.norm(guess - shown[k], axis=1).mean()
    first, last = one_standard_error(wanted)
    assert found.ridges == (RIDGES[first], RIDGES[last])
    gains = [fitted(shown, inputs, penalty)[1] for penalty in penalties[first : last + 1]]
    foreseen = straight(away) + np.einsum("ni,ikj->nkj", away, np.mean(gains, axis=0))
    np.testing.assert_allclose(np.einsum("kij,nj->nki", found.gain, away), foreseen, atol=1e-9)
    # What is left, by the slope of each prediction in what it predicts.
    hats = [
        away @ np.linalg.solve(away.T @ away + p * np.eye(len(away.T)), away.T) for p in penalties[first : last + 1]
    ]
    free = 1.0 - 0.2 - np.diag(np.mean(hats, axis=0))
    left = shown - shown.mean(axis=0) - foreseen
    np.testing.assert_allclose(found.residuals, left / np.sqrt(free)[:, None, None], atol=1e-8)
    normal = away.T @ away + min(penalties[first], 10.0 * np.sum(away**2)) * np.eye(len(away.T))
    np.testing.assert_allclose(found.growth @ normal, np.eye(len(normal)), atol=1e-8)


def test_one_standard_error_by_hand():
    # Differences from the least: 0.4 and 0 with a standard error of 0.2, which is their mean; then 1 and 1 with none.
    assert one_standard_error(np.array([[1.5, 1.5], [1.0, 1.0], [1.4, 1.0], [2.0, 2.0]])) == (1, 2)


def test_starts_that_say_nothing_have_no_response(planar):
    for one in (replace(planar, twists=planar.twists[:1]), planar.without(0)):
        assert response_to_start(one.displaced).ridges == (np.inf, np.inf)
    alone = ShapedMotion.fit(replace(planar, twists=planar.twists[:1]), options=OPTIONS)
    assert alone.network is alone.shaping.network


def test_the_network_realises_the_response(posed, learned):
    mean, away = displacement(posed.mean), displacement(posed.twists[:, 0]) - displacement(posed.mean)[0]
    regressed = mean + np.einsum("kij,nj->nki", learned.response.gain, away * posed.scale) / posed.scale
    found = learned._run(displacement(posed.twists[:, 0]), np.linspace(0.0, 16.0, 3000)) * posed.scale
    for path, wanted in zip(found, regressed * posed.scale, strict=True):
        off = np.linalg.norm(path[None] - wanted[:, None], axis=2).min(axis=1)
        # As near as the mean itself, which the network was shaped to follow.
        assert np.sqrt(np.mean(off**2)) < learned.shaping.deviation + 1e-3
    # Far more than that from one path with a start that fades.
    fading = ShapedMotion.fit(posed, options=OPTIONS, family=False)
    t = np.linspace(0.0, posed.duration, 200)
    ways = [model.reproduce(posed.twists[:, 0], t)[..., 3:] for model in (learned, fading)]
    assert np.abs(ways[0] - ways[1]).max() > 0.01


def test_the_mean_motion_is_that_of_the_network_without_pairs(posed, learned):
    fading = ShapedMotion.fit(posed, options=OPTIONS, family=False)
    t = np.linspace(0.0, posed.duration, 50)
    ways = [model.reproduce(posed.mean[0], t) for model in (learned, fading)]
    np.testing.assert_allclose(*ways, atol=1e-12)
    np.testing.assert_array_equal(learned.tau, fading.tau)
    # Without a family it is what shaping alone makes, to the last bit.
    curve = displacement(posed.mean)[:, None]
    asked = 2e-3 * posed.extent
    assert fading.network == shape(curve, asked, units=posed.scale, options=OPTIONS).network
    assert fading.network.start_gain is None


def test_starts_touch_neither_the_certificate_nor_the_goal(posed, learned, tmp_path):
    learned.network.save(tmp_path / "network.npz")
    network = LieEDNN.load(tmp_path / "network.npz")
    assert network == learned.network
    assert "started by the visible ones" in repr(network)
    plain = network.with_start(network.hidden_start)
    assert network.certificate == plain.certificate
    assert network.certified
    np.testing.assert_array_equal(network.equilibrium().xi, plain.equilibrium().xi)
    found = attraction(learned, posed, random_starts(posed, 40, seed=1))
    assert (found.arrived, found.spurious) == (40, 0)


def test_several_motions_in_one_set(monkeypatch):
    monkeypatch.setattr(paths, "SAMPLES", 50)
    shown = motions_in_one()
    family = ShapedMotion.fit(shown, options=OPTIONS)
    fading = ShapedMotion.fit(shown, options=OPTIONS, family=False)
    (ours,), _ = compare_models(shown, family, rivals=[], starts=1)
    (today, mixture), _ = compare_models(shown, fading, rivals=["lpv-ds"], starts=1, leave_one_out=False)
    # What it has not seen it knows better than they know what they have.
    for error in (ours.training.dtwd_mm, ours.left_out.dtwd_mm):
        assert error < 0.2 * today.training.dtwd_mm
        assert error <= mixture.training.dtwd_mm
