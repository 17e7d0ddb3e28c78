"""Pairs of opposite switches: silent together, and a bump when both are shifted."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.network import ACTIVATIONS
from lieednn_sim.synthesis import ShapingOptions, shape
from lieednn_sim.synthesis.shaping.cascade import PAIRS, clockwork, with_pairs


@pytest.fixture(scope="module", params=ACTIVATIONS)
def bent(request):
    """Two visible neurons on a curve, made to repeat in one what the other's start does."""
    s = np.linspace(0.0, 1.0, 60)[:, None, None]
    curve = (1.0 - s) * np.arange(1.0, 13.0).reshape(2, 6) / 12.0 + 0.2 * np.sin(np.pi * s)
    options = ShapingOptions(neurons=(2,), activation=request.param)
    shaping = shape(curve, 1.0, options=options)
    clock = clockwork(1.0, ACTIVATIONS[request.param])
    bump = np.exp(-clock.t)[:, None, None] * np.eye(12)
    w = 1.0 - clock.g
    bump[:, 3, 10] += 0.5 * np.sin(np.pi * w) ** 2
    near = 0.02 * np.eye(12)[10:11]
    return shaping, clock, curve[0], with_pairs(shaping.parameters, clock, shaping.network, curve[0], bump, near)


def test_pairs_are_silent_from_the_reference(bent):
    shaping, _, start, network = bent
    assert network.certified
    assert network.n_hidden == 2 + 2 * 2 * PAIRS
    for t in (0.0, 0.4, 1.7, 5.0):
        state = network.start(start)
        first = network.n_visible
        hidden = network.bias[first:] + (state[first:] - network.bias[first:]) * np.exp(-t)
        state[first:] = hidden
        plain = state[: first + 2]
        there = network.vector_field(state)[:first]
        np.testing.assert_allclose(there, shaping.network.vector_field(plain)[:first], atol=1e-13)


def test_a_shifted_start_is_the_response_that_was_asked_for(bent):
    _, clock, start, network = bent
    off = 0.02 * np.eye(12)[10].reshape(2, 6)
    ways = [network.trajectory(network.start(x), 12.0, rtol=1e-10, atol=1e-12) for x in (start, start + off)]
    instants = clock.t[clock.t < 12.0]
    moved = (network.visible(ways[1](instants)) - network.visible(ways[0](instants))).reshape(-1, 12)
    wanted = np.zeros((len(instants), 12))
    wanted[:, 10] = 0.02 * np.exp(-instants)
    wanted[:, 3] = 0.02 * 0.5 * np.sin(np.pi * (1.0 - np.exp(-instants))) ** 2
    # A hundredth of the bump of 10 mm.
    np.testing.assert_allclose(moved, wanted, atol=1e-4)


def test_codes_that_say_nothing_add_nothing(bent):
    shaping, clock, start, _ = bent
    fading = np.exp(-clock.t)[:, None, None] * np.eye(12)
    assert with_pairs(shaping.parameters, clock, shaping.network, start, fading, np.ones((1, 12))) is shaping.network
