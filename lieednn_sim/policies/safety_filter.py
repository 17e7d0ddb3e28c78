"""A filter that replaces wanted joint velocities by the nearest ones that keep all limits and the clearance.

Within a control step of h seconds the acceleration is constant, so the joints move by h (v + v') / 2 to the velocities
v' that a quadratic program chooses:

    minimise  |D^-1 (v' - v_wanted)|^2 + s |D^-1 (v' - v)|^2     with D the velocity limits,

subject to the limits of velocity and acceleration, to the braking rule for those of position, and to a row for each
barrier (`bounds`). The limits always have a common solution. If a barrier contradicts them or another barrier, the arm
brakes: it comes to rest, violating barriers as little as possible. The solver is the one that mink prefers, DAQP
(Arnstrom et al., IEEE Trans. Autom. Control 2022); mink's limits know neither accelerations nor the present velocity,
and its collision limit measures every pair of geoms at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import daqp
import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.bounds import AngleBarrier, ClearanceBarrier, FilterOptions, JointBounds
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen


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
        """Reduce margins of pairs that are closer at ``q`` ``(n,)``, and tighten limits, but not beyond ``q``.

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
        """Set where moving obstacles are now, as in `Collisions.move`; their velocity is not taken into account."""
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
            # Come to rest, violating the barriers, which are soft constraints now, as little as the bounds allow.
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
