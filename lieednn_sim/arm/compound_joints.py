"""Where the chain is cut into compound joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import BALL, JOINT_KINDS, SLIDE
from lieednn_sim.arm.coupled_joints import Couplings
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats


def cut(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], ranges: dict[int, Floats], couplings: Couplings
) -> tuple[tuple[int, ...], ...]:
    """Cut a chain into compound joints.

    Coupled joints, and joints of one body, stay together. Each slide, or telescope, ends a compound joint, which
    includes the hinge or ball joint directly inboard if together they turn by less than pi from their reference, so
    that the logarithm is unique, and their dofs are independent, so that the pose determines them. Every other joint
    is a compound joint of its own. If all would be one, the first joint is separated: a network of a single neuron has
    hardly any target that can be certified.

    Args:
        model, data: the model, with its kinematics at a representative configuration.
        joints: joint ids from the base outwards.
        ranges: for each joint, its range ``(2,)``.
        couplings: joints that follow others.

    Raises:
        InputError: a joint moves nothing, because a follower undoes its motion.
    """
    units = _units(model, data, joints, ranges, couplings)
    groups: list[list[_Unit]] = []
    for unit in units:
        group = [unit]
        while unit.kind == "slide" and groups and len(groups[-1]) == 1 and groups[-1][0].kind in ("hinge", "ball"):
            if not _fits([*groups[-1], *group]):
                break
            group = [*groups.pop(), *group]
        groups.append(group)
    if len(groups) == 1 and len(units) > 1:
        groups = [units[:1], units[1:]]
    return tuple(tuple(joint for unit in group for joint in unit.joints) for group in groups)


@dataclass(frozen=True, eq=False)
class _Unit:
    joints: tuple[int, ...]
    kind: str
    turn: float  # how far it turns from its reference at most [rad]
    screws: Floats  # (6, k), translations in units of the arm's size


def _units(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], ranges: dict[int, Floats], couplings: Couplings
) -> list[_Unit]:
    anchors, screws = data.xanchor[list(joints)], np.zeros((2, 3, model.nv))
    mujoco.mj_comPos(model, data)
    size = max(float(np.linalg.norm(anchors - anchors[0], axis=1).max()), 1e-2)
    runs: list[list[int]] = []
    last = {lead: i for i, joint in enumerate(joints) for lead in couplings.ratios(joint)}
    end, bodies = -1, model.jnt_bodyid
    for i, joint in enumerate(joints):
        if i > end:
            runs.append([])
        runs[-1].append(joint)
        same_body = max(k for k, other in enumerate(joints) if bodies[other] == bodies[joint])
        end = max(end, same_body, *(last[lead] for lead in couplings.ratios(joint)))
    units = []
    for run in runs:
        kinds = {int(model.jnt_type[joint]) for joint in run}
        kind = JOINT_KINDS[kinds.pop()] if len(kinds) == 1 else "mixed"
        turns, columns = 0.0, {lead: np.zeros((6, 1)) for joint in run for lead in couplings.ratios(joint)}
        mujoco.mj_jac(model, data, screws[1], screws[0], anchors[0], int(bodies[run[-1]]))
        moving = np.concatenate([screws[0], screws[1] / size])
        for joint in run:
            dof, ball = int(model.jnt_dofadr[joint]), model.jnt_type[joint] == BALL
            if model.jnt_type[joint] != SLIDE:
                reference = 0.0 if ball else model.qpos0[model.jnt_qposadr[joint]]
                turns += float(np.abs(ranges[joint] - reference).max())
            for lead, ratio in couplings.ratios(joint).items():
                columns[lead] = columns[lead] + ratio * moving[:, dof : dof + (3 if ball else 1)]
        for lead, column in columns.items():
            if np.linalg.norm(column) < 1e-9:
                others = ", ".join(repr(model.joint(joint).name) for joint in run if joint != lead)
                raise InputError(
                    f"joint {model.joint(lead).name!r} moves nothing, since {others}, which follows it, undoes its "
                    "motion; correct the equality, or leave both out of the arm"
                )
        units.append(_Unit(tuple(run), kind, turns, np.hstack(list(columns.values()))))
    return units


def _fits(units: Sequence[_Unit]) -> bool:
    screws = np.hstack([unit.screws for unit in units])
    if screws.shape[1] > 6 or sum(unit.turn for unit in units) >= np.pi:
        return False
    sizes = np.linalg.svd(screws / np.linalg.norm(screws, axis=0), compute_uv=False)
    singular = 1e-3  # least relative singular value at which the screws of a compound joint count as independent
    return bool(sizes[-1] > singular * sizes[0])
