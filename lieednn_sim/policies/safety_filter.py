"""A filter that replaces wanted joint velocities by the nearest ones that keep all limits and the clearance.

Within a control step of h seconds the acceleration is constant, so the joints move by h (v + v') / 2 to the velocities
v' that a quadratic program chooses:

    minimise  |D^-1 (v' - v_wanted)|^2 + s |D^-1 (v' - v)|^2     with D the velocity limits,

subject to the limits of velocity and acceleration, to a braking rule for those of position, and to a row for each
barrier. The limits always have a common solution. If a barrier contradicts them or another barrier, the arm brakes: it
comes to rest, violating barriers as little as possible. The solver is the one that mink prefers, DAQP (Arnstrom et al.,
IEEE Trans. Autom. Control 2022); mink's limits know neither accelerations nor the present velocity, and its collision
limit measures every pair of geoms at every step.

Barriers are functions of the joint positions that must stay positive. For one of value d, the filter requires
d' + c (d + h (d' + d'_old) / 2) >= 0, a control barrier condition (Ames et al., European Control Conference 2019) that
is linear in the velocities v', since d' = grad d . v'. Its rate c is at most sqrt(2 a_n / d), from which the joints can
brake, where a_n is a fraction of |grad d| . a.

The braking rule is v'^2 / (2 a) + h (v + v') / 2 <= d for the distance d to a position limit. A joint that keeps it can
still stop before its limit. The rule is an upper bound of v'; if v satisfies it, braking does, too, so it never
contradicts the limits of velocity and acceleration. Such bounds, which make position limits viable under bounded
accelerations, are due to Flacco, De Luca and Khatib (ICRA 2012; IEEE Transactions on Robotics 31(3), 2015), and in
discrete time to Del Prete (IEEE Robotics and Automation Letters 3(1), 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions, Distances
from lieednn_sim.errors import InputError
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.base import JointBounds, Policy
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen

# Fraction of the distance of start and target that is kept where these are closer than the margin.
_MARGIN_FRACTION = 0.8


@dataclass(frozen=True)
class FilterOptions(PlannerOptions):
    """Settings of the safety filter, which keeps limits and clearance by a quadratic program at every control step.

    Attributes:
        margin: distance kept from the surroundings [m].
        own_margin: distance that parts of the arm keep from each other [m].
        approach: upper bound on the rate c [1/s]: geoms at a distance d may approach each other at c d.
        cutoff: distance beyond which pairs are ignored [m].
        smoothing: s, the weight of the change of velocity in the quadratic program of `safety_filter`.
    """

    margin: float = 0.01
    own_margin: float = 0.002
    approach: float = 5.0
    cutoff: float = 0.4
    smoothing: float = 0.05


class ApproachBounds:
    """Upper bounds of the rates at which distances of pairs change; pairs too far apart to matter are then left out.

    A degree of freedom that moves both geoms of a pair, ids ``(P, 2)``, does not change their distance. A unit velocity
    of a slide moves the points of a geom at a speed of 1; that of a rotation, at most at the distance of its anchor
    from the geom's centre plus the geom's radius.
    """

    def __init__(self, arm: Arm, pairs: NDArray[np.int_]) -> None:
        self._arm, self._data, model = arm, mujoco.MjData(arm.model), arm.model
        self._geoms, index = np.unique(pairs, return_inverse=True)
        self._first, self._second = index.reshape(-1, 2).T
        self._moves = np.array([arm.moved_by(int(model.geom_bodyid[geom])) for geom in self._geoms])
        self._turns = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_SLIDE
        self._radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, 0.0)[self._geoms]

    def __call__(self, q: Floats, speeds: Floats) -> Floats:
        """Bounds ``(P,)`` [m/s] at ``q`` ``(n,)`` for joint velocities of at most ``speeds`` ``(n,)``."""
        model, data = self._arm.model, self._data
        data.qpos[:] = self._arm.qpos(q)
        mujoco.mj_kinematics(model, data)
        anchors = data.xanchor[model.dof_jntid]
        levers = np.linalg.norm(data.geom_xpos[self._geoms][:, None] - anchors, axis=2) + self._radius[:, None]
        moved = np.where(self._turns, levers, 1.0) * self._moves * (np.abs(self._arm.unit_rates(q)) @ speeds)
        table = moved @ ~self._moves.T
        return np.asarray(table[self._first, self._second] + table[self._second, self._first])


class ClearanceBarrier:
    """Distances of pairs of geoms minus their margins, for finite acceleration limits ``(n,)`` and steps of h [s]."""

    # Several constraints may need the joints' accelerations to brake, and normals turn.
    braking_fraction = 0.15
    _near: Distances

    def __init__(self, arm: Arm, acceleration_limits: Floats, timestep: float, options: FilterOptions) -> None:
        self._acceleration, self._timestep, self._options = acceleration_limits, timestep, options
        self.collisions = Collisions(arm)
        # By geom ids; other entries than those of pairs are never read.
        self._margins = np.zeros((arm.model.ngeom, arm.model.ngeom))
        own, pairs = self.collisions.own, tuple(self.collisions.pairs.T)
        self._margins[pairs] = np.where(own, options.own_margin, options.margin)
        self.cutoffs = np.full(len(own), options.cutoff)  # distances beyond which pairs are ignored [m]
        # Parts of the arm within 0.15 m at home are taken for neighbours, which approach slowly.
        beside = np.zeros_like(self._margins, dtype=bool)
        beside[tuple(self.collisions.distances(arm.keyframe("home"), 0.15).pairs.T)] = True
        self.cutoffs[own & beside[pairs]] = min(0.04, options.cutoff)
        self._approach = ApproachBounds(arm, self.collisions.pairs)

    def values(self, q: Floats, velocity: Floats, speeds: Floats) -> tuple[Floats, Floats]:
        """Values ``(m,)`` [m] and gradients ``(m, n)`` of the pairs that matter in a step, as of `needed`."""
        near = self._near = self.collisions.distances(q, self.needed(q, velocity, speeds))
        return near.distance - self._margins[tuple(near.pairs.T)], near.jacobian

    def needed(self, q: Floats, velocity: Floats, speeds: Floats) -> Floats:
        """Distances ``(P,)`` beyond which no velocities within the bounds break a pair's barrier; at most the cutoff.

        Let s be the largest rate of the distance, and room the distance minus the margin. The barrier holds if
        c room > (1 + c h) s. Here c is the option's `approach`, or sqrt(2 b / room), with the deceleration b >= braking
        fraction times s / T, and T the longest time to stop.
        """
        h, rate = self._timestep, self._options.approach
        speeds = np.maximum(speeds, np.abs(velocity))
        stop = float((speeds / self._acceleration).max())
        times = max(1.0 / rate + h, (1.0 + h * rate) ** 2 * stop / (2.0 * self.braking_fraction))
        margins = self._margins[tuple(self.collisions.pairs.T)]
        return np.minimum(margins + times * self._approach(q, speeds) + 1e-3, self.cutoffs)

    def allow(self, q: Floats) -> None:
        """Reduce margins of pairs closer at ``q`` ``(n,)`` to a part of their distance; `InputError` if some touch."""
        near = self.collisions.distances(q, max(self._options.margin, self._options.own_margin) / _MARGIN_FRACTION)
        if len(near.distance) and near.distance[0] <= 0.0:
            first, second = self.collisions.names(near.pairs[0])
            raise InputError(f"{first!r} touches {second!r} at the start")
        where = tuple(near.pairs.T)
        self._margins[where] = np.minimum(self._margins[where], _MARGIN_FRACTION * near.distance)

    def name(self, row: int) -> str:
        """Name of a row of the last `values`, for messages about what holds the arm back."""
        first, second = self.collisions.names(self._near.pairs[row])
        return f"the clearance of {first!r} from {second!r}"


class AngleBarrier:
    """Angles by which ball joints are below their limits in use, which bound the norm of their three coordinates."""

    # Staying inside while moving along the limit takes most of the acceleration.
    braking_fraction = 0.05

    def __init__(self, arm: Arm) -> None:
        self._arm, self._balls = arm, arm.space.balls.reshape(-1, 3)
        self._largest = self.limits = arm.position_limits[self._balls[:, 0], 1]

    def values(self, q: Floats) -> tuple[Floats, Floats]:
        """Values ``(B,)`` [rad] and gradients ``(B, n)`` at ``q`` ``(n,)``."""
        vectors = q[self._balls]
        angles = np.linalg.norm(vectors, axis=1)
        inward = np.zeros((len(angles), len(q)))
        np.put_along_axis(inward, self._balls, -vectors / np.maximum(angles, 1e-9)[:, None], axis=1)
        return self.limits - angles, inward

    def allow(self, q: Floats) -> None:
        """Tighten the limits, but not below the angles at ``q`` ``(n,)``."""
        angles = np.linalg.norm(q[self._balls], axis=1)
        # Motion along the limit exceeds it to second order in a step.
        self.limits = np.minimum(np.maximum(self._largest - 5e-3, angles), self._largest)

    def name(self, row: int) -> str:
        """As of `ClearanceBarrier`."""
        # The names of a ball joint's three coordinates differ in their last two letters.
        return f"the position limit of joint {self._arm.joint_names[self._balls[row, 0]][:-2]!r}"


@frozen
class FilterStep:
    """Result of the filter for one control step.

    Attributes:
        velocity: ``(n,)`` joint velocities at the end of the step [rad/s, m/s].
        braked: whether the arm braked because the barriers and the limits could not all be kept.
        blocking: what held the arm back, the strongest first: position limits and pairs of geoms; if the arm
            braked, the barriers that it violates, the worst first.
    """

    velocity: Floats
    braked: bool
    blocking: tuple[str, ...]


class SafetyFilter(JointBounds):
    """The safety filter of an arm, for control steps of constant length.

    Attributes:
        velocity_limits: ``(n,)`` limits in use [rad/s, m/s].
        acceleration_limits: ``(n,)`` limits in use [rad/s^2, m/s^2]; finite even where the arm has none.
        position_limits: ``(n, 2)`` limits in use [rad, m].
        clearance: the barrier of the distances.
        angles: the barrier of the ball joints.

    Args:
        arm: the arm, with its obstacles.
        timestep: h, the control step [s].
        options: settings of the filter.
    """

    def __init__(self, arm: Arm, timestep: float, options: FilterOptions | None = None) -> None:
        self.arm = arm
        self.timestep = h = as_positive("timestep", timestep)
        self.options = options or FilterOptions()
        velocity, acceleration = arm.velocity_limits, arm.acceleration_limits
        # Without limits, joints cross their ranges in a second, and reach their velocity limits in a quarter of one.
        self.velocity_limits = np.where(np.isfinite(velocity), velocity, arm.ranges)
        self.acceleration_limits = np.where(np.isfinite(acceleration), acceleration, 4.0 * self.velocity_limits)
        self.position_limits = arm.position_limits
        self.clearance = ClearanceBarrier(arm, self.acceleration_limits, h, self.options)
        self.angles = AngleBarrier(arm)

    def allow(self, q: ArrayLike) -> None:
        """Reduce margins where ``q`` ``(n,)`` is closer, and tighten limits, but not beyond it.

        Joints that reverse within a step then keep the arm's limits. `InputError` if something touches there.
        """
        position = as_floats("q", q, (self.arm.n_joints,))
        self.clearance.allow(position)
        self.angles.allow(position)
        inset = self.acceleration_limits * self.timestep**2 / 4.0
        low, high = self.arm.position_limits.T
        lower = np.maximum(np.minimum(low + inset, position), low)
        upper = np.minimum(np.maximum(high - inset, position), high)
        self.position_limits = np.stack([lower, upper], axis=1)

    def see(self, places: Mapping[str, ArrayLike]) -> None:
        """Be told where moving obstacles are now, as in `Collisions.move`; their velocity is not taken into account."""
        self.clearance.collisions.move(places)

    def step(self, q: ArrayLike, velocity: ArrayLike, wanted: ArrayLike) -> FilterStep:
        """Velocities at the end of a step that begins at ``q`` with ``velocity``, all ``(n,)``."""
        n, options = self.arm.n_joints, self.options
        # No arm has larger values; with them the quadratic program could not tell its bounds apart.
        given = {"q": q, "velocity": velocity, "wanted": wanted}
        position, old, goal = (as_floats(name, value, (n,), largest=1e9) for name, value in given.items())
        low, high, of_position = self._bounds(position, old)
        rows, floors, names = self._rows(position, old, low, high)
        scale = self.velocity_limits
        pull = (goal + options.smoothing * old) / scale / (1.0 + options.smoothing)
        upper = np.concatenate([high / scale, np.full(len(rows), 1e30)])
        lower = np.concatenate([low / scale, floors])
        scaled = np.ascontiguousarray(rows * scale)
        hard = np.zeros(n + len(rows), dtype=np.int32)
        solution, _, flag, info = daqp.solve(np.eye(n), -pull, scaled, upper, lower, hard)
        if flag < 1:
            # Come to rest, violating barriers, soft constraints now, as little as the bounds allow.
            soft = np.repeat(np.array([0, 8], dtype=np.int32), [n, len(rows)])
            solution, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), scaled, upper, lower, soft, rho_soft=1e-4)
            braking = np.clip(solution * scale if flag > 0 else np.zeros(n), low, high)
            missing = floors - rows @ braking
            violated = np.argsort(-missing, kind="stable")[: max(1, np.count_nonzero(missing > 0.0))]
            return FilterStep(braking, True, tuple(names(row) for row in violated))
        chosen = np.clip(solution * scale, low, high)
        multipliers = np.abs(info["lam"])
        below = solution * scale >= goal
        at_end = np.where(below, chosen <= low, chosen >= high) & np.where(below, *of_position)
        # Constraints with multipliers above this hold the arm back.
        holding = np.flatnonzero((multipliers > 1e-4) & np.append(at_end, np.ones(len(rows), bool)))
        strongest = holding[np.argsort(-multipliers[holding], kind="stable")]
        limit = "the position limit of joint"
        blocking = (f"{limit} {self.arm.joint_names[k]!r}" if k < n else names(k - n) for k in strongest)
        return FilterStep(chosen, False, tuple(blocking))

    def _rows(
        self, q: Floats, old: Floats, low: Floats, high: Floats
    ) -> tuple[Floats, Floats, Callable[[np.intp], str]]:
        """Barrier rows not implied by the bounds, their lower bounds, and the name of each by its index."""
        h, rate = self.timestep, self.options.approach
        distances = self.clearance.values(q, old, np.maximum(np.abs(low), np.abs(high)))
        rooms, slopes = (np.concatenate(parts) for parts in zip(distances, self.angles.values(q), strict=True))
        count = len(distances[0])
        # Decelerations along each gradient: the fraction of the joints' accelerations available to brake.
        of_pairs = np.arange(len(rooms)) < count
        fractions = np.where(of_pairs, ClearanceBarrier.braking_fraction, AngleBarrier.braking_fraction)
        brakes = fractions * (np.abs(slopes) @ self.acceleration_limits)
        rates = np.minimum(rate, np.sqrt(2.0 * brakes / np.maximum(rooms, 1e-6)))
        rows = (1.0 + 0.5 * h * rates[:, None]) * slopes
        floors = -rates * (rooms + 0.5 * h * slopes @ old)
        worst = np.maximum(rows, 0.0) @ low + np.minimum(rows, 0.0) @ high
        kept = np.flatnonzero(worst < floors)

        def name(row: np.intp) -> str:
            index = int(kept[row])
            return self.clearance.name(index) if index < count else self.angles.name(index - count)

        return rows[kept], floors[kept], name


class FilteredPolicy(Policy):
    """Another policy behind a safety filter, which keeps position, velocity and acceleration limits and clearance.

    The state of the wrapped policy does not depend on the filter, except that its speed limits count from the filtered
    reference. Its proof covers only this state; where an obstacle blocks the arm, the filtered reference stays behind.

    Args:
        policy: the policy.
        options: settings of the filter.

    Attributes:
        inner: the wrapped policy.
        blocking: what held the reference back in the last period, see `FilterStep`.
        braked: see `FilterStep`.

    Raises:
        InputError: `reset` raises it if something touches at the start.
    """

    def __init__(self, policy: Policy, options: FilterOptions | None = None) -> None:
        super().__init__(policy.arm, policy.rate)
        self.inner, self._options = policy, options
        self.certified = policy.certified
        # A dictionary, which can be pickled.
        self.channel_units = dict(policy.channel_units)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        self.inner.reset(q)
        self._filter = SafetyFilter(self.arm, self.period, self._options)
        self._filter.allow(q)
        self.blocking: tuple[str, ...] = ()
        self.braked = False

    def see(self, places: Mapping[str, Floats]) -> None:
        """See `Policy`; raises `InputError` for names of no obstacles."""
        super().see(places)
        self.inner.see(places)
        self._filter.see(places)

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        q, qd = self.inner.step(measured, target)
        error = q - self.q - 0.5 * self.period * self.qd
        # Rate at which the reference is pulled towards the unfiltered one [1/s].
        tracking_gain = 8.0
        step = self._filter.step(self.q, self.qd, qd + tracking_gain * error)
        self.blocking, self.braked = step.blocking, step.braked
        moved = self.q + 0.5 * self.period * (self.qd + step.velocity)
        # The inner policy takes the filtered reference for its own.
        self.inner.q, self.inner.qd = moved, step.velocity
        return moved, step.velocity

    @property
    def state(self) -> Floats:
        """See `Policy`."""
        return self.inner.state

    @property
    def message(self) -> str:
        """See `Policy`."""
        if not self.blocking:
            return self.inner.message
        return f"{'brakes for' if self.braked else 'is held back by'} {self.blocking[0]}"

    def channels(self) -> Floats:
        """See `Policy`."""
        return self.inner.channels()
