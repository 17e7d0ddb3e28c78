"""Out of the way of moving obstacles: where an arm at rest can go, and how, before they are there.

Tried are configurations around the present one, within growing parts of the joints' ranges, along each joint and at
random. The one that a straight motion reaches first is taken which stays clear of obstacles, as these move and as they
are now. If no straight motion does, RRT-Connect searches for paths to the nearest ones at which the arm may rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly

from lieednn_sim.arm import Arm
from lieednn_sim.errors import LieEDNNError, PlanError
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.transition import straight
from lieednn_sim.policies.searching import aside
from lieednn_sim.policies.surroundings import Surroundings, path_around
from lieednn_sim.values import Floats

# Parts of the ranges within which configurations are tried, and how many at random in each, for each joint.
_PARTS, _RANDOM = (0.05, 0.1, 0.2, 0.4, 0.8), 4
# Shortest evasion [s], and time between the configurations of one that are looked at.
_SOONEST, _STEP = 0.25, 0.08
# Paths searched for, and configurations tested for each at most: there is no time for more.
_PATHS, _TESTS = 2, 2000


@dataclass(frozen=True, eq=False)
class Threat:
    """What an arm is to evade.

    Attributes:
        places, velocities: of the moving obstacles ``(3,)`` [m, m/s], as of `Surroundings`.
        lead: time until the arm sets off [s].
        horizon: time for which obstacles are foreseen [s].
    """

    places: Mapping[str, Floats]
    velocities: Mapping[str, Floats]
    lead: float
    horizon: float

    def seen(self, arm: Arm, margin: float) -> Surroundings:
        """The surroundings with these obstacles."""
        around = Surroundings(arm, margin)
        around.see(self.places)
        around.velocities = dict(self.velocities)
        return around


def search_refuge(
    arm: Arm, threat: Threat, start: Floats, margin: float, options: RrtConnectOptions, seed: int
) -> Future[PPoly]:
    """Search for an evasion beside the control loop (`searching.aside`); the result depends on the arguments alone.

    Asked for what was `found`, it raises `PlanError` if there is none.

    Args:
        arm, threat: the arm, and what it is to evade.
        start: ``(n,)`` where the arm rests, or can.
        margin: distance to be kept from moving obstacles where that is possible, else half of it [m].
        options: of RRT-Connect.
        seed: seed of the configurations tried, and of RRT-Connect.
    """
    return aside(arm, _evasion, threat, start, margin, options, seed)


def _evasion(arm: Arm, threat: Threat, start: Floats, margin: float, options: RrtConnectOptions, seed: int) -> PPoly:
    tried = _around(arm, start, np.random.default_rng(seed))
    motions = sorted((straight(arm, start, q, _SOONEST) for q in tried), key=lambda motion: motion.x[-1])
    brief = replace(options, max_collision_checks=(_TESTS,))
    for share in (1.0, 0.5):
        resting, leaving = (threat.seen(arm, share * margin) for _ in range(2))
        # Where it is too near already, it may leave.
        leaving.leave(start)
        refuges = []
        for motion in motions:
            if _may_rest(resting, threat, motion):
                if _is_clear(leaving, threat, motion):
                    return motion
                refuges.append(motion(motion.x[-1]))
        for refuge in refuges[:_PATHS]:
            try:
                path = path_around(arm, dict(threat.places), (start, refuge), share * margin, brief, seed)
            except LieEDNNError:
                continue
            if _is_clear(leaving, threat, path):
                return path
    raise PlanError(f"none of {len(motions)} configurations around stays free and can be reached")


def _around(arm: Arm, start: Floats, rng: np.random.Generator) -> Floats:
    """Configurations ``(C, n)`` to be tried."""
    n, parts = arm.n_joints, np.array(_PARTS)[:, None, None]
    away = np.concatenate([np.eye(n), -np.eye(n)])
    steps = np.concatenate([parts * away, parts * rng.uniform(-1.0, 1.0, (len(_PARTS), _RANDOM * n, n))], axis=1)
    q = np.clip(start + arm.ranges * steps.reshape(-1, n), *arm.position_limits.T)
    return q[(arm.limit_excess(q) <= 0.0).all(axis=1) & (np.abs(q - start) > 0.01 * arm.ranges).any(axis=1)]


def _may_rest(around: Surroundings, threat: Threat, motion: PPoly) -> bool:
    """Whether the end of a motion is clear, and stays so from when the arm is there on."""
    end, there = motion(motion.x[-1])[None], threat.lead + float(motion.x[-1])
    times = np.append(np.arange(there, threat.horizon, _STEP), max(there, threat.horizon))
    return around.blocked(end) is None and around.nearing(end.repeat(len(times), axis=0), times) is None


def _is_clear(around: Surroundings, threat: Threat, motion: PPoly) -> bool:
    """Whether a motion is clear of everything now, and of obstacles as they move."""
    times = np.append(np.arange(0.0, motion.x[-1], _STEP), motion.x[-1])
    q = motion(times)
    return around.blocked(q) is None and around.nearing(q, threat.lead + times) is None
