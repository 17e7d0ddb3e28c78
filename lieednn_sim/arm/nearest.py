"""Least squares on SE(3): the coordinates of a chain whose poses are nearest to given ones, for whole trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from lieednn_sim.arm.bridging import VAGUE, bridge
from lieednn_sim.arm.kinematics import CompoundJoint, distinctness
from lieednn_sim.budget import check_time
from lieednn_sim.lie import hat
from lieednn_sim.values import Floats

# Levenberg-Marquardt to get near, Newton to get exact: with a gap left, Gauss-Newton steps converge linearly only.
_DAMPED_STEPS, _NEWTON_STEPS = 40, 6
# Steps [rad, m] below which Newton takes over.
_NEAR = 1e-3
_DAMPING, _DAMPING_FALL, _DAMPING_RISE = 1e-3, 0.2, 5.0
# Step of the central differences of the gradient [rad, m], and share of the largest curvature taken for zero.
_DIFFERENCE, _FLAT = 1e-5, 1e-9
# Where this much of f is left there may be a lower minimum: it is looked for from the best of so many postures.
_FAR, _POSTURES, _STARTS = 0.1, 256, 2
# Of minima that are equal up to rounding the first counts.
_TIE = 1e-9
# A way is followed in at least so many strides, and in shorter ones where a coordinate moves more than this [rad, m].
_STRIDES, _LONG = 64, 0.2
# On the way the last posture is near already.
_FOLLOWING_STEPS = 8
# Strides that are leapt at most where poses hardly tell the coordinates apart.
_LEAPS = 16


class NearestPose:
    """Minimises f(q) = sum_i ||R_i(q) - R_i||_F^2 / 2 + ||p_i(q) - p_i||^2 / length^2 over a group of compound joints.

    The first term is 4 sin^2(angle / 2), the chordal distance. The minimum is sought from the joints' own linearisation
    at the reference; where f is above 0.1 there, also from the best of 256 postures spread over all angles, each with
    its best slides, and the lowest is returned. That is a search, no proof: on universal joints, balls and telescopes
    disturbed by 0.1 rad and m no dense search found a nearer posture, disturbed by 0.8 in 3 of 3850 poses one (by
    at most 0.09 in the root of f; from the reference alone it would be 9 %, by at most 1.7).

    Args:
        joints: the group.
        indices: ``(c,)`` of its coordinates.
        size: n, the length of q.
        length: [m] that weighs as much as one radian.
    """

    def __init__(self, joints: Sequence[CompoundJoint], indices: NDArray[np.int_], size: int, length: float) -> None:
        self._joints, self._indices, self._size, self._length = tuple(joints), indices, size, length
        turning = [factor.indices for joint in joints for factor in joint.factors if factor.kind != "slide"]
        self._sliding = ~np.isin(indices, np.concatenate([*turning, []]))
        factors = [factor for joint in joints for factor in joint.factors]
        self._periodic = np.array(
            [all(f.kind == "hinge" and abs(f.ratio) == 1.0 for f in factors if i in f.indices) for i in indices]
        )

    def solve(self, rotation: Floats, translation: Floats) -> Floats:
        """Displacements ``(..., c)`` from the reference for poses ``(..., m, 3, 3)`` and ``(..., m, 3)``.

        Hinges are within half a turn.
        """
        shape = translation.shape[:-2]
        goal = self._stack(rotation, translation).reshape(-1, 12 * len(self._joints))
        q = self._descend(np.zeros((len(goal), len(self._indices))), goal)
        value = self._value(q, goal)
        far = np.flatnonzero(value > _FAR)
        for start in self._starts(goal[far]) if far.size else ():
            other = self._descend(start, goal[far])
            lower = self._value(other, goal[far])
            better = lower < value[far] * (1.0 - _TIE)
            q[far[better]], value[far[better]] = other[better], lower[better]
        wound = self._periodic & (np.abs(q) > np.pi)
        q = np.where(wound, q - 2.0 * np.pi * np.round(q / (2.0 * np.pi)), q)
        return q.reshape(*shape, len(self._indices))

    def follow(self, rotation: Floats, translation: Floats, near: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Displacements ``(K, ..., c)`` along ways of poses ``(K, ..., m, 3, 3)`` and ``(K, ..., m, 3)``.

        The minimum next to ``near`` ``(c,)``, then each time the one next to the last: where several postures have the
        same poses, as the two of a wrist, the branch is kept, and hinges are counted beyond half a turn. Where the
        poses hardly tell the coordinates apart they go straight on, see `bridging.bridge`; the second result says
        where, ``(K, ...)``.
        """
        goal = self._stack(rotation, translation).reshape(len(translation), -1, 12 * len(self._joints))
        q = np.empty((*goal.shape[:2], len(self._indices)))
        q[0] = self._approach(np.broadcast_to(near, q.shape[1:]), goal[0])
        known, longest = [0], max(1, len(goal) // _STRIDES)
        stride, vague = longest, False
        while known[-1] < len(goal) - 1:
            check_time()
            last = known[-1]
            stride = min(stride, len(goal) - 1 - last)
            trial = self._approach(q[last], goal[last + stride], _FOLLOWING_STEPS)
            vague, before = bool((distinctness(self._evaluate(trial)[1]) < VAGUE).any()), vague
            if vague and not before and (leap := self._leap(q, goal, known, longest)):
                known.append(leap)
                continue
            if stride > 1 and np.abs(trial - q[last]).max() > _LONG:
                stride //= 2
                continue
            q[last + stride] = trial
            known.append(last + stride)
            stride = min(2 * stride, longest)
        if len(known) < len(goal):
            q = PchipInterpolator(known, q[known])(np.arange(len(goal)))
        exact = self._descend(q.reshape(-1, q.shape[-1]), goal.reshape(-1, goal.shape[-1])).reshape(q.shape)
        bridged = np.zeros(q.shape[:-1], dtype=bool)
        for way in range(q.shape[1]):
            exact[:, way], bridged[:, way] = bridge(self._evaluate, exact[:, way], q[:, way], goal[:, way])
        return exact.reshape(*translation.shape[:-2], len(self._indices)), bridged.reshape(translation.shape[:-2])

    def _leap(self, q: Floats, goal: Floats, known: list[int], longest: int) -> int:
        """Go straight on from the last two postures to where poses tell coordinates apart; that sample, or zero."""
        last = known[-1]
        if len(known) < 2:
            return 0
        pace = (q[last] - q[known[-2]]) / (last - known[-2])
        for strides in range(1, _LEAPS + 1):
            there = min(last + strides * longest, len(goal) - 1)
            guess = q[last] + (there - last) * pace
            trial = self._approach(guess, goal[there], _FOLLOWING_STEPS)
            clear = distinctness(self._evaluate(trial)[1]) >= VAGUE
            if clear.all() and np.abs(trial - guess).max() < 2.0 * _LONG:
                q[there] = trial
                return there
        return 0

    def _descend(self, q: Floats, goal: Floats) -> Floats:
        """Minima ``(B, c)`` next to starts ``(B, c)`` for stacked poses ``(B, 12m)``."""
        q = self._approach(q, goal)
        for _ in range(_NEWTON_STEPS):
            step = self._newton_step(q, goal)
            q = q - step
            if np.abs(step).max() < 1e-13:
                break
        return q

    def _approach(self, q: Floats, goal: Floats, steps: int = _DAMPED_STEPS) -> Floats:
        """Postures near these minima, by damped steps down to `_NEAR`."""
        damping = np.full(len(goal), _DAMPING)
        values, jacobian = self._evaluate(q)
        residual = values - goal
        for _ in range(steps):
            square = np.swapaxes(jacobian, -1, -2) @ jacobian
            gradient = np.einsum("bri,br->bi", jacobian, residual)
            scale = np.trace(square, axis1=-2, axis2=-1) / square.shape[-1]
            weight = (damping * np.maximum(scale, 1e-12))[:, None, None]
            step = np.linalg.solve(square + weight * np.eye(square.shape[-1]), gradient[..., None])[..., 0]
            trial = q - step
            new_values, new_jacobian = self._evaluate(trial)
            new_residual = new_values - goal
            better = (new_residual**2).sum(axis=-1) <= (residual**2).sum(axis=-1)
            q, residual = np.where(better[:, None], trial, q), np.where(better[:, None], new_residual, residual)
            jacobian = np.where(better[:, None, None], new_jacobian, jacobian)
            damping = np.clip(np.where(better, _DAMPING_FALL, _DAMPING_RISE) * damping, 1e-12, 1e6)
            if np.abs(step).max() < _NEAR:
                break
        return q

    def _value(self, q: Floats, goal: Floats) -> Floats:
        return np.asarray(((self._evaluate(q)[0] - goal) ** 2).sum(axis=-1))

    def _starts(self, goal: Floats) -> Floats:
        """The best postures ``(S, B, c)`` of a set for stacked poses ``(B, 12m)``."""
        postures, values, slopes, inverse = self._spread
        # Given the angles f is quadratic in the slides: what their best leaves is what a projection does.
        slides = np.tensordot(goal, inverse, axes=(1, 2)) - (inverse @ values[..., None])[..., 0]
        taken = np.einsum("bps,pst,bpt->bp", slides, np.swapaxes(slopes, -1, -2) @ slopes, slides)
        left = (values**2).sum(axis=-1) - 2.0 * goal @ values.T - taken
        best = np.argsort(left, axis=1, kind="stable")[:, :_STARTS]
        starts = postures[best]
        starts[..., self._sliding] = np.take_along_axis(slides, best[..., None], axis=1)
        return np.moveaxis(starts, 1, 0)

    @cached_property
    def _spread(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Postures ``(P, c)`` without slides, stacked poses, their derivatives in the slides, and pseudo-inverses."""
        from scipy.stats import qmc  # a third of the time in which a command starts; few poses are far

        postures = np.pi * (2.0 * qmc.Halton(len(self._indices), scramble=False).random(_POSTURES) - 1.0)
        for factor in (factor for joint in self._joints for factor in joint.factors if factor.kind == "ball"):
            turns = Rotation.random(_POSTURES, rng=np.random.default_rng(0)).as_rotvec()
            postures[:, np.searchsorted(self._indices, factor.indices)] = turns @ factor.axes
        postures[:, self._sliding] = 0.0
        values, jacobian = self._evaluate(postures)
        slopes = jacobian[:, :, self._sliding]
        return postures, values, slopes, np.asarray(np.linalg.pinv(slopes), dtype=np.float64)

    def rates(self, q: Floats, rotation: Floats, translation: Floats, omega: Floats, velocity: Floats) -> Floats:
        """Derivative ``(..., c)`` of the minimiser along a motion of the poses, by the implicit function theorem."""
        shape = q.shape
        goal_rate = self._stack(hat(omega) @ rotation, velocity).reshape(-1, 12 * len(self._joints))
        goal = self._stack(rotation, translation).reshape(goal_rate.shape)
        flat = q.reshape(-1, shape[-1])
        jacobian = self._evaluate(flat)[1]
        pull = np.einsum("bri,br->bi", jacobian, goal_rate)
        return (self._inverse_hessian(flat, goal) @ pull[..., None])[..., 0].reshape(shape)

    def rates_along(self, q: Floats, rotation: Floats, translation: Floats, omega: Floats, velocity: Floats) -> Floats:
        """Derivative ``(K, ..., c)`` of coordinates along a way, by its samples, whatever they minimise."""
        rate = self._stack(hat(omega) @ rotation, velocity)
        moved = np.gradient(self._stack(rotation, translation), axis=0)
        size = np.maximum((rate**2).sum(axis=-1), 1e-300)
        samples = (moved * rate).sum(axis=-1) / size  # in a unit of the rate's time
        along = CubicSpline(np.arange(len(q)), q)(np.arange(len(q)), 1)
        return np.asarray(along / np.maximum(samples, 1e-300)[..., None])

    def _newton_step(self, q: Floats, goal: Floats) -> Floats:
        step = (self._inverse_hessian(q, goal) @ self._gradient(q, goal)[..., None])[..., 0]
        # Far from the minimum the quadratic model means nothing.
        return np.where(np.abs(step).max(axis=-1, keepdims=True) < 0.1, step, 0.0)

    def _inverse_hessian(self, q: Floats, goal: Floats) -> Floats:
        """Pseudo-inverse, so that directions that no pose depends on stay where they are."""
        directions = _DIFFERENCE * np.eye(q.shape[-1])
        # All neighbours at once: the calls cost more than the numbers in them.
        neighbours = np.concatenate([q + direction for direction in (*directions, *-directions)])
        forward, backward = np.split(self._gradient(neighbours, np.tile(goal, (2 * len(directions), 1))), 2)
        change = (forward - backward).reshape(len(directions), *q.shape) / (2.0 * _DIFFERENCE)
        hessian = np.moveaxis(change, 0, -1)
        symmetric = 0.5 * (hessian + np.swapaxes(hessian, -1, -2))
        return np.asarray(np.linalg.pinv(symmetric, rcond=_FLAT, hermitian=True), dtype=np.float64)

    def _gradient(self, q: Floats, goal: Floats) -> Floats:
        values, jacobian = self._evaluate(q)
        return np.einsum("bri,br->bi", jacobian, values - goal)

    def _evaluate(self, q: Floats) -> tuple[Floats, Floats]:
        """The stacked poses ``(B, 12m)`` and their Jacobian ``(B, 12m, c)``."""
        offset = np.zeros((len(q), self._size))
        offset[:, self._indices] = q
        rotations, translations, columns = [], [], []
        for joint in self._joints:
            rotation, translation, *twists = joint.pose_and_twists(offset)
            omega, v = (part[:, self._indices] for part in twists)
            spin = hat(omega)
            turning = spin @ rotation[:, None]
            moving = v + (spin @ translation[:, None, :, None])[..., 0]
            columns.append(self._join(turning, moving))
            rotations.append(rotation)
            translations.append(translation)
        values = self._stack(np.stack(rotations, axis=1), np.stack(translations, axis=1))
        jacobian = np.swapaxes(np.concatenate(columns, axis=-1), -1, -2)
        return values.reshape(len(q), -1), jacobian

    def _stack(self, rotation: Floats, translation: Floats) -> Floats:
        joined = self._join(rotation, translation)
        return joined.reshape(*joined.shape[:-2], -1)

    def _join(self, rotation: Floats, translation: Floats) -> Floats:
        flat = rotation.reshape(*rotation.shape[:-2], 9) * np.sqrt(0.5)
        return np.concatenate([flat, translation / self._length], axis=-1)
