"""Limits besides the coordinates' position limits: rates, and the ranges of what else an arm moves.

Limits of rates are a model's custom numerics, those that the caller gives, or accelerations that force limits allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco, scratch_data
from lieednn_sim.arm.checks import BALL, FREE, SLIDE
from lieednn_sim.arm.equalities import free_ranges, joint_range, names, tendon_joints
from lieednn_sim.arm.forces import required_forces
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_positive
from lieednn_sim.values import Floats

RATES = ("velocity", "acceleration", "jerk")  # that have limits
_ROUNDING = 1e-6  # how far beyond a range rounding may lead [rad, m]


def check_rates(limits: Any) -> None:
    """Raise `InputError` unless ``limits`` is as in `Arm.of`."""
    for coordinate, given in (limits or {}).items():
        for what, value in given.items():
            as_choice("limit", what, RATES)
            as_positive(f"limit of {what} of {coordinate}", value)


def read_numeric(model: mujoco.MjModel, arm: str, field: str, default: Floats, viewed: bool) -> Floats:
    """A custom numeric of the model with as many values as ``default``, all of them positive.

    In a viewed model, a numeric with another number of values belongs to another arm, and is ignored.
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
    """Largest inertia ``(n,)``, armature included, of each coordinate with the others held, at ``(S, nq)``.

    Rates are as in `force_ranges`, ``(nv, n)`` or, where they differ, ``(S, nv, n)``.
    """
    data, column = scratch_data(model), np.zeros(model.nv)
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
    # A limit of zero would allow no motion; if an actuator cannot hold its load, plans and runs report that.
    known = (force > load) & (inertia > 0.0)
    # Half of the spare force: the rest is for friction and coupling to other joints.
    return np.where(known, 0.5 * (force - load) / np.where(known, inertia, 1.0), np.inf)


class Stops:
    """The ranges of joints that an arm moves by loops or curves and of limited tendons, in a compiled model.

    Args:
        joints: ids of the dependent joints; those with a range count.
        moving: ids of all joints that the arm moves: limited tendons between them count.
        loops: whether rows may be NaN, because loops cannot be closed there.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[int], moving: Sequence[int], *, loops: bool) -> None:
        self._model, self._loops = model, loops
        self._joints = [joint for joint in joints if model.jnt_limited[joint] and model.jnt_type[joint] != FREE]
        limited = np.flatnonzero(model.tendon_limited).tolist()
        self._tendons = [tendon for tendon in limited if tendon_joints(model, tendon).intersection(moving)]
        ranges = [joint_range(model, joint) for joint in self._joints]
        ranges += [*free_ranges(model.tendon_range[self._tendons], model.tendon_margin[self._tendons])]
        self._low, self._high = np.array(ranges, dtype=float).reshape(-1, 2).T

    def __len__(self) -> int:
        """Number of ranges, plus one if there are loops."""
        return len(self._low) + self._loops

    def excess(self, qpos: Floats) -> Floats:
        """How far joints and tendons ``(..., L)`` are beyond their ranges at ``(..., nq)`` [rad, m]; negative inside.

        Infinite in rows that are NaN, where loops cannot be closed.
        """
        rows = qpos.reshape(-1, self._model.nq)
        values, excess = self._values(rows), np.full((len(rows), len(self)), -np.inf)
        excess[:, : len(self._low)] = np.maximum(self._low - values, values - self._high) - _ROUNDING
        excess[np.isnan(rows).any(axis=1)] = np.inf
        return excess.reshape(*qpos.shape[:-1], len(self))

    def describe(self, qpos: Floats, index: int) -> str:
        """The message that the range with an index is exceeded at ``(nq,)``."""
        value, low, high = self._values(qpos[None])[0, index], self._low[index], self._high[index]
        if index >= len(self._joints):
            tendon = self._model.tendon(self._tendons[index - len(self._joints)])
            return f"tendon {tendon.name!r} would be at {value:.4g}, its range is [{low:.4g}, {high:.4g}]"
        joint = self._joints[index]
        unit = "m" if self._model.jnt_type[joint] == SLIDE else "rad"
        return (
            f"joint {names(self._model, [joint])}, which the arm's joints move, would be at {value:.4g} {unit}, its "
            f"range is [{low:.4g}, {high:.4g}]"
        )

    def _values(self, rows: Floats) -> Floats:
        """Positions of joints and lengths of tendons ``(K, L)`` at ``(K, nq)``."""
        model, values = self._model, np.empty((len(rows), len(self._low)))
        for column, joint in zip(values.T, self._joints, strict=False):
            first = model.jnt_qposadr[joint]
            if model.jnt_type[joint] == BALL:
                turn = np.linalg.norm(rows[:, first + 1 : first + 4], axis=1)
                column[:] = 2.0 * np.arctan2(turn, np.abs(rows[:, first]))
            else:
                column[:] = rows[:, first]
        if self._tendons:
            data = scratch_data(model)
            for value, row in zip(values[:, len(self._joints) :], rows, strict=True):
                if np.isnan(row[0]):
                    value[:] = np.nan
                    continue
                kinematics_at(model, row, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_tendon(model, data)
                value[:] = data.ten_length[self._tendons]
        return values
