"""The manifold onto which projective learning projects: blocks alpha_ij Ad(theta_ij), or quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.lie import adjoint, project_to_adjoint, project_to_adjoint_exact, project_to_scaled_adjoint
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.base import flatten_blocks
from lieednn_sim.network.componentwise import HopfieldNetwork
from lieednn_sim.theory import GroupLieEDNN
from lieednn_sim.theory.groups import group
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.values import Floats, frozen

Network = LieEDNN | GroupLieEDNN | HopfieldNetwork

_SMALLEST_ALPHA = 1e-9  # least |alpha| in W/alpha: a block without strength has no direction


@frozen
class WeightPoint:
    """Weights on the manifold: strengths ``(N, N)``, L[Ad(theta_ij)] ``(N, N, d, d)``, and theta.

    ``elements`` holds theta as arguments of the network's constructor.
    """

    alpha: Floats
    adjoints: Floats
    elements: dict[str, Any]

    @property
    def weight(self) -> Floats:
        """Flat W, ``(Nd, Nd)``."""
        return flatten_blocks(self.alpha[:, :, None, None] * self.adjoints)


class SE3Weights:
    """Adjoint blocks of SE(3)."""

    dimension = 6

    def project(self, weight: Floats, alpha: Floats, kind: str, near: WeightPoint | None = None) -> WeightPoint:
        """Project weights ``(Nd, Nd)``; ``kind`` is a projection of `TrainingOptions`, and "scaled" ignores alpha.

        ``near`` is a point from which a search may start; no projection here needs it.
        """
        blocks = block_view(weight, 6)
        if kind == "scaled":
            alpha, rotation, translation = project_to_scaled_adjoint(blocks)
        else:
            alpha = guarded(alpha)
            nearest = project_to_adjoint_exact if kind == "exact" else project_to_adjoint
            rotation, translation = nearest(blocks / alpha[:, :, None, None])
        return self.point(alpha, {"rotation": rotation, "translation": translation})

    def point(self, alpha: Floats, elements: dict[str, NDArray[Any]]) -> WeightPoint:
        """The point with given strengths and elements."""
        return WeightPoint(alpha, adjoint(elements["rotation"], elements["translation"]), elements)

    def network(self, point: WeightPoint, bias: Floats, rates: dict[str, Any]) -> LieEDNN:
        """The network with these weights."""
        return LieEDNN(point.alpha, **point.elements, bias=bias, **rates)


class GroupWeights:
    """Adjoint blocks of any matrix Lie group; its projection is the Frobenius-nearest one."""

    def __init__(self, group: MatrixLieGroup) -> None:
        self.group = group
        self.dimension = group.dimension

    def project(self, weight: Floats, alpha: Floats, kind: str, near: WeightPoint | None = None) -> WeightPoint:
        """See `SE3Weights`; "block-wise" is the same as "exact"."""
        blocks = block_view(weight, self.dimension)
        start = None if near is None else near.elements["theta"]
        if kind != "scaled":
            alpha = guarded(alpha)
            return self.point(alpha, {"theta": self._nearest(blocks, alpha, start)})
        # Starting from its own strengths, a point on the manifold is its own projection. The nearer of both signs wins.
        size = near.alpha if near is not None else np.linalg.norm(blocks, axis=(-2, -1)) / np.sqrt(self.dimension)
        points = [self._alternate(blocks, guarded(sign * size), start) for sign in (1.0, -1.0)]
        far = [np.linalg.norm(blocks - p.alpha[:, :, None, None] * p.adjoints, axis=(-2, -1)) for p in points]
        first = far[0] <= far[1]
        theta = np.where(first[:, :, None, None], points[0].elements["theta"], points[1].elements["theta"])
        return self.point(np.where(first, points[0].alpha, points[1].alpha), {"theta": theta})

    def _alternate(self, blocks: Floats, alpha: Floats, start: NDArray[Any] | None) -> WeightPoint:
        """Alternate between the best element for the strengths and the best strengths for the element."""
        for _ in range(3):
            start = self._nearest(blocks, alpha, start)
            adjoints = self.group.adjoint(start)
            best = np.einsum("ijab,ijab->ij", blocks, adjoints) / np.einsum("ijab,ijab->ij", adjoints, adjoints)
            alpha = guarded(best)
        return self.point(alpha, {"theta": np.asarray(start)})

    def _nearest(self, blocks: Floats, alpha: Floats, start: NDArray[Any] | None) -> NDArray[Any]:
        return self.group.project_to_adjoint(blocks / alpha[:, :, None, None], start)

    def point(self, alpha: Floats, elements: dict[str, NDArray[Any]]) -> WeightPoint:
        """The point with given strengths and elements."""
        return WeightPoint(alpha, self.group.adjoint(elements["theta"]), elements)

    def network(self, point: WeightPoint, bias: Floats, rates: dict[str, Any]) -> GroupLieEDNN:
        """See `SE3Weights`."""
        return GroupLieEDNN(self.group, point.alpha, **point.elements, bias=bias, **rates)


class QuaternionWeights:
    """Blocks that multiply quaternions (w, x, y, z) from the left, |omega_ij| L(omega_ij / |omega_ij|)."""

    dimension = 4

    def project(self, weight: Floats, alpha: Floats, kind: str, near: WeightPoint | None = None) -> WeightPoint:
        """See `SE3Weights`; "scaled" is the orthogonal projection onto the linear space of blocks."""
        # L(1), L(i), L(j), L(k) are orthogonal, with norm 2.
        quaternion = np.einsum("ijab,cab->ijc", block_view(weight, 4), _LEFT) / 4.0
        length = np.linalg.norm(quaternion, axis=-1)
        unit = quaternion / np.maximum(length, np.finfo(float).tiny)[..., None]
        return self.point(length if kind == "scaled" else alpha, {"quaternion": unit})

    def point(self, alpha: Floats, elements: dict[str, NDArray[Any]]) -> WeightPoint:
        """The point with given strengths and elements."""
        return WeightPoint(alpha, np.tensordot(elements["quaternion"], _LEFT, axes=1), elements)

    def network(self, point: WeightPoint, bias: Floats, rates: dict[str, Any]) -> HopfieldNetwork:
        """See `SE3Weights`."""
        return HopfieldNetwork(point.weight, bias, **rates)


WeightManifold = SE3Weights | GroupWeights | QuaternionWeights
_LEFT = np.asarray(group("H^x").basis)


def guarded(alpha: Floats) -> Floats:
    """Strengths kept away from zero, with their signs."""
    return np.where(np.abs(alpha) < _SMALLEST_ALPHA, np.copysign(_SMALLEST_ALPHA, alpha), alpha)


def block_view(weight: Floats, dimension: int) -> Floats:
    """Blocks ``(N, N, d, d)`` of a flat matrix ``(Nd, Nd)``."""
    n = len(weight) // dimension
    return weight.reshape(n, dimension, n, dimension).transpose(0, 2, 1, 3)
