"""Probabilistic movement primitives (Paraschos et al., NeurIPS 2013) by `movement_primitives`, an optional library.

The path at a share of the duration is a sum of normalised Gaussian bumps in it. Their weights are normally
distributed: of each demonstration they are found by least squares, and have a mean and a covariance over the
demonstrations. The motion from a start is the mean of the distribution given that start at the beginning, and the goal
at the end.
"""

from __future__ import annotations

import importlib.util
from typing import ClassVar

import numpy as np

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part, twist_of
from lieednn_sim.learning.demonstrations.models import at_times
from lieednn_sim.values import Floats, frozen

# What it needs, and what installs it; the library imports the second and does not say so.
LIBRARIES = ("movement_primitives", "pytransform3d")
INSTALL = "pip install 'lieednn_sim[dmp]' (needs a C compiler and Python's headers)"
# Shares of the duration at which paths are fitted and drawn.
_INSTANTS = 201
# Standard deviation of every weight beside what the demonstrations show, in their extent: without it few demonstrations
# could not be conditioned on a start elsewhere.
_DOUBT = 1e-2


@frozen
class ProbabilisticPrimitive:
    """The mean of a fitted primitive, given a start and the goal: affine in the start.

    Attributes:
        path: ``(K, 6)`` turns and positions from a start at the goal [rad, m], at equal steps of the duration.
        response: ``(K, 6, 6)`` what each coordinate of the start adds to that.
        duration: of the demonstrations [s].
        n_parameters: weights of what was shown: the mean's. The covariance's are not counted.
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

        freedoms, duration = demonstrations.freedoms, demonstrations.duration
        shown = shown_part(freedoms)
        n_basis = max(2, round(n_parameters / freedoms))
        shares = np.linspace(0.0, 1.0, _INSTANTS)
        paths = displacement(at_times(demonstrations.twists, demonstrations.t / duration, shares))
        scale = demonstrations.scale[shown]
        # One coordinate after another: the least squares do not couple them.
        single = ProMP(1, n_basis)
        weights = np.array(
            [
                [single.weights(shares.copy(), column[:, None]) for column in path.T]
                for path in paths[..., shown] * scale
            ]
        ).reshape(len(paths), -1)
        doubt = (_DOUBT * demonstrations.extent) ** 2 * np.eye(weights.shape[1])
        centred = weights - weights.mean(axis=0)
        told = ProMP(freedoms, n_basis).from_weight_distribution(
            weights.mean(axis=0), centred.T @ centred / len(weights) + doubt
        )
        told = told.condition_position(np.zeros(freedoms), t=1.0)
        # The mean given a start is affine in it: from the goal itself, and from each unit beside it.
        drawn = np.array(
            [
                told.condition_position(start, t=0.0).mean_trajectory(shares.copy()) / scale
                for start in (np.zeros(freedoms), *np.diag(scale))
            ]
        )
        path, response = np.zeros((_INSTANTS, 6)), np.zeros((_INSTANTS, 6, 6))
        path[:, shown] = drawn[0]
        response[:, shown, shown] = (drawn[1:] - drawn[0]).transpose(1, 2, 0)
        return cls(path, response, duration, n_basis * freedoms)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`; after the duration it rests."""
        begin = displacement(start.reshape(-1, 6))
        ways = self.path + np.einsum("kij,nj->nki", self.response, begin)
        path = twist_of(at_times(ways, np.linspace(0.0, self.duration, _INSTANTS), t))
        return path.reshape(*start.shape[:-1], len(t), 6)


def missing_library() -> str | None:
    """The first library that is not installed; None where all are."""
    return next((name for name in LIBRARIES if importlib.util.find_spec(name) is None), None)
