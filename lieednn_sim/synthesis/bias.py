"""Bias rules: which equilibria a certified network can have is decided by the bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.validation import as_choice

Floats = NDArray[np.float64]

BIAS_RULES = ("uniform", "sign-matched", "solved")

# Angles below this [rad] are zero up to rounding.
_NEGLIGIBLE = 1e-6


# How far beyond the least strength that can be certified the sign-matched rule goes, where it must go beyond it.
_HEADROOM = 1.25


def bias_for(rule: str, xi: Floats, outputs: Floats, bound: float, magnitude: float) -> Floats:
    """The bias that a rule prescribes for a target ``xi`` ``(N, 6)`` with outputs phi(xi) and bound gamma/mu.

    - ``"uniform"``: every entry is ``magnitude``, as in the paper.
    - ``"sign-matched"``: ``xi`` clipped to +-``magnitude``: the sign of the target at full strength for every
      coordinate larger than the magnitude, and continuous through zero, so that a coordinate that is zero up to
      rounding gets no push that the weights would have to cancel. The magnitude is raised where every angle of the
      target is too large for it: a certificate needs one with |bound omega| - |b| < bound phi(|omega|).
    - ``"solved"``: the bias that makes ``xi`` the equilibrium of weights drawn without regard to it; it starts at zero.
    """
    as_choice("bias rule", rule, BIAS_RULES)
    if rule == "uniform":
        return np.full_like(xi, magnitude)
    if rule == "sign-matched":
        needed = bound * np.abs(xi[:, :3] - outputs[:, :3])[np.abs(xi[:, :3]) > _NEGLIGIBLE]
        strength = max(magnitude, _HEADROOM * float(needed.min(initial=np.inf))) if needed.size else magnitude
        return np.clip(bound * xi, -strength, strength)
    return np.zeros_like(xi)


def impossibility(outputs: Floats, required: Floats, bound: float) -> str | None:
    """Why no weights at all can be certified with this equilibrium and bias, or None where nothing forbids it.

    With P diagonal, u = phi(xi) and W u = c, P (W - bound I) is negative definite only when
    sum_i p_i u_i (c_i - bound u_i) < 0, so at least one rotational coordinate must have u_i (c_i - bound u_i) < 0.
    Where all outputs are zero, zero must be required, for W 0 = 0.

    Args:
        outputs: phi(omega) of the target, ``(N, 3)``.
        required: (gamma/mu) omega - b, ``(N, 3)``.
        bound: gamma/mu.
    """
    if not outputs.any():
        if np.abs(required).max() > 0.0:
            return (
                "every rotation of the target is zero, so no weights can produce the rotational bias; "
                "use the sign-matched bias"
            )
        return None
    if (outputs * (required - bound * outputs)).min() >= 0.0:
        return (
            "no rotational coordinate has its bias on the side of its target, so no diagonal Lyapunov matrix can "
            "exist; use the sign-matched bias or retarget a certified network"
        )
    return None
