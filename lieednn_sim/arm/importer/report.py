"""The options of an import, and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from lieednn_sim.arm.oscillation import Mode


class ImportOptions(TypedDict, total=False):
    """The options of an import.

    Attributes:
        links: names of bodies or sites, from the base outwards; the frame of a body is at its origin.
        joints: names of the arm's joints, from which the links follow; instead of links. Joints that equalities couple
            to them move with them; all others belong to the scene.
        tip: body or site of the end effector's frame, beyond the last joint, if no links are named. Default: the body
            that the last joint moves.
        base: body or site of the base frame. Default: the parent of the first moving body of link 1.
        keyframe: configuration of the robot at home. Default: home, else the first keyframe, else the reference
            position. Keyframes without positions, and with controls for another configuration, do not count.
        home: positions of joints by name [rad, m] that replace the keyframe's, or in a URDF the reference position's.
        limits: velocity, acceleration and jerk of coordinates by name [rad or m, s]; they take precedence over the
            model's.
        servos: keep the model's actuators and add servos for undriven joints (keep), design new ones for the whole arm
            (design), or add none (none).
        overlaps: ignore contacts between parts of the robot that overlap by design (ignore), or keep them (keep).
        floor: height of the floor [m], or none. Default, auto: the model's own plane, else one at the height of the
            base, and none if the robot reaches below its base at home.
    """

    links: Sequence[str] | None
    joints: Sequence[str] | None
    tip: str | None
    base: str | None
    keyframe: str | None
    home: Mapping[str, float] | None
    limits: Mapping[str, Mapping[str, float]] | None
    servos: str
    overlaps: str
    floor: float | str


@dataclass(frozen=True)
class Coupling:
    """One joint that follows another: qpos = ratio * (qpos of the leader) + shift.

    Attributes:
        follower, leader: joint names.
        ratio: dimensionless between two joints of one kind.
        shift: [rad, m].
        source: the equality or tendon that ties them.
    """

    follower: str
    leader: str
    ratio: float
    shift: float
    source: str

    def __str__(self) -> str:
        shift = f" {self.shift:+g}" if self.shift else ""
        return f"{self.follower} = {self.ratio:g} {self.leader}{shift}, by {self.source}"


@dataclass(frozen=True)
class Servo:
    """What drives one coordinate: position servos with the force kp (ctrl - q) - kv dq/dt, or motors.

    Attributes:
        name: name of the coordinate.
        kp: [N m/rad, N/m]; zero for motors.
        kv: [N m s/rad, N s/m].
        force_range: [N m, N]; infinite where nothing limits the actuators.
        frequency: natural frequency on the largest inertia of a few configurations, the other coordinates held [Hz].
        kept: whether it is the given model's.
    """

    name: str
    kp: float
    kv: float
    force_range: tuple[float, float]
    frequency: float
    kept: bool

    def __str__(self) -> str:
        low, high = self.force_range
        limits = "no force limit" if np.isinf([low, high]).all() else f"force {low:.4g} .. {high:.4g}"
        gains = f"kp {self.kp:.4g}, kv {self.kv:.4g}, {self.frequency:.3g} Hz" if self.kp else "motor"
        return f"{self.name}: {'kept' if self.kept else 'made'}, {gains}, {limits}"


@dataclass(frozen=True)
class ImportReport:
    """What an import found in a file, and what it added.

    Attributes:
        configuration: where the robot is at home: a keyframe or the reference position.
        base: name of the body or site of the base frame.
        links: names of the bodies or sites of the link frames.
        groups: for each link, the joints of its compound joint, from the base outwards.
        couplings: joints of the chain that follow others.
        others: joints that are not the arm's: their own actuators or added ones hold them, or they swing and bend.
        servos: what drives each independent coordinate.
        notes: all other decisions of the import, and what the user should look at.
        remarks: the notes that may require an action of the user.
        modes: free oscillations of undriven joints at home (`oscillation.PassiveJoints`), slowest first.
    """

    configuration: str
    base: str
    links: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    couplings: tuple[Coupling, ...]
    others: tuple[str, ...]
    servos: tuple[Servo, ...]
    notes: tuple[str, ...]
    modes: tuple[Mode, ...] = ()
    remarks: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = [f"configuration: {self.configuration}", f"base: {self.base}"]
        lines += [f"link {i + 1}: {link}, moved by {', '.join(self.groups[i])}" for i, link in enumerate(self.links)]
        found = {"coupled": self.couplings, "servo": self.servos, "oscillates": self.modes, "note": self.notes}
        lines += [f"{title}: {entry}" for title, entries in found.items() for entry in entries]
        return "\n".join([*lines, f"other joints: {', '.join(self.others) or 'none'}"])
