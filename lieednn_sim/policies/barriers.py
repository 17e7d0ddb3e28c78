"""Barriers: functions of the joint positions that must stay positive, each a row of the filter's quadratic program.

For a barrier of value d, the filter requires d' + c (d + h (d' + d'_old) / 2) >= 0, a control barrier condition (Ames
et al., European Control Conference 2019) that is linear in the velocities v', since d' = grad d . v'. Its rate c is at
most sqrt(2 a_n / d), from which the joints can brake, where a_n is a fraction of |grad d| . a.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions, Distances
from lieednn_sim.errors import InputError
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.values import Floats

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

    A degree of freedom that moves both geoms of a pair does not change their distance. A unit velocity of a slide joint
    moves the points of a geom at a speed of 1; that of a rotation, at most at the distance of its anchor from the
    geom's centre plus the geom's radius. The pairs are geom ids ``(P, 2)``.
    """

    def __init__(self, arm: Arm, pairs: NDArray[np.int_]) -> None:
        self._arm = arm
        self._data = mujoco.MjData(arm.model)
        model = arm.model
        self._geoms, index = np.unique(pairs, return_inverse=True)
        self._first, self._second = index.reshape(-1, 2).T
        self._moves = np.array([arm.moved_by(int(model.geom_bodyid[geom])) for geom in self._geoms])
        self._turns = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_SLIDE
        self._radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, 0.0)[self._geoms]
        self._identity = np.eye(arm.n_joints)

    def __call__(self, q: Floats, speeds: Floats) -> Floats:
        """Bounds ``(P,)`` [m/s] at ``q`` ``(n,)`` for joint velocities of at most ``speeds`` ``(n,)``."""
        model, data = self._arm.model, self._data
        data.qpos[:] = self._arm.qpos(q)
        mujoco.mj_kinematics(model, data)
        rates = self._arm.qvel(np.broadcast_to(q, self._identity.shape), self._identity)
        anchors = data.xanchor[model.dof_jntid]
        levers = np.linalg.norm(data.geom_xpos[self._geoms][:, None] - anchors, axis=2) + self._radius[:, None]
        moved = np.where(self._turns, levers, 1.0) * self._moves * (speeds @ np.abs(rates))
        table = moved @ ~self._moves.T
        return np.asarray(table[self._first, self._second] + table[self._second, self._first])


class ClearanceBarrier:
    """Distances of pairs of geoms, minus their margins, for finite acceleration limits ``(n,)`` and a time step h [s].

    Attributes:
        collisions: the pairs.
        cutoffs: ``(P,)`` distances beyond which pairs are ignored [m].
    """

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
        self.cutoffs = np.full(len(own), options.cutoff)
        # Parts of the arm within 0.15 m at home are taken for neighbours, which approach slowly.
        beside = np.zeros_like(self._margins, dtype=bool)
        beside[tuple(self.collisions.distances(arm.keyframe("home"), 0.15).pairs.T)] = True
        self.cutoffs[own & beside[pairs]] = min(0.04, options.cutoff)
        self._approach = ApproachBounds(arm, self.collisions.pairs)

    def values(self, q: Floats, velocity: Floats, speeds: Floats) -> tuple[Floats, Floats]:
        """Values ``(m,)`` [m] and gradients ``(m, n)`` of the pairs that matter in a step.

        It begins at ``q`` with ``velocity``, and ends with joint speeds of at most ``speeds``, all ``(n,)``.
        """
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
        """Reduce the margins of pairs that are closer at ``q`` ``(n,)`` to a fraction of their distance there.

        Raises:
            InputError: something touches there.
        """
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
    """Angles by which ball joints are below their limits, which bound the norm of their three coordinates.

    Attributes:
        limits: ``(B,)`` angle limits in use [rad].
    """

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
