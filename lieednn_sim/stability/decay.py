"""The proved bound on the distance from an equilibrium, as time passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.stability.guarantees import UP, spectral_norm
from lieednn_sim.stability.robustness import Robustness
from lieednn_sim.validation import as_count, as_floats
from lieednn_sim.values import Floats


class Decay:
    """How far a network may still be from its equilibrium, by proof, a time after it was some way off.

    With e the state minus the equilibrium, a guarantee |T e(t)| <= k exp(-r t) |T e(0)| bounds the first m coordinates
    by |e_m(t)| <= |T^-1_m| k exp(-r t) |T e(0)|, where T^-1_m are the first m rows. The least bound of all guarantees
    is taken.

    Args:
        bounds: bounds for pushes that reach all n coordinates, see `robustness`.
        watched: number m of the coordinates whose distance is bounded, the first ones.

    Raises:
        InputError: the bounds leave coordinates out, or there are fewer than m.
    """

    def __init__(self, bounds: Robustness, watched: int) -> None:
        if bounds.others is not None:
            raise InputError("bounds must be for pushes that reach all coordinates")
        self.watched = as_count("watched", watched, 1, len(bounds.reached))
        rows = slice(self.watched)
        self._factors = np.array(
            [g.overshoot * UP * spectral_norm(g.inverse[rows]) * g.factor for g in bounds.guarantees]
        )
        self._rates = np.array([g.rate for g in bounds.guarantees])

    def begin(self, off: ArrayLike) -> Floats:
        """The bounds ``(g,)`` of all guarantees for a state that is off its equilibrium by e ``(n,)`` now."""
        return np.asarray(np.linalg.norm(self._factors @ as_floats("off", off, self._factors.shape[-1:]), axis=1))

    def bound(self, begun: ArrayLike, time: float) -> float:
        """The largest |e_m| a time after `begin` returned ``begun``, in the network's time."""
        begun = as_floats("begun", begun, self._rates.shape)
        return float((begun * np.exp(-self._rates * as_floats("time", time, ()))).min())
