"""Movement primitives of position and orientation, dynamic and probabilistic.

Dynamic ones. Position: Ijspeert et al., Dynamical movement primitives, Neural Computation 25(2), 2013; orientation: Ude
et al., Orientation in Cartesian space dynamic movement primitives, ICRA 2014. In units of the duration, relative to the
goal,

    p'' = alpha (-beta p - p') + f_p(s),    eta' = alpha (-beta log R - eta) + f_R(s),    R' = hat(eta) R,    s' = -k s,

with f(s) = s sum_b psi_b(s) w_b / sum_b psi_b(s). The forcing is not scaled by the distance from start to goal, which
may be arbitrarily small; the effect of another start decays with alpha.

Probabilistic ones (Paraschos et al., NeurIPS 2013). The path is a weighted sum of normalised Gaussian basis functions
of the phase, the fraction of the duration. The weights are normally distributed: they are fitted to each demonstration
by least squares, and have a mean and a covariance over the demonstrations. The motion from a start is the mean of the
distribution conditioned on that start, and on the goal at the end.
"""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lieednn_sim.budget import check_time
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part
from lieednn_sim.learning.demonstrations.models import DECAY, at_times, even_grid
from lieednn_sim.lie import exp
from lieednn_sim.lie.se3 import turns_near, twist_of
from lieednn_sim.values import Floats, frozen, read_only

ALPHA = 25.0  # Ijspeert's values: critically damped
BETA = ALPHA / 4.0
STEP = 1.0 / 200.0  # step of the integrator, in durations; the weights are fitted to exactly these steps
_INSTANTS = 201  # number of instants at which paths of probabilistic primitives are fitted and evaluated


@frozen
class DynamicPrimitive:
    """A dynamic movement primitive, fitted to demonstrations."""

    weights: Floats  # (B, 6) for rotations [rad] and positions [m]; zero for entries that were not recorded
    duration: float  # mean duration of the demonstrations [s]
    dof: int  # 2, 3 or 6

    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int) -> DynamicPrimitive:
        """Fit as many basis functions as there are parameters to spend, at least two.

        The path is linear in the weights except for the curvature of rotations, so that the least squares are in the
        path itself: no recorded motion is differentiated.
        """
        dof, duration = demonstrations.dof, demonstrations.duration
        shown = shown_part(dof)
        n_basis = max(2, round(n_parameters / dof))
        grid = np.arange(0.0, 1.0 + 0.5 * STEP, STEP)
        target = displacement(at_times(demonstrations.twists, demonstrations.t / duration, grid))
        # Responses to neighbouring basis functions are similar, so small singular values are not inverted.
        inverse = np.linalg.pinv(responses(forcing(n_basis, np.exp(-DECAY * grid)), STEP), rcond=1e-6)
        weights = np.zeros((n_basis, 6))
        # Corrections of the weights: positions need one, rotations more, as they are not quite linear in the weights.
        for _ in range(4 if dof == 6 else 1):
            model = cls(weights, duration, dof)
            missing = target - displacement(model.reproduce(demonstrations.twists[:, 0], duration * grid))
            if dof == 6:
                turns = [Rotation.from_rotvec(path[..., :3].reshape(-1, 3)) for path in (target, target - missing)]
                turned = (turns[0] * turns[1].inv()).as_rotvec().reshape((*missing.shape[:-1], 3))
                missing[..., :3] = turns_near(turned, missing[..., :3])
            weights = weights.copy()
            weights[:, shown] += inverse @ missing.mean(axis=0)[:, shown]
        return cls(weights, duration, dof)

    @property
    def n_parameters(self) -> int:
        """The number of weights of recorded entries."""
        return len(self.weights) * self.dof

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`."""
        states = start.reshape(-1, 6)
        grid = even_grid(t[-1] / self.duration, STEP)
        drive = forcing(len(self.weights), np.exp(-DECAY * grid)) @ self.weights
        pose = exp(states)
        turn, position, rate = pose.rotation, pose.translation, np.zeros((len(states), 6))
        path = [displacement(states)]
        for force in drive[:-1]:
            check_time()
            rate = rate + STEP * (ALPHA * (-BETA * path[-1] - rate) + force)
            position = position + STEP * rate[:, 3:]
            turned = path[-1][:, :3]
            if self.dof == 6:
                turn = Rotation.from_rotvec(STEP * rate[:, :3]) * turn
                turned = turns_near(turn.as_rotvec(), turned)  # which may be more than half a turn
            path.append(np.concatenate([turned, position], axis=1))
        shown = twist_of(at_times(np.stack(path, axis=1), grid, t / self.duration))
        return shown.reshape(*start.shape[:-1], len(t), 6)


def forcing(n_basis: int, phase: Floats, decay: float = DECAY) -> Floats:
    """Forcing ``(G, B)`` per unit weight at phases ``(G,)``, which fall from 1 at the start to e^-k, k the decay.

    The B >= 2 basis functions are equally spaced in time.
    """
    centres, widths = _basis(n_basis, decay)
    # By logarithms, since far from all centres every function underflows.
    exponent = -(((phase[:, None] - centres) / widths) ** 2)
    psi = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return phase[:, None] * psi / psi.sum(axis=1, keepdims=True)


@lru_cache(maxsize=8)  # cached, since a policy asks at every step
def _basis(n_basis: int, decay: float) -> tuple[Floats, Floats]:
    """Centres and widths ``(B,)`` of the basis functions, in the phase."""
    centres = np.exp(-decay * np.linspace(0.0, 1.0, n_basis))
    return read_only(centres), read_only(np.abs(np.diff(centres, append=centres[-1] ** 2 / centres[-2])))


def responses(forces: Floats, step: float) -> Floats:
    """Positions ``(G, B)`` from rest at zero under forces ``(G, B)``, ``step`` durations apart.

    The semi-implicit Euler method, p' += step (alpha (-beta p - p') + f) and then p += step p', is a recursion in p.
    """
    stiffness, damping = step**2 * ALPHA * BETA, step * ALPHA
    recursion = [1.0, stiffness + damping - 2.0, 1.0 - damping]
    # `scipy.signal` is loaded on this use: its import takes as long as that of all of `planning`, and few need it.
    return np.asarray(scipy.signal.lfilter([0.0, step**2], recursion, forces, axis=0))


@frozen
class ProbabilisticPrimitive:
    """A fitted probabilistic primitive: the mean motion given the start and the goal, which is affine in the start."""

    path: Floats  # (K, 6) rotations and positions from a start at the goal [rad, m], at equal steps of the duration
    response: Floats  # (K, 6, 6) derivatives of the path in the coordinates of the start
    duration: float  # mean duration of the demonstrations [s]
    n_parameters: int  # number of weights of recorded entries; the covariance is not counted

    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int) -> ProbabilisticPrimitive:
        """Fit as many basis functions as there are parameters to spend, at least two."""
        dof, duration = demonstrations.dof, demonstrations.duration
        shown, scale = shown_part(dof), demonstrations.scale[shown_part(dof)]
        n_basis = max(2, round(n_parameters / dof))
        phases = np.linspace(0.0, 1.0, _INSTANTS)
        # Gaussians (K, B), normalised after they were 0.7 at 1/(2B) from their centres, about half way to the next.
        psi = np.exp(4.0 * n_basis**2 * np.log(0.7) * (phases[:, None] - np.linspace(0.0, 1.0, n_basis)) ** 2)
        basis = psi / psi.sum(axis=1, keepdims=True)
        paths = displacement(at_times(demonstrations.twists, demonstrations.t / duration, phases))[..., shown] * scale
        ridge = 1e-12  # added to the squared singular values of the least squares
        inverse = np.linalg.pinv(basis.T @ basis + ridge * np.eye(n_basis)) @ basis.T
        weights = (inverse @ paths).swapaxes(1, 2).reshape(len(paths), -1)
        centred = weights - weights.mean(axis=0)
        # Otherwise a model of few demonstrations could not be conditioned on another start.
        added = (1e-2 * demonstrations.extent) ** 2 * np.eye(len(centred.T))
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
