"""A curve to follow, tabulated over its length, and foot points on it."""

from __future__ import annotations

import numpy as np
import scipy  # whose ndimage is loaded when it is used
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

_ROWS = 2048  # rows of a table: it resolves a curve of two metres to a millimetre along it, and to micrometres across
_REACH = 64  # longest Newton step to a foot point, in rows


@frozen
class Curve:
    """A curve, tabulated evenly over its length."""

    points: Floats  # (R, N, 6) in network coordinates, from start to target
    tangents: Floats  # (R, N, 6) derivatives in the fraction s of the length, from 0 to 1
    units: Floats  # (N, 6) metres that one unit of each coordinate counts for, the metric
    length: float  # length in this metric [m]

    @classmethod
    def through(cls, samples: Floats, units: Floats) -> Curve:
        """The curve through samples ``(K, N, 6)``, smooth between them and without overshoot.

        `InputError` if all samples are the same point.
        """
        steps = np.linalg.norm((np.diff(samples, axis=0) * units).reshape(len(samples) - 1, -1), axis=1)
        kept = np.append(True, steps > 1e-9 * max(float(steps.sum()), 1e-300))
        if kept.sum() < 2:
            raise InputError("the curve must move: all its samples are the same point")
        kept_samples = samples[kept]
        kept_samples[-1] = samples[-1]  # the last sample is the target, even where it repeats the one before it
        chord = np.append(0.0, np.cumsum(steps[kept[1:]]))
        dense = np.linspace(0.0, chord[-1], 4 * _ROWS)
        fine = PchipInterpolator(chord, kept_samples, axis=0)(dense)
        pieces = np.linalg.norm((np.diff(fine, axis=0) * units).reshape(len(dense) - 1, -1), axis=1)
        arc = np.append(0.0, np.cumsum(pieces))
        even = np.interp(np.linspace(0.0, arc[-1], _ROWS), arc, dense)
        points = PchipInterpolator(chord, kept_samples, axis=0)(even)
        points[0], points[-1] = samples[0], samples[-1]
        tangents = np.gradient(points, 1.0 / (_ROWS - 1), axis=0)
        return cls(points, tangents, units, float(arc[-1]))

    def at(self, s: Floats) -> tuple[Floats, Floats]:
        """Points and tangents ``(K, N, 6)`` at fractions ``(K,)`` of the length."""
        row = np.clip(s, 0.0, 1.0) * (len(self.points) - 1)
        low = np.minimum(row.astype(int), len(self.points) - 2)
        part = (row - low)[:, None, None]
        point, tangent = (table[low] + part * (table[low + 1] - table[low]) for table in (self.points, self.tangents))
        return point, tangent

    def feet(self, x: Floats, s: Floats) -> Floats:
        """Fractions ``(K,)`` of the length at the foot points of ``x`` ``(K, N, 6)`` near ``s``; nondecreasing."""
        for _ in range(3):  # Newton steps to a foot point from its previous estimate
            point, tangent = self.at(s)
            along = (tangent * self.units**2).reshape(len(x), -1)
            step = np.einsum("kp,kp->k", along, (x - point).reshape(len(x), -1)) / np.maximum(
                np.einsum("kp,kp->k", along, tangent.reshape(len(x), -1)), 1e-300
            )
            s = np.clip(s + np.clip(step, -_REACH / _ROWS, _REACH / _ROWS), 0.0, 1.0)
        s = np.maximum.accumulate(s)
        s[0], s[-1] = 0.0, 1.0
        return s


def as_units(units: ArrayLike, n: int) -> Floats:
    """Metres ``(N, 6)`` that one unit of each coordinate counts for, positive; or `InputError`."""
    given = as_floats("units", units, (), batched=True)
    try:
        scale = np.broadcast_to(given, (n, 6))
    except ValueError:
        raise InputError(f"units must broadcast to ({n}, 6), got shape {given.shape}") from None
    if not (scale > 0.0).all():
        raise InputError(f"units must be positive, the smallest is {scale.min():g}")
    return scale


def clock_along(points: Floats, per_turn: float, smoothing: float) -> Floats:
    """Fractions ``(P + 1,)`` of the clock at points ``(P + 1, D)`` that divide a curve evenly: slower where it turns.

    A turn of the tangent by one radian takes as much of the clock as the fraction ``per_turn`` of the length; turns are
    smoothed over the fraction ``smoothing``.
    """
    s, pieces = np.linspace(0.0, 1.0, len(points)), np.diff(points, axis=0)
    directions = pieces / np.maximum(np.linalg.norm(pieces, axis=1, keepdims=True), 1e-300)
    turning = np.interp(s[:-1], s[1:-1], np.linalg.norm(np.diff(directions, axis=0), axis=1))
    turning = scipy.ndimage.gaussian_filter1d(turning, smoothing * len(pieces), mode="nearest")
    passed = np.append(0.0, np.cumsum(1.0 / len(pieces) + per_turn * turning))
    return np.asarray(passed / passed[-1])


def third_derivative(w: Floats) -> Floats:
    """Matrix ``(K - 3, K)`` of third divided differences of values at ``w`` ``(K,)``, which approximate derivatives."""
    matrix = np.eye(len(w))
    for order in (1, 2, 3):
        matrix = order * np.diff(matrix, axis=0) / (w[order:] - w[:-order])[:, None]
    return matrix
