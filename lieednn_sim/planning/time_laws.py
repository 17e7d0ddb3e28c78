"""Time laws: how fast a motion follows its path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.ndimage import convolve1d, maximum_filter1d

from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats

# Fraction of a path's length and its slope, both ``(K,)``, at fractions ``(K,)`` of the duration.
Law = Callable[[Floats], tuple[Floats, Floats]]

# Acceleration across a path above which a turn is sharp, in units of the path's length over the squared duration. Along
# the path minimum jerk needs at most 5.8; five of six certified motions of the package's arms stay below.
_SHARP_TURN = 10.0
# Half width of the maximum and of the average by which a motion slows down around a sharp turn, as a fraction of the
# duration: it begins to slow down twice as long before.
_EASING_WIDTH = 0.1


def minimum_jerk_law(s: Floats) -> tuple[Floats, Floats]:
    """The minimum-jerk law on [0, 1] and its slope, at s (Flash and Hogan, J. Neuroscience 5(7), 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2


def step_lengths(xi: Floats, units: Floats) -> Floats:
    """Lengths ``(K - 1,)`` of the steps of states ``(K, N, 6)`` in ``units`` ``(N, 6)`` [m]."""
    return np.asarray(np.linalg.norm(np.diff(xi, axis=0) * units, axis=(-2, -1)))


def law_of(motion: Motion, units: Floats) -> Law:
    """The law by which a motion follows its path, whose length is that of its states in ``units`` ``(N, 6)``."""
    length = np.append(0.0, np.cumsum(step_lengths(motion.xi, units)))
    s, fraction = motion.t / motion.t[-1], length / length[-1]
    slope = np.gradient(fraction, s, edge_order=2)
    return _through(s, fraction, np.maximum(slope, 0.0))


def law_of_times(t: Floats, fraction: Floats) -> Law:
    """The monotonic law from rest to rest with the given fractions ``(K,)`` of the length at times ``(K,)``."""
    s = t / t[-1]
    return _through(s, fraction, PchipInterpolator(s, fraction).derivative()(s))


def eased_law(motion: Motion, law: Law, units: Floats) -> Law | None:
    """A law that slows down where a motion by another law turns sharply; None if it does so nowhere.

    With a law that ignores the curvature kappa, the acceleration across the path, v^2 kappa, is unbounded. Here time is
    stretched around every instant at which it exceeds a bound, by the square root of their ratio. The path's length has
    ``units`` ``(n,)`` of the joints.
    """
    count, duration = len(motion.t), motion.t[-1]
    velocity = motion.qd / units
    acceleration = np.gradient(velocity, motion.timestep, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    length = float(np.trapezoid(speed, motion.t))
    if length <= 0.0:
        return None
    tangent = velocity / np.maximum(speed, 1e-300)[:, None]
    along = np.einsum("kj,kj->k", acceleration, tangent)
    # At rest there is no direction to be across.
    across = np.where(speed > 0.0, np.linalg.norm(acceleration - along[:, None] * tangent, axis=1), 0.0)
    sharpness = across * duration**2 / (_SHARP_TURN * length)
    if sharpness.max() <= 1.0:
        return None
    # A Hann window; scipy.signal has it, but takes as long to import as everything else in a planning process.
    window = 1.0 + np.cos(np.linspace(-np.pi, np.pi, 2 * max(1, round(_EASING_WIDTH * count)) + 1))
    slower = maximum_filter1d(np.sqrt(np.maximum(sharpness, 1.0)), len(window), mode="nearest")
    slower = convolve1d(slower, window / window.sum(), mode="nearest")
    s = motion.t / duration
    return law_of_times(cumulative_trapezoid(slower, s, initial=0.0), law(s)[0])


def _through(s: Floats, fraction: Floats, slope: Floats) -> Law:
    law = CubicHermiteSpline(s, fraction, np.where((s > 0.0) & (s < 1.0), slope, 0.0))
    rate = law.derivative()
    return lambda x: (np.clip(law(x), 0.0, 1.0), np.maximum(rate(x), 0.0))
