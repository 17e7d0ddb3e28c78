"""Coupled joints of a serial chain, such as the stages of a telescope that one belt extends together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.coordinates import Line, Sum, line_of, to_independent_leaders
from lieednn_sim.arm.forces import ON_JOINTS
from lieednn_sim.errors import InputError


@dataclass(frozen=True)
class Coupling:
    """One joint that follows another: qpos = ratio * (qpos of the leader) + shift.

    Attributes:
        follower, leader: joint names.
        ratio: dimensionless between two joints of one kind.
        shift: [rad, m].
        source: the equality or tendon that ties them, for the report.
    """

    follower: str
    leader: str
    ratio: float
    shift: float
    source: str

    def __str__(self) -> str:
        """Return one line for a report."""
        shift = f" {self.shift:+g}" if self.shift else ""
        return f"{self.follower} = {self.ratio:g} {self.leader}{shift}, by {self.source}"


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

    def leader(self, joint: int) -> int:
        """The independent joint that ``joint`` follows, or itself."""
        return self.lines[joint][0] if joint in self.lines else joint

    def ratio(self, joint: int) -> float:
        """Displacement of ``joint`` per displacement of its leader."""
        return self.lines[joint][1] if joint in self.lines else 1.0

    def ratios(self, joint: int) -> dict[int, float]:
        """Displacements of ``joint`` per displacement of each independent joint that moves it."""
        return self.sums[joint][0] if joint in self.sums else {self.leader(joint): self.ratio(joint)}

    def named(self, model: mujoco.MjModel) -> tuple[Coupling, ...]:
        """The couplings by names of joints and tendons."""
        return tuple(
            Coupling(
                model.joint(follower).name,
                model.joint(leader).name,
                ratio,
                shift,
                f"tendon {model.tendon(self.added[follower]).name!r}" if follower in self.added else "equality",
            )
            for follower, (leader, ratio, shift) in self.lines.items()
        )


def tied_joints(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs (follower, leader) of the active equalities between two joints."""
    return [
        (int(model.eq_obj1id[e]), int(model.eq_obj2id[e]))
        for e in range(model.neq)
        if model.eq_type[e] == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_active0[e] and model.eq_obj2id[e] >= 0
    ]


def find_couplings(model: mujoco.MjModel, joints: Sequence[int]) -> Couplings:
    """Couplings among the joints of a chain, by equalities and, where these leave it open, by fixed tendons.

    An actuator on a fixed tendon of length sum c_i q_i determines only how far the stages extend together. It pulls
    stage i with c_i times its force, so similar stages (of equal inertia and friction) move in the ratio of the c_i,
    which is also the smallest motion that gives the length. Equal coefficients mean equal displacements, as with a belt
    around all stages.

    Raises:
        InputError: a chain joint is tied other than linearly to one other joint, or joints are tied in a circle.
    """
    direct: dict[int, Line] = {}
    for e in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if not model.eq_active0[e] or follower not in joints:
            continue
        name = model.joint(follower).name
        if leader < 0:
            raise InputError(f"joint {name!r} is locked by an equality; delete the equality, or the joint")
        if leader not in joints:
            continue
        line = line_of(model, int(e))
        if line is None:
            raise InputError(
                f"joint {name!r} follows joint {model.joint(leader).name!r} by polycoef "
                f"{' '.join(f'{c:g}' for c in model.eq_data[e, :5])}; an arm needs a straight line, 'a0 a1 0 0 0'"
            )
        if follower in direct:
            raise InputError(f"joint {name!r} follows two joints; keep one of its equalities")
        direct[follower] = line
    couplings = Couplings(to_independent_leaders(direct, lambda joint: f"joint {model.joint(joint).name!r}"))
    return along_tendons(model, joints, couplings)


def along_tendons(model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings) -> Couplings:
    """Couplings, and those among some joints that driven tendons add to them (`find_couplings`)."""
    for tendon in dict.fromkeys(driven_tendons(model)):
        couplings = _along_tendon(model, joints, couplings, tendon)
    return couplings


def tendon_joints(model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Joints of a fixed tendon with their coefficients; empty for a spatial one."""
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    wraps = [w for w in range(start, start + count) if model.wrap_type[w] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
    return {int(model.wrap_objid[w]): float(model.wrap_prm[w]) for w in wraps}


def driven_tendons(model: mujoco.MjModel) -> list[int]:
    """Tendons that actuators pull at."""
    tendon = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
    return [int(model.actuator_trnid[a, 0]) for a in np.flatnonzero(tendon)]


def driven_directly(model: mujoco.MjModel) -> set[int]:
    """Joints that actuators drive without a tendon."""
    return {int(model.actuator_trnid[a, 0]) for a in range(model.nu) if model.actuator_trntype[a] in ON_JOINTS}


def _along_tendon(model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings, tendon: int) -> Couplings:
    coefficients: dict[int, float] = {}  # of the independent joints that the tendon moves
    for joint, coefficient in tendon_joints(model, tendon).items():
        if joint in joints and coefficient:
            leader = couplings.leader(joint)
            coefficients[leader] = coefficients.get(leader, 0.0) + coefficient * couplings.ratio(joint)
    heads = [joint for joint in joints if coefficients.get(joint)]
    if len(heads) < 2 or driven_directly(model).intersection(heads):
        return couplings
    if len({int(model.jnt_type[joint]) for joint in heads}) > 1:
        raise InputError(
            f"tendon {model.tendon(tendon).name!r} drives hinges and slides together; "
            "tie its joints by equalities that say how they share the motion"
        )
    lines, added = dict(couplings.lines), dict(couplings.added)
    first, *others = heads
    x0 = float(model.qpos0[model.jnt_qposadr[first]])
    for joint in others:
        ratio = coefficients[joint] / coefficients[first]
        shift = float(model.qpos0[model.jnt_qposadr[joint]]) - ratio * x0
        added[joint] = tendon
        for follower, (leader, further, constant) in couplings.lines.items():
            if leader == joint:
                lines[follower] = first, further * ratio, further * shift + constant
        lines[joint] = first, ratio, shift
    sums: dict[int, Sum] = {}
    for joint, (ratios, shift) in couplings.sums.items():
        through: dict[int, float] = {}
        for head, ratio in ratios.items():
            leader, further, constant = lines.get(head, (head, 1.0, 0.0))
            through[leader] = through.get(leader, 0.0) + ratio * further
            shift += ratio * constant
        sums[joint] = through, shift
    return Couplings(lines, added, sums)
