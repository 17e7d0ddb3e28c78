"""A filter on joint velocities: the nearest ones to the wanted that keep all limits, now and later, and clearance.

Within a control step of h seconds the acceleration is constant, so the joints move by h (v + v') / 2 to the velocities
v' that a quadratic program chooses:

    minimise  |D^-1 (v' - v_wanted)|^2 + s |D^-1 (v' - v)|^2     with D the velocity limits, subject to
    |v'| <= velocity limit,   |v' - v| <= a h,
    v'^2 / (2 a) + h (v + v') / 2 <= d                           for the distance d to a position limit,
    delta' + c (delta + h (delta' + delta'_old) / 2) >= 0        for a pair of geoms, delta = distance - margin,

and the same for the angle left to a ball joint, whose three coordinates are limited by their norm.

The third line says that the joint can still brake before its limit; it bounds v' from above and, where v keeps it, can
be kept by braking, so the first three always have a solution together. The last one is a control barrier function
(Ames et al., European Control Conference 2019), linear in v' by delta' = grad d . v'; its rate c is at most what the
accelerations can brake, sqrt(2 a_n / delta) with a share a_n of |grad d| . a. Where it contradicts the others the arm
brakes: it gives way as little as it can, and comes to rest.

Not by `mink`: its limits know no accelerations, nor velocities to start from, and its collision limit measures every
pair of geoms each time. The solver is the one it prefers, DAQP (Arnstrom et al., IEEE Trans. Autom. Control 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions, Distances
from lieednn_sim.errors import InputError
from lieednn_sim.planning.filtering.approach import ApproachBounds
from lieednn_sim.validation import as_floats, as_positive

Floats = NDArray[np.float64]

# Where an arm names no acceleration limits, its joints get up to their velocity limits in this time [s].
_ACCELERATION_TIME = 0.25
# And where it names no velocity limit either, a joint crosses its range in this time [s].
_RANGE_TIME = 1.0
# A change of the wanted velocity by more than this share of the limits counts as filtering.
_ACTIVE = 1e-3
# Multipliers above this mark a constraint that holds the arm back.
_PRESSING = 1e-4
_UNBOUNDED = 1e30
# Positions and velocities beyond this are none of an arm, and the quadratic program could not tell its bounds apart.
_LARGEST = 1e9
# DAQP's mark of a constraint that may give way, and the inverse of the weight of doing so.
_SOFT, _GIVING = 8, 1e-4
# Share of the accelerations that braking before obstacles may count on: constraints share them, and normals turn.
_BRAKING_SHARE = 0.15
# Parts of the arm this near at home belong to neighbouring links, which close in slowly: a shorter cutoff does [m].
_NEIGHBOURS, _NEIGHBOUR_CUTOFF = 0.15, 0.04
# Pairs are looked at up to here at least [m].
_LEAST_CUTOFF = 0.001
# Where start or target are nearer than the margin, this share of their distance is kept.
_MARGIN_SHARE = 0.8
# Sliding along the limit of a ball joint's angle goes beyond it by second order in a step [rad], and takes most of the
# acceleration to stay inside.
_ANGLE_INSET, _ANGLE_BRAKING_SHARE = 5e-3, 0.05


@dataclass(frozen=True)
class FilterOptions:
    """Settings of the filter.

    Attributes:
        margin: distance kept from the surroundings [m].
        own_margin: distance that parts of the arm keep from each other [m].
        approach: largest c, geoms approach each other by at most this share of their distance each second [1/s].
        cutoff: pairs further apart are not looked at [m].
        smoothing: s, weight of the change of velocity.

    Raises:
        InputError: a value is not positive.
    """

    margin: float = 0.01
    own_margin: float = 0.002
    approach: float = 5.0
    cutoff: float = 0.4
    smoothing: float = 0.05

    def __post_init__(self) -> None:
        for name in ("margin", "own_margin", "approach", "cutoff", "smoothing"):
            object.__setattr__(self, name, as_positive(name, getattr(self, name)))


@dataclass(frozen=True)
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
        position_limits: ``(n, 2)`` in use [rad, m].
        velocity_limits: ``(n,)`` in use [rad/s, m/s].
        acceleration_limits: ``(n,)`` in use [rad/s^2, m/s^2]; finite also where the arm names none.

    Args:
        arm: the arm, with its obstacles.
        timestep: h, the control step [s].
        options: settings.
    """

    def __init__(self, arm: Arm, timestep: float, options: FilterOptions | None = None) -> None:
        self.arm = arm
        self.timestep = as_positive("timestep", timestep)
        self.options = options or FilterOptions()
        self.collisions = Collisions(arm)
        # By geom ids; what is no pair is never looked up.
        self._margins = np.zeros((arm.model.ngeom, arm.model.ngeom))
        own = self.collisions.own
        self._margins[tuple(self.collisions.pairs.T)] = np.where(own, self.options.own_margin, self.options.margin)
        self._cutoffs = np.full(len(own), self.options.cutoff)
        neighbours = self.collisions.distances(arm.keyframe("home"), _NEIGHBOURS).pairs
        beside = np.zeros_like(self._margins, dtype=bool)
        beside[tuple(neighbours.T)] = True
        self._cutoffs[own & beside[tuple(self.collisions.pairs.T)]] = min(_NEIGHBOUR_CUTOFF, self.options.cutoff)
        self._approach = ApproachBounds(arm, self.collisions.pairs)
        self.position_limits = arm.position_limits.copy()
        low, high = arm.position_limits.T
        # A ball joint's three coordinates are limited together, by the angle that is their norm.
        self._balls = arm.space.balls.reshape(-1, 3)
        self._angle_limits = high[self._balls[:, 0]]
        self.velocity_limits = np.where(
            np.isfinite(arm.velocity_limits), arm.velocity_limits, (high - low) / _RANGE_TIME
        )
        self.acceleration_limits = np.where(
            np.isfinite(arm.acceleration_limits), arm.acceleration_limits, self.velocity_limits / _ACCELERATION_TIME
        )

    def allow(self, *positions: Floats) -> None:
        """Fit the constraints to positions ``(n,)`` that shall be reached.

        The position limits are drawn in, so that joints that turn round within a step keep the arm's own, but not
        beyond these positions; pairs that are nearer there than their margin keep a share of that distance.

        Raises:
            InputError: something touches at a position.
        """
        for position in positions:
            near = self.collisions.distances(
                position, max(self.options.margin, self.options.own_margin) / _MARGIN_SHARE
            )
            if len(near.distance) and near.distance[0] <= 0.0:
                first, second = self.collisions.names(near.pairs[0])
                raise InputError(f"{first!r} touches {second!r} at a position to reach")
            where = tuple(near.pairs.T)
            self._margins[where] = np.minimum(self._margins[where], _MARGIN_SHARE * near.distance)
        inset = self.acceleration_limits * self.timestep**2 / 4.0
        low, high = self.arm.position_limits.T
        reached = np.array(positions)
        angles = np.linalg.norm(reached[:, self._balls], axis=-1).max(axis=0, initial=0.0)
        self._angle_limits = np.minimum(
            np.maximum(high[self._balls[:, 0]] - _ANGLE_INSET, angles), high[self._balls[:, 0]]
        )
        lower = np.maximum(np.minimum(low + inset, reached.min(axis=0)), low)
        upper = np.minimum(np.maximum(high - inset, reached.max(axis=0)), high)
        self.position_limits = np.stack([lower, upper], axis=1)

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
        low, high, low_stop, high_stop = self._bounds(position, old)
        near = self.collisions.distances(position, self._needed(position, np.maximum(np.abs(low), np.abs(high)), old))
        clearance = float(near.distance[0]) if len(near.distance) else np.inf
        rows, floors, kept = self._rows(position, near, old, low, high)

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
            return FilterStep(braking, True, True, clearance, self._names(near, kept[:1]))
        chosen = np.clip(solution * scale, low, high)
        multipliers = np.abs(info["lam"])
        at_stop = np.where(solution * scale >= goal, (chosen <= low) & low_stop, (chosen >= high) & high_stop)
        pressing = [
            (multipliers[j], f"the position limit of joint {self.arm.joint_names[j]!r}")
            for j in np.flatnonzero(at_stop & (multipliers[:n] > _PRESSING))
        ]
        held = np.flatnonzero(multipliers[n:] > _PRESSING)
        pressing += list(zip(multipliers[n + held], self._names(near, kept[held]), strict=True))
        blocking = tuple(name for _, name in sorted(pressing, key=lambda entry: -entry[0]))
        reachable = np.clip(goal, old - self.acceleration_limits * h, old + self.acceleration_limits * h)
        free = (reachable + options.smoothing * old) / (1.0 + options.smoothing)
        active = bool((np.abs(chosen - free) > _ACTIVE * scale).any()) and bool(blocking)
        return FilterStep(chosen, active, False, clearance, blocking)

    def _bounds(self, q: Floats, old: Floats) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:
        """Lower and upper ends ``(n,)`` of the velocities, and whether a position limit makes them."""
        h, a = self.timestep, self.acceleration_limits
        low, high = self.position_limits.T
        up, down = self._stopping(high - q, old), -self._stopping(q - low, -old)
        lower = np.maximum(-self.velocity_limits, old - a * h)
        upper = np.minimum(self.velocity_limits, old + a * h)
        low_stop, high_stop = down > lower, up < upper
        # Outside a limit, where only a bad start can be, come back as fast as the acceleration allows.
        lower, upper = np.clip(down, lower, upper), np.clip(up, lower, upper)
        return np.minimum(lower, upper), upper, low_stop, high_stop

    def _needed(self, q: Floats, speeds: Floats, old: Floats) -> Floats:
        """Distances ``(P,)`` from which on no velocities within the bounds can break a pair's barrier, or the cutoff.

        With s the largest rate of the distance, a barrier holds where c room > (1 + c h) s. Either c is the option's,
        or the root of 2 b / room with the deceleration b >= braking share times s / T, T the longest time to stop.
        """
        h, rate = self.timestep, self.options.approach
        speeds = np.maximum(speeds, np.abs(old))
        stop = float((speeds / self.acceleration_limits).max())
        times = max(1.0 / rate + h, (1.0 + h * rate) ** 2 * stop / (2.0 * _BRAKING_SHARE))
        margins = self._margins[tuple(self.collisions.pairs.T)]
        return np.minimum(margins + times * self._approach(q, speeds) + _LEAST_CUTOFF, self._cutoffs)

    def _stopping(self, distance: Floats, old: Floats) -> Floats:
        """Largest velocities ``(n,)`` at the end of the step from which the distance suffices to brake."""
        h, a = self.timestep, self.acceleration_limits
        left = distance - 0.5 * h * old
        root = np.sqrt(np.maximum((0.5 * a * h) ** 2 + 2.0 * a * left, 0.0)) - 0.5 * a * h
        return np.where(left >= 0.0, root, 2.0 * left / h)

    def _rows(
        self, q: Floats, near: Distances, old: Floats, low: Floats, high: Floats
    ) -> tuple[Floats, Floats, NDArray[np.int_]]:
        """Barrier rows that the bounds do not keep already, their lower ends, and which they are: pairs, then balls."""
        h, rate = self.timestep, self.options.approach
        vectors = q[self._balls]
        angles = np.linalg.norm(vectors, axis=1)
        inward = np.zeros((len(angles), len(q)))
        np.put_along_axis(inward, self._balls, -vectors / np.maximum(angles, 1e-9)[:, None], axis=1)
        slopes = np.concatenate([near.jacobian, inward])
        rooms = np.concatenate([near.distance - self._margins[tuple(near.pairs.T)], self._angle_limits - angles])
        # What the joints can do along each slope, of which a share must do for braking.
        shares = np.repeat([_BRAKING_SHARE, _ANGLE_BRAKING_SHARE], [len(near.pairs), len(angles)])
        brakes = shares * (np.abs(slopes) @ self.acceleration_limits)
        rates = np.minimum(rate, np.sqrt(2.0 * brakes / np.maximum(rooms, 1e-6)))
        rows = (1.0 + 0.5 * h * rates[:, None]) * slopes
        floors = -rates * (rooms + 0.5 * h * slopes @ old)
        worst = np.maximum(rows, 0.0) @ low + np.minimum(rows, 0.0) @ high
        kept = np.flatnonzero(worst < floors)
        return rows[kept], floors[kept], kept

    def _names(self, near: Distances, kept: NDArray[np.int_]) -> tuple[str, ...]:
        names = []
        for row in kept:
            if row < len(near.pairs):
                first, second = self.collisions.names(near.pairs[row])
                names.append(f"the clearance of {first!r} from {second!r}")
            else:
                # Of a ball joint's three coordinates the names differ in their last two letters.
                joint = self.arm.joint_names[self._balls[row - len(near.pairs), 0]][:-2]
                names.append(f"the position limit of joint {joint!r}")
        return tuple(names)
