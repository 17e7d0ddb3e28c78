"""How motions of a family differ though their start is the same: a normal distribution of their codes.

The codes are those of `synthesis.shaping.pairs`: with the deviation c of a code, the visible state at network time tau
is that of the family plus b(tau) c, where the row b(tau) holds the pairs' bumps. As in a probabilistic movement
primitive (Paraschos et al., NeurIPS 2013), motions through a via point are those whose codes are conditioned on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieednn_sim.network import ACTIVATIONS
from lieednn_sim.synthesis.shaping.cascade import clockwork
from lieednn_sim.synthesis.shaping.pairs import PAIRS, bumps
from lieednn_sim.values import Floats, frozen


@frozen
class CodeSpread:
    """Normal distribution of the codes of one visible neuron's motions about those that their start gives.

    At u from the mean start (and the mean goal, if there are several), in metres, the covariance is
    (1 + 1/n + u^T A u) F F^T: noise, and the doubt about the mean and about the response (as of a Bayesian linear
    regression, whose prior is the ridge).

    Attributes:
        root: ``(6M, r)`` F, for the codes D delta ``(M, 6)`` of M pairs, flat [rad, m].
        count: n, the number of demonstrations.
        growth: ``(E, E)`` A [1/m^2], with E = 6, or 12 for start and goal.
        units: ``(6,)`` metres for a unit of each coordinate.
        activation: of the network.
    """

    root: Floats
    count: int
    growth: Floats
    units: Floats
    activation: str

    @classmethod
    def of(cls, codes: Floats, growth: Floats, units: Floats, least: Floats, activation: str) -> CodeSpread:
        """The distribution of codes ``(n, M, 6)`` with mean zero.

        Args:
            codes: residuals of n demonstrations, standardised (`Response.residuals`).
            growth: as in the attributes.
            units: as in the attributes.
            least: ``(6,)`` standard deviations of the displacement [rad, m] that are allowed for in any direction, also
                where demonstrations do not differ.
            activation: of the network.
        """
        places = np.arange(PAIRS) / PAIRS
        # Correlation length, in fractions of the clock's way, of the deviations that are allowed for beside those seen.
        smoothness = 0.2
        smooth = np.exp(-0.5 * ((places[:, None] - places) / smoothness) ** 2)
        basis = bumps(clockwork(1.0, ACTIVATIONS[activation]), PAIRS)[:-1]
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
        return np.stack([np.interp(tau, clock.t, bump, right=0.0) for bump in bumps(clock, PAIRS)[:-1].T], axis=-1)

    def along(self, tau: Floats) -> Floats:
        """Covariances ``(T, 6, 6)`` of the displacement at network times ``(T,)``, before `scale`."""
        root = np.einsum("tm,mir->tir", self.basis(tau), self.root.reshape(PAIRS, 6, -1))
        return root @ root.swapaxes(1, 2)

    def gain(self, seen: Floats, noise: Floats) -> Floats:
        """Codes ``(6M, o)`` for an observed deviation of a motion from the mean start.

        Args:
            seen: ``(o, 6M)`` derivatives of what is observed in the codes.
            noise: ``(o,)`` its standard deviations.
        """
        root = seen @ self.root
        doubt = root @ root.T + np.diag(noise**2) / self.scale(np.zeros(len(self.growth)))
        return np.asarray(np.linalg.solve(doubt, root @ self.root.T).T)

    def knowing(self, seen: Floats, noise: Floats) -> CodeSpread:
        """The distribution about the conditioned codes, given the observation as for `gain`."""
        gain = self.gain(seen, noise)
        left = gain * noise / np.sqrt(self.scale(np.zeros(len(self.growth))))
        return replace(self, root=np.concatenate([self.root - gain @ (seen @ self.root), left], axis=1))
