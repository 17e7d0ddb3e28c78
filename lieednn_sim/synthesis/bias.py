"""Bias rules: which equilibria a certified network can have is decided by the bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.validation import as_choice

Floats = NDArray[np.float64]

BIAS_RULES = ("uniform", "sign-matched", "solved")

# Angles below this [rad] are zero up to rounding.
_NEGLIGIBLE = 1e-6
# Rotations carry translations through t badly when all their coordinates are below this [rad] ...
_SMALL_ROTATION = 0.6
# ... and not at all when a single neuron turns by more than this [rad].
_TURNING = 0.05
# How far beyond the least strength that can be certified the sign-matched rule goes, where it must go beyond it.
_HEADROOM = 1.25


def bias_for(rule: str, xi: Floats, outputs: Floats, bound: float, magnitude: float) -> Floats:
    """The bias that a rule prescribes for a target ``xi`` ``(N, 6)`` with outputs phi(xi) and bound gamma/mu.

    - ``"uniform"``: every entry is ``magnitude``, as in the paper.
    - ``"sign-matched"``: ``xi`` clipped to +-``magnitude``, times ``bound``: the sign of the target at full strength
      for every coordinate larger than the magnitude, and continuous through zero, so that a coordinate that is zero up
      to rounding gets no push that the weights would have to cancel. The magnitude is raised where every coordinate of
      the target is too large for it: a certificate needs one with |xi_i| - magnitude < phi(|xi_i|) among those of
      `equation_columns`.
    - ``"solved"``: the bias that makes ``xi`` the equilibrium of weights drawn without regard to it; it starts at zero.
    """
    as_choice("bias rule", rule, BIAS_RULES)
    if rule == "uniform":
        return np.full_like(xi, magnitude)
    if rule == "sign-matched":
        strength = magnitude
        for part in equation_columns(xi):
            needed = np.abs(xi - outputs)[:, part][np.abs(xi[:, part]) > _NEGLIGIBLE]
            if needed.size:
                strength = max(strength, _HEADROOM * float(needed.min()))
        return bound * np.clip(xi, -strength, strength)
    return np.zeros_like(xi)


def equation_columns(xi: Floats) -> list[slice]:
    """Which coordinates (omega, v) the weights W_R had better serve by themselves.

    The rotational equations always; the translational ones too where t could not carry them: when the rotations are
    small, or when only one neuron turns. Then a row that must not turn, alpha_i0 R_i0 phi(omega_0) = 0, has no lever.
    """
    turning = np.linalg.norm(xi[:, :3], axis=1) > _TURNING
    if np.abs(xi[:, :3]).max() < _SMALL_ROTATION or np.count_nonzero(turning) < 2:
        return [slice(0, 3), slice(3, 6)]
    return [slice(0, 3)]


def impossibility(outputs: Floats, required: Floats) -> str | None:
    """Why no weights can be certified with this equilibrium and bias, or None where nothing forbids it.

    In units of gamma/mu: with P diagonal, u = phi(xi) and W u = c, P (W - I) is negative definite only when
    sum_i p_i u_i (c_i - u_i) < 0, so at least one rotational coordinate must have u_i (c_i - u_i) < 0. Where all
    outputs are zero, zero must be required, for W 0 = 0.

    Args:
        outputs: phi(xi) of the target, ``(N, 6)``.
        required: xi - (mu/gamma) b, ``(N, 6)``.
    """
    for part, name in ((slice(0, 3), "rotational"), (slice(3, 6), "translational")):
        given, wanted = outputs[:, part], required[:, part]
        if given.any():
            if (given * (wanted - given)).min() >= 0.0:
                return (
                    f"no {name} coordinate has its bias on the side of its target, so no diagonal Lyapunov matrix can "
                    "exist; use the sign-matched bias or retarget a certified network"
                )
            # Rotations that are not zero may carry the translations through t.
            return None
        if wanted.any():
            return (
                f"every {name} coordinate of the target is zero, so no weights can produce the {name} bias; "
                "use the sign-matched bias"
            )
    return None
