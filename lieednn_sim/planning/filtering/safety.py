"""A filter on joint velocities: the nearest ones to the wanted that keep all limits, now and later, and clearance.

Within a control step of h seconds the acceleration is constant, so the joints move by h (v + v') / 2 to the velocities
v' that a quadratic program chooses:

    minimise  |D^-1 (v' - v_wanted)|^2 + s |D^-1 (v' - v)|^2     with D the velocity limits,

within the bounds of the `limits` and above the rows of the `barriers`. The limits always have a solution together.
Where a barrier contradicts them or another one the arm brakes: it gives way as little as it can, and comes to rest.

Limits and barriers are objects as in mink and pink. Not theirs: mink's limits know no accelerations, nor velocities to
start from, and its collision limit measures every pair of geoms each time. The solver is the one it prefers, DAQP
(Arnstrom et al., IEEE Trans. Autom. Control 2022).
"""

from __future__ import annotations

from collections.abc import Sequence

import daqp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.filtering.barriers import AngleBarrier, Barrier, ClearanceBarrier, FilterOptions
from lieednn_sim.planning.filtering.limits import AccelerationLimit, Limit, PositionLimit, VelocityLimit, finite_rates
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen

# A change of the wanted velocity by more than this share of the limits counts as filtering.
_ACTIVE = 1e-3
# Multipliers above this mark a constraint that holds the arm back.
_PRESSING = 1e-4
_UNBOUNDED = 1e30
# Positions and velocities beyond this are none of an arm, and the quadratic program could not tell its bounds apart.
_LARGEST = 1e9
# DAQP's mark of a constraint that may give way, and the inverse of the weight of doing so.
_SOFT, _GIVING = 8, 1e-4


@frozen
class FilterStep:
    """What the filter made of one control step.

    Attributes:
        velocity: ``(n,)`` joint velocities at the end of the step [rad/s, m/s].
        active: whether they differ from the wanted by more than the acceleration limits make them.
        braked: whether clearance could not be kept together with the other limits, and the arm braked.
        clearance: smallest distance at the beginning of the step [m] among the pairs that its velocities could bring
            too near; infinite when there are none.
        blocking: what held the arm back, the hardest first: position limits and pairs of geoms.
    """

    velocity: Floats
    active: bool
    braked: bool
    clearance: float
    blocking: tuple[str, ...]


class SafetyFilter:
    """The filter of one arm at one control step.

    Attributes:
        velocity_limits: ``(n,)`` in use [rad/s, m/s].
        acceleration_limits: ``(n,)`` in use [rad/s^2, m/s^2]; finite also where the arm names none.
        limits: all limits, the user's last. One that yields gives way to those before it.
        barriers: all barriers, the user's last.
        position: the limit of the joint positions, one of the former.
        clearance: the barrier of the distances, one of the former.
        angles: the barrier of the ball joints, one of the former.

    Args:
        arm: the arm, with its obstacles.
        timestep: h, the control step [s].
        options: settings.
        limits: more limits.
        barriers: more barriers.

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
        """Fit limits and barriers to positions ``(n,)`` that shall be reached.

        Raises:
            InputError: something touches at a position.
        """
        reached = np.array(positions)
        for barrier in self.barriers:
            barrier.allow(reached)
        for limit in self.limits:
            limit.allow(reached)

    def step(self, q: ArrayLike, velocity: ArrayLike, wanted: ArrayLike) -> FilterStep:
        """Velocities at the end of a step that begins at ``q`` with ``velocity``, all ``(n,)``.

        Raises:
            InputError: a value is malformed.
        """
        n, h, options = self.arm.n_joints, self.timestep, self.options
        position, old, goal = (
            as_floats(name, value, (n,), largest=_LARGEST)
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
            # Come to rest, breaking the barriers as little as the bounds allow.
            sense = np.concatenate([np.zeros(n), np.full(len(rows), _SOFT)]).astype(np.int32)
            solution, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), scaled, upper, lower, sense, rho_soft=_GIVING)
            braking = np.clip(solution * scale if flag > 0 else np.zeros(n), low, high)
            return FilterStep(braking, True, True, clearance, self._names(kept[:1]))
        chosen = np.clip(solution * scale, low, high)
        multipliers = np.abs(info["lam"])
        below = solution * scale >= goal
        at_end = np.where(below, chosen <= low, chosen >= high)
        makers = np.where(below, low_makers, high_makers)
        pressing = [
            (multipliers[j], self.limits[makers[j]].name(int(j)))
            for j in np.flatnonzero(at_end & (multipliers[:n] > _PRESSING))
        ]
        held = np.flatnonzero(multipliers[n:] > _PRESSING)
        pressing += list(zip(multipliers[n + held], self._names(kept[held]), strict=True))
        blocking = tuple(name for _, name in sorted(pressing, key=lambda entry: -entry[0]) if name)
        reachable = np.clip(goal, old - self.acceleration_limits * h, old + self.acceleration_limits * h)
        free = (reachable + options.smoothing * old) / (1.0 + options.smoothing)
        active = bool((np.abs(chosen - free) > _ACTIVE * scale).any()) and bool(blocking)
        return FilterStep(chosen, active, False, clearance, blocking)

    def _bounds(self, q: Floats, old: Floats) -> tuple[Floats, Floats, NDArray[np.int_], NDArray[np.int_]]:
        """Lower and upper ends ``(n,)`` of the velocities, and which of the limits make them."""
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
        """Barrier rows that the bounds do not keep already, their lower ends, and which of all rows they are."""
        h, rate, speeds = self.timestep, self.options.approach, np.maximum(np.abs(low), np.abs(high))
        found = [barrier.values(q, old, speeds) for barrier in self.barriers]
        self._counts = [len(values) for values, _ in found]
        rooms, slopes = (np.concatenate(parts) for parts in zip(*found, strict=True))
        # What the joints can do along each slope, of which a share must do for braking.
        shares = np.repeat([barrier.braking_share for barrier in self.barriers], self._counts)
        brakes = shares * (np.abs(slopes) @ self.acceleration_limits)
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
