"""Whether actuators can hold an arm at rest, and have the forces for a motion, including what the arm carries."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import (
    actuator_moments,
    actuator_ranges,
    control_forces,
    dry_friction,
    limited_tendons,
    lost_forces,
    required_forces,
)
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.values import Floats, weakly_cached

_NEAR = 0.7  # of a limit; above it more samples are checked, between which 288 fast motions had < 1.25 times as much
_TOLERANCE = 1e-6  # relative excess of a force over its limit that is allowed
# Rate below which dry friction holds a joint rather than brakes it [rad/s, m/s], and least bound of a force [N m, N].
_RESTING, _LEAST = 1e-6, 1e-6


class TooWeakError(PlanError, InputError):
    """Actuators cannot hold the arm's weight, at start or target, or on the way; another way may need less force."""


def force_use(arm: Arm, t: Floats, q: Floats, qd: Floats) -> float:
    """Largest force that a motion needs from the actuators, in units of its limit; arguments as for `check_forces`."""
    return float(_use(_along(arm, t, q, qd, np.arange(len(t) - 1))).max())


def exerted_use(arm: Arm, qpos: Floats, qd: Floats, force: Floats) -> float:
    """Largest use of limits, as in `force_use`, by forces ``(K, n)`` along the coordinates, with rates qd."""
    basis = arm.moving(qpos)
    return float(_use(_with_bounds(arm, force, basis, np.matvec(basis, qd))).max())


def path_forces(arm: Arm, path: Callable[..., Floats], s: Floats) -> Floats:
    """Forces along a path q(s) over their bounds: coefficients ``(4, S, 2 m)`` of s'', s'^2, s' > 0 and 1.

    The path is called as ``path(s, order)``, with s ``(S,)``. The forces must be below 1; bounds from below come first.
    """
    q, slope, step = path(s), path(s, 1), 1e-6
    ahead, behind = (arm.qvel(path(at), path(at, 1)) for at in (s + step, s - step))
    rates = arm.qvel(q, slope)
    still, damping, rest = _parts(arm, q, slope, rates, (ahead - behind) / (2.0 * step))
    forces = np.stack([needed_forces(arm, q, slope, 0.0, rates)[0] - still, rest, damping, still])
    return np.concatenate([forces / bound for bound in _bounds(arm)], axis=2)


def check_held(arm: Arm, q: Floats, where: Sequence[str]) -> None:
    """Raise `TooWeakError` if actuators cannot hold the arm at rest, even with the help of dry friction.

    It is checked at configurations q ``(K, n)``; ``where`` says what each is, for the message.
    """
    use = _use(forces := needed_forces(arm, q, np.zeros_like(q)))
    k, j = map(int, np.unravel_index(use.argmax(), use.shape))
    if use[k, j] > 1.0:
        raise TooWeakError(_overload(arm, j, f"cannot be held at {where[k]}", *forces[:, k, j]))


def check_forces(arm: Arm, t: Floats, q: Floats, qd: Floats) -> tuple[float, str] | None:
    """Compare the forces that a motion needs, by inverse dynamics, with those that the arm's actuators have.

    The arm includes its payload and what it holds; arguments are as for `motion.check_joints`. Dry friction acts
    against the motion; contacts are left out. First a few samples and those with extreme accelerations are checked.
    If one of these needs 0.7 of a limit, about 250 are, and then all samples near those that need as much, or where an
    acceleration changes by a fifth of its largest value.

    If time is stretched by s, the forces f0 of gravity, springs and dry friction stay the same, f1 of dampers become f1
    / s, and the others f2 / s^2. So a force is below F from s = (f1 + sqrt(f1^2 + 4 (F - f0) f2)) / (2 (F - f0)) on.
    `TooWeakError` if f0 alone is beyond a limit.

    Returns:
        None if all are within their limits; otherwise the duration that keeps them [s], and what does not, in words.
    """
    last = len(t) - 1
    looks, changes = np.linspace(0, last, 33).round().astype(int), np.diff(qd, axis=0)
    first = np.unique([*np.minimum(looks, last - 1), *changes.argmax(axis=0), *changes.argmin(axis=0)])
    if np.isinf(_bounds(arm)).all() or (near := _use(_along(arm, t, q, qd, first)).max(axis=1) > _NEAR).sum() == 0:
        return None
    check_held(arm, q[looks], [f"t = {time:.2f} s" for time in t[looks]])
    # About 250 samples tell whether a motion is far too fast, as many are. If not, check those near the busiest, too.
    some = np.arange(0, last, stride := max(1, last // 250))
    use = _use(forces := _along(arm, t, q, qd, some))
    if stride > 1 and use.max() <= 1.0 + _TOLERANCE:
        busy = use.max(axis=1) > _NEAR
        busy[np.searchsorted(some, first[near], side="right") - 1] = True
        some = _between(some, busy, qd)
        use = _use(forces := _along(arm, t, q, qd, some))
    k, j = np.nonzero(use > 1.0 + _TOLERANCE)
    if not len(k):
        return None
    rows, (needed, bound) = some[k], forces[:, k, j]
    # The parts of the force in the direction of the bound that is exceeded.
    f0, f1, f2 = np.sign(needed) * [part[np.arange(len(rows)), j] for part in _along(arm, t, q, qd, rows, _parts)]
    if (f0 >= bound).any():
        worst = int((bound - f0).argmin())
        where = f"cannot be held at t = {t[rows[worst]]:.2f} s"
        raise TooWeakError(_overload(arm, int(j[worst]), where, f0[worst], bound[worst]))
    stretch = least_stretch(f0, f1, f2, bound)
    worst = int(stretch.argmax())
    where = f"would be overloaded at t = {t[rows[worst]]:.2f} s"
    return float(t[-1] * stretch[worst]), _overload(arm, int(j[worst]), where, needed[worst], bound[worst])


def _between(some: NDArray[np.int_], busy: NDArray[np.bool_], qd: Floats) -> NDArray[np.int_]:
    """Samples between two evenly spaced ones if one of these is busy, or an acceleration changes by a fifth or more."""
    changes = np.diff(qd, axis=0)
    swing = np.maximum.reduceat(changes, some) - np.minimum.reduceat(changes, some)
    busy = busy | np.append(busy[1:], False) | (swing > 0.2 * np.abs(changes).max(axis=0)).any(axis=1)
    between = (some[busy, None] + np.arange(1, some[1] - some[0])).ravel()
    return between[between < len(changes)]


def least_stretch(still: Floats, damping: Floats, rest: Floats, bound: Floats | float) -> Floats:
    """The least stretch s of time for which f0 + f1 / s + f2 / s^2 is below a bound; 0 where f0 alone is above it."""
    spare = bound - still
    root = np.sqrt(np.maximum(damping**2 + 4.0 * spare * rest, 0.0))
    return np.where(spare > 0.0, (damping + root) / (2.0 * np.where(spare > 0.0, spare, 1.0)), 0.0)


def _simple(arm: Arm) -> bool:
    """Whether `Arm.force_limits` say all: no actuator, or pair of them, has a limit that these do not show."""
    if arm.dependents is not None:
        return False
    moves = np.abs(actuator_moments(arm.model) @ arm.unit_rates()) > 1e-9
    (low, high), lost = (of(arm.model)[moves.any(axis=1)].T for of in (actuator_ranges, lost_forces))
    alone = max(moves.sum(axis=0).max(), moves.sum(axis=1).max(initial=0)) <= 1
    return bool(alone and not lost.any() and (low < 0.0).all() and (high > 0.0).all())


@weakly_cached
def _bounds(arm: Arm) -> tuple[Floats, Floats]:
    """Least and largest forces ``(m,)``, as in `needed_forces`; more than n unless the arm is `_simple`."""
    most = arm.force_limits if arm.dependents is None else np.full(arm.n_joints, np.inf)
    low, high = np.stack([-most, most])
    if not _simple(arm):
        model = arm.model
        sums = model.jnt_actfrcrange[model.jnt_actfrclimited != 0], limited_tendons(model)[1]
        ranges = actuator_ranges(model, controls=False), control_forces(model), *sums
        low, high = np.concatenate([[low, high], *(each.T for each in ranges)], axis=1)
    return np.minimum(low, -_LEAST), np.maximum(high, _LEAST)


def _parts(arm: Arm, q: Floats, qd: Floats, qvel: Floats, qacc: Floats) -> Floats:
    """Forces of gravity, springs and dry friction, of dampers, and the rest, ``(3, S, m)``, as in `needed_forces`."""
    # Only the forces of dampers change their sign if the rates are reversed.
    still, along, back = (needed_forces(arm, q, qd, *rates)[0] for rates in ((0.0, 0.0), (qvel, qacc), (-qvel, qacc)))
    return np.stack([still, 0.5 * (along - back), 0.5 * (along + back) - still])


def needed_forces(arm: Arm, q: Floats, qd: Floats, qvel: Floats | float = 0.0, qacc: Floats | float = 0.0) -> Floats:
    """Forces needed at configurations q ``(S, n)``, with dry friction against rates qd, and their bounds ``(2, S, m)``.

    They are generalised forces along the coordinates. Where limits of these do not say all, such as in closed loops or
    with tendons that pull at several joints, those of all actuators and limited sums at joints and tendons follow.
    """
    qpos = arm.qpos(q)  # with rates of what is carried, forces include those on it
    basis = arm.moving(qpos) if arm.grasp is None else arm.unit_rates(q)
    needed = np.vecmat(required_forces(arm.model, qpos, qvel, qacc, limited=True), basis)
    friction = dry_friction(arm.model, basis)
    needed += np.where(np.abs(qd) > _RESTING, np.sign(qd) * friction, -np.clip(needed, -friction, friction))
    return _with_bounds(arm, needed, basis, qvel)


def _with_bounds(arm: Arm, needed: Floats, basis: Floats, qvel: Floats | float) -> Floats:
    """Forces along the coordinates ``(S, n)``, and those that follow from them, with bounds, as in `needed_forces`."""
    (low, high), model = _bounds(arm), arm.model
    if len(low) > arm.n_joints:
        # The actuator forces of least norm that have this effect.
        moments = actuator_moments(model)
        exerted = np.matvec(np.linalg.pinv(np.swapaxes(moments @ basis, -1, -2)), needed)
        at_joints, at_tendons = moments[:, model.jnt_dofadr[model.jnt_actfrclimited != 0]], limited_tendons(model)[0].T
        controlled = exerted + lost_forces(model) * np.matvec(moments, qvel + np.zeros(model.nv))
        needed = np.concatenate([needed, exerted, controlled, exerted @ at_joints, exerted @ at_tendons], axis=1)
    return np.stack([needed, np.where(needed > 0.0, high, -low)])


def _along(
    arm: Arm, t: Floats, q: Floats, qd: Floats, rows: NDArray[np.int_], of: Callable[..., Floats] = needed_forces
) -> Floats:
    """`needed_forces` for some samples of a motion, each with the acceleration to the next sample."""
    qvel, after = arm.qvel(q[rows], qd[rows]), arm.qvel(q[rows + 1], qd[rows + 1])
    # At the first step from rest, dry friction acts against the motion, too.
    return of(arm, q[rows], qd[rows] + qd[rows + 1], qvel, (after - qvel) / (t[1] - t[0]))


def _use(forces: Floats) -> Floats:
    """Forces of `needed_forces` in units of their bounds ``(S, m)``."""
    return np.asarray(np.abs(forces[0]) / forces[1])


def _overload(arm: Arm, j: int, where: str, load: float, limit: float) -> str:
    """The message that a force is beyond its bound."""
    model, unit, n = arm.model, "N or N m", arm.n_joints
    if j < n:
        what, unit = f"joint {arm.joint_names[j]!r}", "N" if arm.unit(j) == "m" else "N m"
    elif j < n + 2 * model.nu:
        what, where = f"actuator {model.actuator((j - n) % model.nu).name!r}", where.replace("be held", "hold")
    else:
        at, joints = j - n - 2 * model.nu, np.flatnonzero(model.jnt_actfrclimited)
        limited = *map(model.joint, joints), *map(model.tendon, np.flatnonzero(model.tendon_actfrclimited))
        what = f"{'joint' if at < len(joints) else 'tendon'} {limited[at].name!r}"
    carried = f" with a payload of {arm.payload:g} kg" if arm.payload > 0.0 else ""
    return f"{what} {where}{carried}: its load is {abs(load):.4g} {unit}, its force limit {limit:.4g} {unit}"
