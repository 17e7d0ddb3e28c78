"""LieEDNN on any matrix Lie group (paper, Sec. 3.2 and App. D)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.network.base import as_rates, as_strengths
from lieednn_sim.network.componentwise import DEFAULT_ACTIVATION, ComponentwiseNetwork, as_activation
from lieednn_sim.theory import groups
from lieednn_sim.theory.matrix_group import MatrixLieGroup, as_numbers
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen, read_only, set_fields


@frozen
class GroupLieEDNN(ComponentwiseNetwork):
    """The paper's network on any matrix Lie group.

    It is X_i' = -gamma X_i + mu sum_j alpha_ij theta_ij phi(X_j) theta_ij^-1 + mu B_i in the Lie algebra (paper,
    eq. 3.9).

    The state ``(..., N, d)`` holds the coordinates of X_i in the basis of the group, and phi acts on each of them: the
    network depends on the basis. theta_ij matters only up to the kernel of Ad: SU(2) gives the networks of SO(3).

    Attributes:
        group: the group, with d coordinates and m x m matrices.
        alpha: ``(N, N)`` connection strengths.
        theta: ``(N, N, m, m)`` group elements; i receives, j sends.
        bias: ``(N, d)``.
        gamma, mu: decay rate and scale of the interaction, positive.
        activation: a name of `ACTIVATIONS`.
        lyapunov_diagonal: ``(dN,)`` diagonal of P that certifies the whole W, or None. Checked by `certificate`.

    Raises:
        InputError: wrong shapes, entries that are not finite, or theta outside the group.
    """

    group: MatrixLieGroup
    alpha: Floats
    theta: NDArray[Any]
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = DEFAULT_ACTIVATION
    lyapunov_diagonal: Floats | None = None

    _kind: ClassVar[str] = "group-network"

    def __post_init__(self) -> None:
        alpha = as_strengths(self.alpha)
        n, d = len(alpha), self.group.dimension
        diagonal = self.lyapunov_diagonal
        set_fields(
            self,
            alpha=alpha,
            theta=_as_elements(self.group, self.theta, n),
            bias=as_floats("bias", self.bias, (n, d)),
            **as_rates(self.gamma, self.mu),
            activation=as_activation(self.activation),
            lyapunov_diagonal=None if diagonal is None else as_floats("lyapunov_diagonal", diagonal, (n * d,)),
        )

    @cached_property
    def blocks(self) -> Floats:
        """Weight blocks alpha_ij L[Ad(theta_ij)], ``(N, N, d, d)``."""
        return read_only(self.alpha[:, :, None, None] * self.group.adjoint(self.theta))

    def _meta(self) -> dict[str, Any]:
        return {"group": groups.catalogue_name(self.group), **super()._meta()}

    @classmethod
    def _from_meta(cls, meta: Mapping[str, Any]) -> dict[str, Any]:
        return {"group": groups.group(str(meta["group"])), **super()._from_meta(meta)}


def _as_elements(group: MatrixLieGroup, theta: ArrayLike, n: int) -> NDArray[Any]:
    theta = as_numbers("theta", theta, (n, n, group.size, group.size))
    if not (inside := group.contains(theta)).all():
        raise InputError(
            f"theta must hold elements of {group.name}, {np.count_nonzero(~inside)} of {inside.size} are none; "
            "`project_to_adjoint` of the group finds the nearest"
        )
    return np.array(theta, dtype=group.basis.dtype)
