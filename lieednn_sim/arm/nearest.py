"""Least squares on SE(3): coordinates of a chain whose poses are nearest to given ones, also along trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim.arm.kinematics import CompoundJoint, least_singular_value
from lieednn_sim.arm.singularities import NEARLY_SINGULAR, pseudo_inverse, singularity_margin, straighten
from lieednn_sim.budget import check_time
from lieednn_sim.lie.se3 import skew
from lieednn_sim.values import Floats

_LONG = 0.2  # a stride along a path is shorter if a coordinate would move more than this in it [rad, m]
# Strides may be longer if the least singular value, which tells how well poses determine coordinates, exceeds this.
_CLEAR = 2.0 * NEARLY_SINGULAR


class NearestPose:
    """Minimises f(q) = sum_i ||R_i(q) - R_i||_F^2 / 2 + ||p_i(q) - p_i||^2 / length^2 over a group of compound joints.

    The first term is 4 sin^2(angle / 2), the squared chordal distance. The minimum is searched for from the reference
    configuration. If f exceeds 0.1 there, it is also searched for from the best of 256 configurations spread over all
    angles, each with its best slides, and the lowest minimum is returned. This is a search, not a proof: a dense one
    found nothing nearer for poses disturbed by 0.1 rad and m, and for 3 of 3850 disturbed by 0.8.

    The ``indices`` ``(c,)`` are those of the group's coordinates in q, of ``size`` n; a ``length`` [m] weighs as much
    as one radian; ``sliding`` ``(c,)`` tells which coordinates are those of slides.
    """

    def __init__(self, joints: Sequence[CompoundJoint], indices: NDArray[np.int_], size: int, length: float) -> None:
        self._joints, self._indices, self._size, self.length = tuple(joints), indices, size, length
        # Weights of the entries of [R, p].
        self._weights = np.tile([np.sqrt(0.5)] * 3 + [1.0 / length], 3)
        turning = [factor.indices for joint in joints for factor in joint.factors if factor.kind != "slide"]
        self.sliding = ~np.isin(indices, np.concatenate([*turning, []]))
        # For each joint: a selection matrix ``(c, r)`` of its r coordinates among the group's, or None if equal;
        # and for pairs ``(r, r)`` of them 1 if the first belongs to an earlier factor, 1/2 if both to the same one.
        self._places = [None if np.array_equal(j.coordinates, indices) else j.selection(indices) for j in joints]
        ranks = [np.repeat(np.arange(len(j.factors)), [len(f.indices) for f in j.factors]) for j in joints]
        self._orders = [np.heaviside(rank - rank[:, None], 0.5) for rank in ranks]
        winding = [f for joint in joints for f in joint.factors if f.kind != "hinge" or abs(f.ratio) != 1.0]
        self._periodic = np.array([not any(i in factor.indices for factor in winding) for i in indices])

    def solve(self, rotation: Floats, translation: Floats) -> Floats:
        """Displacements ``(..., c)`` from the reference for poses ``(..., m, 3, 3)`` and ``(..., m, 3)``.

        Hinges are within half a turn.
        """
        shape = translation.shape[:-2]
        goal = self._stack(rotation, translation).reshape(-1, 12 * len(self._joints))
        q = self._descend(np.zeros((len(goal), len(self._indices))), goal)
        value = self._value(q, goal)
        # If a minimum is this far off, there may be a lower one.
        far = np.flatnonzero(value > 0.1)
        for start in self._starts(goal[far]) if far.size else ():
            other = self._descend(start, goal[far])
            lower = self._value(other, goal[far])
            # If minima are equal up to rounding, the first one is taken.
            better = lower < value[far] * (1.0 - 1e-9)
            q[far[better]], value[far[better]] = other[better], lower[better]
        wound = self._periodic & (np.abs(q) > np.pi)
        q = np.where(wound, q - 2.0 * np.pi * np.round(q / (2.0 * np.pi)), q)
        return q.reshape(*shape, len(self._indices))

    def follow(self, rotation: Floats, translation: Floats, near: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Displacements ``(K, ..., c)`` along paths of poses ``(K, ..., m, 3, 3)`` and ``(K, ..., m, 3)``.

        The first is the minimum next to ``near`` ``(..., c)``, and each other one the minimum next to its predecessor;
        or, with guesses ``near`` ``(K, ..., c)`` along the path, each is the minimum next to its guess. So if several
        configurations have the same poses, as the two of a wrist, the branch is kept, and hinges may exceed half a
        turn. Where poses hardly determine the coordinates, these go straight on (`singularities.straighten`), which the
        second result ``(K, ...)`` marks.
        """
        goal = self._stack(rotation, translation).reshape(len(translation), -1, 12 * len(self._joints))
        if near.ndim == translation.ndim - 1:
            guess = near.reshape(*goal.shape[:2], -1)
        else:
            start = np.broadcast_to(near, (*translation.shape[1:-2], len(self._indices))).reshape(goal.shape[1], -1)
            guess = self._stride(start, goal)
        flat = guess.reshape(-1, guess.shape[-1])
        evaluated = self._evaluate(flat)
        q = self._descend(flat, goal.reshape(-1, goal.shape[-1]), evaluated).reshape(guess.shape)
        margin = singularity_margin(evaluated[1]).reshape(q.shape[:-1])
        straightened = np.zeros(q.shape[:-1], dtype=bool)
        for k in np.flatnonzero((margin[1:-1] < 1.0).any(axis=0)):
            q[:, k], straightened[:, k] = straighten(self._evaluate, q[:, k], guess[:, k], margin[:, k], goal[:, k])
        return q.reshape(*translation.shape[:-2], len(self._indices)), straightened.reshape(translation.shape[:-2])

    def _stride(self, start: Floats, goal: Floats) -> Floats:
        """Guesses ``(K, B, c)`` along paths of stacked poses ``(K, B, 12m)``: found stride by stride, interpolated."""
        q = np.empty((*goal.shape[:2], len(self._indices)))
        q[0], evaluated = self._approach(start, goal[0])
        # Few damped steps are enough, since the last configuration is close.
        known, longest, steps = [0], max(1, len(goal) // 64), 8
        stride, singular = longest, False
        while known[-1] < len(goal) - 1:
            check_time()
            last = known[-1]
            stride = min(stride, len(goal) - 1 - last)
            trial, there = self._approach(q[last], goal[last + stride], steps, evaluated, enough=0.02)
            clear = float(least_singular_value(there[1]).min())
            if stride > longest and clear < _CLEAR:
                stride = longest
                continue
            singular, before = clear < NEARLY_SINGULAR, singular
            if singular and not before and (leap := self._leap(q, goal, known, longest)):
                known.append(leap)
                evaluated = self._evaluate(q[leap])
                continue
            moved = float(np.abs(trial - q[last]).max())
            if stride > 1 and moved > _LONG:
                stride //= 2
                continue
            q[last + stride], evaluated = trial, there
            known.append(last + stride)
            stride = min(2 * stride if moved < 0.5 * _LONG else stride, longest * (8 if clear >= _CLEAR else 1))
        if len(known) == len(goal):
            return q
        return np.asarray(scipy.interpolate.PchipInterpolator(known, q[known])(np.arange(len(goal))))

    def _leap(self, q: Floats, goal: Floats, known: list[int], longest: int) -> int:
        """Extrapolate from the last two samples to where poses determine coordinates; returns that sample, or 0."""
        last = known[-1]
        if len(known) < 2:
            return 0
        pace = (q[last] - q[known[-2]]) / (last - known[-2])
        for strides in range(1, 17):
            there = min(last + strides * longest, len(goal) - 1)
            guess = q[last] + (there - last) * pace
            trial, (_, jacobian) = self._approach(guess, goal[there], 8)
            clear = least_singular_value(jacobian) >= NEARLY_SINGULAR
            if clear.all() and np.abs(trial - guess).max() < 2.0 * _LONG:
                q[there] = trial
                return there
        return 0

    def _descend(self, q: Floats, goal: Floats, known: tuple[Floats, Floats] | None = None) -> Floats:
        """Minima ``(B, c)`` next to starts ``(B, c)`` for stacked poses ``(B, 12m)``; ``known`` as in `_approach`."""
        q, _ = self._approach(q, goal, 0 if known and np.abs(known[0] - goal).max() < 1e-3 else 40, known)
        moving = np.arange(len(q))
        # If a gap remains, Gauss-Newton converges only linearly.
        for _ in range(6):
            gradient, inverse = self._quadratic(q[moving], goal[moving])
            step = (inverse @ gradient[..., None])[..., 0]
            # Long steps are not taken, since they leave the range of the quadratic model.
            step = np.where(np.abs(step).max(axis=-1, keepdims=True) < 0.1, step, 0.0)
            q[moving] -= step
            # After a step of this size, the next one, about its square, would hardly be more than rounding.
            moving = moving[np.abs(step).max(axis=-1) > 1e-6]
            if not moving.size:
                break
        return q

    def _approach(
        self,
        q: Floats,
        goal: Floats,
        steps: int = 40,
        known: tuple[Floats, Floats] | None = None,
        enough: float = 1e-3,  # near enough for Newton's method
    ) -> tuple[Floats, tuple[Floats, Floats]]:
        """Configurations close to these minima, by Levenberg-Marquardt steps, and the result of `_evaluate` there.

        ``known`` is its result at ``q``, if available. It ends after a step of at most ``enough``.
        """
        damping, one = np.full(len(goal), 1e-3), np.eye(q.shape[-1])
        values, jacobian = self._evaluate(q) if known is None else known
        for _ in range(steps):
            residual = values - goal
            transposed = np.swapaxes(jacobian, -1, -2)
            square = transposed @ jacobian
            scale = np.einsum("bii->b", square) / square.shape[-1]
            weight = (damping * np.maximum(scale, 1e-12))[:, None, None]
            step = np.linalg.solve(square + weight * one, transposed @ residual[..., None])[..., 0]
            trial = q - step
            new_values, new_jacobian = self._evaluate(trial)
            left = new_values - goal
            better = np.vecdot(left, left) <= np.vecdot(residual, residual)
            if better.all():
                q, values, jacobian = trial, new_values, new_jacobian
            else:
                q, values = np.where(better[:, None], trial, q), np.where(better[:, None], new_values, values)
                jacobian = np.where(better[:, None, None], new_jacobian, jacobian)
            damping = np.minimum(np.maximum(np.where(better, 0.2, 5.0) * damping, 1e-12), 1e6)
            if np.abs(step).max() < enough:
                break
        return q, (values, jacobian)

    def _value(self, q: Floats, goal: Floats) -> Floats:
        return np.asarray(((self._evaluate(q)[0] - goal) ** 2).sum(axis=-1))

    def _starts(self, goal: Floats) -> Floats:
        """The best configurations ``(S, B, c)`` of a spread for stacked poses ``(B, 12m)``."""
        configurations, values, slopes, inverse = self._spread
        # For given angles f is quadratic in the slides; its minimum is the residual of a projection.
        slides = np.tensordot(goal, inverse, axes=(1, 2)) - (inverse @ values[..., None])[..., 0]
        taken = np.einsum("bps,pst,bpt->bp", slides, np.swapaxes(slopes, -1, -2) @ slopes, slides)
        left = (values**2).sum(axis=-1) - 2.0 * goal @ values.T - taken
        best = np.argsort(left, axis=1, kind="stable")[:, :2]
        starts = configurations[best]
        starts[..., self.sliding] = np.take_along_axis(slides, best[..., None], axis=1)
        return np.moveaxis(starts, 1, 0)

    @cached_property
    def _spread(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Configurations ``(P, c)`` without slides, stacked poses, their derivatives by slides, and pseudo-inverses."""
        spread = scipy.stats.qmc.Halton(len(self._indices), scramble=False).random(256)
        configurations = np.pi * (2.0 * spread - 1.0)
        for factor in (factor for joint in self._joints for factor in joint.factors if factor.kind == "ball"):
            turns = scipy.spatial.transform.Rotation.random(len(spread), rng=np.random.default_rng(0)).as_rotvec()
            configurations[:, np.searchsorted(self._indices, factor.indices)] = turns @ factor.axes
        configurations[:, self.sliding] = 0.0
        values, jacobian = self._evaluate(configurations)
        slopes = jacobian[:, :, self.sliding]
        return configurations, values, slopes, np.asarray(np.linalg.pinv(slopes), dtype=np.float64)

    def rates(self, q: Floats, rotation: Floats, translation: Floats, omega: Floats, velocity: Floats) -> Floats:
        """Derivative ``(..., c)`` of the minimiser along a motion of the poses, by the implicit function theorem."""
        shape = q.shape
        goal_rate = self._stack(skew(omega) @ rotation, velocity).reshape(-1, 12 * len(self._joints))
        goal = self._stack(rotation, translation).reshape(goal_rate.shape)
        pull, inverse = self._quadratic(q.reshape(-1, shape[-1]), goal, goal_rate)
        return (inverse @ pull[..., None])[..., 0].reshape(shape)

    def rates_along(self, q: Floats, rotation: Floats, translation: Floats, omega: Floats, velocity: Floats) -> Floats:
        """Derivative ``(K, ..., c)`` of coordinates along a path, from its samples alone, whatever they minimise."""
        rate = self._stack(skew(omega) @ rotation, velocity)
        moved = np.gradient(self._stack(rotation, translation), axis=0)
        size = np.maximum((rate**2).sum(axis=-1), 1e-300)
        samples = (moved * rate).sum(axis=-1) / size  # in a unit of the rate's time
        along = scipy.interpolate.CubicSpline(np.arange(len(q)), q)(np.arange(len(q)), 1)
        return np.asarray(along / np.maximum(samples, 1e-300)[..., None])

    @property
    def counts(self) -> tuple[float, float]:
        """Numbers T and S of turning and of sliding joints that move a link, the largest among its links.

        T is infinite if a ball joint or a coupled hinge is among them. Stages coupled with ratios r count (sum r)^2.
        """
        result = np.zeros((len(self._joints), 2, self._size))
        for rates, joint in zip(result, self._joints, strict=True):
            for factor in joint.factors:
                rates[int(factor.kind == "slide"), factor.indices] += abs(factor.ratio)
        turning, sliding = np.square(result).sum(axis=-1).max(axis=0)
        plain = all(factor.kind != "ball" for joint in self._joints for factor in joint.factors)
        return float(turning) if plain and np.isin(result[:, 0], (0.0, 1.0)).all() else np.inf, float(sliding)

    def firmness(self, q: Floats, rotation: Floats, translation: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """How firmly poses ``(B, m, 3, 3)`` and ``(B, m, 3)`` hold the coordinates at q ``(B, c)``.

        That is the least singular value of the Jacobian, the distance f^(1/2), the length of the gradient of f / 2, and
        the longest lever arm of a hinge, each ``(B,)``; lengths, and coordinates of slides, in units of ``length``.
        """
        goal = self._stack(rotation, translation).reshape(len(q), -1)
        values, jacobian = self._evaluate(q)
        slopes, residual = jacobian * np.where(self.sliding, self.length, 1.0), values - goal
        transposed = np.swapaxes(slopes, -1, -2)
        least = np.linalg.eigvalsh(transposed @ slopes)[:, 0]
        levers = np.linalg.norm(slopes.reshape(len(q), -1, 12, slopes.shape[-1])[:, :, 3::4], axis=2)
        return (
            np.sqrt(np.maximum(least, 0.0)),
            np.asarray(np.linalg.norm(residual, axis=1)),
            np.asarray(np.linalg.norm((transposed @ residual[..., None])[..., 0], axis=1)),
            levers[..., ~self.sliding].max(axis=(1, 2), initial=0.0),
        )

    def _quadratic(self, q: Floats, goal: Floats, rate: Floats | None = None) -> tuple[Floats, Floats]:
        """The gradient ``(B, c)`` of f / 2, and the pseudo-inverse of its Hessian, so undetermined coordinates stay.

        With rates of stacked poses ``(B, 12m)``, their product with the Jacobian takes the gradient's place.

        With Y = R (R - R_goal)^T / 2 and e = p - p_goal, the second derivatives of the poses T_i contribute, for joints
        a before b, omega_a^T Y omega_b - (omega_a . omega_b) tr Y + (e x omega_a) . p_b / length^2. Within a ball joint
        their symmetric part is used, which is exact where the gradient vanishes.
        """
        gradient, hessian = np.zeros(q.shape), np.zeros((*q.shape, q.shape[-1]))
        offset = self._offset(q)
        for i, (joint, place, order) in enumerate(zip(self._joints, self._places, self._orders, strict=True)):
            value, rows, omega = self._moved(joint, offset)
            error = value - goal[:, 12 * i : 12 * (i + 1)]
            own = rows if place is None else place @ rows
            pulling = error if rate is None else rate[:, 12 * i : 12 * (i + 1)]
            gradient += (own @ pulling[..., None])[..., 0]
            frame, left = value.reshape(-1, 3, 4), error.reshape(-1, 3, 4)
            turn = frame[..., :3] @ np.swapaxes(left[..., :3], -1, -2)
            turn -= np.trace(turn, axis1=-2, axis2=-1)[:, None, None] * np.eye(3)
            across = turn @ np.swapaxes(omega, -1, -2) - skew(left[..., 3]) @ np.swapaxes(rows[..., 3::4], -1, -2)
            bend = order * (omega @ across)
            bend = bend + np.swapaxes(bend, -1, -2)
            hessian += own @ np.swapaxes(own, -1, -2) + (bend if place is None else place @ bend @ place.T)
        return gradient, pseudo_inverse(hessian)

    def _evaluate(self, q: Floats) -> tuple[Floats, Floats]:
        """The stacked poses ``(B, 12m)`` and their Jacobian ``(B, 12m, c)``."""
        offset = self._offset(q)
        values, columns = [], []
        for joint, place in zip(self._joints, self._places, strict=True):
            value, rows, _ = self._moved(joint, offset)
            values.append(value)
            columns.append(rows if place is None else place @ rows)
        return np.concatenate(values, axis=-1), np.swapaxes(np.concatenate(columns, axis=-1), -1, -2)

    def _moved(self, joint: CompoundJoint, offset: Floats) -> tuple[Floats, Floats, Floats]:
        """A joint's stacked pose ``(B, 12)``, its derivatives ``(B, r, 12)`` and angular velocities ``(B, r, 3)``."""
        frames, omega = joint.pose_and_slopes(offset)
        flat = frames.reshape(*frames.shape[:2], 12) * self._weights
        return flat[:, 0], flat[:, 1:], omega

    def _offset(self, q: Floats) -> Floats:
        offset = np.zeros((len(q), self._size))
        offset[:, self._indices] = q
        return offset

    def _stack(self, rotation: Floats, translation: Floats) -> Floats:
        frames = np.concatenate([rotation, translation[..., None]], axis=-1)
        flat = frames.reshape(*frames.shape[:-2], 12) * self._weights
        return flat.reshape(*flat.shape[:-2], -1)
