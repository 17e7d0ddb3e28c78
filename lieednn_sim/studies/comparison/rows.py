"""Rows of a comparison, and its cases."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter

from lieednn_sim.studies.rows import TableRow, column, columns_of

_of_motion = partial(column, of_motion=True)


@dataclass(frozen=True, order=True)
class Case:
    """A planning problem of a comparison; all controllers track its one motion."""

    arm: str
    scene: str
    planner: str
    seed: int

    def __str__(self) -> str:
        return f"{self.planner}:{self.arm}:{self.scene}:{self.seed}"


@dataclass(frozen=True, slots=True)
class Row(TableRow):
    """A row of the comparison's table: one rollout. Measured columns are named as in `Evaluation` and `MotionMetrics`.

    Attributes:
        arm, scene, planner, controller: names; together with the seed, the key of the row.
        seed: seed of target, obstacles and planner.
        mass_scale: true masses relative to those that the controller knows.
        success: whether the rollout arrived without contact.
        reason: why the rollout failed; begins with the step that failed: "problem", "plan", "simulation", "contact",
            "arrival", or "error" for a bug or a worker that died repeatedly.
        stability: proven stability of the network: "global", "local" or "none"; "-" without a network, "" without a
            motion.
        stability_level: the condition that proves it.
    """

    _key = ("arm", "scene", "planner", "controller", "seed")

    arm: str
    scene: str
    planner: str
    controller: str
    seed: int
    mass_scale: float
    success: bool = field(default=True, init=False)
    reason: str = ""
    stability: str = ""
    stability_level: str = ""
    planning_s: float | None = _of_motion(
        "planning [s]",
        "CPU time of the planner, stopped at its time budget; the one column that differs between runs",
        timed=True,
        shown=12,
    )
    motion_s: float | None = _of_motion("motion [s]", "time at which the plan comes to rest")
    gap_mm: float | None = _of_motion(
        "gap [mm]", "largest distance of a planned pose from the nearest that its joint can take", shown=11
    )
    gap_deg: float | None = _of_motion("gap [deg]", "the same as an angle", shown=11)
    gap_end_mm: float | None = _of_motion("gap at end [mm]", "mechanism gap of the last planned poses")
    gap_end_deg: float | None = _of_motion("gap at end [deg]", "the same as an angle")
    path_ranges: float | None = _of_motion(
        "joint path [ranges]", "planned length in joint space, each joint in units of its range", shown=5
    )
    jerk_joints: float | None = _of_motion(
        "joint jerk [ranges/s³]", "RMS jerk of the planned joints, in units of their ranges"
    )
    jerk_effector: float | None = _of_motion(
        "effector jerk [m/s³]", "RMS jerk of the planned end-effector path", shown=8
    )
    curvature: float | None = _of_motion(
        "curvature [1/m]",
        "RMS curvature along the planned end-effector path, where its speed is above 5 % of the peak",
        shown=9,
    )
    proved_fraction: float | None = _of_motion(
        "proved",
        "fraction of the plan's time over which it is proved, for every instant, that nothing touches",
        shown=3,
    )
    proved_clearance_mm: float | None = _of_motion(
        "proved clearance [mm]", "proved lower bound of the clearance there, at every instant; at most 100", shown=3
    )
    tube_mm: float | None = _of_motion(
        "tube [mm]",
        "largest deviation of all links at once that is proved to end at the target without contact",
        shown=4,
    )
    settling_s: float | None = column(
        "settled [s]", "time from which every link stays at its target; none when it does not", shown=7
    )
    final_effector_mm: float | None = column(
        "final effector [mm]", "distance of the end effector from its target at the end"
    )
    final_effector_deg: float | None = column("[deg]", "the same as an angle")
    final_worst_mm: float | None = column(
        "final worst link [mm]", "distance of the worst link from its target at the end", shown=1
    )
    final_worst_deg: float | None = column("[deg]", "the same as an angle", shown=1)
    tracking_rms_mm: float | None = column(
        "tracking RMS [mm]", "simulated against planned frames, RMS in time, worst link", shown=2
    )
    tracking_rms_deg: float | None = column("[deg]", "the same as an angle", shown=2)
    tracking_max_mm: float | None = column("tracking max [mm]", "the largest such distance", shown=2)
    tracking_max_deg: float | None = column("[deg]", "the same as an angle")
    path_m: float | None = column("effector path [m]", "length of the end effector's simulated path", shown=6)
    velocity_fraction: float | None = column(
        "velocity / limit", "largest joint velocity in units of its limit", shown=10
    )
    force_fraction: float | None = column(
        "force / limit", "largest actuator force or torque in units of its limit in the weaker direction", shown=10
    )
    clearance_mm: float | None = column(
        "clearance [mm]", "least clearance along the simulated motion; below 0: penetration", shown=3
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

    # A case is planned once for all controllers.
    motion = case

    @property
    def planned(self) -> bool:
        """Whether there was a motion to track."""
        return not self.reason.startswith(("plan:", "problem:", "error:"))


COLUMNS = columns_of(Row)
BY_NAME = {entry.name: entry for entry in COLUMNS}
# Columns of the page's table, in its order.
SHOWN = sorted((entry for entry in COLUMNS if entry.shown), key=attrgetter("shown"))
