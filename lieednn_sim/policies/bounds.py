"""Bounds on joint velocities that keep position limits and clearance: a braking rule, and barriers.

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

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions, Distances
from lieednn_sim.errors import InputError
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.values import Floats


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


class JointBounds:
    """Base class of filters that choose the joints' velocities at the end of each step by the braking rule.

    A subclass sets the step h [s] and the limits ``(n,)`` to keep; acceleration limits must be finite.
    """

    timestep: float
    velocity_limits: Floats
    acceleration_limits: Floats
    position_limits: Floats

    def _bounds(self, q: Floats, old: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Lower and upper bounds ``(n,)`` of the velocities, and which ``(2, n)`` are those of position limits.

        A joint outside its limits, as after a bad start, returns as fast as velocity and acceleration allow.
        """
        change = self.acceleration_limits * self.timestep
        lower, upper = np.maximum(-self.velocity_limits, old - change), np.minimum(self.velocity_limits, old + change)
        low, high = self.position_limits.T
        h, a, middle = self.timestep, self.acceleration_limits, q + 0.5 * self.timestep * old
        back, ahead = -fastest(middle - low, a, h), fastest(high - middle, a, h)
        of_position = np.stack([back > lower, ahead < upper])
        lower, upper = np.clip(back, lower, upper), np.clip(ahead, lower, upper)
        return np.minimum(lower, upper), upper, of_position


def fastest(left: Floats, a: Floats, h: float) -> Floats:
    """Largest velocities at the end of a step h [s] from which joints can brake before a limit by accelerations ``a``.

    The joints are ``left`` away from the limit if they stop within the step; joints beyond it return.
    """
    left = np.minimum(left, 1e6)
    root = np.sqrt(np.maximum(0.25 * h**2 + 2.0 * left / a, 0.0))
    return 2.0 * left / np.where(left >= 0.0, 0.5 * h + root, h)


def braking_in_time(arm: Arm, middle: Floats, rates: Floats, old: Floats, h: float) -> Floats:
    """Velocities ``(n,)`` at the end of a step h [s] from which an arm can brake before its position limits.

    Args:
        arm: the arm, with its limits of position and acceleration.
        middle: joints ``(n,)`` at half of the step.
        rates: desired velocities, within the limits of velocity and acceleration. Near position limits those returned
            are smaller; those of ball joints keep the acceleration limits.
        old: velocities at the beginning of the step.
    """
    (low, high), a = arm.position_limits.T, arm.acceleration_limits
    reach = middle + rates * (h + 0.5 * np.abs(rates) / a)
    if ((reach < low) | (reach > high)).any():
        rates = np.minimum(np.maximum(rates, -fastest(middle - low, a, h)), fastest(high - middle, a, h))
    for ball in arm.space.balls:
        largest, at, most = high[ball[0]], middle[ball], a[ball] * h
        # Half of the acceleration is left for turning while it moves along the limit.
        ahead = at + rates[ball] * (h + np.abs(rates[ball]) / a[ball])
        if math.hypot(*at) + math.hypot(*(ahead - at)) > largest:
            rates = rates.copy()
            # Brake towards where the joint would leave its limits, and outwards where it is. Repeat this, since some
            # coordinates may already brake as hard as they can, so that others have to.
            for way in (ahead, at) * 4:
                outward = way / max(math.hypot(*way), 1e-300)
                least = 0.5 * (a[ball] / np.maximum(np.abs(outward), 1e-9)).min()
                # Minus the approach in half a step by motion along the limit.
                left = largest - outward @ at - 0.125 * h**2 * (rates[ball] @ rates[ball]) / largest
                excess = outward @ rates[ball] - fastest(left, least, h)
                if excess > 0.0:
                    slower = rates[ball] - excess * outward
                    rates[ball] = np.minimum(np.maximum(slower, old[ball] - most), old[ball] + most)
    return rates


class ApproachBounds:
    """Upper bounds of the rates at which distances of pairs change, by which pairs too far apart are left out.

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
        model, data = self._arm.model, kinematics_at(self._arm.model, self._arm.qpos(q), self._data)
        anchors = data.xanchor[model.dof_jntid]
        levers = np.linalg.norm(data.geom_xpos[self._geoms][:, None] - anchors, axis=2) + self._radius[:, None]
        moved = np.where(self._turns, levers, 1.0) * self._moves * (np.abs(self._arm.unit_rates(q)) @ speeds)
        table = moved @ ~self._moves.T
        return np.asarray(table[self._first, self._second] + table[self._second, self._first])


class ClearanceBarrier:
    """Distances of pairs of geoms minus their margins, for finite acceleration limits ``(n,)`` and steps of h [s]."""

    # It is small, since several constraints may need the joints' accelerations to brake, and normals turn.
    braking_fraction = 0.15
    _near: Distances

    def __init__(self, arm: Arm, acceleration_limits: Floats, timestep: float, options: FilterOptions) -> None:
        self._acceleration, self._timestep, self._options = acceleration_limits, timestep, options
        self.collisions = Collisions(arm)
        # Margins by geom ids; entries that are not those of pairs are never read.
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
        """Values ``(m,)`` [m] and gradients ``(m, n)`` of the pairs that matter in a step, see `needed`."""
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
        part = 0.8
        near = self.collisions.distances(q, max(self._options.margin, self._options.own_margin) / part)
        if len(near.distance) and near.distance[0] <= 0.0:
            first, second = self.collisions.names(near.pairs[0])
            raise InputError(f"{first!r} touches {second!r} at the start")
        where = tuple(near.pairs.T)
        self._margins[where] = np.minimum(self._margins[where], part * near.distance)

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
        vectors, angles = q[self._balls], self._arm.space.angles(q)
        inward = np.zeros((len(angles), len(q)))
        np.put_along_axis(inward, self._balls, -vectors / np.maximum(angles, 1e-9)[:, None], axis=1)
        return self.limits - angles, inward

    def allow(self, q: Floats) -> None:
        """Tighten the limits, but not below the angles at ``q`` ``(n,)``."""
        angles = self._arm.space.angles(q)
        # Motion along the limit exceeds it to second order in a step.
        self.limits = np.minimum(np.maximum(self._largest - 5e-3, angles), self._largest)

    def name(self, row: int) -> str:
        """See `ClearanceBarrier`."""
        # The names of a ball joint's three coordinates differ in their last two letters.
        return f"the position limit of joint {self._arm.joint_names[self._balls[row, 0]][:-2]!r}"
