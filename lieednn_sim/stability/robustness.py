"""How far a push throws a network, for how long, how far it lags behind a moving target, and which time steps are safe.

A push moves only the coordinates that it reaches through W; the others stay on their course. So everything is proved on
the submatrix of the coordinates reached; in a cascade, a push on the last layer involves that layer alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.stability.certificate import known_or_found
from lieednn_sim.stability.contraction import find_contraction
from lieednn_sim.stability.guarantees import UP, Guarantee, by_contraction, by_lyapunov, spectral_norm
from lieednn_sim.stability.norms import as_weight
from lieednn_sim.validation import as_choice, as_count, as_floats, as_positive, quoted
from lieednn_sim.values import Floats, frozen

Indices = NDArray[np.intp]

#: Integrators with fixed time steps for which `Robustness.largest_step` proves a largest step.
INTEGRATORS_WITH_PROOF = ("Euler", "RK4")


@frozen
class Robustness:
    """Bounds on the effect of a perturbation of the state, and on the lag behind a target that moves.

    A push is a sudden change of some coordinates of the state. Each bound is the best one of several proofs.

    Sizes are Euclidean, in the units of the state (rad for omega, m for v); times are the network's own.

    Attributes:
        pushed: flat coordinates that a push may move, ascending.
        reached: those that it eventually moves, ``(m,)``, ascending.
        guarantees: guarantees that all hold; every method uses the sharpest one.
        others: the bounds for the coordinates that are not reached; None if all are. Only the largest time step depends
            on them, since the steps of a run must suit all coordinates.
    """

    pushed: Indices
    reached: Indices
    guarantees: tuple[Guarantee, ...]
    others: Robustness | None = None

    @property
    def contracting(self) -> Robustness | None:
        """The guarantees by contraction, which hold between any two motions; None if there are none."""
        chosen = tuple(guarantee for guarantee in self.guarantees if guarantee.contracting)
        return replace(self, guarantees=chosen) if chosen else None

    def push_gain(self, pushed: ArrayLike | None = None, watched: ArrayLike | None = None) -> float:
        """Largest deviation at any time after a push of size 1: sup over t of |e_watched(t)| / |e_pushed(0)|.

        Args:
            pushed: flat coordinates that the push moves, among `pushed`; all of them by default.
            watched: flat coordinates of the effect; by default, all that may be pushed.
        """
        return min(guarantee.overshoot * gain for guarantee, gain in self._gains(pushed, watched))

    def settling_time(
        self, fraction: float, pushed: ArrayLike | None = None, watched: ArrayLike | None = None
    ) -> float:
        """Time after which |e_watched| stays below ``fraction`` of the push's size; arguments as in `push_gain`."""
        part = as_positive("fraction", fraction)
        gains = self._gains(pushed, watched)
        return min(max(0.0, float(np.log(g.overshoot * gain / part)) / g.rate) if gain else 0.0 for g, gain in gains)

    def lag(self, moved: ArrayLike | None = None, watched: ArrayLike | None = None) -> float:
        """Largest |e_watched| behind an equilibrium that moves at speed 1 in ``moved``, starting without lag.

        The equilibrium moves by the bias b(t) = (gamma/mu) x*(t) - W phi(x*(t)). A larger initial lag decays to this
        one like a push. Arguments are as in `push_gain`; the unit is that of the state per unit of speed: network time.
        """
        return min(guarantee.delay * gain for guarantee, gain in self._gains(moved, watched))

    def largest_step(self, method: str) -> float:
        """Largest time step with which fixed steps by ``method``, one of `INTEGRATORS_WITH_PROOF`, keep the proof.

        Each step then brings two runs closer together (contraction), or one closer to the equilibrium, in the
        guarantee's norm or function U: first in the coordinates that no push reaches and, as these come to rest, in the
        others. So the run ends where the network does. The result is in network time. Methods whose weights are not all
        positive, such as the adaptive RK45, have no proof here.
        """
        euler = as_choice("method", method, INTEGRATORS_WITH_PROOF) == "Euler"
        largest = max(guarantee.euler_step if euler else guarantee.rk4_step for guarantee in self.guarantees)
        return largest if self.others is None else min(largest, self.others.largest_step(method))

    def __str__(self) -> str:
        scope = "any motion" if self.contracting else "the equilibrium"
        best = self.contracting or self
        return (
            f"a push of size 1 leads the state at most {best.push_gain():.3g} away from {scope}, and less than 0.1 "
            f"after {best.settling_time(0.1):.3g} of the network's time\n"
            f"a target that moves by 1 per unit of that time is followed at a distance of at most {self.lag():.3g}\n"
            f"the proof holds for time steps up to {self.largest_step('Euler'):.3g} (Euler) or "
            f"{self.largest_step('RK4'):.3g} (RK4), not for the adaptive RK45"
        )

    def _gains(self, pushed: ArrayLike | None, watched: ArrayLike | None) -> list[tuple[Guarantee, float]]:
        """Largest |T e| of a unit push times the largest |e_watched| of a unit |T e|, for each guarantee."""
        n = len(self.reached) + (0 if self.others is None else len(self.others.reached))
        moved = self.pushed if pushed is None else flat_coordinates("pushed", pushed, n)
        if not np.isin(moved, self.pushed).all():
            raise InputError(f"pushed must name some of the coordinates {self.pushed.tolist()}, got {moved.tolist()}")
        seen = self.pushed if watched is None else flat_coordinates("watched", watched, n)
        columns, rows = np.isin(self.reached, moved), np.isin(self.reached, seen)
        norm = spectral_norm
        # Coordinates that the push does not reach never move.
        return [(g, norm(g.factor[:, columns]) * norm(g.inverse[rows]) * UP) for g in self.guarantees]


def robustness(
    weight: ArrayLike,
    *,
    gamma: float = 1.0,
    mu: float = 1.0,
    pushed: ArrayLike | None = None,
    rotational_weight: ArrayLike | None = None,
    lyapunov_diagonal: ArrayLike | None = None,
) -> Robustness:
    """Prove bounds on pushes, moving targets and time steps, for x' = -gamma x + mu W phi(x) + mu b.

    Args:
        weight, gamma, mu, lyapunov_diagonal: as for `assess`.
        pushed: flat coordinates that pushes and targets may move, all by default.
        rotational_weight: W_R, ``(3N, 3N)``, on which proofs are searched for.

    Raises:
        InputError: shapes disagree, or a coordinate does not exist.
        NotCertifiedError: the coordinates that the push reaches are not certified.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    moved = np.arange(n) if pushed is None else flat_coordinates("pushed", pushed, n)
    reached = np.isin(np.arange(n), moved)
    while (wider := reached | matrix[:, reached].any(axis=1)).sum() > reached.sum():
        reached = wider
    # The coordinates of W_R that belong to those reached; S of W follows from S of W_R, for each weight of v.
    twists = rotational_weight is not None
    core = matrix if rotational_weight is None else as_floats("rotational_weight", rotational_weight, (n // 2, n // 2))
    kept = reached.reshape(-1, 2, 3).any(axis=1).ravel() if twists else reached
    part = core[np.ix_(kept, kept)]
    diagonal = lyapunov_diagonal
    known = None if diagonal is None else as_floats("lyapunov_diagonal", diagonal, (len(core),))[kept]
    certificate = known_or_found(known, part, gamma=gamma, mu=mu)
    if not certificate.valid:
        raise NotCertifiedError(f"nothing is proved about pushes without a certificate ({certificate})")
    contraction = find_contraction(part, gamma=gamma, mu=mu, lyapunov_diagonal=certificate.lyapunov_diagonal)
    inner = matrix[np.ix_(reached, reached)]
    guarantees: list[Guarantee] = []
    # Weights of v against omega: with smaller ones, the coupling of omega to v costs less rate, but more size.
    translation_weights = (1.0, 0.25, 0.06, 0.015, 0.004, 1e-4)
    for weight_of_v in translation_weights if twists else (1.0,):

        def whole(diagonal: Floats, factor: float = weight_of_v) -> Floats:
            log_scale = np.zeros(len(core))
            log_scale[kept] = 0.5 * np.log(diagonal)
            if twists:
                each = log_scale.reshape(-1, 3)
                log_scale = np.stack([each, each + np.log(factor)], axis=1).ravel()
            return np.asarray(log_scale[reached], np.float64)

        for power in (1.0, 0.0):  # rounder norms (power 0) prove slower rates and smaller effects
            guarantees += by_contraction(inner, whole(contraction.multiplier**power), contraction, gamma, mu)
            guarantees += by_lyapunov(inner, whole(certificate.lyapunov_diagonal**power), gamma, mu)
    if not guarantees:
        raise NotCertifiedError("the certificate is too near its bound for proofs about pushes")
    others = None
    if not reached.all():
        # The others are not affected by the reached ones. They need not be whole twists, so the proof is on W itself.
        rest = matrix[np.ix_(~reached, ~reached)]
        every, alone = np.arange(len(rest)), not rest.any()  # if each decays on its own, one stands for all
        others = robustness(rest[:1, :1] if alone else rest, gamma=gamma, mu=mu)
        others = replace(others, pushed=every, reached=every)
    return Robustness(moved, np.flatnonzero(reached), tuple(guarantees), others)


def flat_coordinates(name: str, value: ArrayLike, n: int) -> Indices:
    """The flat coordinates, out of n, that a value names: ascending, without repetitions, at least one."""
    try:
        # The length is checked before the value is copied.
        given = np.empty(0) if len(value) > n else np.unique(np.asarray(value))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        given = np.empty(0)
    # Masks and fractions would be mistaken for other coordinates.
    if given.dtype.kind not in "iu" or not len(given) or given[0] < 0 or given[-1] >= n:
        raise InputError(f"{name} must name coordinates from 0 to {n - 1} by whole numbers, got {quoted(value)}")
    return given.astype(np.intp)


class Decay:
    """A proved bound of a network's distance from its equilibrium, a time after it was some distance off.

    With e the state minus the equilibrium, a guarantee |T e(t)| <= k exp(-r t) |T e(0)| bounds the first m coordinates
    by |e_m(t)| <= |T^-1_m| k exp(-r t) |T e(0)|, where T^-1_m are the first m rows. The least of all bounds is taken.

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
        sizes = [g.overshoot * UP * spectral_norm(g.inverse[: self.watched]) for g in bounds.guarantees]
        self._factors = np.array([size * g.factor for size, g in zip(sizes, bounds.guarantees, strict=True)])
        self._rates = np.array([g.rate for g in bounds.guarantees])

    def begin(self, off: ArrayLike) -> Floats:
        """The bounds ``(g,)`` of all guarantees for a state that is off its equilibrium by e ``(n,)`` now."""
        return np.asarray(np.linalg.norm(self._factors @ as_floats("off", off, self._factors.shape[-1:]), axis=1))

    def bound(self, begun: ArrayLike, time: float) -> float:
        """The largest |e_m| a time after `begin` returned ``begun``, in the network's time."""
        begun = as_floats("begun", begun, self._rates.shape)
        return float((begun * np.exp(-self._rates * as_floats("time", time, ()))).min())
