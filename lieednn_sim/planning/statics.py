"""Whether actuators hold an arm where it rests, and have the forces for a motion, with what the arm carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import actuator_moments, actuator_ranges, dry_friction, required_forces, tangent_basis
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

_LOOKS = 33  # at samples of a motion
_NEAR = 0.5  # part of a limit above which, at one of them, all samples are looked at
_TOLERANCE = 1e-6  # by which a force may pass its limit, in units of it
_RESTING = 1e-6  # rate below which dry friction holds a joint rather than brakes it [rad/s, m/s]


class TooWeakError(InputError):
    """Actuators cannot hold an arm's weight, at rest or at any speed."""


class _Forces(NamedTuple):
    """Forces at S samples, along the coordinates or, where they act through closed loops, of the actuators.

    Attributes:
        needed: ``(S, m)`` what a motion needs [N m, N].
        damping: ``(S, m)`` the part of it against dampers.
        low, high: ``(m,)`` bounds.
    """

    needed: Floats
    damping: Floats
    low: Floats
    high: Floats

    @property
    def bounds(self) -> Floats:
        """The bound ``(S, m)`` of each needed force, in its direction."""
        return np.where(self.needed > 0.0, self.high, -self.low)

    @property
    def use(self) -> Floats:
        """The needed forces ``(S, m)`` in units of their bounds."""
        return np.abs(self.needed) / np.maximum(self.bounds, 1e-12)


def force_use(arm: Arm, t: Floats, q: Floats, qd: Floats) -> float:
    """Largest force that a motion needs of the actuators, in units of its limit; arguments are as of `check_forces`."""
    return float(_along(arm, t, q, qd, np.arange(len(t) - 1))[1].use.max())


def check_held(arm: Arm, q: Floats, where: Sequence[str]) -> None:
    """Raise `TooWeakError` if actuators are too weak for the arm's weight at rest; dry friction may help them.

    It is checked at configurations q ``(K, n)``; ``where`` says what each is, for the message.
    """
    if not _limited(arm):
        return
    _require_held(arm, _at_rest(arm, arm.qpos(q), np.zeros_like(q)), where)


def check_forces(arm: Arm, t: Floats, q: Floats, qd: Floats) -> tuple[float, str] | None:
    """Compare the forces that a motion needs with those that the arm's actuators have, by inverse dynamics.

    Dry friction acts against the motion; contacts are left out. Some samples are looked at, and those with the largest
    accelerations; all of them if any of these needs half of a limit.

    If time is stretched by s, forces f0 of gravity, springs and dry friction stay, f1 of dampers become f1 / s, and the
    rest f2 / s^2. So a force stays below F from s = (f1 + sqrt(f1^2 + 4 (F - f0) f2)) / (2 (F - f0)) on.

    Args:
        arm: the arm, with its payload and what it holds.
        t: ``(K,)`` evenly spaced times [s].
        q: ``(K, n)`` joint positions [rad, m].
        qd: ``(K, n)`` their rates [rad/s, m/s].

    Returns:
        None if all are within their limits; else the duration that keeps them [s], and what does not, in words.

    Raises:
        TooWeakError: f0 alone is beyond a limit.
    """
    if not _limited(arm):
        return None
    last = len(t) - 1
    looks = np.linspace(0, last, _LOOKS).round().astype(int)
    rows = np.union1d(np.minimum(looks, last - 1), np.abs(np.diff(qd, axis=0)).argmax(axis=0))
    qpos, forces = _along(arm, t, q, qd, rows, looks)
    _require_held(arm, forces, [f"t = {time:.2f} s" for time in t[looks]])
    if forces.use.max() <= _NEAR:
        return None
    rows = np.arange(last)
    qpos, forces = _along(arm, t, q, qd, rows)
    k, j = np.nonzero(forces.use > 1.0 + _TOLERANCE)
    if not len(k):
        return None
    at_rest = _at_rest(arm, qpos[k], qd[rows[k]])
    # Of each force that is beyond a bound, in the direction of that.
    needed, f1, f0 = forces.needed[k, j], forces.damping[k, j], at_rest.needed[np.arange(len(k)), j]
    towards, bound = np.sign(needed), forces.bounds[k, j]
    f0, f1 = towards * f0, towards * f1
    f2, spare = np.abs(needed) - f0 - f1, bound - f0
    worst = int(spare.argmin())
    if spare[worst] <= 0.0:
        raise TooWeakError(_too_weak(arm, at_rest, worst, int(j[worst]), f"t = {t[rows[k[worst]]]:.2f} s"))
    stretch = (f1 + np.sqrt(np.maximum(f1**2 + 4.0 * spare * f2, 0.0))) / (2.0 * spare)
    worst = int(stretch.argmax())
    what, unit = _bounded_by(arm, int(j[worst]))
    reason = (
        f"{what} would need {abs(needed[worst]):.4g} {unit} at t = {t[rows[k[worst]]]:.2f} s, its force limit is "
        f"{bound[worst]:.4g} {unit}"
    )
    return float(t[-1] * stretch[worst]), reason


def _limited(arm: Arm) -> bool:
    """Whether any force has a limit."""
    return bool(np.isfinite(arm.force_limits if arm.dependents is None else actuator_ranges(arm.model)).any())


def _at_rest(arm: Arm, qpos: Floats, qd: Floats) -> _Forces:
    """Forces at rest, with dry friction against rates ``(S, n)``."""
    rest = np.zeros((len(qpos), arm.model.nv))
    return _bounded(arm, qpos, qd, *required_forces(arm.model, qpos, rest, rest, limited=True, grasp=arm.grasp))


def _along(
    arm: Arm, t: Floats, q: Floats, qd: Floats, rows: NDArray[np.int_], looks: NDArray[np.int_] | None = None
) -> tuple[Floats, _Forces]:
    """Positions ``(S, nq)`` and forces at rest at some samples, and then those of a motion at others.

    The acceleration is that to the next sample.
    """
    resting = np.arange(0) if looks is None else looks
    both = np.union1d(rows, rows + 1)
    qvel, at = arm.qvel(q[both], qd[both]), np.searchsorted(both, rows)
    qpos, still = arm.qpos(q[np.append(resting, rows)]), ((len(resting), 0), (0, 0))
    rates, qacc = np.pad(qvel[at], still), np.pad((qvel[at + 1] - qvel[at]) / (t[1] - t[0]), still)
    forces = required_forces(arm.model, qpos, rates, qacc, limited=True, grasp=arm.grasp)
    return qpos, _bounded(arm, qpos, np.pad(qd[rows], still), *forces)


def _bounded(arm: Arm, qpos: Floats, qd: Floats, needed: Floats, damping: Floats) -> _Forces:
    """What generalised forces ``(S, nv)``, and dry friction against rates ``(S, n)``, need of what is bounded."""
    model, basis = arm.model, tangent_basis(arm.space)
    if arm.dependents is not None:
        basis = arm.dependents.basis(qpos) @ basis[arm.dependents.dofs]
    needed, damping = np.vecmat(needed, basis), np.vecmat(damping, basis)
    friction = dry_friction(model, basis)
    moving = np.abs(qd) > _RESTING
    needed = needed + np.where(moving, np.sign(qd) * friction, -np.clip(needed, -friction, friction))
    if arm.dependents is None:
        return _Forces(needed, damping, -arm.force_limits, arm.force_limits)
    # Actuators act through the loops: forces of least norm.
    exert = np.linalg.pinv(np.swapaxes(actuator_moments(model) @ basis, -1, -2))
    return _Forces(np.matvec(exert, needed), np.matvec(exert, damping), *actuator_ranges(model).T)


def _bounded_by(arm: Arm, j: int) -> tuple[str, str]:
    """What has a bound, and the unit of that."""
    if arm.dependents is not None:
        return f"actuator {arm.model.actuator(j).name!r}", "N or N m"
    return f"joint {arm.joint_names[j]!r}", "N" if arm.unit(j) == "m" else "N m"


def _require_held(arm: Arm, forces: _Forces, where: Sequence[str]) -> None:
    """Raise `TooWeakError` if one of the first forces, those at rest, is beyond its bound."""
    use = forces.use[: len(where)]
    k, j = map(int, np.unravel_index(use.argmax(), use.shape))
    if use[k, j] > 1.0:
        raise TooWeakError(_too_weak(arm, forces, k, j, where[k]))


def _too_weak(arm: Arm, forces: _Forces, k: int, j: int, where: str) -> str:
    """The message that a force at rest is beyond its bound."""
    what, unit = _bounded_by(arm, j)
    how = "cannot be held" if arm.dependents is None else "cannot hold the arm"
    carried = f" with a payload of {arm.payload:g} kg" if arm.payload > 0.0 else ""
    return (
        f"{what} {how} at {where}{carried}: its load is {abs(forces.needed[k, j]):.4g} {unit}, its force limit "
        f"{forces.bounds[k, j]:.4g} {unit}"
    )
