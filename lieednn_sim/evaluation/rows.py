"""A row of a comparison: what was planned, by what it was followed, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.columns import BY_NAME

Key = tuple[str, str, str, str, int]


@dataclass(frozen=True, order=True)
class Case:
    """What is planned once."""

    arm: str
    scene: str
    planner: str
    seed: int

    @classmethod
    def parse(cls, text: str) -> Case:
        """Read ``planner:arm:scene:seed``.

        Raises:
            InputError: not of that form.
        """
        parts = text.split(":")
        if len(parts) != 4 or not all(parts) or not (parts[3].isascii() and parts[3].isdecimal()):
            raise InputError(
                f"a case must look like planner:arm:scene:seed, as se3-geodesic:telescopic_pr:free:0, got {text!r}"
            )
        planner, arm, scene, seed = parts
        return cls(arm, scene, planner, int(seed))

    def __str__(self) -> str:
        return f"{self.planner}:{self.arm}:{self.scene}:{self.seed}"


@dataclass(frozen=True)
class Row:
    """One rollout. Measured numbers are None where there is none, and called as in `Evaluation` and `MotionMetrics`.

    They are rounded to the digits of the file, so that a table that is read says what it said when it was made.

    The other attributes are those of `columns.COLUMNS`.

    Attributes:
        arm: with the next four, what tells a row from the others.
        scene: around the arm.
        planner: of the motion.
        controller: that followed it.
        seed: of target, obstacles and planner.
        mass_scale: true masses in units of those that the controller knows.
        success: whether the rollout arrived without contact.
        reason: why it did not; begins with what failed: "problem", "plan", "simulation", "contact" or "arrival".
        stability: proved of the network: "global", "local" or "none"; "-" without a network, "" without a motion.
        stability_level: the condition that proves it.
    """

    arm: str
    scene: str
    planner: str
    controller: str
    seed: int
    mass_scale: float
    success: bool
    reason: str = ""
    stability: str = ""
    stability_level: str = ""
    planning_s: float | None = None
    motion_s: float | None = None
    gap_mm: float | None = None
    gap_deg: float | None = None
    gap_end_mm: float | None = None
    gap_end_deg: float | None = None
    path_ranges: float | None = None
    jerk_joints: float | None = None
    jerk_effector: float | None = None
    curvature: float | None = None
    settling_s: float | None = None
    final_effector_mm: float | None = None
    final_effector_deg: float | None = None
    final_worst_mm: float | None = None
    final_worst_deg: float | None = None
    tracking_rms_mm: float | None = None
    tracking_rms_deg: float | None = None
    tracking_max_mm: float | None = None
    tracking_max_deg: float | None = None
    path_m: float | None = None
    velocity_share: float | None = None
    force_share: float | None = None
    clearance_mm: float | None = None
    position_violations: int | None = None
    position_excess: float | None = None
    velocity_violations: int | None = None
    velocity_excess: float | None = None
    acceleration_violations: int | None = None
    acceleration_excess: float | None = None

    def __post_init__(self) -> None:
        for name in ("mass_scale", *BY_NAME):
            if isinstance(getattr(self, name), float):
                object.__setattr__(self, name, float(f"{getattr(self, name):.6g}"))

    @property
    def case(self) -> Case:
        """What was planned."""
        return Case(self.arm, self.scene, self.planner, self.seed)

    @property
    def key(self) -> Key:
        """What tells the row from the others."""
        return self.arm, self.scene, self.planner, self.controller, self.seed

    @property
    def planned(self) -> bool:
        """Whether there was a motion to track."""
        return not self.reason.startswith(("plan:", "problem:"))

    def as_texts(self) -> dict[str, str]:
        """The row's cells in a CSV file."""
        return {name: _as_text(getattr(self, name)) for name in FIELDS}

    @classmethod
    def from_texts(cls, texts: dict[str, str]) -> Row:
        """Read `as_texts`; `ValueError` where a cell is not of its column's type."""
        values: dict[str, Any] = {name: texts[name] for name in FIELDS if name not in BY_NAME}
        values |= {"seed": int(texts["seed"]), "mass_scale": float(texts["mass_scale"])}
        if texts["success"] != ("no" if texts["reason"] else "yes"):
            raise ValueError(f"success is {texts['success']!r} where the reason of a failure is {texts['reason']!r}")
        values["success"] = texts["success"] == "yes"
        for name in BY_NAME:
            kind = int if name.endswith("_violations") else float
            values[name] = kind(texts[name]) if texts[name] else None
        return cls(**values)


def _as_text(value: bool | int | float | str | None) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


FIELDS = tuple(entry.name for entry in fields(Row))
