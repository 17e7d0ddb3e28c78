"""Compound joints: which joints of a chain follow others, such as the stages of a telescope, and where it is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import BALL, JOINT_KINDS, SLIDE
from lieednn_sim.arm.coordinates import Line, Sum
from lieednn_sim.arm.forces import ON_JOINTS, disabled_actuators
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class Couplings:
    """Joints that follow others: qpos = ratio * (qpos of the leader) + shift."""

    lines: dict[int, Line] = field(default_factory=dict)  # for each follower of one independent joint
    added: dict[int, int] = field(default_factory=dict)  # tendons of followers that no equality ties yet
    sums: dict[int, Sum] = field(default_factory=dict)  # for joints that follow several others

    def line(self, joint: int) -> Line:
        """The independent joint that ``joint`` follows, or itself, with ratio and shift."""
        return self.lines.get(joint, (joint, 1.0, 0.0))

    def ratios(self, joint: int) -> dict[int, float]:
        """Displacements of ``joint`` per displacement of each independent joint that moves it."""
        leader, ratio, _ = self.line(joint)
        return self.sums[joint][0] if joint in self.sums else {leader: ratio}


def along_tendons(model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings) -> Couplings:
    """The couplings, and those of joints that they leave open but that actuators on fixed tendons determine.

    An actuator on a fixed tendon of length sum c_i q_i determines only how far the stages extend together. It pulls
    stage i with c_i times its force, so similar stages (of equal inertia and friction) move in the ratio of the c_i,
    which is also the smallest motion that gives the length. Equal coefficients mean equal displacements, as with a belt
    around all stages. Where several tendons determine all their joints, as in a differential, no joint follows another.
    `InputError` if such a tendon drives hinges and slides together.
    """
    for tendon in dict.fromkeys(driven_tendons(model)):
        couplings = _along_tendon(model, joints, couplings, tendon)
    return couplings


def coefficients(model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Joints of a fixed tendon with their coefficients; empty for a spatial one."""
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    wraps = [w for w in range(start, start + count) if model.wrap_type[w] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
    return {int(model.wrap_objid[w]): float(model.wrap_prm[w]) for w in wraps}


def driven_tendons(model: mujoco.MjModel) -> list[int]:
    """Tendons that enabled actuators pull at."""
    tendon = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)) & ~disabled_actuators(model)
    return [int(model.actuator_trnid[a, 0]) for a in np.flatnonzero(tendon)]


def driven_directly(model: mujoco.MjModel) -> set[int]:
    """Joints that enabled actuators drive without a tendon."""
    on_joints = np.isin(model.actuator_trntype, ON_JOINTS) & ~disabled_actuators(model)
    return set(model.actuator_trnid[on_joints, 0].tolist())


def _along_tendon(model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings, tendon: int) -> Couplings:
    pulls: dict[int, float] = {}  # coefficients of the independent joints that the tendon moves
    for joint, coefficient in coefficients(model, tendon).items():
        if joint in joints and coefficient:
            leader, ratio, _ = couplings.line(joint)
            pulls[leader] = pulls.get(leader, 0.0) + coefficient * ratio
    heads = [joint for joint in joints if pulls.get(joint)]
    if len(heads) < 2 or driven_directly(model).intersection(heads):
        return couplings
    every = [coefficients(model, other) for other in driven_tendons(model)]
    if np.linalg.matrix_rank([[each.get(head, 0.0) for head in heads] for each in every]) == len(heads):
        return couplings
    if len({int(model.jnt_type[joint]) for joint in heads}) > 1:
        name = model.tendon(tendon).name
        raise InputError(f"tendon {name!r} drives hinges and slides together; tie its joints by equalities instead")
    first, *others = heads
    x0, *zeros = model.qpos0[model.jnt_qposadr[heads]].tolist()
    ratios = [pulls[joint] / pulls[first] for joint in others]
    tied = {joint: (first, r, zero - r * x0) for joint, r, zero in zip(others, ratios, zeros, strict=True)}

    def along(leader: int, ratio: float, shift: float) -> Line:
        """A line whose leader may follow the first of the heads now."""
        root, further, constant = tied.get(leader, (leader, 1.0, 0.0))
        return root, ratio * further, ratio * constant + shift

    lines = {follower: along(*line) for follower, line in couplings.lines.items()} | tied
    sums: dict[int, Sum] = {}
    for joint, (parts, shift) in couplings.sums.items():
        total: dict[int, float] = {}
        for head, part in parts.items():
            root, further, shift = along(head, part, shift)
            total[root] = total.get(root, 0.0) + further
        sums[joint] = total, shift
    return Couplings(lines, couplings.added | dict.fromkeys(others, tendon), sums)


def cut(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], ranges: dict[int, Floats], couplings: Couplings
) -> tuple[tuple[int, ...], ...]:
    """Cut a chain into compound joints.

    Coupled joints, and joints of one body, stay together. Each slide, or telescope, ends a compound joint, which
    includes the hinge or ball joint directly inboard if together they turn by less than pi from their reference, so
    that the logarithm is unique, and their dofs are independent, so that the pose determines them. Every other joint
    is a compound joint of its own. If all would be one, the first joint is separated: a network of a single neuron has
    hardly any target that can be certified.

    Joints are ids from the base outwards, each with its range ``(2,)``; the data has the kinematics at a representative
    configuration. `InputError` if a joint moves nothing, because a follower undoes its motion.
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
