"""Where a model of demonstrations leads from random starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.learning.demonstrations import Demonstrations
from lieednn_sim.learning.demonstrations.alignment import displacement, twist_of
from lieednn_sim.learning.demonstrations.models import MotionModel
from lieednn_sim.validation import Seed, as_count, as_generator
from lieednn_sim.values import Floats

# Durations after which it is decided whether a start has arrived.
HORIZON = 10.0
# In units of the demonstrations' extent: distance from the goal that counts as arrived, motion per duration that counts
# as rest, and distance between points of rest that count as one attractor.
ARRIVED, AT_REST, ONE_ATTRACTOR = 1e-2, 1e-4, 5e-2
# Largest rotation of a random start from the goal [rad].
LARGEST_TURN = 0.9 * np.pi
# Number of starts run at once, limited by memory.
_BATCH = 500


@dataclass(frozen=True)
class Attraction:
    """Where random starts ended, after `HORIZON` durations.

    Attributes:
        starts: number of starts.
        arrived: number of them that ended within a hundredth of the demonstrations' extent from the goal.
        spurious: number of spurious attractors, places other than the goal at which starts came to rest.
    """

    starts: int
    arrived: int
    spurious: int


def random_starts(demonstrations: Demonstrations, count: int, seed: Seed = 0) -> Floats:
    """Random twists ``(count, 6)`` around the demonstrations.

    Positions are uniform in their bounding box, extended on all sides by its longest side; rotations, where poses were
    recorded, have a random axis and an angle of up to 162 degrees from the goal.
    """
    rng = as_generator("seed", seed)
    count = as_count("count", count)
    place = demonstrations.displaced[..., 3:].reshape(-1, 3)
    low, high = place.min(axis=0), place.max(axis=0)
    margin = np.ptp(place, axis=0).max()
    starts = np.zeros((count, 6))
    starts[:, 3:] = rng.uniform(low - margin, high + margin, (count, 3))
    if demonstrations.dof == 6:
        axis = rng.normal(size=(count, 3))
        starts[:, :3] = rng.uniform(0.0, LARGEST_TURN, (count, 1)) * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    elif demonstrations.dof == 2:
        starts[:, 5] = 0.0
    return twist_of(starts)


def attraction(model: MotionModel, demonstrations: Demonstrations, starts: Floats) -> Attraction:
    """Run a model from start twists ``(n, 6)``; in distances a radian counts as the demonstrations' ``lever`` [m]."""
    t = demonstrations.duration * np.array([0.0, HORIZON - 1.0, HORIZON])
    batches = [starts[k : k + _BATCH] for k in range(0, len(starts), _BATCH)]
    before, ends = (
        np.concatenate([displacement(model.reproduce(batch, t)[:, 1:]) for batch in batches])
        * demonstrations.scale
        / demonstrations.extent
    ).swapaxes(0, 1)
    arrived = np.linalg.norm(ends, axis=1) < ARRIVED
    resting = ends[~arrived & (np.linalg.norm(ends - before, axis=1) < AT_REST)]
    spurious = 0
    while len(resting):
        spurious += 1
        resting = resting[np.linalg.norm(resting - resting[0], axis=1) > ONE_ATTRACTOR]
    return Attraction(len(starts), int(arrived.sum()), spurious)
