"""Checks of the parameters of networks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_count, as_floats, as_positive, as_ratio
from lieednn_sim.values import Floats


def as_strengths(alpha: ArrayLike) -> Floats:
    """Return connection strengths ``(N, N)`` with N >= 1, or raise `InputError`."""
    checked = as_floats("alpha", alpha, ("N", "N"))
    if len(checked) == 0:
        raise InputError("alpha must have shape (N, N) with N >= 1, got (0, 0)")
    return checked


def as_rates(gamma: float, mu: float) -> dict[str, float]:
    """Return gamma and mu checked, by name."""
    as_ratio(gamma, mu)
    return {"gamma": as_positive("gamma", gamma), "mu": as_positive("mu", mu)}


def as_poses(rotation: ArrayLike, translation: ArrayLike, alpha: Floats) -> dict[str, Floats]:
    """Return the rotations ``(N, N, 3, 3)`` and translations ``(N, N, 3)`` of theta checked, by name.

    Their product with the strengths ``(N, N)``, which the weights are made of, must be in range as well.
    """
    n = len(alpha)
    checked = {
        "rotation": as_floats("rotation", rotation, (n, n, 3, 3)),
        "translation": as_floats("translation", translation, (n, n, 3)),
    }
    require_rotations(checked["rotation"])
    as_floats("alpha times translation", alpha[:, :, None] * checked["translation"], (n, n, 3))
    return checked


def as_hidden(hidden_start: ArrayLike, n_clock: int, n: int) -> dict[str, Floats | int]:
    """Return the hidden neurons' start ``(M, 6)`` and the size of the clock checked, by name, in a network of N."""
    start = as_floats("hidden_start", hidden_start, ("M", 6))
    if len(start) >= n:
        raise InputError(
            f"hidden_start must hold fewer neurons than the network, which has {n} and needs a visible one, got "
            f"{len(start)}"
        )
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
    # More than rounding leaves, far less than a wrong matrix has.
    if np.abs(gram).max() > 1e-9 or (np.linalg.det(rotation) < 0).any():
        raise InputError(
            f"rotation must hold rotation matrices; R R^T differs from I by up to {np.abs(gram).max():.2g} or a "
            "determinant is negative; project with lieednn_sim.lie.project_to_rotation"
        )
