"""Acceleration limits of a foreign arm: what the forces of its drives are good for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.servos import Freedom, Servo, reduced_inertia, resting_load

Floats = NDArray[np.float64]
_FIELD = "acceleration_limit"
# Of the force that a drive has left: the rest is for friction, and for what the other joints do to it.
_SHARE = 0.5


def set_acceleration_limits(
    spec: Any, model: mujoco.MjModel, postures: Sequence[Floats], freedoms: list[Freedom], servos: tuple[Servo, ...]
) -> list[str]:
    """Limit accelerations where drives have force limits, or motions would be planned that they cannot follow.

    Each limit is (F - |load|) / (2 I): F the drive's force limit, the load that of gravity and springs at rest, I the
    inertia with the other coordinates held, both the largest of a few postures.

    Args:
        spec: changed, unless it has a custom numeric ``acceleration_limit``.
        model: compiled from it.
        postures: ``(nq,)`` each.
        freedoms: of the arm, with rates of ``model``.
        servos: of the freedoms.

    Returns:
        Remarks.
    """
    if spec.numeric(_FIELD) is not None:
        return []
    rates = np.array([freedom.rates for freedom in freedoms])
    inertia = np.max([np.diag(reduced_inertia(model, qpos, freedoms)) for qpos in postures], axis=0)
    load = np.max([np.abs(rates @ resting_load(model, qpos)) for qpos in postures], axis=0)
    force = np.array([min(-servo.force_range[0], servo.force_range[1]) for servo in servos])
    # A drive that cannot hold its load anywhere near is remarked on elsewhere; a limit of zero would allow no motion.
    limits = np.where(force > load, _SHARE * (force - load) / inertia, np.inf)
    finite = np.flatnonzero(np.isfinite(limits))
    if not finite.size:
        return []
    spec.add_numeric(name=_FIELD, data=limits, size=len(limits))
    shown = ", ".join(f"{servos[k].name} {limits[k]:.3g}" for k in finite)
    return [f"acceleration limits from force limits [rad/s^2, m/s^2]: {shown}"]
