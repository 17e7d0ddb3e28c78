"""What a policy knows of moving obstacles: where they are, whether they are in the way, and paths around them."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.contacts import ContactFinder, colliding_geoms, fixed_body, moving_geoms
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions, rrt_connect
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.validation import as_floats, quoted
from lieednn_sim.values import Floats


class Surroundings:
    """The arm's scene with moving obstacles at their last known places.

    A moving obstacle is in the way if it is nearer than the margin [m], everything else if nearer than the arm's
    clearance. Positions ``(3,)`` of the moving obstacles' bodies are in `places`, by name; empty before any was seen.
    """

    def __init__(self, arm: Arm, margin: float) -> None:
        self._arm, self._margin, self._kept = arm, margin, margin
        bare = arm.without_visuals
        self._model = bare.geometry
        self._all = bare.contact_finder(arm.clearance)
        # Sees nothing but pairs of the arm and a moving obstacle.
        self._near: ContactFinder | None = None
        self.places: dict[str, Floats] = {}

    def see(self, places: Mapping[str, Floats]) -> None:
        """Take note of the places; raises `InputError` for names of no obstacles."""
        seen = {name: as_floats(f"the place of {quoted(name)}", place, (3,)) for name, place in places.items()}
        if not seen.keys() <= self.places.keys():
            self._near = ContactFinder(self._pairs_of({*self.places, *seen}), self._margin)
        self.places.update(seen)
        for finder in filter(None, (self._all, self._near)):
            finder.move(self.places)

    def blocked(self, q: Floats, *, only_moving: bool = False) -> tuple[int, str] | None:
        """Index of the first of the configurations ``(K, n)`` at which something is in the way, and its body's name."""
        finders = [each for each in (None if only_moving else self._all, self._near) if each is not None]
        for index, qpos in enumerate(self._arm.qpos(q)):
            for finder in finders:
                distance, result = finder.geoms(qpos)
                if len(result) and finder is self._near:
                    result = self._near_pairs(distance, result, self._kept)[1]
                if len(result):
                    first, second = result[0]
                    obstacle = first if self._model.body_weldid[self._model.geom_bodyid[first]] == 0 else second
                    return index, self._model.body(self._model.geom_bodyid[obstacle]).name
        return None

    def leave(self, q: Floats) -> None:
        """Let the arm, at ``q`` ``(n,)``, get away from a moving obstacle that is nearer than the margin already.

        Until this is called again, something is in the way only below four fifths of that distance.
        """
        if self._near is not None:
            distance, _ = self._near_pairs(*self._near.geoms(self._arm.qpos(q)), self._margin)
            self._kept = min(self._margin, 0.8 * max(float(distance.min(initial=np.inf)), 0.0))

    def _near_pairs(self, distance: Floats, pairs: NDArray[np.int_], margin: float) -> tuple[Floats, NDArray[np.int_]]:
        """Those of the pairs ``(C, 2)`` and their distances that have a moving obstacle within a margin."""
        # Explicit pairs of the model collide whatever their types.
        near = self._moved[pairs].any(axis=1) & (distance < margin)
        return distance[near], pairs[near]

    def _pairs_of(self, names: set[str]) -> mujoco.MjModel:
        """The arm's model, in which its moving parts collide with the bodies of these names, and nothing else does."""
        model = copy.deepcopy(self._model)
        colliding, parts = colliding_geoms(model), moving_geoms(model)
        bodies = {fixed_body(model, name) for name in names}
        along = np.array([not bodies.isdisjoint(ancestry(model, part)) for part in range(model.nbody)])
        self._moved = moved = along[model.geom_bodyid]
        model.geom_contype[:], model.geom_conaffinity[:] = colliding & moved, colliding & parts
        return model


def search_path(
    arm: Arm,
    places: Mapping[str, Floats],
    ends: tuple[Floats, Floats],
    margin: float,
    options: RrtConnectOptions,
    seed: int,
) -> Future[Motion]:
    """Search for a path by RRT-Connect in a thread of its own; the result depends on the arguments alone.

    It keeps the margin [m] from moving obstacles, in their places, where its ends, start and target ``(n,)``, allow it.
    Asked for its result, the motion raises `LieEDNNError` if there is no path, or OMPL is not installed.
    """
    seen = dict(places)

    def search() -> Motion:
        refused: InputError | None = None
        # With less of the margin where start or target are nearer than that.
        for share in (1.0, 0.5, 0.0):
            there = arm.with_moved_bodies(seen, share * margin)
            try:
                # Nearly every motion needs more than this, and gets it.
                problem = PlanningProblem(there, *ends, duration=0.5, longest=50.0, seed=seed)
            except InputError as error:
                refused = error
                continue
            return rrt_connect(problem, options)
        raise PlanError(str(refused))

    return _worker(os.getpid()).submit(search)


@cache
def _worker(_: int) -> ThreadPoolExecutor:
    # One for each process, since threads do not survive a fork; one thread, since OMPL's random numbers are global.
    return ThreadPoolExecutor(1, "replanning")
