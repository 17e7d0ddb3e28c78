"""Joints of a chain that follow others, such as the stages of a telescope that one belt extends together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.coordinates import Line, Sum
from lieednn_sim.arm.forces import ON_JOINTS, disabled_actuators
from lieednn_sim.errors import InputError


@dataclass(frozen=True)
class Couplings:
    """Joints that follow others: qpos = ratio * (qpos of the leader) + shift.

    Attributes:
        lines: for each follower, its independent leader, ratio and shift.
        added: for each follower tied by a fixed tendon and by no equality yet, the tendon.
        sums: of joints that follow several others, ratios by leader, and shift.
    """

    lines: dict[int, Line] = field(default_factory=dict)
    added: dict[int, int] = field(default_factory=dict)
    sums: dict[int, Sum] = field(default_factory=dict)

    def line(self, joint: int) -> Line:
        """The independent joint that ``joint`` follows, or itself, with ratio and shift."""
        return self.lines.get(joint, (joint, 1.0, 0.0))

    def ratios(self, joint: int) -> dict[int, float]:
        """Displacements of ``joint`` per displacement of each independent joint that moves it."""
        leader, ratio, _ = self.line(joint)
        return self.sums[joint][0] if joint in self.sums else {leader: ratio}


def along_tendons(model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings) -> Couplings:
    """Couplings, and those among some joints that fixed tendons with actuators add where they leave it open.

    An actuator on a fixed tendon of length sum c_i q_i determines only how far the stages extend together. It pulls
    stage i with c_i times its force, so similar stages (of equal inertia and friction) move in the ratio of the c_i,
    which is also the smallest motion that gives the length. Equal coefficients mean equal displacements, as with a belt
    around all stages.

    Raises:
        InputError: such a tendon drives hinges and slides together.
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
    if len({int(model.jnt_type[joint]) for joint in heads}) > 1:
        raise InputError(
            f"tendon {model.tendon(tendon).name!r} drives hinges and slides together; "
            "tie its joints by equalities that say how they share the motion"
        )
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
