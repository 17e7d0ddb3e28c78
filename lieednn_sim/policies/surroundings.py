"""What a policy knows of moving obstacles: where they are, whether they are in the way, and ways around them."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.contacts import ContactFinder, colliding_geoms, fixed_body, moving_geoms
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions, rrt_connect
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.transition import BaseMotion, along, straight
from lieednn_sim.validation import as_floats, quoted
from lieednn_sim.values import Floats

_Vectors = dict[str, Floats]  # places [m] or velocities [m/s] ``(3,)`` of bodies by name

_LOOKS = 3  # periods over which velocities are averaged


class Surroundings:
    """The arm's scene with moving obstacles at their last known places.

    Moving obstacles are in the way if nearer than the margin [m], everything else if nearer than the arm's clearance.

    Attributes:
        places: positions ``(3,)`` of the moving obstacles' bodies [m], by name; empty before any was seen.
        velocities: velocities ``(3,)`` [m/s] of the obstacles that move, by name, at the last `look`; may be set.
        touching: name of the obstacle that touched the arm at the last call of `leave`; empty if none did.
    """

    def __init__(self, arm: Arm, margin: float) -> None:
        self._arm, self._margin, self._kept, self.touching = arm, margin, margin, ""
        bare = arm.without_visuals
        self._model = bare.geometry
        self._all = bare.contact_finder(arm.clearance)
        # Finds only pairs of the arm and a moving obstacle.
        self._near: ContactFinder | None = None
        self.places: dict[str, Floats] = {}
        self.velocities: dict[str, Floats] = {}
        self._seen = deque[dict[str, Floats]](maxlen=_LOOKS + 1)

    def see(self, places: Mapping[str, Floats]) -> None:
        """Take note of the places; raises `InputError` for a name that is no obstacle's."""
        seen = {name: as_floats(f"the place of {quoted(name)}", place, (3,)) for name, place in places.items()}
        if not seen.keys() <= self.places.keys():
            self._near = ContactFinder(self._pairs_of({*self.places, *seen}), self._margin)
        self.places.update(seen)
        for finder in filter(None, (self._all, self._near)):
            finder.move(self.places)

    def look(self, period: float) -> None:
        """Note where obstacles are, one period [s] after the last time, to know their velocities.

        These are means over the last `_LOOKS` periods.
        """
        self._seen.append(dict(self.places))
        first, span = self._seen[0], period * (len(self._seen) - 1)
        gone = {name: place - first.get(name, place) for name, place in self.places.items()}
        self.velocities = {name: way / span for name, way in gone.items() if way.any()}

    def blocked(self, q: Floats, *, only_moving: bool = False) -> tuple[int, str] | None:
        """Index of the first of the configurations ``(K, n)`` at which something is in the way, and its body's name."""
        positions = self._arm.to_qpos(q)
        begin = 0 if self._near is not None or only_moving else self._all.first(positions)
        for index, qpos in enumerate(positions[begin:], begin):
            if (found := self._in_the_way(qpos, only_moving)) is not None:
                return index, self._obstacle_of(found[1][0])
        return None

    def nearing(self, q: Floats, after: Floats) -> tuple[int, str] | None:
        """As `blocked`, by moving obstacles only, predicted with their `velocities`.

        The arm is at the configurations ``(K, n)`` after the times ``(K,)`` [s].
        """
        if self._near is None or not self.velocities:
            return None
        bodies = np.array([self._model.body(name).id for name in self.velocities])
        now, velocity = np.array([self.places[name] for name in self.velocities]), np.array([*self.velocities.values()])
        try:
            for index, (qpos, time) in enumerate(zip(self._arm.qpos(q), after.tolist(), strict=True)):
                self._near.put(bodies, now + time * velocity)
                if (found := self._in_the_way(qpos, only_moving=True)) is not None:
                    return index, self._obstacle_of(found[1][0])
            return None
        finally:
            self._near.put(bodies, now)

    def nearest(self, q: Floats) -> tuple[str, str, float]:
        """Names of the two nearest bodies at ``q`` ``(n,)``, where something is in the way, and their distance [m]."""
        found = self._in_the_way(self._arm.qpos(q), only_moving=False)
        assert found is not None
        distance, pairs = found
        first, second = self._model.geom_bodyid[pairs[distance.argmin()]]
        return self._model.body(first).name, self._model.body(second).name, float(distance.min())

    def _in_the_way(self, qpos: Floats, only_moving: bool) -> tuple[Floats, NDArray[np.int_]] | None:
        """Distances ``(C,)`` and pairs ``(C, 2)`` of geoms too near at positions ``(nq,)``; moving obstacles first."""
        for finder in (self._near, None if only_moving else self._all):
            if finder is None:
                continue
            distance, pairs = finder.geoms(qpos)
            if not len(pairs):
                continue
            if finder is self._near:
                distance, pairs = self._near_pairs(distance, pairs, self._kept)
            elif self._near is not None:
                other = ~self._moved[pairs].any(axis=1)
                distance, pairs = distance[other], pairs[other]
            if len(pairs):
                return distance, pairs
        return None

    def leave(self, q: Floats) -> None:
        """Let the arm, at ``q`` ``(n,)``, get away from a moving obstacle that is nearer than the margin already.

        Until the next call, a moving obstacle is in the way only below four fifths of that distance or, if it touches
        the arm, where it is a fifth deeper.
        """
        if self._near is not None:
            distance, pairs = self._near_pairs(*self._near.geoms(self._arm.qpos(q)), self._margin)
            least = float(distance.min(initial=np.inf))
            self._kept = min(self._margin, least - 0.2 * abs(least))
            self.touching = self._obstacle_of(pairs[distance.argmin()]) if least < 0.0 else ""

    @property
    def near(self) -> bool:
        """Whether a moving obstacle is nearer than the margin, so that the arm must leave it."""
        return self._kept < self._margin

    def _obstacle_of(self, pair: NDArray[np.int_]) -> str:
        """Name of the body of a pair of geoms ``(2,)`` that the arm does not move."""
        first, second = pair
        obstacle = first if self._model.body_weldid[self._model.geom_bodyid[first]] == 0 else second
        return str(self._model.body(self._model.geom_bodyid[obstacle]).name)

    def _near_pairs(self, distance: Floats, pairs: NDArray[np.int_], margin: float) -> tuple[Floats, NDArray[np.int_]]:
        """Distances and pairs, out of those of pairs ``(C, 2)``, in which a moving obstacle is within a margin."""
        # Explicit pairs of the model collide whatever their types.
        near = self._moved[pairs].any(axis=1) & (distance < margin)
        return distance[near], pairs[near]

    def _pairs_of(self, names: set[str]) -> mujoco.MjModel:
        """The arm's model, in which its moving parts collide with the bodies of these names, and with nothing else."""
        model = copy.deepcopy(self._model)
        colliding, parts = colliding_geoms(model), moving_geoms(model)
        bodies = {fixed_body(model, name) for name in names}
        along = np.array([not bodies.isdisjoint(ancestry(model, part)) for part in range(model.nbody)])
        self._moved = moved = along[model.geom_bodyid]
        model.geom_contype[:], model.geom_conaffinity[:] = colliding & moved, colliding & parts
        return model


def path_around(
    arm: Arm, places: _Vectors, ends: tuple[Floats, Floats], margin: float, options: RrtConnectOptions, seed: int
) -> BaseMotion:
    """A path by RRT-Connect, as `transition.along` makes it; the result depends on the arguments alone.

    It keeps the margin [m] from moving obstacles at ``places`` if its ``ends``, start and target ``(n,)``, allow it.
    `LieEDNNError` if there is no path, or OMPL is not installed.
    """
    refused = ""
    # Less of the margin is kept if start or target are nearer than that.
    for share in (1.0, 0.5, 0.0):
        there = arm.with_moved_bodies(places, share * margin)
        try:
            # Nearly every motion needs a longer duration than this, and gets it.
            problem = PlanningProblem(there, *ends, duration=0.5, longest=50.0, seed=seed)
        except InputError as error:
            refused = str(error)
            continue
        return along(arm, rrt_connect(problem, options))
    raise PlanError(refused)


def evasion(
    arm: Arm,
    places: _Vectors,
    velocities: _Vectors,
    start: Floats,
    margin: float,
    lead: float,
    horizon: float,
    seed: int,
) -> BaseMotion:
    """A motion from rest at ``start`` ``(n,)`` to rest out of the way of moving obstacles, before they arrive.

    Configurations around the start are tried in the order in which straight motions reach them. The first one is taken
    at which, and on the way to which, the arm stays clear of obstacles as they move; `PlanError` if there is none.

    Args:
        places, velocities: those of the obstacles ``(3,)`` [m, m/s], by name, as in `Surroundings`.
        margin: distance to keep from them if possible, otherwise half of it [m].
        lead, horizon: times until the arm sets off, and for which obstacles are foreseen [s].
    """
    tried = _around(arm, start, np.random.default_rng(seed))
    # No motion takes less than a quarter of a second.
    motions = sorted((straight(arm, start, q, 0.25) for q in tried), key=lambda motion: motion.x[-1])
    step = 0.08  # time between configurations that are checked [s]
    for share in (1.0, 0.5):
        resting, leaving = Surroundings(arm, share * margin), Surroundings(arm, share * margin)
        for around in (resting, leaving):
            around.see(places)
            around.velocities = velocities
        # An arm that is too near already may move away.
        leaving.leave(start)
        for motion in motions:
            lasts = float(motion.x[-1])
            moving = np.append(np.arange(0.0, lasts, step), lasts)
            after = np.append(np.arange(lead + lasts, horizon, step), max(lead + lasts, horizon))
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
    """Configurations ``(C, n)`` within growing parts of the joints' ranges, along each joint and at random."""
    n, parts = arm.n_joints, np.array([0.05, 0.1, 0.2, 0.4, 0.8])[:, None, None]
    axes = parts * np.concatenate([np.eye(n), -np.eye(n)])
    steps = np.concatenate([axes, parts * rng.uniform(-1.0, 1.0, (len(parts), 4 * n, n))], axis=1)
    q = np.clip(start + arm.ranges * steps.reshape(-1, n), *arm.position_limits.T)
    return q[(arm.limit_excess(q) <= 0.0).all(axis=1) & (np.abs(q - start) > 0.01 * arm.ranges).any(axis=1)]
