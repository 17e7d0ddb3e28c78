"""Joints of any MuJoCo model that the independent joints of an arm move through its active equality constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.closed_loops import ClosedLoops
from lieednn_sim.arm.coordinates import Line, Sum
from lieednn_sim.arm.equalities import (
    Residuals,
    dof_addresses,
    equalities_hold,
    equality_name,
    involved_joints,
    joint_range,
    loop_closures,
    names,
)
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats, weakly_cached

_PATH = 100  # number of rows from which on they count as a path


@dataclass(frozen=True)
class Follower:
    """A hinge or slide at y = c_0 + c_1 (x - x0) + c_2 (x - x0)^2 + ..., x the position of its leader [rad, m]."""

    joint: int  # its id
    leader: int | None  # the leader's id; None of a joint that an equality fixes at c_0
    coefficients: tuple[float, ...]  # c_0, c_1, ..., the last one not zero unless it is c_0
    x0: float


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
        active = np.flatnonzero(data.eq_active & equalities_hold(model.opt))
        self._followers, roots, remaining = _in_closed_form(model, [int(e) for e in active], self.independent)
        equalities, looped = _loops_of(model, remaining, roots)
        led = {follower.joint for follower in self._followers if roots[follower.joint] is not None}
        self.moved = tuple(sorted(led | looped))
        self.lines, self.sums = _lines(self._followers, self.independent), dict[int, Sum]()
        self._loops: ClosedLoops | None = None
        if equalities:
            qpos = np.array(data.qpos)
            moving = {roots[joint] for e in equalities for joint in involved_joints(model, e) & roots.keys()} - {None}
            drivers = dof_addresses(model, [joint for joint in moving if joint is not None])
            self._loops = ClosedLoops(model, data, equalities, sorted(looped), drivers, self._follow)
            self._follow(qpos)
            self._loops.check_independent(self._closed_form_basis(qpos[None])[0], model.dof_jntid[self.dofs])
            self._find_lines(qpos, sorted(looped))
        self.has_loops = self._loops is not None

    @property
    @weakly_cached
    def _asked(self) -> SimpleNamespace:
        """The last rows that this thread asked for, and their solution, and those of its last path by their bytes.

        Limits and contacts are tested one after another, along a path in another order, with a few other rows among
        them. The last digits of a row's solution depend on the rows before it.
        """
        nothing = np.zeros((0, self._model.nq))
        return SimpleNamespace(last=(nothing, nothing), path=dict[bytes, Floats]())

    def to_qpos(self, qpos: Floats, *, strict: bool = True) -> Floats:
        """Solve the dependent joints in rows ``(..., nq)`` in which the independent ones are set; all others stay.

        With loops, rows along a path take the least time. `NoSolutionError` if the loops cannot be closed there, or not
        on the branch of the state; if not ``strict``, such rows become NaN.
        """
        result = self._checked(qpos).copy()
        self._follow(result)
        if self._loops is None:
            return result
        rows, known = result.reshape(-1, self._model.nq), self._asked
        if not np.array_equal(rows, known.last[0]):
            asked, keys = rows.copy(), [row.tobytes() for row in rows] if len(rows) > _PATH else []
            new = [k for k, key in enumerate(keys) if key not in known.path]
            if keys and 2 * len(new) < len(keys):
                some = asked[new]
                self._loops.solve(some)
                path = {**known.path, **{keys[k]: row for k, row in zip(new, some, strict=True)}}
                rows[:] = [path[key] for key in keys]
            else:
                self._loops.solve(rows)
                if keys:
                    known.path = dict(zip(keys, rows.copy(), strict=True))
            known.last = asked, rows.copy()
        rows[:] = known.last[1]
        missing = np.isnan(rows).any(axis=1)
        if strict and missing.any():
            first = int(missing.argmax())
            raise self._loops.failure(first, known.last[0][first])
        return result

    def basis(self, qpos: Floats) -> Floats:
        """B ``(..., nv, m)`` with qvel = B qd for the independent rates qd, at rows ``(..., nq)`` of `to_qpos`.

        The dependent rates are -J_d^+ J_i qd with the Jacobian J of the equalities; those of other joints are zero.
        `NoSolutionError` if a row is at a dead centre of a loop.
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


def independent_joints(model: mujoco.MjModel, chosen: Sequence[int]) -> list[int]:
    """The chosen joints, without those that equalities make followers of other chosen ones.

    Of several that follow a joint not chosen, such as telescope stages that a drum drives, the first one is kept.
    """
    leaders = dict(tied_joints(model))
    result, led = [], set[int]()
    for joint in chosen:
        above, seen = leaders.get(joint), [joint]
        while above is not None and above not in chosen and above not in seen:
            seen.append(above)
            above = leaders.get(above)
        mutual = above is not None and leaders.get(above) == joint and above not in result  # the first of both leads
        if above is not None and above in chosen and above != joint and not mutual:
            continue
        if above is None and len(seen) > 1:
            if seen[-1] in led:
                continue
            led.add(seen[-1])
        result.append(joint)
    return result


def freely_moving(model: mujoco.MjModel, qpos: Floats, joints: Sequence[int]) -> list[int]:
    """Those of the joints that can move independently of the ones before them, with closed loops at ``(nq,)``."""
    loops = loop_closures(model)
    if not loops:
        return list(joints)
    freedom = scipy.linalg.null_space(Residuals(model, mujoco.MjData(model), loops, ()).at(qpos)[1], rcond=1e-9)
    result: list[int] = []
    for joint in joints:
        dofs = dof_addresses(model, [*result, joint])
        if np.linalg.matrix_rank(freedom[dofs], tol=1e-9) == len(dofs):
            result.append(joint)
    return result


def tied_joints(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs (follower, leader) of the active equalities between two joints."""
    tied = (model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_active0 != 0) & (model.eq_obj2id >= 0)
    return list(zip(model.eq_obj1id[tied].tolist(), model.eq_obj2id[tied].tolist(), strict=True))


def _follower_of(model: mujoco.MjModel, equality: int) -> Follower:
    """MuJoCo's y - y0 = a0 + a1 (x - x0) + ..., y the first joint and x the second, y0 and x0 their references."""
    joint, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    y0 = float(model.qpos0[model.jnt_qposadr[joint]])
    constant, *slopes = map(float, model.eq_data[equality, :5])
    while slopes and slopes[-1] == 0.0:
        slopes.pop()
    if leader < 0 or not slopes:
        return Follower(joint, None, (y0 + constant,), 0.0)
    return Follower(joint, leader, (y0 + constant, *slopes), float(model.qpos0[model.jnt_qposadr[leader]]))


def _lines(followers: Sequence[Follower], independent: Sequence[int]) -> dict[int, Line]:
    """The linear followers of an independent joint, directly or through others."""
    lines: dict[int, Line] = {joint: (joint, 1.0, 0.0) for joint in independent}
    for follower in followers:
        if follower.leader in lines and len(follower.coefficients) == 2:
            (constant, slope), (root, ratio, shift) = follower.coefficients, lines[follower.leader]
            lines[follower.joint] = root, slope * ratio, constant + slope * (shift - follower.x0)
    return {joint: line for joint, line in lines.items() if joint not in independent}


def _in_closed_form(
    model: mujoco.MjModel, equalities: Sequence[int], independent: Sequence[int]
) -> tuple[list[Follower], dict[int, int | None], list[int]]:
    """Followers, each after its leader; the independent joint that each joint follows, or None; the rest."""
    roots: dict[int, int | None] = {joint: joint for joint in independent}
    followers, remaining, tied = [], list(equalities), int(mujoco.mjtEq.mjEQ_JOINT)
    while True:
        before = len(remaining)
        for equality in [e for e in remaining if model.eq_type[e] == tied]:
            follower = _follower_of(model, equality)
            joint, leader, coefficients = follower.joint, follower.leader, follower.coefficients
            if joint in roots and leader is not None and leader not in roots and len(coefficients) == 2:
                constant, slope = coefficients
                follower = Follower(leader, joint, (follower.x0, 1.0 / slope), constant)
            elif joint in independent and leader is None:
                raise InputError(
                    f"{names(model, [joint])} is fixed by {equality_name(model, equality)}; leave it out of the "
                    "independent joints, or deactivate the equality"
                )
            elif joint in roots or (leader is not None and leader not in roots):
                continue
            roots[follower.joint] = None if follower.leader is None else roots[follower.leader]
            followers.append(follower)
            remaining.remove(equality)
        if len(remaining) == before:
            return followers, roots, remaining


def _loops_of(
    model: mujoco.MjModel, equalities: Sequence[int], roots: dict[int, int | None]
) -> tuple[list[int], set[int]]:
    """The equalities that involve joints moved by the arm, directly or through other joints, and these other joints."""
    involved = {equality: involved_joints(model, equality) for equality in equalities}
    moved, chosen = {joint for joint, root in roots.items() if root is not None}, set[int]()
    while more := {e for e, joints in involved.items() if e not in chosen and joints & moved}:
        chosen |= more
        moved |= {joint for e in more for joint in involved[e] if joint not in roots}
    return sorted(chosen), moved - roots.keys()
