"""The result of evaluating a rollout: its metrics, their tables for the terminal, and their files."""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass, field, fields

import numpy as np
from rich.console import Group
from rich.table import Table

from lieednn_sim import io
from lieednn_sim.evaluation.display import as_text, table
from lieednn_sim.evaluation.load import LoadMetrics
from lieednn_sim.simulation import Disturbances
from lieednn_sim.values import StrPath, rounded, set_fields
from lieednn_sim.versions import versions

# A frame has settled if it stays this close to its target [m, rad].
SETTLED_TRANSLATION = 1e-3
SETTLED_ROTATION = float(np.deg2rad(0.1))
_LOST = 50.0  # a body that moves by more in the hand is lost [mm]


@dataclass(frozen=True)
class FrameErrors:
    """Errors of one link frame.

    ``final_*`` compares the last simulated frame with the target, ``tracking_*`` the simulated with the planned frame
    of the same instant over the whole rollout. ``settling_s`` is the time from which the frame stays within 1 mm and
    0.1 deg of its target, None when it does not.
    """

    name: str
    final_mm: float
    final_deg: float
    tracking_rms_mm: float
    tracking_rms_deg: float
    tracking_max_mm: float
    tracking_max_deg: float
    settling_s: float | None

    @property
    def arrived(self) -> bool:
        """Whether it ends within 1 mm and 0.1 deg of its target."""
        return self.final_mm <= 1e3 * SETTLED_TRANSLATION and self.final_deg <= np.rad2deg(SETTLED_ROTATION)


@dataclass(frozen=True)
class JointUse:
    """Peak velocity and actuator force of one joint against its limits (rad/s, N m or m/s, N).

    ``peak_constraint_force`` is what contacts, joint limits and welds exert on it; it has no limit.
    """

    name: str
    peak_velocity: float
    velocity_limit: float
    peak_force: float
    force_limit: float
    peak_constraint_force: float


@dataclass(frozen=True)
class Recovery:
    """The effect of a push, up to the next push or the end of the rollout.

    ``peak_deviation_*`` is the largest error of any link frame against its reference since the push began.
    ``recovery_s`` is the time from the push's end until all frames stay within 1 mm and 0.1 deg of theirs, else None.
    """

    body: str
    start_s: float
    end_s: float
    peak_deviation_mm: float
    peak_deviation_deg: float
    recovery_s: float | None


@dataclass(frozen=True)
class MotionMetrics:
    """Metrics of a planned motion before it is simulated; those not listed here are explained in `studies.Row`.

    Attributes:
        curvature: see `rms_curvature`; None where the end effector does not move.
        network_residual: distance from the equilibrium at the end of the motion [network coordinates].
    """

    motion_s: float
    gap_mm: float
    gap_deg: float
    gap_end_mm: float
    gap_end_deg: float
    path_ranges: float
    jerk_joints: float
    jerk_effector: float
    curvature: float | None
    network_residual: float


@dataclass(frozen=True)
class Evaluation:
    """Metrics of one rollout; `print` shows them as tables.

    The conditions of the run have the names of `simulate`'s arguments. Attributes that are not listed here are also
    columns of a comparison, and are explained in `studies.Row`.

    Attributes:
        arm, scene, controller: their names.
        reference_rate: rate of the samples of the motion that the controller saw [Hz], None for every step.
        disturbances: disturbances unknown to the controller.
        hold: time of the rollout after the motion [s].
        duration_s, motion_s: duration of the rollout, and time at which the reference comes to rest.
        plan: metrics of the motion that was followed; None without one.
        frames: errors of each link frame, the last one being the end effector.
        joints: peak velocity and forces of each joint.
        displacement_m: distance between the end effector's first and last position.
        clearance_mm: least clearance along the motion; None where nothing can collide or it was not computed.
        proof: the proved clearance of the run in words (`Rollout.clearance`), and `Rollout.outside`.
        proved: whether it is proved that nothing touched at any instant, since the run stayed inside its plan's proof.
        contacts: largest number of simultaneous contacts.
        peak_contact_force_n: largest normal force of a contact.
        peak_weld_force_n, peak_weld_torque_n_m: largest between a link and its mocap body; zero without mocap bodies.
        recoveries: the effect of each push.
        planned_force_fraction: largest force that the plan needs of an actuator, in units of its limit, by inverse
            dynamics; None without a plan. That of the run is ``force_fraction``.
        sequence: whether the run is that of a sequence; its contacts are shown, but are no failure: grasps are such.
        slip_mm: largest displacement in the hand of a body held by a sequence.
        load: what the motion left swinging and bending; None for an arm without such parts.
        causes: if the arm does not end at its target, the reasons that its model gives, see `diagnosis.error_causes`.
    """

    arm: str
    scene: str
    controller: str
    reference_rate: float | None
    disturbances: Disturbances
    hold: float
    duration_s: float
    motion_s: float
    plan: MotionMetrics | None
    frames: tuple[FrameErrors, ...]
    joints: tuple[JointUse, ...]
    path_m: float
    displacement_m: float
    clearance_mm: float | None
    contacts: int
    peak_contact_force_n: float
    peak_weld_force_n: float
    peak_weld_torque_n_m: float
    recoveries: tuple[Recovery, ...]
    position_violations: int
    position_excess: float
    velocity_violations: int
    velocity_excess: float
    acceleration_violations: int
    acceleration_excess: float
    force_fraction: float
    planned_force_fraction: float | None = None
    causes: tuple[str, ...] = ()
    proof: str = ""
    proved: bool = False
    load: LoadMetrics | None = None
    sequence: bool = False
    slip_mm: float = 0.0
    settling_s: float | None = field(init=False)
    final_effector_mm: float = field(init=False)
    final_effector_deg: float = field(init=False)
    final_worst_mm: float = field(init=False)
    final_worst_deg: float = field(init=False)
    tracking_rms_mm: float = field(init=False)
    tracking_rms_deg: float = field(init=False)
    tracking_max_mm: float = field(init=False)
    tracking_max_deg: float = field(init=False)
    velocity_fraction: float = field(init=False)

    def __post_init__(self) -> None:
        times = [frame.settling_s for frame in self.frames if frame.settling_s is not None]
        results = {
            "settling_s": max(times) if len(times) == len(self.frames) else None,
            "velocity_fraction": max(joint.peak_velocity / joint.velocity_limit for joint in self.joints),
        }
        for unit in ("mm", "deg"):
            results[f"final_effector_{unit}"] = getattr(self.end_effector, f"final_{unit}")
            for name, of_frame in (("final_worst", "final"), ("tracking_rms",) * 2, ("tracking_max",) * 2):
                results[f"{name}_{unit}"] = max(getattr(frame, f"{of_frame}_{unit}") for frame in self.frames)
        set_fields(self, **results)

    def __repr__(self) -> str:
        return f"<Evaluation of {self.arm}, {self.scene}, by {self.controller}: {self.arrival}>"

    def __rich__(self) -> Group:
        tables = [_frames(self), _joints(self), *([_recoveries(self)] if self.recoveries else [])]
        return Group(self.arrival + (f"; clearance {self.proof}" if self.proof else ""), *tables, *self.notes)

    def __str__(self) -> str:
        return as_text(self)

    @property
    def end_effector(self) -> FrameErrors:
        """Errors of the last link frame."""
        return self.frames[-1]

    @property
    def shortfall(self) -> str:
        """Why the run failed, or "": contact outside of sequences, a body that was lost, or a link off its target."""
        if self.contacts and not self.sequence:
            return f"contact: up to {self.contacts} at a time"
        if self.slip_mm > _LOST:
            return f"hold: what the hand should hold moves by {rounded(self.slip_mm)} mm in it"
        for frame in self.frames:
            if not frame.arrived:
                off = f"{rounded(frame.final_mm, 1e-3)} mm and {rounded(frame.final_deg, 1e-3)} deg off"
                return f"arrival: {frame.name} ends {off}"
        return ""

    @property
    def arrival(self) -> str:
        """Whether the arm ended at its target and touched nothing, in a few words."""
        off = f"{rounded(self.final_worst_mm, 1e-3)} mm and {rounded(self.final_worst_deg, 1e-3)} degrees off"
        touched = f"{self.contacts} contacts at a time, " if self.contacts else ""
        if self.slip_mm > _LOST:
            return f"fails: {self.shortfall}"
        if self.shortfall:
            return f"fails: {touched}a link ends {off}"
        return f"arrives after {_seconds(self.settling_s)} s, {touched}ends {off}"

    @property
    def notes(self) -> list[str]:
        """Lines on conditions unknown to the controller, forces and measured clearance, and causes of a final error."""
        rate, force, torque = self.reference_rate, self.peak_weld_force_n, self.peak_weld_torque_n_m
        conditions = [*([f"reference held at {rate:g} Hz"] if rate else []), *self.disturbances.conditions]
        lines = [f"conditions: {', '.join(conditions)}"] if conditions else []
        if late := len(self.disturbances.pushes) - len(self.recoveries):
            lines.append(f"pushes after the end of the run, which did nothing: {late}")
        extremes = []
        if self.contacts:
            extremes.append(f"contact force up to {rounded(self.peak_contact_force_n)} N")
        if force or torque:
            extremes.append(f"welds up to {rounded(force)} N and {rounded(torque)} N m")
        if self.scene != "free" and self.clearance_mm is not None:
            extremes.append(f"least clearance {rounded(self.clearance_mm)} mm at samples")
        if (planned := self.planned_force_fraction or 0.0) > 0.5:  # forces far below their limits are not worth a line
            extremes.append(f"forces up to {planned:.0%} of a limit as planned, {self.force_fraction:.0%} exerted")
        if extremes:
            lines.append("; ".join(extremes))
        if self.slip_mm:
            lines.append(f"what the hand holds moves by up to {rounded(self.slip_mm)} mm in it")
        if self.load:
            lines.append(f"after the motion: {self.load}")
        if self.causes:
            lines.append(f"final error {rounded(self.final_worst_mm)} mm and {rounded(self.final_worst_deg)} degrees:")
        return lines + [f"- {cause}" for cause in self.causes]

    def save_json(self, path: StrPath) -> None:
        """Write all metrics, conditions and why it failed (`shortfall`) as JSON; unlimited joints have limit null."""
        value = {"success": not self.shortfall, "reason": self.shortfall, **asdict(self), "versions": versions()}
        for joint in value["joints"]:
            for name in ("velocity_limit", "force_limit"):
                joint[name] = joint[name] if np.isfinite(joint[name]) else None
        io.save_json(path, value)

    def save_csv(self, path: StrPath) -> None:
        """Write the errors of the frames as CSV, a row for each frame."""
        io.save_csv(path, [[item.name for item in fields(FrameErrors)], *map(astuple, self.frames)])


def _frames(evaluation: Evaluation) -> Table:
    columns = "frame", "final mm", "deg", "RMS mm", "deg", "max mm", "deg", "settled s"
    rows = table(f"tracking error, {evaluation.controller}", *columns)
    for frame in evaluation.frames:
        name, *errors, settling = astuple(frame)
        # Thousandths of millimetres and degrees are enough.
        rows.add_row(name, *(rounded(error, 1e-3) for error in errors), _seconds(settling))
    rows.caption = (
        f"the end effector moves {evaluation.displacement_m:.2f} m (path {evaluation.path_m:.2f} m) in "
        f"{evaluation.motion_s:g} s, then holds; contacts: {evaluation.contacts}{', grasps too' * evaluation.sequence}"
    )
    if plan := evaluation.plan:
        rows.caption += f"; mechanism gap of the plan: {rounded(plan.gap_mm)} mm, {rounded(plan.gap_deg)} degrees"
    return rows


def _joints(evaluation: Evaluation) -> Table:
    rows = table("joints", "joint", "peak velocity", "of limit", "peak force", "of limit", "constraints")
    for name, velocity, fastest, force, strongest, held in map(astuple, evaluation.joints):
        uses = (velocity, fastest), (force, strongest)
        parts = ["-" if limit == float("inf") else f"{value / limit:.0%}" for value, limit in uses]
        rows.add_row(name, rounded(velocity), parts[0], rounded(force), parts[1], rounded(held))
    return rows


def _recoveries(evaluation: Evaluation) -> Table:
    rows = table("pushes", "body", "from s", "to s", "peak mm", "deg", "recovered after s")
    for push in evaluation.recoveries:
        peaks = (rounded(push.peak_deviation_mm), rounded(push.peak_deviation_deg))
        rows.add_row(push.body, f"{push.start_s:g}", f"{push.end_s:g}", *peaks, _seconds(push.recovery_s))
    rows.caption = "peak: largest error of any link frame against its reference"
    return rows


def _seconds(time: float | None) -> str:
    return "never" if time is None else f"{time:.2f}"
