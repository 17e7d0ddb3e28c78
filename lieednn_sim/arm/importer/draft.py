"""The state that the importer's steps share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.frames import Frame
from lieednn_sim.arm.importer.coupled_joints import Coupling, Couplings
from lieednn_sim.arm.importer.servos import Actuation, Dof, Servo
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class ImportReport:
    """Report of `import_arm`: what it found in a model, and what it changed.

    Attributes:
        configuration: the keyframe that the locked joints and the new keyframe ``home`` were taken from.
        base: name of the body or site of the base frame.
        links: names of the bodies or sites of the link frames.
        groups: for each link, the joints of its compound joint, from the base outwards.
        couplings: joints that follow others.
        locked: joints that were removed, their bodies left where the configuration has them.
        servos: the position servo of each independent coordinate.
        notes: everything else that was decided, and what to look at.
    """

    configuration: str
    base: str
    links: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    couplings: tuple[Coupling, ...]
    locked: tuple[str, ...]
    servos: tuple[Servo, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Return the report as lines of text."""
        lines = [f"configuration: {self.configuration}", f"base: {self.base}"]
        for i, (link, group) in enumerate(zip(self.links, self.groups, strict=True), start=1):
            lines.append(f"link {i}: {link}, moved by {', '.join(group)}")
        for title, entries in (("coupled", self.couplings), ("servo", self.servos), ("note", self.notes)):
            lines += [f"{title}: {entry}" for entry in entries]
        lines.append(f"locked: {', '.join(self.locked) or 'none'}")
        return "\n".join(lines)


_BALL = int(mujoco.mjtJoint.mjJNT_BALL)


@dataclass(eq=False)
class Draft:
    """An arm during its import: each step uses and adds to what the steps before it have found.

    Joints are ids in ``original``; positions ``q`` of the independent ones are ``(1,)`` for a hinge or slide and
    a rotation vector ``(3,)`` for a ball joint.

    Attributes:
        spec: the spec, edited by the steps.
        source: its file, if any.
        links, chosen, tip, base, keyframe, home, limits, servo_rule, floor: the options of `import_arm`; `chosen` are
            its ``joints``.
        notes: remarks for the report.
        original: the model as given.
        keyframes: those of ``original`` that hold configurations.
        configuration: name of the configuration of the locked joints.
        qpos: ``(nq,)`` that configuration in ``original``.
        frames: frames of the base and the links.
        groups: for each link, the joints that move it.
        couplings: joints that follow others.
        ranges: for each joint, its range ``(2,)`` [rad, m].
        locked: names of the removed joints.
        bare: the model with the arm's joints, without actuators.
        dofs: the independent coordinates, with rates in ``bare``.
        samples: positions of the independent joints: at home, then random ones within the ranges.
        extremes: at home but with all slides retracted, and with all extended.
        actuations: what drove each coordinate in ``original``.
        servos: the servo that drives it now.
        model: the compiled arm.
    """

    spec: mujoco.MjSpec
    source: Path | None
    links: tuple[str, ...] | None
    chosen: tuple[str, ...] | None
    tip: str | None
    base: str | None
    keyframe: str | None
    home: Mapping[str, float]
    limits: Mapping[str, Mapping[str, float]]
    servo_rule: str
    floor: float | str
    notes: list[str] = field(default_factory=list)
    original: mujoco.MjModel = field(init=False)
    keyframes: list[int] = field(init=False)
    configuration: str = field(init=False)
    qpos: Floats = field(init=False)
    frames: tuple[Frame, ...] = field(init=False)
    groups: tuple[tuple[int, ...], ...] = field(init=False)
    couplings: Couplings = field(init=False)
    ranges: dict[int, Floats] = field(init=False)
    locked: tuple[str, ...] = field(init=False)
    bare: mujoco.MjModel = field(init=False)
    dofs: list[Dof] = field(init=False)
    samples: list[dict[int, Floats]] = field(init=False)
    extremes: list[dict[int, Floats]] = field(init=False)
    actuations: list[Actuation] = field(init=False)
    servos: tuple[Servo, ...] = field(init=False)
    model: mujoco.MjModel = field(init=False)

    @property
    def rates(self) -> Floats:
        """Velocities ``(nv, n)`` in ``bare`` at unit rates of the coordinates."""
        return np.array([dof.rates for dof in self.dofs]).T

    @property
    def joints(self) -> list[int]:
        """The joints of the arm, from the base outwards."""
        return [joint for group in self.groups for joint in group]

    @property
    def independent(self) -> list[int]:
        """The joints that follow no other."""
        return [joint for joint in self.joints if joint not in self.couplings.lines]

    def is_ball(self, joint: int) -> bool:
        """Whether a joint is a ball joint."""
        return bool(self.original.jnt_type[joint] == _BALL)

    def dofs_of(self, model: mujoco.MjModel) -> list[Dof]:
        """The independent coordinates with their rates in ``model``, which has joints of the same names."""
        dofs = []
        for joint in self.independent:
            name, ball = self.original.joint(joint).name, self.is_ball(joint)
            followers = {f: ratio for f, (leader, ratio, _) in self.couplings.lines.items() if leader == joint}
            span = np.array([-1.0, 1.0]) * self.ranges[joint][1] if ball else self.ranges[joint]
            for axis in range(3 if ball else 1):
                rates = np.zeros(model.nv)
                for moved, ratio in {joint: 1.0, **followers}.items():
                    rates[model.jnt_dofadr[model.joint(self.original.joint(moved).name).id] + axis] = ratio
                dofs.append(Dof(f"{name}_{'xyz'[axis]}" if ball else name, name, axis, rates, span))
        return dofs

    def place(self, model: mujoco.MjModel, q: dict[int, Floats], qpos: Floats) -> Floats:
        """``qpos`` ``(nq,)`` of ``model`` with the arm's joints, found by name, at ``q``; one row for each of ``q``."""
        values = dict(q)
        filled = np.tile(qpos, (*np.shape(next(iter(q.values())))[:-1], 1))
        for follower, (leader, ratio, shift) in self.couplings.lines.items():
            values[follower] = ratio * q[leader] + shift
        for joint, value in values.items():
            address = model.jnt_qposadr[model.joint(self.original.joint(joint).name).id]
            if self.is_ball(joint):
                turn = scipy.spatial.transform.Rotation.from_rotvec(value)
                filled[..., address : address + 4] = turn.as_quat(scalar_first=True)
            else:
                filled[..., address] = value[..., 0]
        return filled

    def configurations(self, positions: Sequence[dict[int, Floats]]) -> Floats:
        """``qpos`` ``(S, nq)`` of ``bare`` at positions of the independent joints."""
        return self.place(self.bare, stacked(positions), self.bare.qpos0)

    def report(self) -> ImportReport:
        """The report for the user, without repeated remarks."""
        return ImportReport(
            configuration=self.configuration,
            base=self.frames[0].name,
            links=tuple(frame.name for frame in self.frames[1:]),
            groups=tuple(tuple(self.original.joint(joint).name for joint in group) for group in self.groups),
            couplings=self.couplings.named(self.original),
            locked=self.locked,
            servos=self.servos,
            notes=tuple(dict.fromkeys(self.notes)),
        )


def stacked(positions: Sequence[dict[int, Floats]]) -> dict[int, Floats]:
    """Positions of the independent joints, one row per configuration, for `Draft.place`."""
    return {joint: np.array([q[joint] for q in positions]) for joint in positions[0]}
