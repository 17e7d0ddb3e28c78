"""Laws of time: how a path is run through."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats

# Share of a path's length and its slope, both ``(K,)``, at shares ``(K,)`` of the duration.
Law = Callable[[Floats], tuple[Floats, Floats]]


def minimum_jerk_law(s: Floats) -> tuple[Floats, Floats]:
    """Position and slope in s of the minimum-jerk law on [0, 1] (Flash and Hogan, J. Neuroscience 5(7), 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2


def step_lengths(xi: Floats, units: Floats) -> Floats:
    """Lengths ``(K - 1,)`` of the steps of states ``(K, N, 6)`` in ``units`` ``(N, 6)`` [m]."""
    return np.asarray(np.linalg.norm(np.diff(xi, axis=0) * units, axis=(-2, -1)))


def law_of(motion: Motion, units: Floats) -> Law:
    """The law by which a motion runs through its path, whose length is that of its states in ``units`` ``(N, 6)``."""
    length = np.append(0.0, np.cumsum(step_lengths(motion.xi, units)))
    s, share = motion.t / motion.t[-1], length / length[-1]
    slope = np.gradient(share, s, edge_order=2)
    return _through(s, share, np.maximum(slope, 0.0))


def law_of_times(t: Floats, share: Floats) -> Law:
    """The law, from rest to rest, that has the shares ``(K,)`` behind it at times ``(K,)``; it never goes back."""
    s = t / t[-1]
    return _through(s, share, PchipInterpolator(s, share).derivative()(s))


def _through(s: Floats, share: Floats, slope: Floats) -> Law:
    way = CubicHermiteSpline(s, share, np.where((s > 0.0) & (s < 1.0), slope, 0.0))
    rate = way.derivative()
    return lambda x: (np.clip(way(x), 0.0, 1.0), np.maximum(rate(x), 0.0))
