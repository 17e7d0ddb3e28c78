"""Rows of tables: their keys, measured columns, and cells in a CSV file."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, Self

from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted


@dataclass(frozen=True)
class Column:
    """A measured column.

    Attributes:
        name: name of the row's attribute, and of the column in the CSV file.
        heading: short heading with the unit.
        meaning: explanation in one line.
        of_motion: whether it belongs to the plan, so that it is the same for every controller.
    """

    name: str
    heading: str
    meaning: str
    of_motion: bool = False


def column(heading: str, meaning: str, *, of_motion: bool = False) -> Any:
    """A field of a row for a measured number, or None; arguments as in `Column`."""
    return field(default=None, metadata={"heading": heading, "meaning": meaning, "of_motion": of_motion})


_of_motion = partial(column, of_motion=True)


def outcome() -> Any:
    """The field ``success`` of a row: whether its ``reason`` is empty."""
    return field(default=True, init=False)


def columns_of(kind: type[TableRow]) -> tuple[Column, ...]:
    """The measured columns of a kind of row."""
    return tuple(Column(entry.name, **entry.metadata) for entry in fields(kind) if entry.metadata)


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table, with a field for each column, among them ``success`` (see `outcome`) and ``reason``.

    Numbers are rounded to the digits of the file, so that a table is the same after saving and reading.
    """

    # The fields that form the key of a row, and the digits of numbers.
    _key: ClassVar[tuple[str, ...]]
    _digits: ClassVar[int]

    def __post_init__(self) -> None:
        for entry in fields(self):
            if isinstance(value := getattr(self, entry.name), float):
                object.__setattr__(self, entry.name, float(f"{value:.{self._digits}g}"))
            elif isinstance(value, str):
                # A row is one line. Interned, since many rows share their texts.
                object.__setattr__(self, entry.name, sys.intern(" ".join(value.splitlines())))
                if entry.name == "reason" and value:
                    object.__setattr__(self, "success", False)

    @property
    def key(self) -> tuple[Any, ...]:
        """The values that identify the row."""
        return tuple(getattr(self, name) for name in self._key)

    def as_texts(self) -> dict[str, str]:
        """The row's cells in a CSV file."""
        return {entry.name: self._as_text(getattr(self, entry.name)) for entry in fields(self)}

    @classmethod
    def from_texts(cls, texts: dict[str, str]) -> Self:
        """The inverse of `as_texts`; `ValueError` if a cell does not have its column's type."""
        if texts.keys() != {entry.name for entry in fields(cls)} or None in texts.values():
            raise InputError("a row has too many or too few columns")
        if texts["success"] != ("no" if texts["reason"] else "yes"):
            raise InputError(f"success is {texts['success']!r} where the reason of a failure is {texts['reason']!r}")
        return cls(**{entry.name: _value(texts[entry.name], str(entry.type)) for entry in fields(cls) if entry.init})

    def _as_text(self, value: bool | int | float | str | None) -> str:
        if isinstance(value, bool):
            return "yes" if value else "no"
        return "" if value is None else f"{value:.{self._digits}g}" if isinstance(value, float) else str(value)


def _value(text: str, kind: str) -> bool | int | float | str | None:
    """The value of a cell in a column with an annotated type."""
    if kind in ("str", "bool"):
        return text if kind == "str" else text == "yes"
    if kind.endswith("None") and not text:
        return None
    return int(text) if kind.startswith("int") else float(text)


@dataclass(frozen=True, order=True)
class Case:
    """A planning task of a comparison, shared by all controllers."""

    arm: str
    scene: str
    planner: str
    seed: int

    @classmethod
    def parse(cls, text: str) -> Case:
        """Read ``planner:arm:scene:seed``.

        Raises:
            InputError: the text is not of that form.
        """
        parts = text.split(":")
        if len(parts) != 4 or not all(parts) or not (parts[3].isascii() and parts[3].isdecimal()):
            raise InputError(
                f"a case must look like planner:arm:scene:seed, e.g. se3-geodesic:telescopic_pr:free:0, "
                f"got {quoted(text)}"
            )
        planner, arm, scene, seed = parts
        return cls(arm, scene, planner, int(seed))

    def __str__(self) -> str:
        return f"{self.planner}:{self.arm}:{self.scene}:{self.seed}"


@dataclass(frozen=True, slots=True)
class Row(TableRow):
    """One rollout of a comparison. Measured columns have their names from `Evaluation` and `MotionMetrics`.

    Attributes:
        arm: name of the arm; together with the next four, the key of the row.
        scene: name of its scene.
        planner: name of the planner.
        controller: name of the controller that followed the motion.
        seed: seed of target, obstacles and planner.
        mass_scale: true masses relative to those that the controller knows.
        success: whether the rollout arrived without contact.
        reason: why it did not; begins with what failed: "problem", "plan", "simulation", "contact", "arrival", or
            "error" for a bug or a worker that died repeatedly.
        stability: proven stability of the network: "global", "local" or "none"; "-" without a network, "" without a
            motion.
        stability_level: the condition that proves it.
    """

    _key = ("arm", "scene", "planner", "controller", "seed")
    _digits = 6

    arm: str
    scene: str
    planner: str
    controller: str
    seed: int
    mass_scale: float
    success: bool = outcome()
    reason: str = ""
    stability: str = ""
    stability_level: str = ""
    planning_s: float | None = _of_motion(
        "planning [s]", "CPU time of the planner, stopped at its time budget; the one column that differs between runs"
    )
    motion_s: float | None = _of_motion("motion [s]", "time at which the plan comes to rest")
    gap_mm: float | None = _of_motion("gap [mm]", "largest mechanism gap on the way: what the joints cannot follow")
    gap_deg: float | None = _of_motion("gap [deg]", "the same as an angle")
    gap_end_mm: float | None = _of_motion("gap at end [mm]", "mechanism gap of the last planned poses")
    gap_end_deg: float | None = _of_motion("gap at end [deg]", "the same as an angle")
    path_ranges: float | None = _of_motion(
        "joint path [ranges]", "planned length in joint space, each joint in units of its range"
    )
    jerk_joints: float | None = _of_motion(
        "joint jerk [ranges/s³]", "RMS jerk of the planned joints, in units of their ranges"
    )
    jerk_effector: float | None = _of_motion("effector jerk [m/s³]", "RMS jerk of the planned end-effector path")
    curvature: float | None = _of_motion(
        "curvature [1/m]", "RMS curvature along the planned end-effector path, where its speed is above 5 % of the peak"
    )
    settling_s: float | None = column(
        "settled [s]", "time from which every link stays at its target; none when it does not"
    )
    final_effector_mm: float | None = column(
        "final effector [mm]", "distance of the end effector from its target at the end"
    )
    final_effector_deg: float | None = column("[deg]", "the same as an angle")
    final_worst_mm: float | None = column(
        "final worst link [mm]", "distance of the worst link from its target at the end"
    )
    final_worst_deg: float | None = column("[deg]", "the same as an angle")
    tracking_rms_mm: float | None = column(
        "tracking RMS [mm]", "simulated against planned frames, RMS in time, worst link"
    )
    tracking_rms_deg: float | None = column("[deg]", "the same as an angle")
    tracking_max_mm: float | None = column("tracking max [mm]", "the largest such distance")
    tracking_max_deg: float | None = column("[deg]", "the same as an angle")
    path_m: float | None = column("effector path [m]", "length of the end effector's simulated path")
    velocity_share: float | None = column("velocity / limit", "largest joint velocity in units of its limit")
    force_share: float | None = column(
        "force / limit", "largest actuator force or torque in units of its limit in the weaker direction"
    )
    clearance_mm: float | None = column(
        "clearance [mm]", "least clearance along the simulated motion; below 0: penetration"
    )
    position_violations: int | None = column("position violations", "simulated samples with a joint outside its range")
    position_excess: float | None = column("worst", "how far outside, in units of the range")
    velocity_violations: int | None = column(
        "velocity violations", "simulated samples with a joint above its velocity limit"
    )
    velocity_excess: float | None = column("worst", "how far above, in units of the limit")
    acceleration_violations: int | None = column(
        "acceleration violations", "simulated samples with a joint above its acceleration limit"
    )
    acceleration_excess: float | None = column("worst", "how far above, in units of the limit")

    @property
    def case(self) -> Case:
        """The case of the row."""
        return Case(self.arm, self.scene, self.planner, self.seed)

    @property
    def planned(self) -> bool:
        """Whether there was a motion to track."""
        return not self.reason.startswith(("plan:", "problem:", "error:"))


FIELDS = tuple(entry.name for entry in fields(Row))
COLUMNS = columns_of(Row)
BY_NAME = {entry.name: entry for entry in COLUMNS}
# Columns that differ between runs.
TIMING = ("planning_s",)
