"""The paper's bounds on velocity, acceleration and curvature of a network's trajectory (App. H).

All of them hold while |xi|_inf <= R, which is for all time if R = max(|xi(0)|_inf, (mu/gamma) (||W||_inf M + |b|_inf)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.stability.norms import as_weight, log_norms
from lieednn_sim.validation import as_finite, as_floats, as_nonnegative, as_positive, as_ratio
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class SmoothnessBounds:
    """Bounds on a trajectory's velocity, acceleration and curvature, in the largest coordinate and the network's time.

    Attributes:
        velocity: on |xi'|_inf: gamma R + mu ||W||_inf M + mu |b|_inf.
        acceleration: on |xi''|_inf, and on each component's curvature, since (1 + xi_i'^2)^(3/2) is at least 1:
            (gamma + mu L ||W||_inf) times the bound on the velocity.
        closing: the paper's closing bound gamma (1 + L) (gamma R + gamma M + mu |b|_inf), which for tanh is
            2 gamma (gamma R + gamma + mu b_max). Valid only when ||W||_inf < gamma/mu, None otherwise.
    """

    velocity: float
    acceleration: float
    closing: float | None


def smoothness_bounds(
    weight: ArrayLike,
    bias: ArrayLike,
    radius: float,
    *,
    gamma: float,
    mu: float,
    output_bound: float = 1.0,
    lipschitz: float = 1.0,
) -> SmoothnessBounds:
    """Evaluate the paper's smoothness and curvature theorem.

    Args:
        weight: W, ``(n, n)``.
        bias: b, ``(n,)``.
        radius: R, largest |xi_i(t)| on the interval considered.
        gamma, mu: decay rate and scale of the interaction, positive.
        output_bound: M, largest |phi| there.
        lipschitz: L, largest slope of phi there.

    Raises:
        InputError: wrong shapes or signs, or numbers so large that a bound overflows.
    """
    matrix = as_weight("weight", weight)
    drive = float(np.abs(as_floats("bias", bias, (len(matrix),))).max())
    decay, scale = as_positive("gamma", gamma), as_positive("mu", mu)
    size = as_nonnegative("radius", radius)
    most, slope = as_positive("output_bound", output_bound), as_positive("lipschitz", lipschitz)
    norm = log_norms(matrix).infinity_norm
    velocity = decay * size + scale * norm * most + scale * drive
    acceleration = (decay + scale * slope * norm) * velocity
    closing = None
    if norm < as_ratio(decay, scale):
        closing = decay * (1.0 + slope) * (decay * size + decay * most + scale * drive)
    as_finite("a bound on the motion", np.array([velocity, acceleration, closing or 0.0]))
    return SmoothnessBounds(velocity, acceleration, closing)


def curvature(xi_dot: ArrayLike, xi_ddot: ArrayLike) -> Floats:
    """Curvature |xi_i''| / (1 + xi_i'^2)^(3/2) of each graph t -> xi_i(t), entry by entry.

    It depends on the units of time and of xi: it is the bend of the plotted curve, not that of the path in space.

    Args:
        xi_dot: first derivatives, any shape.
        xi_ddot: second derivatives, the same shape.
    """
    # Larger velocities are allowed than elsewhere, since the formula only divides by them.
    first = as_floats("xi_dot", xi_dot, (), batched=True, largest=1e300)
    second = as_floats("xi_ddot", xi_ddot, first.shape)
    # hypot keeps large velocities from overflowing where the curvature is merely small.
    steepness = np.hypot(1.0, first)
    return np.abs(second) / steepness / steepness / steepness
