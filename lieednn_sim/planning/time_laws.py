"""Time laws: how fast a motion follows its path. `retiming` finds the fastest law within the arm's limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # whose ndimage is loaded when it is used
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BSpline, CubicHermiteSpline, PchipInterpolator, make_interp_spline

from lieednn_sim.planning.motion import Motion, travelled
from lieednn_sim.values import Floats

# Maps fractions ``(K,)`` of the duration to fractions of a path's length and their slopes, both ``(K,)``.
Law = Callable[[Floats], tuple[Floats, Floats]]

# Acceleration across a path above which a turn is sharp, in units of the path's length over the squared duration. Along
# the path minimum jerk needs at most 5.8; five of six certified motions of the package's arms stay below.
_SHARP_TURN = 10.0
# Half width of the maximum filter and of the average by which a motion slows down around a sharp turn, as a fraction of
# the duration; it begins to slow down two half widths before the turn.
_EASING_WIDTH = 0.1
# Half width of the average over recorded times, as a fraction of their duration.
_RECORDED_WIDTH = 0.05


def minimum_jerk_law(s: Floats) -> tuple[Floats, Floats]:
    """The minimum-jerk law on [0, 1] and its slope, at s (Flash and Hogan, J. Neuroscience 5(7), 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2


def law_of(motion: Motion, units: Floats) -> Law:
    """The law by which a motion follows its path; lengths are those of its states in ``units`` ``(N, 6)``."""
    known = motion.ends(250)
    length = travelled(motion.xi[known] * units)
    return _clipped(make_interp_spline(motion.t[known] / motion.t[-1], length / length[-1], min(5, len(known) - 1)))


def law_of_times(t: Floats, fraction: Floats) -> Law:
    """The monotonic law from rest to rest through given fractions ``(K,)`` of the length at times ``(K,)``."""
    s = t / t[-1]
    slope = PchipInterpolator(s, fraction).derivative()(s)
    return _clipped(CubicHermiteSpline(s, fraction, np.where((s > 0.0) & (s < 1.0), slope, 0.0)))


def recorded_law(t: Floats, fraction: Floats) -> Law:
    """`law_of_times` of a recording, which is noisy and may begin or end in motion, and is averaged over time."""
    width = _RECORDED_WIDTH * (t[-1] - t[0])
    begin, end = np.interp([t[0] + width, t[-1] - width], t, fraction)
    sudden = np.array([begin, 1.0 - end]) > 0.5 * _RECORDED_WIDTH
    # The arm rests before and after the recording; where it begins or ends suddenly, time is added there.
    width *= 1.0 + sudden.any()
    early, late = width * sudden
    s = np.linspace(t[0] - early, t[-1] + late, 401)
    half = round(width / (s[1] - s[0]))
    window = 1.0 + np.cos(np.linspace(-np.pi, np.pi, 2 * half + 3)[1:-1])
    smooth = scipy.ndimage.convolve1d(np.interp(s, t, fraction), window / window.sum(), mode="nearest")
    smooth = (smooth - smooth[0]) / (smooth[-1] - smooth[0])
    # At the other ends the average still moves a little: the law goes to and from rest there in one piece.
    first, last = np.where(sudden, 1, half)
    kept = np.concatenate([[0], np.arange(first, len(s) - last), [len(s) - 1]])
    return law_of_times((s - s[0])[kept], smooth[kept])


def eased_law(motion: Motion, units: Floats) -> Law | None:
    """A law that slows down where a motion by `minimum_jerk_law` turns sharply; None without sharp turns.

    If a law ignores the curvature kappa, the acceleration across the path, v^2 kappa, is unbounded. This law stretches
    time around every instant at which it exceeds a bound, by the square root of their ratio. The path's length is
    measured with joints in ``units`` ``(n,)``.
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
    # At rest the path has no direction.
    across = np.where(speed > 0.0, np.linalg.norm(acceleration - along[:, None] * tangent, axis=1), 0.0)
    sharpness = across * duration**2 / (_SHARP_TURN * length)
    if sharpness.max() <= 1.0:
        return None
    # A Hann window; scipy.signal has it, but takes as long to import as everything else in a planning process.
    window = 1.0 + np.cos(np.linspace(-np.pi, np.pi, 2 * max(1, round(_EASING_WIDTH * count)) + 1))
    slower = scipy.ndimage.maximum_filter1d(np.sqrt(np.maximum(sharpness, 1.0)), len(window), mode="nearest")
    slower = scipy.ndimage.convolve1d(slower, window / window.sum(), mode="nearest")
    s = motion.t / duration
    return law_of_times(cumulative_trapezoid(slower, s, initial=0.0), minimum_jerk_law(s)[0])


def _clipped(law: CubicHermiteSpline | BSpline) -> Law:
    rate = law.derivative()
    return lambda x: (np.clip(law(x), 0.0, 1.0), np.maximum(rate(x), 0.0))
