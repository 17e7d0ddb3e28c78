"""What the measured columns of a comparison mean: one list for the table, its summary and its page."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A measured number.

    Attributes:
        name: of the attribute of a `Row`, and in the CSV file.
        heading: short, with the unit.
        meaning: one line.
        of_motion: whether it belongs to the plan, and so is the same for every controller.
    """

    name: str
    heading: str
    meaning: str
    of_motion: bool = False


COLUMNS = (
    Column(
        "planning_s",
        "planning [s]",
        "CPU time of the planner, stopped at its time budget; the one column that differs between runs",
        True,
    ),
    Column("motion_s", "motion [s]", "time at which the plan comes to rest", True),
    Column("gap_mm", "gap [mm]", "largest mechanism gap on the way: what the joints cannot follow", True),
    Column("gap_deg", "gap [deg]", "the same as an angle", True),
    Column("gap_end_mm", "gap at end [mm]", "mechanism gap of the last planned poses", True),
    Column("gap_end_deg", "gap at end [deg]", "the same as an angle", True),
    Column(
        "path_ranges", "joint path [ranges]", "planned length in joint space, each joint in units of its range", True
    ),
    Column("jerk_joints", "joint jerk [ranges/s³]", "RMS jerk of the planned joints, in units of their ranges", True),
    Column("jerk_effector", "effector jerk [m/s³]", "RMS jerk of the planned end-effector path", True),
    Column(
        "curvature",
        "curvature [1/m]",
        "RMS curvature along the planned end-effector path, where its speed is above 5 % of the peak",
        True,
    ),
    Column("settling_s", "settled [s]", "time from which every link stays at its target; none when it does not"),
    Column("final_effector_mm", "final effector [mm]", "distance of the end effector from its target at the end"),
    Column("final_effector_deg", "[deg]", "the same as an angle"),
    Column("final_worst_mm", "final worst link [mm]", "distance of the worst link from its target at the end"),
    Column("final_worst_deg", "[deg]", "the same as an angle"),
    Column("tracking_rms_mm", "tracking RMS [mm]", "simulated against planned frames, RMS in time, worst link"),
    Column("tracking_rms_deg", "[deg]", "the same as an angle"),
    Column("tracking_max_mm", "tracking max [mm]", "the largest such distance"),
    Column("tracking_max_deg", "[deg]", "the same as an angle"),
    Column("path_m", "effector path [m]", "length of the end effector's simulated path"),
    Column("velocity_share", "velocity / limit", "largest joint velocity in units of its limit"),
    Column("force_share", "force / limit", "largest drive force or torque in units of its limit"),
    Column("clearance_mm", "clearance [mm]", "least clearance along the simulated motion; below 0: penetration"),
    Column("position_violations", "position violations", "simulated samples with a joint outside its range"),
    Column("position_excess", "worst", "how far outside, in units of the range"),
    Column("velocity_violations", "velocity violations", "simulated samples with a joint above its velocity limit"),
    Column("velocity_excess", "worst", "how far above, in units of the limit"),
    Column(
        "acceleration_violations",
        "acceleration violations",
        "simulated samples with a joint above its acceleration limit",
    ),
    Column("acceleration_excess", "worst", "how far above, in units of the limit"),
)
BY_NAME = {column.name: column for column in COLUMNS}
# Everything else is the same on every run.
TIMING = ("planning_s",)
