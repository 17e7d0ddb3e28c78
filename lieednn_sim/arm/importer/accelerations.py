"""Acceleration limits of a foreign arm: what the forces of its actuators are good for."""

from __future__ import annotations

import numpy as np

from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.servos import largest_inertia, resting_load

_FIELD = "acceleration_limit"
# Of the force that an actuator has left: the rest is for friction, and for what the other joints do to it.
_SHARE = 0.5


def limit_accelerations(draft: Draft) -> None:
    """Limit accelerations where actuators have force limits, or motions would be planned that they cannot follow.

    Each limit is (F - |load|) / (2 I): F the actuator's force limit, the load that of gravity and springs at rest, I
    the inertia with the other coordinates held, both the largest of a few postures. A custom numeric
    ``acceleration_limit`` of the model stays.
    """
    if draft.spec.numeric(_FIELD) is not None:
        return
    model, servos, postures = draft.bare, draft.servos, draft.postures(draft.samples[:16])
    rates = np.array([dof.rates for dof in draft.dofs])
    inertia = largest_inertia(model, postures, draft.dofs)
    load = np.max([np.abs(rates @ resting_load(model, qpos)) for qpos in postures], axis=0)
    force = np.array([min(-servo.force_range[0], servo.force_range[1]) for servo in servos])
    # One that cannot hold its load anywhere near is remarked on elsewhere; a limit of zero would allow no motion.
    limits = np.where(force > load, _SHARE * (force - load) / inertia, np.inf)
    finite = np.flatnonzero(np.isfinite(limits))
    if finite.size:
        draft.spec.add_numeric(name=_FIELD, data=limits, size=len(limits))
        shown = ", ".join(f"{servos[k].name} {limits[k]:.3g}" for k in finite)
        draft.notes.append(f"acceleration limits from force limits [rad/s^2, m/s^2]: {shown}")
