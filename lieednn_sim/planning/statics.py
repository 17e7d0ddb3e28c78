"""Whether actuators can hold an arm's weight where it rests, and along a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import actuator_moments, actuator_ranges, dry_friction, resting_load
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats

_LOOKS = 33  # at samples of a motion


class TooWeakError(InputError):
    """Actuators cannot hold an arm's weight at rest."""


def check_held(arm: Arm, q: Floats, where: Sequence[str]) -> None:
    """Raise `TooWeakError` if actuators are too weak for the arm's weight at rest; dry friction may help them.

    It is checked at configurations q ``(K, n)``; ``where`` says what each is, for the message.
    """
    model, limits = arm.model, arm.force_limits
    moments, ranges = actuator_moments(model), actuator_ranges(model)
    looped = arm.dependents is not None
    if not np.isfinite(ranges if looped else limits).any():
        return
    loads = resting_load(model, arm.qpos(q), limited=True)
    for row, at_rest, what in zip(q, loads, where, strict=True):
        basis = arm.unit_rates(row)
        load, friction = at_rest @ basis, dry_friction(model, basis)
        if looped:
            # Actuators act through the loops: forces of least norm that hold the load.
            force = np.linalg.lstsq((moments @ basis).T, load, rcond=None)[0]
            short = np.maximum(ranges[:, 0] - force, force - ranges[:, 1])
            k = int(short.argmax())
            if short[k] > 0.0 and short[k] > friction.max():
                raise TooWeakError(
                    f"actuator {model.actuator(k).name!r} cannot hold the arm at {what}: it would need {force[k]:.4g}, "
                    f"its range is [{ranges[k, 0]:.4g}, {ranges[k, 1]:.4g}] (N or N m)"
                )
            continue
        short = np.abs(load) - friction - limits
        j = int(short.argmax())
        if short[j] > 0.0:
            unit = "N" if arm.unit(j) == "m" else "N m"
            raise TooWeakError(
                f"joint {arm.joint_names[j]!r} cannot be held at {what}: its load is {abs(load[j]):.4g} {unit}, its "
                f"force limit {limits[j]:.4g} {unit}"
            )


def check_held_along(arm: Arm, motion: Motion) -> None:
    """As `check_held` at some samples of a motion, where gravity is not compensated in the model itself."""
    moved = moved_together(arm.model, arm.dofs) > 0
    if arm.grasp is not None or not (arm.model.body_gravcomp[moved] == 1.0).all():
        some = np.linspace(0, len(motion.t) - 1, _LOOKS).round().astype(int)
        check_held(arm, motion.q[some], [f"t = {t:.2f} s" for t in motion.t[some]])
