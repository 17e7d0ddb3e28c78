"""Joints of a model that follow others in closed form, by its joint equalities; and which joints are left to lead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.coordinates import Line
from lieednn_sim.arm.equalities import (
    Residuals,
    dof_addresses,
    equality_name,
    involved_joints,
    loop_closures,
    names,
)
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class Follower:
    """A hinge or slide at y = c_0 + c_1 (x - x0) + c_2 (x - x0)^2 + ..., x the position of its leader [rad, m]."""

    joint: int  # its id
    leader: int | None  # the leader's id; None of a joint that an equality fixes at c_0
    coefficients: tuple[float, ...]  # c_0, c_1, ..., the last one not zero unless it is c_0
    x0: float


def independent_joints(model: mujoco.MjModel, chosen: Sequence[int]) -> list[int]:
    """The chosen joints, without those that equalities make followers of other chosen ones.

    Of several that follow a joint that is not chosen, such as stages of a telescope a drum, the first one is kept.
    """
    leaders = dict(tied_joints(model))
    result, led = [], set[int]()
    for joint in chosen:
        above, seen = leaders.get(joint), [joint]
        while above is not None and above not in chosen and above not in seen:
            seen.append(above)
            above = leaders.get(above)
        if above is not None and above in chosen and above != joint:
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
    data = mujoco.MjData(model)
    freedom = scipy.linalg.null_space(Residuals(model, data, loops, ()).at(qpos)[1], rcond=1e-9)
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


def straight_lines(followers: Sequence[Follower], independent: Sequence[int]) -> dict[int, Line]:
    """The linear followers of an independent joint, directly or through others."""
    lines: dict[int, Line] = {joint: (joint, 1.0, 0.0) for joint in independent}
    for follower in followers:
        if follower.leader in lines and len(follower.coefficients) == 2:
            (constant, slope), (root, ratio, shift) = follower.coefficients, lines[follower.leader]
            lines[follower.joint] = root, slope * ratio, constant + slope * (shift - follower.x0)
    return {joint: line for joint, line in lines.items() if joint not in independent}


def in_closed_form(
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


def loops_of(
    model: mujoco.MjModel, equalities: Sequence[int], roots: dict[int, int | None]
) -> tuple[list[int], set[int]]:
    """The equalities that involve joints moved by the arm, directly or through other joints, and these other joints."""
    involved = {equality: involved_joints(model, equality) for equality in equalities}
    moved, chosen = {joint for joint, root in roots.items() if root is not None}, set[int]()
    while more := {e for e, joints in involved.items() if e not in chosen and joints & moved}:
        chosen |= more
        moved |= {joint for e in more for joint in involved[e] if joint not in roots}
    return sorted(chosen), moved - roots.keys()
