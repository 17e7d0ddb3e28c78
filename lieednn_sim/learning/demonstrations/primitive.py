"""Dynamic movement primitives of position and orientation.

Position: Ijspeert et al., Dynamical movement primitives, Neural Computation 25(2), 2013; orientation: Ude et al.,
Orientation in Cartesian space dynamic movement primitives, ICRA 2014. In units of the duration, relative to the goal,

    p'' = alpha (-beta p - p') + f_p(s),    eta' = alpha (-beta log R - eta) + f_R(s),    R' = hat(eta) R,    s' = -k s,

with f(s) = s sum_b psi_b(s) w_b / sum_b psi_b(s). The forcing is not scaled by the distance from start to goal, which
may be arbitrarily small; the effect of another start decays with alpha.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim.budget import check_time
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part, twist_of
from lieednn_sim.learning.demonstrations.models import DECAY, at_times, even_grid
from lieednn_sim.lie import exp
from lieednn_sim.values import Floats, frozen

# Ijspeert's values: critically damped.
_ALPHA = 25.0
_BETA = _ALPHA / 4.0
# Step of the integrator, in durations; the weights are fitted to exactly these steps.
STEP = 1.0 / 200.0
# Corrections of the weights: positions need one, since rotations are not quite linear in the weights.
_CORRECTIONS = 4
# Relative size below which singular values are not inverted: responses to neighbouring basis functions are similar.
_LEAST_RESPONSE = 1e-6


@frozen
class MovementPrimitive:
    """A fitted primitive.

    Attributes:
        weights: ``(B, 6)`` for rotations [rad] and positions [m]; zero for entries that were not recorded.
        duration: mean duration of the demonstrations [s].
        dof: 2, 3 or 6.
    """

    weights: Floats
    duration: float
    dof: int

    name: ClassVar[str] = "dmp"
    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int) -> MovementPrimitive:
        """Fit as many basis functions as there are parameters to spend, at least two.

        The path is linear in the weights except for the curvature of rotations, so that the least squares are in the
        path itself: no recorded motion is differentiated.
        """
        dof, duration = demonstrations.dof, demonstrations.duration
        shown = shown_part(dof)
        n_basis = max(2, round(n_parameters / dof))
        grid = np.arange(0.0, 1.0 + 0.5 * STEP, STEP)
        wanted = displacement(at_times(demonstrations.twists, demonstrations.t / duration, grid))
        inverse = np.linalg.pinv(_responses(_forcing(n_basis, grid)), rcond=_LEAST_RESPONSE)
        weights = np.zeros((n_basis, 6))
        for _ in range(_CORRECTIONS if dof == 6 else 1):
            model = cls(weights, duration, dof)
            missing = wanted - displacement(model.reproduce(demonstrations.twists[:, 0], duration * grid))
            if dof == 6:
                turns = [Rotation.from_rotvec(path[..., :3].reshape(-1, 3)) for path in (wanted, wanted - missing)]
                missing[..., :3] = (turns[0] * turns[1].inv()).as_rotvec().reshape((*missing.shape[:-1], 3))
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
        drive = _forcing(len(self.weights), grid) @ self.weights
        pose = exp(states)
        turn, position, rate = pose.rotation, pose.translation, np.zeros((len(states), 6))
        path = [displacement(states)]
        for force in drive[:-1]:
            check_time()
            rate = rate + STEP * (_ALPHA * (-_BETA * path[-1] - rate) + force)
            position = position + STEP * rate[:, 3:]
            turned = path[-1][:, :3]
            if self.dof == 6:
                turn = Rotation.from_rotvec(STEP * rate[:, :3]) * turn
                turned = turn.as_rotvec()
            path.append(np.concatenate([turned, position], axis=1))
        shown = twist_of(at_times(np.stack(path, axis=1), grid, t / self.duration))
        return shown.reshape(*start.shape[:-1], len(t), 6)


def _forcing(n_basis: int, grid: Floats) -> Floats:
    """Forcing ``(G, B)`` per unit weight; the basis functions are equally spaced in time."""
    phase = np.exp(-DECAY * grid)[:, None]
    centres = np.exp(-DECAY * np.linspace(0.0, 1.0, n_basis))
    widths = np.abs(np.diff(centres, append=centres[-1] ** 2 / centres[-2]))
    # By logarithms, since far from all centres every function underflows.
    exponent = -(((phase - centres) / widths) ** 2)
    psi = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return phase * psi / psi.sum(axis=1, keepdims=True)


def _responses(forcing: Floats) -> Floats:
    """Paths ``(G, B)`` from rest at zero under forcings ``(G, B)``, by the steps of `reproduce`."""
    path, rate = np.zeros_like(forcing), np.zeros(forcing.shape[1])
    for k in range(1, len(forcing)):
        rate = rate + STEP * (_ALPHA * (-_BETA * path[k - 1] - rate) + forcing[k - 1])
        path[k] = path[k - 1] + STEP * rate
    return path
