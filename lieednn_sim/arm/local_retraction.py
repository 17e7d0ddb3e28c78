"""Retraction in real time, for states that arrive one after another: Newton's method from the last configuration.

`Retractor` takes milliseconds to find the configuration nearest to any poses; here it is known to be near the last one.
All links are computed at once: the given poses and those of all joints are exponentials of one stack of twists. With T
= M_1 ... M_F over a link's joints with twists Z_f, the derivatives of T are M_1 ... Z_f M_f ... M_F.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import idamax
from scipy.linalg.lapack import dposv

from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.kinematics import Factor
from lieednn_sim.lie.se3 import hat, skew
from lieednn_sim.values import Floats

# Step of the central difference for rates [s]: neither rounding nor the third derivative affects ten digits.
_AHEAD = 1e-4
# Unit of length, in the network's unit, in which squared entries of a pose have the weights of the metric.
_UNIT = np.sqrt(0.5)
# Rows: the matrices hat(e_k) of the network's twists in that unit, flattened.
_HAT = hat(np.diag(np.repeat([1.0, 1.0 / _UNIT], 3))).reshape(6, 16)
_ONE = np.eye(4).ravel()
_MINUS_HALF_TRACE = -0.5 * _ONE[:, None]


class LocalRetraction:
    """Minimises ||R_i(q) - R_i||^2 / 2 + ||p_i(q) - p_i||^2 / length^2, summed over links i, near the last q.

    Attributes:
        q: ``(n,)`` the last configuration [rad, m], at first the one given; may be set.
    """

    def __init__(self, arm: Arm, q: Floats) -> None:
        joints = [_merged(joint.factors) for joint in arm.joints.joints]
        n_factors, links, n = max(map(len, joints)), len(joints), len(q)
        # The largest number of coordinates of each factor in any link, and where they begin and end.
        widths = [max(len(factors[f].indices) for factors in joints if f < len(factors)) for f in range(n_factors)]
        ends = np.cumsum([0, *widths])
        self._arm, self._reference = arm, arm.joints.reference
        # For all joints, the maps from displacements to twists, and the matrices Z of their coordinates.
        twists, turns = np.zeros((n_factors, links, 6, n)), np.zeros((links, 1 + ends[-1], 16))
        turns[:, 0] = _ONE
        chosen = np.zeros((links, n, ends[-1]))
        balls = []
        for i, factors in enumerate(joints):
            for f, factor in enumerate(factors):
                columns = ends[f] + np.arange(len(factor.indices))
                each = np.concatenate(factor.twists(np.zeros(n)), axis=1) / arm.twist_units
                twists[f, i][:, factor.indices] = each.T
                if factor.kind == "ball":
                    # Matrices about the body's axes at the reference, and weights that combine them into coordinates.
                    about = np.concatenate([np.eye(3), skew(factor.anchor).T], axis=1) / arm.twist_units @ _HAT
                    balls.append((f * links + i, i * len(turns[i]) + 1 + columns, about))
                    turns[i, 1 + columns], weights = about, factor.ratio * factor.axes.T
                else:
                    turns[i, 1 + columns], weights = each @ _HAT, np.eye(len(columns))
                # Selects and combines the coordinates of q.
                chosen[i][np.ix_(factor.indices, columns)] = weights
        self._twists = twists.reshape(-1, n)
        self._balls = [np.array(part) for part in zip(*balls, strict=True)]
        self._turns, self._chosen = turns.reshape(-1, 16), chosen
        self._stack = np.empty((3 + n_factors, links, 6))
        self._joints = self._stack[3:].reshape(-1)
        # For each link, stacked: M_1 ... M_f; the same with Z_k M_k in place of M_k for each earlier coordinate k; and
        # M_1 ... M_f Z_k for the coordinates of the next factor. One product with M_f+1 advances all of them.
        turns = turns.reshape(links, -1, 4, 4)
        before = turns[:, : 1 + ends[1]].reshape(links, -1, 4)
        self._chain = []
        for begin, end in pairwise([*ends[1:], ends[-1]]):
            after = np.zeros((links, 4 * (1 + end), 4))
            turned = after[:, 4 * (1 + begin) :].reshape(links, -1, 4, 4)
            self._chain.append((before, after[:, : 4 * (1 + begin)], turns[:, 1 + begin : 1 + end], turned))
            before = after
        self._configuration, self._slopes = before[:, :4], before[:, 4:].reshape(links, -1, 16)
        # The Jacobian's columns, below them the residuals of the given poses, and behind them what keeps undetermined
        # coordinates in place, relative to one radian and one unit of length.
        self._rows = np.zeros((n + 3, 16 * links + n))
        self._rows[:n, 16 * links :] = 1e-6 * np.eye(n)
        self._columns = self._rows[:n, : 16 * links].reshape(n, links, 16).transpose(1, 0, 2)
        self._errors = self._rows[n:, : 16 * links].reshape(3, links, 4, 4)
        # Weights that sum squared entries to the squared gaps of rotation and translation.
        rotation, translation = np.zeros((2, 4, 4))
        rotation[:3, :3], translation[:3, 3] = 0.5, (_UNIT * arm.length_scale) ** 2
        self._parts = np.stack([rotation, translation], axis=-1).reshape(16, 2)
        self._step, self.q = np.zeros(n), q

    def __reduce__(self) -> tuple[type[LocalRetraction], tuple[Arm, Floats]]:
        # Copied entry by entry, the views would become arrays of their own.
        return LocalRetraction, (self._arm, self.q)

    @property
    def gap(self) -> Floats:
        """``(N, 2)`` distance of the last configuration from the given poses, in rotation [rad] and translation [m]."""
        left = self._errors[0].reshape(-1, 16) - self._step @ self._columns
        return np.sqrt((left * left).dot(self._parts))

    def __call__(self, xi: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Joint coordinates and their rates along ``rate``, both ``(n,)``, for a network state ``(N, 6)``; unchecked.

        If the nearest configuration is far from the last one, eight steps of Newton's method may not reach it.
        """
        stack, rows, n = self._stack, self._rows, len(self.q)
        ahead = _AHEAD * rate
        stack[0], stack[1], stack[2] = xi, xi + ahead, xi - ahead
        for _ in range(8):
            self._twists.dot(self.q - self._reference, out=self._joints)
            poses, lefts = _exp(stack)
            np.subtract(poses[:3], self._linearised(poses[3:], lefts[3:]), out=self._errors)
            products = rows.dot(rows.T)
            _, steps, _ = dposv(products[:n, :n], products[:n, n:])
            step, ahead, behind = steps.T
            self.q = self.q + step
            # The square of the last step is about the remaining error.
            if abs(step[idamax(step)]) < 1e-3:
                break
        self._step = step
        return self.q, (ahead - behind) / (2.0 * _AHEAD)

    def _linearised(self, moved: Floats, lefts: Floats) -> Floats:
        """Poses of the links ``(N, 4, 4)`` from those of their joints ``(F, N, 4, 4)``; also sets the Jacobian."""
        if self._balls:
            factors, columns, about = self._balls
            jacobians = lefts.reshape(-1, 4, 4).take(factors, axis=0)[:, :3, :3]
            self._turns[columns] = jacobians.transpose(0, 2, 1) @ about
        for (before, after, turns, turned), pose in zip(self._chain, moved, strict=True):
            np.matmul(before, pose, out=after)
            np.matmul(after[:, None, :4], turns, out=turned)
        np.matmul(self._chosen, self._slopes, out=self._columns)
        return self._configuration


def _merged(factors: Sequence[Factor]) -> list[Factor]:
    """Factors with consecutive slides merged; they commute, so one exponential is enough."""
    merged: list[Factor] = []
    for factor in factors:
        last = merged[-1] if merged else None
        if last is not None and last.kind == factor.kind == "slide" and not set(last.indices) & set(factor.indices):
            axes = np.concatenate([last.ratio * last.axes, factor.ratio * factor.axes], axis=1)
            merged[-1] = Factor("slide", axes, last.anchor, np.concatenate([last.indices, factor.indices]))
        else:
            merged.append(factor)
    return merged


def _exp(twists: Floats) -> tuple[Floats, Floats]:
    """Poses I + X L ``(..., 4, 4)``, X = hat(xi), of twists ``(..., 6)``; L = I + (1 - cos)/a^2 X + (a - sin)/a^3 X^2.

    The first three rows and columns of L are the left Jacobian of SO(3).
    """
    flat = twists.reshape(-1, 6).dot(_HAT)
    matrix = flat.reshape(-1, 4, 4)
    double = (matrix @ matrix).reshape(-1, 16)
    # |omega|^2 = -tr(hat(xi)^2) / 2
    square = np.maximum(double.dot(_MINUS_HALF_TRACE), 1e-16)
    angle = np.sqrt(square)
    sine = np.sin(0.5 * angle)
    left = (2.0 * sine * sine / square) * flat
    left += ((1.0 - np.sin(angle) / angle) / square) * double
    left += _ONE
    poses = (matrix @ left.reshape(-1, 4, 4)).reshape(-1, 16)
    poses += _ONE
    shape = (*twists.shape[:-1], 4, 4)
    return poses.reshape(shape), left.reshape(shape)
