"""Joints of any MuJoCo model that the independent joints of an arm move through its active equality constraints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.closed_loops import ClosedLoops
from lieednn_sim.arm.coordinates import Sum
from lieednn_sim.arm.equalities import (
    dof_addresses,
    involved_joints,
    joint_range,
    names,
)
from lieednn_sim.arm.followers import in_closed_form, loops_of, straight_lines
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

_PATH = 100  # number of rows from which on they count as a path


class Dependents:
    """The dependent joints of a compiled model, in a given state, and where they are.

    Joints tied to one other joint by an equality have a closed form: linear and polynomial followers, chains of them,
    and leaders whose linear follower is the independent joint. The others, in closed loops by connect, weld and tendon
    equalities, are solved by Newton's method from the state. Loops between joints that the arm does not move relative
    to each other, such as a gripper's, are left alone.

    Args:
        model: the compiled model, which is not changed.
        data: its state: which equalities are active, where mocap bodies are, and on which branch the loops are.
        independent: ids of the arm's independent hinge, slide and ball joints, at least one, without repetitions.

    Attributes:
        independent: their ids, in the model's order.
        dofs: ``(m,)`` addresses in qvel of the independent rates, three for a ball.
        moved: ids of the dependent joints that the independent ones move, free ones included, in the model's order.
        lines: for joints that follow an independent joint linearly, that joint, ratio and shift; among joints in loops,
            those that do so at random configurations, such as the bars of a scissor or a parallelogram.
        sums: the same for joints in loops that follow several of them linearly, such as a wrist that bars keep level.
        has_loops: whether there are closed loops, which may not be closed everywhere.

    Raises:
        InputError: a joint is not independent, or the dependent ones are not determined.
        NoSolutionError: the state is not near a solution, or at a dead centre.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, independent: Sequence[int]) -> None:
        self._model = model
        self.independent = tuple(sorted(int(joint) for joint in independent))
        self.dofs = dof_addresses(model, self.independent)
        off = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
        active = np.flatnonzero(data.eq_active * (not model.opt.disableflags & off))
        self._followers, roots, remaining = in_closed_form(model, [int(e) for e in active], self.independent)
        equalities, looped = loops_of(model, remaining, roots)
        led = {follower.joint for follower in self._followers if roots[follower.joint] is not None}
        self.moved = tuple(sorted(led | looped))
        self.lines, self.sums = straight_lines(self._followers, self.independent), dict[int, Sum]()
        self._loops: ClosedLoops | None = None
        # The last rows asked for, and their solution: limits and contacts are tested one after another, along a path in
        # another order, and with a few other rows among them.
        self._last = np.zeros((0, model.nq)), np.zeros((0, model.nq))
        self._path = dict[bytes, Floats]()
        if equalities:
            qpos = np.array(data.qpos)
            moving = {roots[joint] for e in equalities for joint in involved_joints(model, e) & roots.keys()} - {None}
            drivers = dof_addresses(model, [joint for joint in moving if joint is not None])
            self._loops = ClosedLoops(model, data, equalities, sorted(looped), drivers, self._follow)
            self._follow(qpos)
            self._loops.check_independent(self._closed_form_basis(qpos[None])[0], model.dof_jntid[self.dofs])
            self._find_lines(qpos, sorted(looped))
        self.has_loops = self._loops is not None

    def to_qpos(self, qpos: Floats, *, strict: bool = True) -> Floats:
        """Solve the dependent joints in rows ``(..., nq)`` in which the independent ones are set; all others stay.

        With loops, rows along a path take the least time. If not ``strict``, rows without a solution become NaN.

        Raises:
            InputError: the shape is wrong.
            NoSolutionError: the loops cannot be closed there, or not on the branch of the state.
        """
        result = self._checked(qpos).copy()
        self._follow(result)
        if self._loops is None:
            return result
        rows = result.reshape(-1, self._model.nq)
        if not np.array_equal(rows, self._last[0]):
            asked, keys = rows.copy(), [row.tobytes() for row in rows] if len(rows) > _PATH else []
            new = [k for k, key in enumerate(keys) if key not in self._path]
            if keys and 2 * len(new) < len(keys):
                some = asked[new]
                self._loops.solve(some)
                known = {**self._path, **{keys[k]: row for k, row in zip(new, some, strict=True)}}
                rows[:] = [known[key] for key in keys]
            else:
                self._loops.solve(rows)
                if keys:
                    self._path = dict(zip(keys, rows.copy(), strict=True))
            self._last = asked, rows.copy()
        rows[:] = self._last[1]
        missing = np.isnan(rows).any(axis=1)
        if strict and missing.any():
            first = int(missing.argmax())
            raise self._loops.failure(first, self._last[0][first])
        return result

    def basis(self, qpos: Floats) -> Floats:
        """B ``(..., nv, m)`` with qvel = B qd for the independent rates qd, at rows ``(..., nq)`` of `to_qpos`.

        The dependent rates are -J_d^+ J_i qd with the Jacobian J of the equalities; those of other joints are zero.

        Raises:
            InputError: the shape is wrong.
            NoSolutionError: a row is at a dead centre of a loop.
        """
        rows = self._checked(qpos)
        result = self._closed_form_basis(rows)
        if self._loops is not None:
            flat = result.reshape(-1, *result.shape[-2:])
            for position, rates in zip(rows.reshape(-1, self._model.nq), flat, strict=True):
                rates[self._loops.dofs] = self._loops.slopes(position, rates)
        return result

    def follower_limits(self) -> Floats:
        """Intervals ``(m, 2)`` of the independent coordinates in which linear followers keep within their ranges.

        They are infinite without such followers; the ranges of the independent joints themselves, of polynomial
        followers and of joints in loops are not considered. `InputError` if followers' ranges leave no position.
        """
        model, limits = self._model, np.tile([-np.inf, np.inf], (len(self.dofs), 1))
        for joint, (leader, ratio, shift) in self.lines.items():
            if model.jnt_limited[joint]:
                low, high = np.sort((joint_range(model, joint) - shift) / ratio)
                k = int(np.searchsorted(self.dofs, model.jnt_dofadr[leader]))
                limits[k] = max(limits[k, 0], low), min(limits[k, 1], high)
        empty = np.flatnonzero(limits[:, 0] > limits[:, 1])
        if len(empty):
            led_by = names(model, [int(model.dof_jntid[self.dofs[empty[0]]])])
            raise InputError(f"the ranges of the joints that follow {led_by} exclude each other; widen them")
        return limits

    def _find_lines(self, state: Floats, joints: Sequence[int]) -> None:
        """Add hinges and slides in loops to `lines` and `sums` if they are linear at random configurations."""
        model, rows = self._model, np.tile(state, (12, 1))
        scalars = [j for j in self.independent if len(dof_addresses(model, [j])) == 1]
        spans = [model.jnt_range[j] if model.jnt_limited[j] else state[model.jnt_qposadr[j]] + [-1, 1] for j in scalars]
        low, high = np.array(spans).reshape(-1, 2).T
        rows[:, model.jnt_qposadr[scalars]] = np.random.default_rng(0).uniform(low, high, (len(rows), len(low)))
        rows = self.to_qpos(rows, strict=False)
        rows = rows[~np.isnan(rows).any(axis=1)]
        for joint in [j for j in joints if len(dof_addresses(model, [j])) == 1 and len(rows) > len(scalars) + 1]:
            y, x = rows[:, model.jnt_qposadr[joint]], rows[:, model.jnt_qposadr[scalars]]
            design = np.column_stack([x, np.ones(len(x))])
            # Rounded, so that short numbers such as 1 and 2 are exact: turns are then known to repeat.
            *ratios, shift = np.round(np.linalg.lstsq(design, y, rcond=None)[0], 12)
            leads = {j: float(ratio) for j, ratio in zip(scalars, ratios, strict=True) if abs(ratio) > 1e-7}
            if leads and np.abs(design @ [*ratios, shift] - y).max() < 1e-9:
                if len(leads) == 1:
                    (lead, ratio), *_ = leads.items()
                    self.lines[joint] = lead, ratio, float(shift)
                else:
                    self.sums[joint] = leads, float(shift)

    def _checked(self, qpos: Floats) -> Floats:
        rows = np.asarray(qpos, dtype=float)
        if rows.shape[-1:] != (self._model.nq,) or not np.isfinite(rows).all():
            raise InputError(f"positions must be finite rows of {self._model.nq} numbers (nq), got shape {rows.shape}")
        return rows

    def _follow(self, qpos: Floats) -> None:
        """Set the joints in closed form, in place; ``qpos`` is ``(..., nq)``."""
        address = self._model.jnt_qposadr
        for follower in self._followers:
            x = 0.0 if follower.leader is None else qpos[..., address[follower.leader]] - follower.x0
            qpos[..., address[follower.joint]] = np.polynomial.polynomial.polyval(x, follower.coefficients)

    def _closed_form_basis(self, qpos: Floats) -> Floats:
        """`basis` without the loops; ``qpos`` is ``(..., nq)``."""
        model = self._model
        result = np.zeros((*qpos.shape[:-1], model.nv, len(self.dofs)))
        result[..., self.dofs, np.arange(len(self.dofs))] = 1.0
        for follower in self._followers:
            if follower.leader is not None:
                x = qpos[..., model.jnt_qposadr[follower.leader]] - follower.x0
                slopes = [k * coefficient for k, coefficient in enumerate(follower.coefficients)][1:] or [0.0]
                slope = np.asarray(np.polynomial.polynomial.polyval(x, slopes))
                rates = result[..., model.jnt_dofadr[follower.leader], :]
                result[..., model.jnt_dofadr[follower.joint], :] = slope[..., None] * rates
        return result
