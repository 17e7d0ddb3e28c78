"""Out of the way of moving obstacles: where an arm that rests can go before they are there.

Tried are configurations around the present one, within growing parts of the joints' ranges, along each joint and at
random. The one that a straight motion reaches first is taken which stays clear of obstacles, as they move and as they
are now.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PPoly

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.transition import straight
from lieednn_sim.policies.surroundings import Surroundings
from lieednn_sim.values import Floats

# Parts of the ranges within which configurations are tried, and how many at random in each, for each joint.
_PARTS, _RANDOM = (0.05, 0.1, 0.2, 0.4, 0.8), 4
# Shortest evasion, and time from one of the configurations that are looked at to the next [s].
_SOONEST, _STEP = 0.25, 0.08


def evasion(
    arm: Arm,
    places: dict[str, Floats],
    velocities: dict[str, Floats],
    start: Floats,
    margin: float,
    lead: float,
    horizon: float,
    seed: int,
) -> PPoly:
    """A motion from rest to rest out of the way of moving obstacles; its first configuration is the start.

    Args:
        arm: the arm.
        places, velocities: of the obstacles ``(3,)`` [m, m/s], by name, as of `Surroundings`.
        start: ``(n,)`` where the arm rests.
        margin: distance to be kept from them where that is possible, else half of it [m].
        lead, horizon: times until the arm sets off, and for which obstacles are foreseen [s].
        seed: seed of the configurations tried.

    Raises:
        PlanError: there is none.
    """
    tried = _around(arm, start, np.random.default_rng(seed))
    motions = sorted((straight(arm, start, q, _SOONEST) for q in tried), key=lambda motion: motion.x[-1])
    for share in (1.0, 0.5):
        resting, leaving = Surroundings(arm, share * margin), Surroundings(arm, share * margin)
        for around in (resting, leaving):
            around.see(places)
            around.velocities = velocities
        # From where it is too near already, it may leave.
        leaving.leave(start)
        for motion in motions:
            lasts = float(motion.x[-1])
            moving = np.append(np.arange(0.0, lasts, _STEP), lasts)
            after = np.append(np.arange(lead + lasts, horizon, _STEP), max(lead + lasts, horizon))
            q = motion(moving)
            if (
                resting.blocked(q[-1:]) is None
                and resting.nearing(q[-1:].repeat(len(after), axis=0), after) is None
                and leaving.blocked(q) is None
                and leaving.nearing(q, lead + moving) is None
            ):
                return motion
    raise PlanError(f"none of {len(motions)} configurations around stays free and can be reached")


def _around(arm: Arm, start: Floats, rng: np.random.Generator) -> Floats:
    """Configurations ``(C, n)`` to be tried."""
    n, parts = arm.n_joints, np.array(_PARTS)[:, None, None]
    axes = parts * np.concatenate([np.eye(n), -np.eye(n)])
    steps = np.concatenate([axes, parts * rng.uniform(-1.0, 1.0, (len(_PARTS), _RANDOM * n, n))], axis=1)
    q = np.clip(start + arm.ranges * steps.reshape(-1, n), *arm.position_limits.T)
    return q[(arm.limit_excess(q) <= 0.0).all(axis=1) & (np.abs(q - start) > 0.01 * arm.ranges).any(axis=1)]
