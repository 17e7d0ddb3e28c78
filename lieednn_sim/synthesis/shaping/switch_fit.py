"""A cascade by linear least squares: its switches are placed along the curve first, and only readouts are unknown.

Each hidden neuron is a turn or a shift: one coordinate of its rotational or of its translational half switches, and the
other half rests. Then a visible neuron's input is a sum of vectors alpha R e_x, one for each switch, and theta need not
translate. The problem is linear, without start and local minima.

Overlapping soft switches leave ripples far below the requested deviation, which a motion feels as jerk. So the third
derivative of the error is penalised too.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters, turns_to
from lieednn_sim.synthesis.shaping.curve import Curve, clock_along, third_derivative
from lieednn_sim.values import Floats

# Pieces over which curvature is computed, and the fraction of the length over which it is smoothed.
_PIECES, _SMOOTHING = 512, 0.01
# Bound on slopes: the steepest switch spans a sixtieth of the path, twice the resolution of `cascade`.
LARGEST_SLOPE = 60.0
# The density of switches is the root of the curve's second derivative plus this much everywhere.
_LEAST_DENSITY = 0.1
# Ripples shorter than 2 pi times this fraction of the clock count more than deviations.
_RIPPLE = 0.03
# Number of instants at which ripples are penalised, nearly even down to where g is this small.
_INSTANTS, _LEAST_CLOCK = 120, 0.01
# Weight of the squared readouts.
_RIDGE = 1e-9


def fit_switches(cascade: Cascade, curve: Curve, n_switches: int) -> Parameters:
    """Parameters of the cascade with ``n_switches`` switches placed along the curve whose path is nearest to it."""
    n, m, clock = curve.points.shape[1], n_switches, cascade.clock
    pace = _pace(curve)
    fractions = pace(1.0 - clock.g)
    goal, _ = curve.at(fractions)
    # The last row is the tail, which should vanish.
    missing = np.concatenate([goal - cascade.free[:-1], np.zeros((1, n, 6))])
    w = 1.0 - clock.g
    # Nearly even, so that no difference is dominated by close instants.
    looks = np.unique(np.abs(w[:, None] - np.linspace(0.0, 1.0 - _LEAST_CLOCK, _INSTANTS)).argmin(axis=0))
    ripples = third_derivative(w[looks])
    a, c, read = np.zeros((m, 6)), np.zeros((m, 6)), np.zeros((n, m, 3))
    for half, chosen in _halves(curve, m):
        place, slope = _switches(curve, pace, half, len(chosen))
        lead = half.start
        c[chosen, lead], a[chosen, lead] = slope, -slope * (1.0 - place)
        outputs = cascade.switched(a[chosen, lead], c[chosen, lead])
        target = missing[..., half].reshape(len(missing), -1)
        left, right = (np.concatenate([side, _RIPPLE**3 * (ripples @ side[looks])]) for side in (outputs, target))
        ridge = np.sqrt(_RIDGE) * np.eye(len(chosen))
        readouts = np.linalg.lstsq(
            np.concatenate([left, ridge]), np.concatenate([right, np.zeros((len(chosen), 3 * n))]), rcond=None
        )[0]
        read[:, chosen] = readouts.reshape(-1, n, 3).transpose(1, 0, 2)
    return Parameters(a, c, np.linalg.norm(read, axis=-1), turns_to(read))


def _halves(curve: Curve, count: int) -> list[tuple[slice, Floats]]:
    """Which neurons switch which half: equally many turns and shifts where the curve has both."""
    halves = [half for half in (slice(0, 3), slice(3, 6)) if np.ptp(curve.points[..., half], axis=0).max() > 0.0]
    return list(zip(halves, np.array_split(np.arange(count), len(halves)), strict=True))


def _pace(curve: Curve) -> CubicSpline:
    """Fraction of the curve's length as a function of the fraction of the clock: slower where the curve turns."""
    s = np.linspace(0.0, 1.0, _PIECES + 1)
    points = (curve.at(s)[0] * curve.units).reshape(len(s), -1)
    # A turn of the tangent by one radian takes as much of the clock as this fraction of the length: it makes room for
    # switches in a sharp corner, where a motion is slow anyway.
    clock_per_turn = 0.03
    return CubicSpline(clock_along(points, clock_per_turn, _SMOOTHING), s)


def _switches(curve: Curve, pace: CubicSpline, half: slice, count: int) -> tuple[Floats, Floats]:
    """Positions of the switches, as fractions ``(count,)`` of the clock, and their slopes."""
    w = np.linspace(0.0, 1.0, _PIECES // 4 + 1)
    points = (curve.at(pace(w))[0] * curve.units)[:, :, half].reshape(len(w), -1) / curve.length
    second = np.linalg.norm(np.diff(points, n=2, axis=0), axis=1) / w[1] ** 2
    density = np.sqrt(gaussian_filter1d(np.pad(second, 1, mode="edge"), 3.0, mode="nearest"))
    density += _LEAST_DENSITY * density.mean() + _LEAST_DENSITY
    mass = np.append(0.0, np.cumsum(0.5 * (density[1:] + density[:-1])))
    edges = np.interp(np.linspace(0.0, mass[-1], 2 * count + 1), mass, w)
    # Slope of a switch over the density of switches, and the least slope: without overlap the path would ripple.
    overlap, least_slope = 1.0, 1.0
    return edges[1::2], np.clip(overlap / (edges[2::2] - edges[:-2:2]), least_slope, LARGEST_SLOPE)
