"""A filter that replaces wanted joint velocities by the nearest ones that keep all limits and the clearance.

Within a control step of h seconds the acceleration is constant, so the joints move by h (v + v') / 2 to the velocities
v' that a quadratic program chooses:

    minimise  |D^-1 (v' - v_wanted)|^2 + s |D^-1 (v' - v)|^2     with D the velocity limits,

subject to the bounds of `limits` and the rows of `barriers`. The bounds always have a common solution. If a barrier
contradicts them or another barrier, the arm brakes: it comes to rest, violating barriers as little as possible.

Limits and barriers are objects, as in mink and pink, but not theirs: mink's limits know neither accelerations nor the
present velocity, and its collision limit measures every pair of geoms at every step. The solver is the one that mink
prefers, DAQP (Arnstrom et al., IEEE Trans. Autom. Control 2022).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import daqp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.safety_filter.barriers import AngleBarrier, Barrier, ClearanceBarrier, FilterOptions
from lieednn_sim.planning.safety_filter.limits import (
    AccelerationLimit,
    Limit,
    PositionLimit,
    VelocityLimit,
    finite_rates,
)
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen

# Changes of the wanted velocity above this fraction of the limits count as filtering.
_ACTIVE_FRACTION = 1e-3
# Constraints with multipliers above this hold the arm back.
_BLOCKING_MULTIPLIER = 1e-4
_UNBOUNDED = 1e30
# No arm has larger positions or velocities; with larger ones the quadratic program could not tell its bounds apart.
_LARGEST_VALUE = 1e9
# DAQP's flag of a soft constraint, and the inverse of the weight of violating it.
_SOFT_FLAG, _SOFTNESS = 8, 1e-4


@frozen
class FilterStep:
    """Result of the filter for one control step.

    Attributes:
        velocity: ``(n,)`` joint velocities at the end of the step [rad/s, m/s].
        active: whether position limits, clearance or a user's limit or barrier changed the velocities noticeably.
        braked: whether the arm braked because the barriers and the limits could not all be kept.
        clearance: smallest distance at the beginning of the step [m] among the pairs that could come too close in it;
            infinite if there are none.
        blocking: what held the arm back, the strongest first: position limits and pairs of geoms; if the arm
            braked, the barriers that it violates, the worst first.
    """

    velocity: Floats
    active: bool
    braked: bool
    clearance: float
    blocking: tuple[str, ...]


class SafetyFilter:
    """The safety filter of an arm, for control steps of constant length.

    Attributes:
        velocity_limits: ``(n,)`` limits in use [rad/s, m/s].
        acceleration_limits: ``(n,)`` limits in use [rad/s^2, m/s^2]; finite even where the arm has none.
        limits: all limits, the user's last; a limit that yields gives way to those before it.
        barriers: all barriers, the user's last.
        position: the limit of the joint positions, one of ``limits``.
        clearance: the barrier of the distances, one of ``barriers``.
        angles: the barrier of the ball joints, one of ``barriers``.

    Args:
        arm: the arm, with its obstacles.
        timestep: h, the control step [s].
        options: settings of the filter.
        limits: additional limits.
        barriers: additional barriers.

    Raises:
        InputError: a value is malformed.
    """

    def __init__(
        self,
        arm: Arm,
        timestep: float,
        options: FilterOptions | None = None,
        *,
        limits: Sequence[Limit] = (),
        barriers: Sequence[Barrier] = (),
    ) -> None:
        for what, given, kind in (("limits", limits, Limit), ("barriers", barriers, Barrier)):
            if not all(isinstance(item, kind) for item in given):
                raise InputError(f"{what} must be objects of {kind.__module__}.{kind.__name__}")
        self.arm = arm
        self.timestep = h = as_positive("timestep", timestep)
        self.options = options or FilterOptions()
        self.velocity_limits, self.acceleration_limits = finite_rates(arm)
        self.position = PositionLimit(arm, self.acceleration_limits, h)
        self.clearance = ClearanceBarrier(arm, self.acceleration_limits, h, self.options)
        self.angles = AngleBarrier(arm)
        rates = VelocityLimit(self.velocity_limits), AccelerationLimit(self.acceleration_limits, h)
        self.limits: tuple[Limit, ...] = (*rates, self.position, *limits)
        self.barriers: tuple[Barrier, ...] = (self.clearance, self.angles, *barriers)

    def allow(self, *positions: Floats) -> None:
        """Adapt limits and barriers to positions ``(n,)`` that must be allowed.

        Raises:
            InputError: something touches at a position.
        """
        reached = np.array([as_floats("positions", q, (self.arm.n_joints,)) for q in positions])
        if not len(reached):
            return
        for barrier in self.barriers:
            barrier.allow(reached)
        for limit in self.limits:
            limit.allow(reached)

    def see(self, places: Mapping[str, ArrayLike]) -> None:
        """Be told where moving obstacles are now, as in `Collisions.move`; their velocity is not taken into account."""
        self.clearance.collisions.move(places)

    def step(self, q: ArrayLike, velocity: ArrayLike, wanted: ArrayLike) -> FilterStep:
        """Velocities at the end of a step that begins at ``q`` with ``velocity``, all ``(n,)``.

        Raises:
            InputError: a value is malformed.
        """
        n, h, options = self.arm.n_joints, self.timestep, self.options
        position, old, goal = (
            as_floats(name, value, (n,), largest=_LARGEST_VALUE)
            for name, value in (("q", q), ("velocity", velocity), ("wanted", wanted))
        )
        low, high, low_makers, high_makers = self._bounds(position, old)
        rows, floors, kept = self._rows(position, old, low, high)
        clearance = self.clearance.clearance

        scale = self.velocity_limits
        pull = (goal + options.smoothing * old) / scale / (1.0 + options.smoothing)
        upper = np.concatenate([high / scale, np.full(len(rows), _UNBOUNDED)])
        lower = np.concatenate([low / scale, floors])
        scaled = np.ascontiguousarray(rows * scale)
        hard = np.zeros(n + len(rows), dtype=np.int32)
        solution, _, flag, info = daqp.solve(np.eye(n), -pull, scaled, upper, lower, hard)
        if flag < 1:
            # Come to rest, violating barriers as little as the bounds allow.
            sense = np.concatenate([np.zeros(n), np.full(len(rows), _SOFT_FLAG)]).astype(np.int32)
            solution, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), scaled, upper, lower, sense, rho_soft=_SOFTNESS)
            braking = np.clip(solution * scale if flag > 0 else np.zeros(n), low, high)
            missing = floors - rows @ braking
            violated = np.argsort(-missing, kind="stable")[: max(1, np.count_nonzero(missing > 0.0))]
            return FilterStep(braking, True, True, clearance, self._names(kept[violated]))
        chosen = np.clip(solution * scale, low, high)
        multipliers = np.abs(info["lam"])
        below = solution * scale >= goal
        at_end = np.where(below, chosen <= low, chosen >= high)
        makers = np.where(below, low_makers, high_makers)
        pressing = [
            (multipliers[j], self.limits[makers[j]].name(int(j)))
            for j in np.flatnonzero(at_end & (multipliers[:n] > _BLOCKING_MULTIPLIER))
        ]
        held = np.flatnonzero(multipliers[n:] > _BLOCKING_MULTIPLIER)
        pressing += list(zip(multipliers[n + held], self._names(kept[held]), strict=True))
        blocking = tuple(name for _, name in sorted(pressing, key=lambda entry: -entry[0]) if name)
        reachable = np.clip(goal, old - self.acceleration_limits * h, old + self.acceleration_limits * h)
        free = (reachable + options.smoothing * old) / (1.0 + options.smoothing)
        active = bool((np.abs(chosen - free) > _ACTIVE_FRACTION * scale).any()) and bool(blocking)
        return FilterStep(chosen, active, False, clearance, blocking)

    def _bounds(self, q: Floats, old: Floats) -> tuple[Floats, Floats, NDArray[np.int_], NDArray[np.int_]]:
        """Lower and upper bounds ``(n,)`` of the velocities, and the indices of the limits that set them."""
        lower, upper = np.full(len(q), -np.inf), np.full(len(q), np.inf)
        low_makers, high_makers = np.zeros((2, len(q)), dtype=int)
        for index, limit in enumerate(self.limits):
            low, high = limit.bounds(q, old)
            low_makers[low > lower], high_makers[high < upper] = index, index
            if limit.yields:
                lower, upper = np.clip(low, lower, upper), np.clip(high, lower, upper)
            else:
                lower, upper = np.maximum(low, lower), np.minimum(high, upper)
        return np.minimum(lower, upper), upper, low_makers, high_makers

    def _rows(self, q: Floats, old: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats, NDArray[np.int_]]:
        """Barrier rows not implied by the bounds, their lower bounds, and their indices among all rows."""
        h, rate, speeds = self.timestep, self.options.approach, np.maximum(np.abs(low), np.abs(high))
        found = [barrier.values(q, old, speeds) for barrier in self.barriers]
        self._counts = [len(values) for values, _ in found]
        rooms, slopes = (np.concatenate(parts) for parts in zip(*found, strict=True))
        # Decelerations along each gradient: the fraction of the joints' accelerations available to brake.
        fractions = np.repeat([barrier.braking_fraction for barrier in self.barriers], self._counts)
        brakes = fractions * (np.abs(slopes) @ self.acceleration_limits)
        rates = np.minimum(rate, np.sqrt(2.0 * brakes / np.maximum(rooms, 1e-6)))
        rows = (1.0 + 0.5 * h * rates[:, None]) * slopes
        floors = -rates * (rooms + 0.5 * h * slopes @ old)
        worst = np.maximum(rows, 0.0) @ low + np.minimum(rows, 0.0) @ high
        kept = np.flatnonzero(worst < floors)
        return rows[kept], floors[kept], kept

    def _names(self, kept: NDArray[np.int_]) -> tuple[str, ...]:
        ends = np.cumsum(self._counts)
        owners = np.searchsorted(ends, kept, side="right")
        return tuple(
            self.barriers[owner].name(int(row - ends[owner] + self._counts[owner]))
            for owner, row in zip(owners, kept, strict=True)
        )
