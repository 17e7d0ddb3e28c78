"""Probabilistic movement primitives (Paraschos et al., NeurIPS 2013).

The path is a weighted sum of normalised Gaussian basis functions of the phase, the fraction of the duration. The
weights are normally distributed: they are fitted to each demonstration by least squares, and have a mean and a
covariance over the demonstrations. The motion from a start is the mean of the distribution conditioned on that start,
and on the goal at the end.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part, twist_of
from lieednn_sim.learning.demonstrations.models import at_times
from lieednn_sim.values import Floats, frozen

# Number of instants at which paths are fitted and evaluated.
_INSTANTS = 201
# Standard deviation added to every weight, in extents of the demonstrations: without it, a model of few demonstrations
# could not be conditioned on another start.
_ADDED_DEVIATION = 1e-2


@frozen
class ProbabilisticPrimitive:
    """A fitted primitive: the mean motion given the start and the goal, which is affine in the start.

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
        """Fit as many basis functions as there are parameters to spend, at least two."""
        dof, duration = demonstrations.dof, demonstrations.duration
        shown, scale = shown_part(dof), demonstrations.scale[shown_part(dof)]
        n_basis = max(2, round(n_parameters / dof))
        phases = np.linspace(0.0, 1.0, _INSTANTS)
        basis = _basis(n_basis, phases)
        paths = displacement(at_times(demonstrations.twists, demonstrations.t / duration, phases))[..., shown] * scale
        # Added to the squared singular values of the least squares.
        ridge = 1e-12
        inverse = np.linalg.pinv(basis.T @ basis + ridge * np.eye(n_basis)) @ basis.T
        weights = (inverse @ paths).swapaxes(1, 2).reshape(len(paths), -1)
        centred = weights - weights.mean(axis=0)
        added = (_ADDED_DEVIATION * demonstrations.extent) ** 2 * np.eye(len(centred.T))
        covariance = centred.T @ centred / len(weights) + added
        # Conditioned on both ends at once, the mean is affine in the start.
        ends = np.concatenate([np.kron(np.eye(dof), row) for row in basis[[0, -1]]])
        gain = covariance @ ends.T @ np.linalg.inv(ends @ covariance @ ends.T)
        mean = weights.mean(axis=0) - gain @ ends @ weights.mean(axis=0)
        path, response = np.zeros((_INSTANTS, 6)), np.zeros((_INSTANTS, 6, 6))
        path[:, shown] = basis @ mean.reshape(dof, n_basis).T / scale
        moved = np.einsum("kb,ibj->kij", basis, gain[:, :dof].reshape(dof, n_basis, dof))
        response[:, shown, shown] = moved / scale[:, None] * scale
        return cls(path, response, duration, n_basis * dof)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`; after the duration the motion rests."""
        begin = displacement(start.reshape(-1, 6))
        paths = self.path + np.einsum("kij,nj->nki", self.response, begin)
        path = twist_of(at_times(paths, np.linspace(0.0, self.duration, _INSTANTS), t))
        return path.reshape(*start.shape[:-1], len(t), 6)


def _basis(n_basis: int, phases: Floats) -> Floats:
    """Normalised Gaussians ``(K, B)`` at phases ``(K,)``."""
    squared = (phases[:, None] - np.linspace(0.0, 1.0, n_basis)) ** 2
    # Value of a basis function at 1/(2B) from its centre, about half way to the next, before they are normalised.
    overlap = 0.7
    psi = np.exp(4.0 * n_basis**2 * np.log(overlap) * squared)
    return psi / psi.sum(axis=1, keepdims=True)
