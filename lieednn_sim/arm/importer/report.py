"""The report on an import, to be read before planning with the arm."""

from __future__ import annotations

from dataclasses import dataclass

from lieednn_sim.arm.importer.servos import Servo
from lieednn_sim.arm.importer.stages import Coupling


@dataclass(frozen=True)
class ImportReport:
    """What `import_arm` made of a model.

    Attributes:
        posture: the keyframe that the locked joints and the new keyframe ``home`` were taken from.
        base: name of the body or site of the base frame.
        links: names of the bodies or sites of the link frames.
        groups: for each link, the joints of its compound joint, from the base outwards.
        couplings: joints that follow others.
        locked: joints that were removed, their bodies left where the posture has them.
        servos: the position servo of each independent coordinate.
        notes: everything else that was decided, and what to look at.
    """

    posture: str
    base: str
    links: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    couplings: tuple[Coupling, ...]
    locked: tuple[str, ...]
    servos: tuple[Servo, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Return the report as lines of text."""
        lines = [f"posture: {self.posture}", f"base: {self.base}"]
        for i, (link, group) in enumerate(zip(self.links, self.groups, strict=True), start=1):
            lines.append(f"link {i}: {link}, moved by {', '.join(group)}")
        for title, entries in (("coupled", self.couplings), ("servo", self.servos), ("note", self.notes)):
            lines += [f"{title}: {entry}" for entry in entries]
        lines.append(f"locked: {', '.join(self.locked) or 'none'}")
        return "\n".join(lines)
