"""Disturbances of policies: the force of a push and the recovery from it, and a pole that walks into the arm's way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.policies.surroundings import Surroundings
from lieednn_sim.simulation import MovingObstacle
from lieednn_sim.values import Floats

# Duration of a push [s], and the deviation of a joint that it should cause [ranges].
PUSH_TIME, PUSH_DEVIATION = 0.2, 0.1
WALKER = "obstacle_walker"


@dataclass(frozen=True)
class PathRecovery:
    """How an arm recovered; the distance of configurations is the largest difference of a joint over its range."""

    deviation: float  #: largest distance from the path
    #: Time from the disturbance's end until the distance stays below a tenth of ``deviation``; None if it never does.
    time_s: float | None
    fraction: float | None  #: fraction of the path left at the disturbance's begin that was covered by then, or None


class UndisturbedPath:
    """The undisturbed path ``(K, n)`` of an arm, sampled evenly over its length."""

    def __init__(self, arm: Arm, q: Floats) -> None:
        self._range = arm.ranges
        scaled = q / self._range
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(scaled, axis=0), axis=1) + 1e-12))
        self._fractions = np.linspace(0.0, 1.0, 2000)
        columns = [np.interp(self._fractions, length / length[-1], column) for column in scaled.T]
        self._points = np.stack(columns, axis=1)

    def nearest(self, q: Floats) -> tuple[Floats, Floats]:
        """Distances ``(K,)`` of configurations ``(K, n)`` from the path, and the nearest places on it in [0, 1]."""
        distance = cdist(q / self._range, self._points, "chebyshev")
        # Many points may be equally near in the largest joint difference: the Euclidean distance breaks ties.
        index = (distance + 1e-6 * cdist(q / self._range, self._points)).argmin(axis=1)
        return distance[np.arange(len(q)), index], self._fractions[index]

    def recovery(self, t: Floats, q: Floats, begin: float, end: float) -> PathRecovery:
        """How an arm disturbed from ``begin`` to ``end`` [s] recovers; ``q`` is ``(K, n)`` at the times ``t``."""
        after = np.flatnonzero(t >= begin)
        distance, at = self.nearest(q[after])
        deviation = float(distance.max())
        outside = np.flatnonzero(distance > 0.1 * deviation)
        last = int(outside[-1]) + 1 if outside.size else 0
        if last >= len(after):
            return PathRecovery(deviation, None, None)
        back, first = max(last, int(np.searchsorted(t[after], end))), float(at[0])
        back = min(back, len(after) - 1)
        fraction = (float(at[back]) - first) / max(1.0 - first, 1e-9)
        return PathRecovery(deviation, max(float(t[after][back] - end), 0.0), fraction)


def pushing_force(deviation_under: Callable[[float], float]) -> float:
    """Force [N] that makes a joint deviate by 8 to 12 % of its range, or the last one tried; at most 20 kN.

    The force must be found in the run itself: drives resist a growing force almost rigidly up to their limits, then
    yield suddenly, and 1.5 times that force moves the arm ten times as far. The force at which this happens depends on
    the configuration, on the forces that the motion itself needs, and on the policy. ``deviation_under`` maps a force
    to the largest deviation of a joint from the undisturbed path in units of its range.
    """
    # Initial guess [N], largest force [N], and the two brackets, each a force and its deviation.
    force, most, low, high = 300.0, 2e4, (0.0, 0.0), (np.inf, np.inf)
    # Bracketing, then false position in the logarithms.
    for _ in range(12):
        result = deviation_under(force)
        if abs(result / PUSH_DEVIATION - 1.0) < 0.2 or (result < PUSH_DEVIATION and force >= most):
            break
        if result < PUSH_DEVIATION:
            low = force, result
        else:
            high = force, result
        if not np.isfinite(high[0]):
            force = min(force * float(np.clip(PUSH_DEVIATION / max(result, 1e-6), 1.2, 4.0)), most)
        elif low[0] == 0.0:
            force *= float(np.clip(PUSH_DEVIATION / result, 0.1, 0.8))
        else:
            exponent = float(np.clip(np.log(PUSH_DEVIATION / low[1]) / np.log(high[1] / low[1]), 0.1, 0.9))
            force = low[0] * (high[0] / low[0]) ** exponent
    return force


def walking_pole(
    arm: Arm, t: Floats, q: Floats, gone: Floats, begin: float, rng: np.random.Generator
) -> tuple[Arm, MovingObstacle]:
    """The arm with a pole that walks, from ``begin`` on, to a place that the end effector would pass later.

    `PlanError` if there is no such place. The pole waits clear of the whole motion, keeps clear of all configurations
    since ``begin`` while it walks, and stands clear of the last one. The undisturbed motion has times ``t`` ``(K,)``
    [s], joint coordinates ``q`` ``(K, n)`` and fractions of the path ``gone`` ``(K,)``.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=WALKER.removeprefix("obstacle_"))
    # Radius and half the height [m].
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.04, 2.0, 0.0], group=2, rgba=(0.9, 0.72, 0.18, 1.0))
    body.pos = [100.0, 0.0, 0.0]
    beside = replace(arm.with_obstacles(spec, "walk"), scene=arm.scene, scene_seed=arm.scene_seed)
    # The pole keeps 4 cm from the arm while it walks, and 6 cm while it waits, or stands and the arm is at its target.
    before, after, touching = (Surroundings(beside, margin) for margin in (0.04, 0.06, 1e-3))
    tips = np.asarray(arm.link_poses(q).translation)[:, -1]
    # The arm would meet the pole on the second half of the path. The pole walks for 0.6 s, or for 0.6 of the time until
    # the arm passes the last place where it may stand, if that is less.
    stands = begin + min(0.6, 0.6 * (float(t[np.argmax(gone >= 0.95)]) - begin))
    stride = 10
    walking = np.flatnonzero((t >= begin) & (t <= stands))[::stride]
    later = np.flatnonzero((gone >= 0.5) & (gone <= 0.95) & (t > stands))
    if not len(later):
        raise PlanError("the arm is past every place where a pole could stand in its way in time")
    for _ in range(400):
        tip, turn = tips[rng.choice(later)], rng.uniform(-np.pi, np.pi)
        first = tip + 0.6 * np.array([np.cos(turn), np.sin(turn), 0.0])
        obstacle = MovingObstacle(WALKER, (begin, stands), (tuple(first.tolist()), tuple(tip.tolist())))
        meets = _blocks(touching, tip, q[later[::stride]])
        if not meets or _blocks(after, tip, q[-1:]) or _blocks(after, first, q[::stride]):
            continue
        # The pole must not walk into the arm, even if the arm has slowed down since the pole began to walk.
        if not any(_blocks(before, obstacle.at(t[k]), q[walking[walking <= k]]) for k in walking):
            return beside.with_moved_bodies({WALKER: first}), obstacle
    raise PlanError("no place was found where a pole can stand in the arm's way")


def _blocks(look: Surroundings, place: Floats, q: Floats) -> bool:
    """Whether the pole at a place is in the way at one of the configurations ``(K, n)``."""
    look.see({WALKER: place})
    return look.blocked(q, only_moving=True) is not None
