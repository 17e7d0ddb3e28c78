"""Rate limits of an imported arm: a URDF's velocities, accelerations from force limits, and those of the caller."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.forces import resting_load
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.servos import largest_inertia
from lieednn_sim.validation import as_choice, as_positive
from lieednn_sim.values import Floats

# The custom numerics that hold the limits.
RATE_LIMITS = {"velocity": "velocity_limit", "acceleration": "acceleration_limit", "jerk": "jerk_limit"}
_VELOCITY, _ACCELERATION, _ = RATE_LIMITS.values()
# Fraction of an actuator's spare force used for acceleration: the rest is for friction and coupling to other joints.
_ACCELERATING_FRACTION = 0.5


def drop_old_limits(draft: Draft) -> None:
    """Delete custom limits of velocity, acceleration and jerk whose size is not the arm's number of coordinates."""
    size = sum(3 if draft.is_ball(joint) else 1 for joint in draft.independent)
    for name in RATE_LIMITS.values():
        numeric = draft.spec.numeric(name)
        if numeric is not None and max(int(numeric.size), len(numeric.data)) != size:
            draft.spec.delete(numeric)
            draft.notes.append(f"removed the custom numeric {name!r}, which is not for {size} coordinates")


def limit_velocities(draft: Draft) -> None:
    """Limit each coordinate by the URDF velocity limits, which MuJoCo does not read, of all the joints that it moves.

    Zero means no limit; a custom numeric ``velocity_limit`` of the model stays.
    """
    if draft.source is None or draft.spec.numeric(_VELOCITY) is not None:
        return
    try:
        given = _velocities(draft.source)
    except (ElementTree.ParseError, ValueError) as error:
        draft.notes.append(f"velocity limits, if there are any, could not be read: {error}")
        return
    limits = np.full(len(draft.dofs), np.inf)
    for name, velocity in given.items():
        joint = mujoco.mj_name2id(draft.bare, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint >= 0:
            rates = np.array([abs(dof.rates[draft.bare.jnt_dofadr[joint]]) for dof in draft.dofs])
            moved = rates > 0.0
            limits[moved] = np.minimum(limits[moved], velocity / rates[moved])
    shown = [f"{dof.name} {limit:.3g}" for dof, limit in zip(draft.dofs, limits, strict=True) if np.isfinite(limit)]
    if shown:
        draft.spec.add_numeric(name=_VELOCITY, data=limits, size=len(limits))
        draft.notes.append(f"velocity limits of the URDF [rad/s, m/s]: {', '.join(shown)}")


def _velocities(source: Path) -> dict[str, float]:
    """The velocity limit of each joint [rad/s, m/s] that has one, if the file is a URDF."""
    robot = ElementTree.parse(source).getroot()
    if robot.tag != "robot":
        return {}
    limits = {joint.get("name", ""): joint.find("limit") for joint in robot.iterfind("joint")}
    result = {name: float(limit.get("velocity", "0")) for name, limit in limits.items() if limit is not None}
    return {name: velocity for name, velocity in result.items() if velocity > 0.0}


def limit_accelerations(draft: Draft) -> None:
    """Limit accelerations where actuators have force limits, so that planned motions can be followed.

    A custom numeric ``acceleration_limit`` of the model stays.
    """
    if draft.spec.numeric(_ACCELERATION) is not None:
        return
    servos = draft.servos
    force = np.array([min(-servo.force_range[0], servo.force_range[1]) for servo in servos])
    limits = spare_acceleration(draft.bare, draft.configurations(draft.samples[:16]), draft.rates, force)
    finite = np.flatnonzero(np.isfinite(limits))
    if finite.size:
        draft.spec.add_numeric(name=_ACCELERATION, data=limits, size=len(limits))
        shown = ", ".join(f"{servos[k].name} {limits[k]:.3g}" for k in finite)
        draft.notes.append(f"acceleration limits from force limits [rad/s^2, m/s^2]: {shown}")


def spare_acceleration(model: mujoco.MjModel, configurations: Floats, rates: Floats, force: Floats) -> Floats:
    """The limits of acceleration ``(n,)`` that force limits ``(n,)`` leave: (F - |load|) / (2 I), or infinite.

    The load of gravity and springs at rest, and the inertia I with the other coordinates held, are the largest over
    the configurations ``(S, nq)``; ``rates`` are as in `servos.reduced_inertia`.
    """
    inertia = largest_inertia(model, configurations, rates)
    load = np.abs(np.vecmat(resting_load(model, configurations), rates)).max(axis=0)
    # An actuator that cannot hold its load is reported by `look_at_home`; a limit of zero would allow no motion.
    return np.where(force > load, _ACCELERATING_FRACTION * (force - load) / inertia, np.inf)


def check_rates(limits: Any) -> None:
    """Raise `InputError` unless ``limits`` is as in `import_arm`."""
    if limits is None:
        return
    for coordinate, given in limits.items():
        for what, value in given.items():
            as_choice("limit", what, list(RATE_LIMITS))
            as_positive(f"limit of {what} of {coordinate}", value)


def limit_as_asked(draft: Draft) -> None:
    """Replace the model's limits of velocity, acceleration and jerk by those of the caller."""
    names = [dof.name for dof in draft.dofs]
    for coordinate in draft.limits:
        as_choice("coordinate", coordinate, names)
    for what, field in RATE_LIMITS.items():
        asked = {name: float(given[what]) for name, given in draft.limits.items() if what in given}
        if not asked:
            continue
        numeric = draft.spec.numeric(field)
        known = dict.fromkeys(names, np.inf) if numeric is None else dict(zip(names, numeric.data, strict=True))
        if numeric is not None:
            draft.spec.delete(numeric)
        draft.spec.add_numeric(name=field, data=list((known | asked).values()), size=len(names))
        shown = ", ".join(f"{name} {limit:.3g}" for name, limit in asked.items())
        draft.notes.append(f"limits of {what} as asked for: {shown}")
