"""Limits of rates: an arm's custom numerics, those that a caller gives, and accelerations that force limits leave."""

from __future__ import annotations

from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.forces import required_forces
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_positive
from lieednn_sim.values import Floats

# Fraction of an actuator's spare force used for acceleration: the rest is for friction and coupling to other joints.
_ACCELERATING_FRACTION = 0.5


def check_rates(limits: Any) -> None:
    """Raise `InputError` unless ``limits`` is as in `Arm.of`."""
    for coordinate, given in (limits or {}).items():
        for what, value in given.items():
            as_choice("limit", what, ["velocity", "acceleration", "jerk"])
            as_positive(f"limit of {what} of {coordinate}", value)


def read_numeric(model: mujoco.MjModel, arm: str, field: str, default: Floats, viewed: bool) -> Floats:
    """A custom numeric of the model with as many values as ``default``, all of them positive.

    In a model of which the arm is a view, one with another number of values is for another arm, and left out.
    """
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, field)
    values = default.copy() if index < 0 else np.array(model.numeric(index).data)
    if viewed and len(values) != len(default):
        return default.copy()
    if len(values) != len(default):
        raise InputError(f"numeric {field!r} of arm {arm!r} has {len(values)} values, expected {len(default)}")
    if not (values > 0.0).all():
        raise InputError(f"numeric {field!r} of arm {arm!r} must be positive, got {' '.join(f'{v:g}' for v in values)}")
    return values


def largest_inertia(model: mujoco.MjModel, configurations: Floats, rates: Floats) -> Floats:
    """Largest inertia ``(n,)``, armature included, of each coordinate with the others held.

    Args:
        model: the compiled model.
        configurations: ``(S, nq)``.
        rates: as in `force_ranges`, ``(nv, n)`` or, where they differ, ``(S, nv, n)``.
    """
    data, column = mujoco.MjData(model), np.zeros(model.nv)
    rates = np.broadcast_to(rates, (len(configurations), *rates.shape[-2:]))
    largest = np.zeros(rates.shape[-1])
    for data.qpos[:], basis in zip(configurations, rates, strict=True):
        mujoco.mj_fwdPosition(model, data)
        for k, rate in enumerate(basis.T):
            mujoco.mj_mulM(model, data, column, rate)
            largest[k] = max(largest[k], column @ rate)
    return largest


def spare_acceleration(model: mujoco.MjModel, configurations: Floats, rates: Floats, force: Floats) -> Floats:
    """The limits of acceleration ``(n,)`` that force limits ``(n,)`` leave: (F - |load|) / (2 I), or infinite.

    The load of gravity and springs at rest, and the inertia I with the other coordinates held, are the largest over
    the configurations; arguments are as in `largest_inertia`.
    """
    inertia = largest_inertia(model, configurations, rates)
    load = np.abs(np.vecmat(required_forces(model, configurations, limited=True), rates)).max(axis=0)
    # A limit of zero would allow no motion; where an actuator cannot hold its load, plans and runs say so.
    known = (force > load) & (inertia > 0.0)
    return np.where(known, _ACCELERATING_FRACTION * (force - load) / np.where(known, inertia, 1.0), np.inf)
