"""LieEDNN: a Hopfield-like neural ODE on se(3)^N with adjoint weight blocks."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.lie import adjoint
from lieednn_sim.network.base import BlockNetwork, checked_fields, flatten_blocks
from lieednn_sim.network.componentwise import DEFAULT_ACTIVATION, ComponentwiseNetwork, as_activation
from lieednn_sim.stability.norms import as_weight
from lieednn_sim.validation import as_count, as_floats
from lieednn_sim.values import Floats, frozen, read_only, set_fields


class RigidNetwork(BlockNetwork):
    """A network on se(3)^N with blocks alpha_ij Ad(theta_ij)."""

    alpha: Floats
    rotation: Floats
    translation: Floats

    _bias_free: ClassVar[list[str]] = [*BlockNetwork._bias_free, "rotational_weight"]

    @cached_property
    def blocks(self) -> Floats:
        """Weight blocks alpha_ij Ad(theta_ij), ``(N, N, 6, 6)``."""
        return read_only(self.alpha[:, :, None, None] * adjoint(self.rotation, self.translation))

    @property
    def coupled(self) -> NDArray[np.bool_]:
        """Whether neuron i has an input from neuron j, ``(N, N)``; blocks of many neurons take much memory."""
        return self.alpha != 0.0

    @cached_property
    def driven_weight(self) -> Floats:
        """The rows of W of the `n_driven` leading neurons, ``(6 n_driven, 6N)``; see `BlockNetwork`."""
        k = self.n_driven
        if k == len(self.alpha):
            return self.weight
        return flatten_blocks(self.alpha[:k, :, None, None] * adjoint(self.rotation[:k], self.translation[:k]))

    @cached_property
    def rotational_weight(self) -> Floats:
        """W_R = [alpha_ij R_ij], ``(3N, 3N)``: the part that decides stability."""
        return flatten_blocks(self.alpha[:, :, None, None] * self.rotation)

    @property
    def certifiable_weight(self) -> Floats:
        """W_R, ``(3N, 3N)``: W has a diagonal Lyapunov matrix exactly when W_R has one (`stability`)."""
        return self.rotational_weight


@frozen
class LieEDNN(RigidNetwork, ComponentwiseNetwork):
    """A Hopfield-like neural ODE whose neurons live in se(3) and whose weight blocks are scaled adjoints of SE(3).

    It is x_i' = -gamma x_i + mu sum_j alpha_ij Ad(theta_ij) phi(x_j) + mu b_i, with x_i in se(3) (paper, eq. 3.9).

    The state has shape ``(..., N, 6)``, twists ordered (omega, v); the flat state is its C-order ravel. The visible
    neurons come first, one for each link of an arm; then the hidden ones, the clock last.

    Attributes:
        alpha: ``(N, N)`` connection strengths.
        rotation: ``(N, N, 3, 3)`` rotations of theta_ij, from neuron j to neuron i.
        translation: ``(N, N, 3)`` translations of theta_ij.
        bias: ``(N, 6)`` bias b.
        gamma: decay rate, positive, in 1 / (the network's time).
        mu: scale of the interaction, positive.
        activation: a name of `ACTIVATIONS`.
        lyapunov_diagonal: ``(3N,)`` diagonal P that certifies W_R, or None. Checked by `certificate`.
        hidden_start: ``(M, 6)`` state of the hidden neurons at time 0, M < N; by default none is hidden.
        n_clock: number of hidden neurons, the last ones, that are the clock, which drives the other hidden ones.
        start_gain: ``(6M, 6 (N - M))`` K, how hidden starts depend on visible ones (see `start`); None if they do not.
        start_reference: ``(N - M, 6)`` visible start at which the hidden one is ``hidden_start``; None without a gain.
        goal_gain: ``(6M, 6 (N - M))`` L, how ``hidden_start`` moves with the target (see `retarget`); None if it stays.

    Raises:
        InputError: wrong shapes, entries that are not finite, or matrices that are no rotations.
    """

    alpha: Floats
    rotation: Floats
    translation: Floats
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = DEFAULT_ACTIVATION
    lyapunov_diagonal: Floats | None = None
    hidden_start: Floats = field(default_factory=lambda: np.empty((0, 6)))
    n_clock: int = 0
    start_gain: Floats | None = None
    start_reference: Floats | None = None
    goal_gain: Floats | None = None

    _kind: ClassVar[str] = "network"

    def __post_init__(self) -> None:
        alpha = as_weight("alpha", self.alpha)
        n = len(alpha)
        set_fields(
            self,
            alpha=alpha,
            **as_poses(self.rotation, self.translation, alpha),
            **checked_fields(self, (n, 6), 3 * n),
            activation=as_activation(self.activation),
            **as_hidden(self.hidden_start, self.n_clock, n),
            **as_start_law(self.start_gain, self.start_reference, self.goal_gain, len(self.hidden_start), n),
        )

    def with_start(
        self,
        hidden_start: Floats,
        start_gain: Floats | None = None,
        start_reference: Floats | None = None,
        goal_gain: Floats | None = None,
    ) -> LieEDNN:
        """The same network with other initial states of its hidden neurons, which are the code of its motion.

        Weights, bias, equilibrium and certificate stay as they are, and are not checked again; see `start`.

        Args:
            hidden_start: ``(M, 6)``.
            start_gain: ``(6M, 6 (N - M))``, or None if the start is the same whatever the visible one is.
            start_reference: ``(N - M, 6)``, with a gain.
            goal_gain: ``(6M, 6 (N - M))``, with a gain, or None if `retarget` leaves the code as it is.

        Raises:
            InputError: a shape does not fit.
        """
        start = as_floats("hidden_start", hidden_start, self.hidden_start.shape)
        law = as_start_law(start_gain, start_reference, goal_gain, self.n_hidden, self.n_neurons)
        network = object.__new__(type(self))
        vars(network).update(vars(self))
        set_fields(network, hidden_start=start, **law)
        return network


def as_poses(rotation: ArrayLike, translation: ArrayLike, alpha: Floats) -> dict[str, Floats]:
    """Return the rotations ``(N, N, 3, 3)`` and translations ``(N, N, 3)`` of theta checked, by name.

    Their product with the strengths ``(N, N)``, which the weights are made of, must be in range as well.
    """
    n = len(alpha)
    turns, moves = as_floats("rotation", rotation, (n, n, 3, 3)), as_floats("translation", translation, (n, n, 3))
    require_rotations(turns)
    as_floats("alpha times translation", alpha[:, :, None] * moves, (n, n, 3))
    return {"rotation": turns, "translation": moves}


def as_hidden(hidden_start: ArrayLike, n_clock: int, n: int) -> dict[str, Floats | int]:
    """Return the hidden neurons' start ``(M, 6)`` and the size of the clock checked, by name, in a network of N."""
    start = as_floats("hidden_start", hidden_start, ("M", 6))
    if len(start) >= n:
        wanted = f"fewer neurons than the network, which has {n} and needs a visible one"
        raise InputError(f"hidden_start must hold {wanted}, got {len(start)}")
    clock = as_count("n_clock", n_clock, least=0)
    if clock > len(start):
        raise InputError(f"n_clock must be at most {len(start)}, the number of hidden neurons, got {clock}")
    return {"hidden_start": start, "n_clock": clock}


def as_start_law(
    gain: ArrayLike | None, reference: ArrayLike | None, goal_gain: ArrayLike | None, n_hidden: int, n: int
) -> dict[str, Floats | None]:
    """Return the gains and the reference of hidden starts checked, by name, in a network of n neurons."""
    if gain is None and reference is None and goal_gain is None:
        return {"start_gain": None, "start_reference": None, "goal_gain": None}
    if gain is None or reference is None:
        raise InputError("start_gain and start_reference must be given together, or neither; goal_gain needs both")
    visible = n - n_hidden
    shape = (6 * n_hidden, 6 * visible)
    return {
        "start_gain": as_floats("start_gain", gain, shape),
        "goal_gain": None if goal_gain is None else as_floats("goal_gain", goal_gain, shape),
        "start_reference": as_floats("start_reference", reference, (visible, 6)),
    }


def require_rotations(rotation: Floats) -> None:
    """Raise `InputError` unless every matrix of ``(..., 3, 3)`` is a rotation."""
    gram = rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)
    # The tolerance is more than rounding leaves, and far less than a wrong matrix has.
    if np.abs(gram).max() > 1e-9 or (np.linalg.det(rotation) < 0).any():
        raise InputError(
            f"rotation must hold rotation matrices; R R^T differs from I by up to {np.abs(gram).max():.2g} or a "
            "determinant is negative; project with lieednn_sim.lie.project_to_rotation"
        )
