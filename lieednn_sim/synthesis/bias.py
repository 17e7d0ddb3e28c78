"""Bias rules: the bias decides which equilibria a certified network can have."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from lieednn_sim.registry import BIAS_RULES
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats

# The strength is raised until W u = c leaves room below the bound, u^T P c <= _AIM u^T P u, for a P that weights
# helpful coordinates at most 1 / _HELP times as much as harmful ones.
_AIM, _HELP = 0.85, 0.2


def bias_for(rule: str, xi: Floats, outputs: Floats, bound: float, magnitude: float) -> Floats:
    """The bias that a rule prescribes for a target ``xi`` ``(N, 6)`` with outputs phi(xi) and bound gamma/mu.

    - ``"uniform"``: every entry is ``magnitude``, as in the paper.
    - ``"sign-matched"``: ``xi`` clipped to +-``magnitude``, times ``bound``. It has the target's sign at full strength
      for every coordinate larger than the magnitude and is continuous through zero, so that a coordinate that is zero
      up to rounding gets no bias that the weights would have to cancel. If a certificate needs it, the magnitude is
      raised (`_least_strength`) for each part of `equation_columns`.
    - ``"solved"``: the bias that makes ``xi`` the equilibrium of weights drawn without regard to it; it starts at zero.
    """
    BIAS_RULES.find(rule)
    xi = as_floats("xi", xi, ("N", 6))
    outputs, bound = as_floats("outputs", outputs, xi.shape), as_positive("bound", bound)
    magnitude = float(as_floats("magnitude", magnitude, ()))
    if rule == "uniform":
        return np.full_like(xi, magnitude)
    if rule == "sign-matched":
        strength = max(_least_strength(xi[:, part], outputs[:, part], magnitude) for part in equation_columns(xi))
        return bound * np.clip(xi, -strength, strength)
    return np.zeros_like(xi)


def _least_strength(xi: Floats, outputs: Floats, magnitude: float) -> float:
    """The least strength, at least ``magnitude``, at which the target leaves room for a certificate.

    With P diagonal, u = phi(xi) and W u = c = xi - clip(xi, -strength, strength), sum_i p_i u_i (c_i - u_i) < 0 is
    necessary. Coordinate i helps if u_i (c_i - _AIM u_i) < 0, and those that help must together outweigh `_HELP` times
    the others. So an angle near zero, which always helps but only by its square, is not counted as one that carries the
    certificate. Every term falls with the strength, and all coordinates help once it reaches the largest |xi_i|.
    """

    def surplus(strength: float) -> float:
        work = outputs * (xi - np.clip(xi, -strength, strength) - _AIM * outputs)
        return -float(np.minimum(work, 0.0).sum() + _HELP * np.maximum(work, 0.0).sum())

    return magnitude if surplus(magnitude) >= 0.0 else float(brentq(surplus, magnitude, float(np.abs(xi).max())))


def equation_columns(xi: Floats) -> list[slice]:
    """The parts (omega, v) of the target whose equations the weights W_R should meet without translations t.

    W_R always meets the rotational ones. It also has to meet the translational ones if t cannot: if the rotations are
    small, or only one neuron turns, so that a row that must not turn, alpha_i0 R_i0 phi(omega_0) = 0, has no lever arm.
    """
    # Rotations drive translations through t poorly when all their coordinates are below the first of these [rad], and
    # not at all when a single neuron turns by more than the second.
    small_rotation, least_turn = 0.6, 0.05
    turning = np.linalg.norm(xi[:, :3], axis=1) > least_turn
    if np.abs(xi[:, :3]).max() < small_rotation or np.count_nonzero(turning) < 2:
        return [slice(0, 3), slice(3, 6)]
    return [slice(0, 3)]


def impossibility(outputs: Floats, required: Floats) -> str | None:
    """Why no weights can be certified with this equilibrium and bias; None if nothing forbids it.

    In units of gamma/mu: with P diagonal, the outputs u = phi(xi) ``(N, 6)`` and W u = c, which is required to be
    xi - (mu/gamma) b, P (W - I) is negative definite only when sum_i p_i u_i (c_i - u_i) < 0, so at least one
    rotational coordinate must have u_i (c_i - u_i) < 0. If all outputs are zero, c must be zero, too, since W 0 = 0.
    """
    for part, name in ((slice(0, 3), "rotational"), (slice(3, 6), "translational")):
        given, target = outputs[:, part], required[:, part]
        if given.any():
            if (given * (target - given)).min() >= 0.0:
                lacking = f"no {name} coordinate has a bias large enough on the side of its target"
                way = "use the sign-matched bias or retarget a certified network"
                return f"{lacking}, so no diagonal Lyapunov matrix can exist; {way}"
            return None  # nonzero rotations may drive the translations through t
        if target.any():
            why = f"every {name} coordinate of the target is zero, so no weights can produce the {name} bias"
            return f"{why}; use the sign-matched bias"
    return None
