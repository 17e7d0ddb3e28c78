"""Probabilistic movement primitives (Paraschos et al., NeurIPS 2013) by `movement_primitives`, an optional library.

The path is a weighted sum of normalised Gaussian basis functions of the share of the duration. The weights are normally
distributed: they are fitted to each demonstration by least squares, and have a mean and a covariance over the
demonstrations. The motion from a start is the mean of the distribution conditioned on that start, and on the goal at
the end.
"""

from __future__ import annotations

import importlib.util
from typing import ClassVar

import numpy as np

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part, twist_of
from lieednn_sim.learning.demonstrations.models import at_times
from lieednn_sim.values import Floats, frozen

# The required libraries, and how to install them; the first imports the second without declaring it.
LIBRARIES = ("movement_primitives", "pytransform3d")
INSTALL = "pip install 'lieednn_sim[dmp]' (needs a C compiler and Python's headers)"
# Number of instants at which paths are fitted and evaluated.
_INSTANTS = 201
# Standard deviation added to every weight, in extents of the demonstrations: without it, a model of few demonstrations
# could not be conditioned on another start.
_DOUBT = 1e-2


@frozen
class ProbabilisticPrimitive:
    """The mean of a fitted primitive, given a start and the goal: affine in the start.

    Attributes:
        path: ``(K, 6)`` rotations and positions from a start at the goal [rad, m], at equal steps of the duration.
        response: ``(K, 6, 6)`` derivatives of the path in the coordinates of the start.
        duration: mean duration of the demonstrations [s].
        n_parameters: number of weights of recorded entries; the covariance is not counted.
    """

    path: Floats
    response: Floats
    duration: float
    n_parameters: int

    name: ClassVar[str] = "promp"
    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int) -> ProbabilisticPrimitive:
        """Fit as many basis functions as there are parameters to spend, at least two.

        Raises:
            LieEDNNError: movement_primitives is not installed.
        """
        if missing_library():
            raise LieEDNNError(f"the rival {cls.name!r} needs movement_primitives: {INSTALL}")
        from movement_primitives.promp import ProMP

        dof, duration = demonstrations.dof, demonstrations.duration
        shown = shown_part(dof)
        n_basis = max(2, round(n_parameters / dof))
        shares = np.linspace(0.0, 1.0, _INSTANTS)
        paths = displacement(at_times(demonstrations.twists, demonstrations.t / duration, shares))
        scale = demonstrations.scale[shown]
        # The least squares do not couple coordinates.
        single = ProMP(1, n_basis)
        weights = np.array(
            [
                [single.weights(shares.copy(), column[:, None]) for column in path.T]
                for path in paths[..., shown] * scale
            ]
        ).reshape(len(paths), -1)
        doubt = (_DOUBT * demonstrations.extent) ** 2 * np.eye(weights.shape[1])
        centred = weights - weights.mean(axis=0)
        told = ProMP(dof, n_basis).from_weight_distribution(
            weights.mean(axis=0), centred.T @ centred / len(weights) + doubt
        )
        told = told.condition_position(np.zeros(dof), t=1.0)
        # The conditional mean is affine in the start: evaluated at the goal, and one unit away in each coordinate.
        drawn = np.array(
            [
                told.condition_position(start, t=0.0).mean_trajectory(shares.copy()) / scale
                for start in (np.zeros(dof), *np.diag(scale))
            ]
        )
        path, response = np.zeros((_INSTANTS, 6)), np.zeros((_INSTANTS, 6, 6))
        path[:, shown] = drawn[0]
        response[:, shown, shown] = (drawn[1:] - drawn[0]).transpose(1, 2, 0)
        return cls(path, response, duration, n_basis * dof)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`; after the duration it rests."""
        begin = displacement(start.reshape(-1, 6))
        ways = self.path + np.einsum("kij,nj->nki", self.response, begin)
        path = twist_of(at_times(ways, np.linspace(0.0, self.duration, _INSTANTS), t))
        return path.reshape(*start.shape[:-1], len(t), 6)


def missing_library() -> str | None:
    """The first library that is not installed; None where all are."""
    return next((name for name in LIBRARIES if importlib.util.find_spec(name) is None), None)
