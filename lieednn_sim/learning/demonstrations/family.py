"""Families of motions: how demonstrations depend on their start, and a network whose motion depends on it as they do.

At equal phases s, demonstration k is x_k(s) = mean(s) + (1 - s) dx_k + B(s) dx_k + noise, with dx_k the deviation
of its start from the mean. B is found by ridge regression, and the ridge by leaving each demonstration out once; with
an infinite ridge, deviations fade as 1 - s. If demonstrations keep their own goals, dg_k from the mean goal, s dg_k is
added, and B(s) acts on (dx_k, dg_k).

Motions from the same start differ by their codes (`synthesis.shaping.cascade`), which are normally distributed: if a
code deviates by c, the visible state at network time tau is that of the family plus b(tau) c, where the row b(tau)
holds the pairs' bumps. As in a probabilistic movement primitive (Paraschos et al., NeurIPS 2013), motions through a via
point are those whose codes are conditioned on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieednn_sim.budget import one_blas_thread
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.synthesis import Shaping
from lieednn_sim.synthesis.shaping.cascade import PAIRS, Cascade, bumps, clockwork, encoder, with_pairs
from lieednn_sim.synthesis.shaping.curve import Curve
from lieednn_sim.values import Floats, frozen

# Ridges that are tried, relative to the mean square deviation of the starts.
RIDGES = np.append(10.0 ** np.arange(-3.0, 1.1, 0.5), np.inf)


@frozen
class Response:
    """How the paths of demonstrations depend on their starts, and on their goals if these differ.

    There are D coordinates, and E = D inputs, or E = 2 D for start and goal.
    """

    gain: Floats  # (K, D, E) derivatives of the path at equal steps of the phase in start and goal
    ridges: tuple[float, float]  # the smallest and the largest of `RIDGES` that were averaged
    # (n, K, D) residuals of the paths, over the square root of 1 - leverage: as large as if the path was not fitted.
    residuals: Floats
    # (E, E) A: if the start (and goal) deviates by u from the mean, the uncertainty of the gain adds u^T A u times the
    # residuals' covariance. A is the inverse of the regression's normal matrix, with the smallest averaged ridge, or if
    # that is infinite with the largest finite one; zero if all starts are the same.
    growth: Floats


def response_to_start(paths: Floats, goals: bool = False) -> Response:
    """Regress paths ``(n, K, D)``, with coordinates in one unit, on their starts, or on their starts and ``goals``.

    The fit is averaged over the ridges from the one with the least left-out error to the largest one that
    `one_standard_error` allows: with few demonstrations, each of these two alone varies much from set to set.
    """
    n, count, size = paths.shape
    away = paths - paths.mean(axis=0)
    fading = (1.0 - np.linspace(0.0, 1.0, count))[:, None, None] * np.eye(size)
    start = away[:, 0]
    if goals:
        fading = np.concatenate([fading, np.eye(size) - fading], axis=2)
        start = np.concatenate([start, away[:, -1]], axis=1)
    # n starts have at most n - 1 directions about their mean; others come from rounding.
    left, spread, right = np.linalg.svd(start, full_matrices=False)
    kept = spread > 1e-9 * max(float(np.abs(paths).max()), 1e-300)
    left, spread, right = left[:, kept], spread[kept], right[kept]
    rest = (away - np.einsum("kij,nj->nki", fading, start)).reshape(n, -1)
    total = max(float(np.sum(spread**2)), 1e-300)
    shrinking = spread**2 / (spread**2 + RIDGES[:, None] * total)
    first, last = len(RIDGES) - 1, len(RIDGES) - 1
    if n > 2 and kept.any():  # if one of two is left out, the other says nothing about starts
        errors = np.empty((len(RIDGES), n))
        for row, factor in enumerate(shrinking):
            hat = left * factor @ left.T
            # A linear smoother's error at a sample that it has not seen, in closed form; 1/n is the mean's part.
            unseen = (rest - hat @ rest) / (1.0 - 1.0 / n - np.diag(hat))[:, None]
            errors[row] = np.linalg.norm(unseen.reshape(n, count, size), axis=2).mean(axis=1)
        first, last = one_standard_error(errors)
    factor = shrinking[first : last + 1].mean(axis=0)
    fitted = (left.T @ rest).reshape(-1, count, size) * (factor / spread)[:, None, None]
    hat = left * factor @ left.T
    free = np.maximum(1.0 - 1.0 / n - np.diag(hat), 1e-9)  # a single path has no residual and leverage 1
    residuals = ((rest - hat @ rest) / np.sqrt(free)[:, None]).reshape(paths.shape)
    growth = np.zeros((start.shape[1],) * 2)
    if kept.any():
        growth = np.linalg.inv(start.T @ start + min(RIDGES[first], RIDGES[-2]) * total * np.eye(len(growth)))
    ridges = float(RIDGES[first]), float(RIDGES[last])
    return Response(fading + np.einsum("rki,rj->kij", fitted, right), ridges, residuals, growth)


def one_standard_error(errors: Floats) -> tuple[int, int]:
    """The row of ``(R, n)`` with the least mean error, and the last row that exceeds it by at most a standard error.

    It is the standard error of the mean of the differences in each demonstration (Breiman et al., Classification and
    Regression Trees, 1984, 3.4.3).
    """
    best = int(errors.mean(axis=1).argmin())
    excess = errors - errors[best]
    doubt = excess.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    return best, int(np.flatnonzero(excess.mean(axis=1) <= doubt)[-1])


@one_blas_thread()
def with_response(
    shaping: Shaping, curve: Floats, paths: Floats, units: Floats, goals: bool = False
) -> tuple[LieEDNN, Response, Floats]:
    """The network shaped by the mean of demonstrations with rho = 1, changed to depend on its start as they do.

    Also the response that it realises, in metres, and the codes ``(n, N, M, 6)`` of its residuals. ``curve`` is the
    mean ``(K, N, 6)``, ``paths`` are the demonstrations ``(n, K, N, 6)`` at the same phases, and ``units`` the metres
    ``(N, 6)`` for a unit of each coordinate. With ``goals``, which must differ, the motion also depends on its goal.
    """
    units = np.broadcast_to(units, curve.shape[1:])
    response = response_to_start((paths * units).reshape(*paths.shape[:2], -1), goals)
    clock = clockwork(1.0, ACTIVATIONS[shaping.network.activation])
    states = Cascade(clock, curve[0], curve[-1]).states(shaping.parameters)[:-1]
    phase, row = _phases(states, curve, units), np.linspace(0.0, 1.0, len(curve))

    def at_instants(curves: Floats) -> Floats:
        flat = curves.reshape(len(curves), -1).T
        return np.stack([np.interp(phase, row, entry) for entry in flat], axis=-1).reshape(-1, *curves.shape[1:])

    scale = units.ravel()
    gain = at_instants(response.gain) / scale[:, None] * np.tile(scale, 1 + goals)
    left = at_instants(response.residuals.swapaxes(0, 1)) / scale
    codes = (encoder(clock) @ left.reshape(len(left), -1)).reshape(PAIRS, -1, *units.shape).transpose(1, 2, 0, 3)
    away = (paths[:, [0, -1]] - curve[[0, -1]])[:, : 1 + goals].reshape(len(paths), -1)
    network = with_pairs(shaping.parameters, clock, shaping.network, curve[0], gain, away, codes)
    return network, response, codes


def _phases(states: Floats, curve: Floats, units: Floats) -> Floats:
    """Phases ``(T,)`` of the points of the mean ``(K, N, 6)`` that are nearest to states ``(T, N, 6)``."""
    # Equal phases of the demonstrations are not equal fractions of their mean's length.
    steps = (np.linalg.norm(np.diff(some, axis=0) * units, axis=(1, 2)) for some in (curve, states))
    passed, covered = (np.append(0.0, np.cumsum(lengths)) for lengths in steps)
    fraction = Curve.through(curve, units).feet(states, covered / covered[-1])
    return np.interp(fraction, passed / passed[-1], np.linspace(0.0, 1.0, len(curve)))


def describe(response: Response | None) -> str:
    """How a network's motion depends on its start, in words."""
    if response is None:
        return "deviations of the start fade as e^-t"
    low, high = (f"{ridge:.3g}" for ridge in response.ridges)
    if np.isinf(response.ridges).all():
        return "the path does not change with the start, which would not predict the other demonstrations better"
    return f"the path changes with the start, by a regression of ridge {low}" + (f" to {high}" if high != low else "")


@frozen
class CodeSpread:
    """Normal distribution of the codes of one visible neuron's motions, about the codes that their start implies.

    For a start (and goal, if there are several) that deviates by u from the mean, in metres, the covariance is
    (1 + 1/n + u^T A u) F F^T: from noise, and from the uncertainty of the mean and of the response (as in a Bayesian
    linear regression, whose prior is the ridge).
    """

    root: Floats  # (6M, r) F, for the codes D delta (M, 6) of M pairs, flat [rad, m]
    count: int  # n, the number of demonstrations
    growth: Floats  # (E, E) A [1/m^2], with E = 6, or 12 for start and goal
    units: Floats  # (6,) metres for a unit of each coordinate
    activation: str  # of the network

    @classmethod
    def of(cls, codes: Floats, growth: Floats, units: Floats, least: Floats, activation: str) -> CodeSpread:
        """The distribution of codes ``(n, M, 6)`` with mean zero, standardised residuals (`Response.residuals`).

        ``least`` ``(6,)`` are standard deviations of the displacement [rad, m] that are added in every direction, also
        where demonstrations do not differ.
        """
        places = np.arange(PAIRS) / PAIRS
        # The added deviations are correlated over a fifth of the clock's range.
        smooth = np.exp(-0.5 * ((places[:, None] - places) / 0.2) ** 2)
        basis = bumps(clockwork(1.0, ACTIVATIONS[activation]))[:-1]
        size, axes = np.linalg.eigh(smooth / np.einsum("km,mn,kn->k", basis, smooth, basis).max())
        allowed = np.kron(axes * np.sqrt(np.maximum(size, 0.0)), np.diag(least))
        root = np.concatenate([codes.reshape(len(codes), -1).T / np.sqrt(len(codes)), allowed], axis=1)
        return cls(root, len(codes), growth, units, activation)

    def scale(self, away: Floats) -> Floats:
        """Factor 1 + 1/n + u^T A u ``(...)`` of the covariance, from deviations ``(..., E)`` of the inputs."""
        u = away * np.tile(self.units, len(self.growth) // 6)
        return np.asarray(1.0 + 1.0 / self.count + np.einsum("...i,ij,...j->...", u, self.growth, u))

    def basis(self, tau: Floats) -> Floats:
        """The bumps ``(T, M)`` at network times ``(T,)``."""
        clock = clockwork(1.0, ACTIVATIONS[self.activation])
        return np.stack([np.interp(tau, clock.t, bump, right=0.0) for bump in bumps(clock)[:-1].T], axis=-1)

    def along(self, tau: Floats) -> Floats:
        """Covariances ``(T, 6, 6)`` of the displacement at network times ``(T,)``, before `scale`."""
        root = np.einsum("tm,mir->tir", self.basis(tau), self.root.reshape(PAIRS, 6, -1))
        return root @ root.swapaxes(1, 2)

    def gain(self, seen: Floats, noise: Floats) -> Floats:
        """Gain ``(6M, o)`` from deviations of o observed coordinates to codes, for motions from the mean start.

        ``seen`` ``(o, 6M)`` are their derivatives in the codes, ``noise`` ``(o,)`` their standard deviations.
        """
        root = seen @ self.root
        doubt = root @ root.T + np.diag(noise**2) / self.scale(np.zeros(len(self.growth)))
        return np.asarray(np.linalg.solve(doubt, root @ self.root.T).T)

    def knowing(self, seen: Floats, noise: Floats) -> CodeSpread:
        """The distribution conditioned on an observation; arguments are as for `gain`."""
        gain = self.gain(seen, noise)
        left = gain * noise / np.sqrt(self.scale(np.zeros(len(self.growth))))
        return replace(self, root=np.concatenate([self.root - gain @ (seen @ self.root), left], axis=1))
