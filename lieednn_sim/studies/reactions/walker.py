"""A pole that walks into the way of an arm during its motion, and stays there."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.policies.surroundings import Surroundings
from lieednn_sim.simulation import MovingObstacle
from lieednn_sim.values import Floats

WALKER = "obstacle_walker"
# Radius and half the height of the pole, how far it walks [m], for how long at most [s], and as a fraction of the time
# until the last place where it may stand.
_RADIUS, _HALF, _WAY, _WALK, _SHARE = 0.04, 2.0, 0.6, 0.6, 0.6
# Fractions of the path between which the arm would meet it.
_PLACES = (0.5, 0.95)
# Distances from the arm that it keeps until it stands, and leaves at the target [m]; and tries to find a place.
_BEFORE, _AFTER, _TRIALS = 0.04, 0.06, 400
_STRIDE = 10


class Walk(NamedTuple):
    """An arm with a pole beside it, and how that walks."""

    arm: Arm
    obstacle: MovingObstacle


def walking_pole(arm: Arm, t: Floats, q: Floats, gone: Floats, begin: float, rng: np.random.Generator) -> Walk:
    """A pole that walks from ``begin`` on to a place that the arm's end effector would pass later.

    It waits clear of the whole way, keeps clear of where the arm is while it walks, and has been since ``begin``, and
    stands clear of the arm's last posture.

    Args:
        arm: the arm, in its scene.
        t: ``(K,)`` times of the undisturbed motion [s].
        q: ``(K, n)`` its joint coordinates.
        gone: ``(K,)`` the fraction of the path gone at these times.
        begin: when it begins to walk [s].
        rng: draws places.

    Raises:
        PlanError: no such place was found.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=WALKER.removeprefix("obstacle_"))
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[_RADIUS, _HALF, 0.0], group=2, rgba=(0.9, 0.72, 0.18, 1.0))
    body.pos = [100.0, 0.0, 0.0]
    beside = replace(arm.with_obstacles(spec, "walk"), scene=arm.scene, scene_seed=arm.scene_seed)
    before, after, touching = (Surroundings(beside, margin) for margin in (_BEFORE, _AFTER, 1e-3))
    tips = np.asarray(arm.link_poses(q).translation)[:, -1]
    stands = begin + min(_WALK, _SHARE * (float(t[np.argmax(gone >= _PLACES[1])]) - begin))
    walking = np.flatnonzero((t >= begin) & (t <= stands))[::_STRIDE]
    later = np.flatnonzero((gone >= _PLACES[0]) & (gone <= _PLACES[1]) & (t > stands))
    if not len(later):
        raise PlanError("the arm is past every place where a pole could stand in its way in time")
    for _ in range(_TRIALS):
        tip, turn = tips[rng.choice(later)], rng.uniform(-np.pi, np.pi)
        first = tip + _WAY * np.array([np.cos(turn), np.sin(turn), 0.0])
        obstacle = MovingObstacle(WALKER, (begin, stands), (tuple(first.tolist()), tuple(tip.tolist())))
        meets = _blocks(touching, tip, q[later[::_STRIDE]])
        if not meets or _blocks(after, tip, q[-1:]) or _blocks(after, first, q[::_STRIDE]):
            continue
        # It walks into no arm, not even into one that has slowed down since it began.
        if not any(_blocks(before, obstacle.at(t[k]), q[walking[walking <= k]]) for k in walking):
            return Walk(beside.with_moved_bodies({WALKER: first}), obstacle)
    raise PlanError("no place was found where a pole can stand in the arm's way")


def _blocks(look: Surroundings, place: Floats, q: Floats) -> bool:
    """Whether the pole at a place is in the way at one of the configurations ``(K, n)``."""
    look.see({WALKER: place})
    return look.blocked(q, only_moving=True) is not None
