"""The protocol of models of demonstrations, two dynamical systems that follow it, and their integration.

The simplest is linear. The other has local linear laws with a common quadratic Lyapunov function, like SEDS and LPV-DS:
x' = sum_k gamma_k(x) A_k x, with gamma_k the posterior of a Gaussian mixture fitted to the positions, and
P A_k + A_k^T P <= -2 epsilon I for one P: V = x^T P x falls everywhere, so the goal attracts every start
(Khansari-Zadeh and Billard, IEEE T-RO 27(5), 2011; Figueroa and Billard, CoRL 2018). The constraint is built in by
A_k = P^-1 (S_k - D_k D_k^T - epsilon I) with S_k skew, so that fitting the velocities is unconstrained least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import scipy  # its `cluster` is loaded when it is used
from scipy.optimize import least_squares

from lieednn_sim.budget import check_time, one_blas_thread
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, shown_part
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.values import Floats, frozen

DECAY = float(np.log(100.0))  # decay rate, per duration, that leaves a hundredth


class MotionModel(Protocol):
    """A model of a motion to the twist zero, relative to its goal as in `Demonstration.twists`."""

    @property
    def n_parameters(self) -> int:
        """The number of fitted parameters."""

    @property
    def durations(self) -> float:
        """Time after which the motion is almost at its end, in durations of the demonstrations."""

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """Twists ``(..., K, 6)`` at increasing times ``(K,)`` from 0 [s], starting at rest at twists ``(..., 6)``."""


@dataclass(frozen=True)
class LinearAttractor:
    """xi' = -k xi: straight in the chart, with k that leaves a hundredth after the demonstrations' duration."""

    duration: float
    n_parameters: ClassVar[int] = 1
    durations: ClassVar[float] = 3.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int = 1) -> LinearAttractor:
        """Fit k to the duration of the demonstrations; there is always one parameter."""
        return cls(demonstrations.duration)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`."""
        return start[..., None, :] * np.exp(-DECAY / self.duration * t)[:, None]


def run_field(
    field: Callable[[Floats], Floats], start: Floats, grid: Floats, t: Floats, kept: int | None = None
) -> Floats:
    """States ``(n, K, d)`` of x' = field(x) at times ``(K,)``, from states ``(n, d)`` at the first time of a grid.

    The classical Runge-Kutta method on the grid ``(G,)``, with linear interpolation. Only the first ``kept``
    coordinates of each state are returned, by default all.
    """
    state = start
    states = [state[:, :kept]]
    for step in np.diff(grid):
        check_time()
        state = runge_kutta_step(field, state, step)
        states.append(state[:, :kept].copy())  # not a view, which would keep the whole state
    return at_times(np.stack(states, axis=1), grid, t)


def even_grid(end: float, step: float) -> Floats:
    """Evenly spaced times from 0 to at least ``end``."""
    return step * np.arange(float(np.ceil(end / step)) + 1.0)


def at_times(states: Floats, grid: Floats, t: Floats) -> Floats:
    """Linear interpolation of states ``(n, G, d)`` on increasing times ``(G,)`` to times ``(K,)``."""
    index = np.clip(np.searchsorted(grid, t, side="right") - 1, 0, len(grid) - 2)
    fraction = np.clip((t - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)[:, None]
    return (1.0 - fraction) * states[:, index] + fraction * states[:, index + 1]


@frozen
class StableMixture:
    """A fitted mixture of laws, in d coordinates scaled to the demonstrations' extent, in units of their duration."""

    prior: Floats  # (k,) priors of the components
    mean: Floats  # (k, d) means of the components
    factor: Floats  # (k, d, d) Cholesky factors of the inverse covariances
    laws: Floats  # (k, d, d) matrices A_k
    lyapunov: Floats  # (d, d) P
    units: Floats  # (d,) units of the coordinates [rad, m]
    duration: float  # mean duration of the demonstrations [s]

    durations: ClassVar[float] = 3.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int, seed: int = 0) -> StableMixture:
        """Fit as many components as there are parameters to spend, at least one; ``seed`` is for k-means."""
        d, extent = demonstrations.dof, demonstrations.extent
        units = np.full(d, extent)
        if d == 6:
            units[:3] = extent / demonstrations.lever
        # Ten times as many samples gain little.
        chosen = np.unique(np.linspace(0, len(demonstrations.t) - 1, 40 if d == 6 else 60).astype(int))
        states = demonstrations.twists[..., shown_part(d)] / units
        rates = np.gradient(states, demonstrations.t / demonstrations.duration, axis=1)[:, chosen].reshape(-1, d)
        states = states[:, chosen].reshape(-1, d)
        components = max(1, round((n_parameters - d * (d + 1) // 2 + 1) / (1 + d + d * (d + 1) // 2 + d * d)))
        with one_blas_thread():
            prior, mean, factor = _mixture(states, components, np.random.default_rng(seed))
            laws, lyapunov = _laws(_posterior(states, prior, mean, factor), states, rates)
        return cls(prior, mean, factor, laws, lyapunov, units, demonstrations.duration)

    @property
    def n_parameters(self) -> int:
        """The number of parameters of priors, means, covariances, laws and P."""
        k, d = self.mean.shape
        return k * (1 + d + d * (d + 1) // 2 + d * d) - 1 + d * (d + 1) // 2

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`."""
        shown = shown_part(len(self.units))
        twists = np.zeros((start[..., 0].size, len(t), 6))
        first = start.reshape(-1, 6)[:, shown] / self.units
        times = t / self.duration
        twists[..., shown] = run_field(self.velocity, first, even_grid(times[-1], 1.0 / 100.0), times) * self.units
        return twists.reshape(*start.shape[:-1], len(t), 6)

    def velocity(self, x: Floats) -> Floats:
        """Velocities ``(n, d)`` per duration at scaled states ``(n, d)``."""
        gamma = _posterior(x, self.prior, self.mean, self.factor)
        return (gamma.T[..., None] * (x @ self.laws.swapaxes(1, 2))).sum(axis=0)


def _posterior(x: Floats, prior: Floats, mean: Floats, factor: Floats) -> Floats:
    """Posterior ``(n, k)`` at states ``(n, d)``."""
    whitened = (x - mean[:, None]) @ factor
    exponent = np.log(prior * np.linalg.det(factor))[:, None] - 0.5 * (whitened**2).sum(axis=-1)
    weight = np.exp(exponent - exponent.max(axis=0))
    return (weight / weight.sum(axis=0)).T


def _mixture(x: Floats, components: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Priors, means and factors of a Gaussian mixture by expectation maximisation, starting from k-means."""
    d = x.shape[1]
    _, label = scipy.cluster.vq.kmeans2(x, components, minit="++", rng=rng)
    gamma = np.eye(components)[label]
    for _ in range(60):
        count = gamma.sum(axis=0) + 1e-9  # an empty component keeps a tiny prior
        prior, mean = count / count.sum(), gamma.T @ x / count[:, None]
        away = x[:, None] - mean
        covariance = np.einsum("nk,nka,nkb->kab", gamma, away, away) / count[:, None, None]
        # No component is narrower than a hundredth of the extent.
        factor = np.linalg.cholesky(np.linalg.inv(covariance + 1e-4 * np.eye(d)))
        gamma = _posterior(x, prior, mean, factor)
    return prior, mean, factor


def _laws(gamma: Floats, x: Floats, rates: Floats) -> tuple[Floats, Floats]:
    """A_k ``(k, d, d)`` and P ``(d, d)`` by least squares on the velocities.

    The unknowns are the lower triangles of D_k and of C, with P = C C^T, and the entries of S_k below the diagonal.
    """
    d, k = x.shape[1], gamma.shape[1]
    low, below = np.tril_indices(d), np.tril_indices(d, -1)
    sizes = np.cumsum([len(low[0]), k * len(low[0])])
    drive = gamma[:, :, None] * x[:, None]

    def unpack(unknown: Floats) -> tuple[Floats, Floats, Floats]:
        factor, damping, skew = np.zeros((d, d)), np.zeros((k, d, d)), np.zeros((k, d, d))
        parts = np.split(unknown, sizes)
        factor[low] = parts[0]
        damping[:, low[0], low[1]] = parts[1].reshape(k, -1)
        skew[:, below[0], below[1]] = parts[2].reshape(k, -1)
        return factor, damping, skew - skew.swapaxes(1, 2)

    def laws(unknown: Floats) -> tuple[Floats, Floats]:
        factor, damping, skew = unpack(unknown)
        metric = factor @ factor.T + 1e-3 * np.eye(d)
        epsilon = 0.1  # the least decay of V per duration
        inside = skew - damping @ damping.swapaxes(1, 2) - epsilon * np.eye(d)
        return np.asarray(np.linalg.solve(metric, inside), dtype=float), metric

    def residual(unknown: Floats) -> Floats:
        return (np.einsum("kab,nkb->na", laws(unknown)[0], drive) - rates).ravel()

    def jacobian(unknown: Floats) -> Floats:
        factor, damping, _ = unpack(unknown)
        result, metric = laws(unknown)
        inverse = np.linalg.inv(metric)
        predicted = np.einsum("kab,nkb->na", result, drive)
        columns = []
        # d(P^-1) w = -P^-1 dP (P^-1 w), and dP = dC C^T + C dC^T.
        pulled = predicted @ factor
        for i, j in zip(*low, strict=True):
            columns.append(-(pulled[:, j, None] * inverse[:, i] + predicted[:, i, None] * (inverse @ factor[:, j])))
        for w, root in zip(drive.swapaxes(0, 1), damping, strict=True):
            pulled, turned = w @ root, inverse @ root
            for i, j in zip(*low, strict=True):
                columns.append(-(pulled[:, j, None] * inverse[:, i] + w[:, i, None] * turned[:, j]))
        for w in drive.swapaxes(0, 1):
            for i, j in zip(*below, strict=True):
                columns.append(w[:, j, None] * inverse[:, i] - w[:, i, None] * inverse[:, j])
        return np.stack([column.ravel() for column in columns], axis=1)

    first = np.concatenate([np.eye(d)[low], np.tile(np.eye(d)[low], k), np.zeros(k * len(below[0]))])
    fitted = least_squares(residual, first, jacobian, method="trf", max_nfev=40 if d == 6 else 100)
    return laws(fitted.x)
