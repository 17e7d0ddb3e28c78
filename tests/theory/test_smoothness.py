"""Bounds on velocity, acceleration and curvature against exact derivatives; the theorem itself is in tests/paper."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.theory import curvature, smoothness_bounds

WEIGHT = np.array([[0.2, -0.3], [0.1, 0.0]])


def test_bounds_by_hand():
    bounds = smoothness_bounds(WEIGHT, [0.1, -0.4], 2.0, gamma=2.0, mu=3.0, output_bound=0.5, lipschitz=0.8)
    # ||W||_inf = 0.5, |b|_inf = 0.4: 2*2 + 3*0.5*0.5 + 3*0.4, times 2 + 3*0.8*0.5.
    assert bounds.velocity == pytest.approx(5.95)
    assert bounds.acceleration == pytest.approx(5.95 * 3.2)
    assert bounds.closing == pytest.approx(2.0 * 1.8 * (2.0 * 2.0 + 2.0 * 0.5 + 1.2))
    assert bounds.acceleration < bounds.closing
    # The closing bound needs ||W||_inf < gamma/mu, strictly.
    assert smoothness_bounds(4.0 * WEIGHT, [0.1, -0.4], 2.0, gamma=2.0, mu=1.0).closing is None
    assert smoothness_bounds(4.0 * WEIGHT, [0.1, -0.4], 2.0, gamma=2.01, mu=1.0).closing is not None


def test_bounds_are_attained_where_every_term_adds_up():
    """One neuron deep in saturation, at +R, driven back by weight and bias: |xi'| comes as near as tanh(R) to 1."""
    gamma, mu, w, b, r = 1.0, 1.0, -0.9, -0.4, 20.0
    bounds = smoothness_bounds([[w]], [b], r, gamma=gamma, mu=mu)
    assert abs(-gamma * r + mu * (w * np.tanh(r) + b)) == pytest.approx(bounds.velocity, rel=1e-12)


def test_curvature_is_that_of_the_plotted_curve():
    # A circle of radius 2 as a graph: curvature 1/2 everywhere, though slope and second derivative vary.
    t = np.linspace(-1.9, 1.9, 21)
    first, second = -t / np.sqrt(4.0 - t**2), -4.0 / (4.0 - t**2) ** 1.5
    np.testing.assert_allclose(curvature(first, second), 0.5, rtol=1e-12)
    assert curvature([[0.0], [1e200]], [[3.0], [1.0]]).tolist() == [[3.0], [0.0]]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: smoothness_bounds(WEIGHT, [0.1], 1.0, gamma=1.0, mu=1.0), r"bias must have shape \(2,\)"),
        (lambda: smoothness_bounds(WEIGHT, [0.1, 0.1], -1.0, gamma=1.0, mu=1.0), "radius must not be negative, got -1"),
        (
            lambda: smoothness_bounds([[1e100]], [0.1], 1e100, gamma=1e50, mu=1e99),
            "beyond the range of double precision",
        ),
        (lambda: smoothness_bounds(WEIGHT, [0.1, 0.1], 1.0, gamma=1.0, mu=1.0, lipschitz=0.0), "lipschitz must be"),
        (lambda: curvature(np.ones(2), np.ones(3)), r"xi_ddot must have shape \(2,\), got \(3,\)"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()
