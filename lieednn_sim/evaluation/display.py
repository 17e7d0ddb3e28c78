"""Tables of an evaluation for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, Group
from rich.table import Table

if TYPE_CHECKING:
    from lieednn_sim.evaluation.metrics import Evaluation


def table(title: str, *columns: str) -> Table:
    """An empty table; the first column is for names, the others for numbers."""
    made = Table(title=title, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, column in enumerate(columns):
        made.add_column(column, justify="left" if index == 0 else "right", no_wrap=index == 0)
    return made


def of_evaluation(evaluation: Evaluation) -> Group:
    """Tables of frames, joints and pushes, the conditions of the run, and why it does not end at its target."""
    shown = [_frames(evaluation), _joints(evaluation), *([_recoveries(evaluation)] if evaluation.recoveries else [])]
    return Group(
        *shown, *(line for line in (_conditions(evaluation), _forces(evaluation), *_causes(evaluation)) if line)
    )


def as_text(evaluation: Evaluation) -> str:
    """The same without colours."""
    console = Console(color_system=None, markup=False, emoji=False, highlight=False, soft_wrap=True)
    with console.capture() as capture:
        console.print(evaluation)
    return capture.get().rstrip("\n")


def _frames(evaluation: Evaluation) -> Table:
    rows = table(
        f"tracking error, {evaluation.controller}",
        "frame",
        "final mm",
        "deg",
        "RMS mm",
        "deg",
        "max mm",
        "deg",
        "settled s",
    )
    for frame in evaluation.frames:
        values = (
            frame.final_mm,
            frame.final_deg,
            frame.tracking_rms_mm,
            frame.tracking_rms_deg,
            frame.tracking_max_mm,
            frame.tracking_max_deg,
        )
        settled = "never" if frame.settling_s is None else f"{frame.settling_s:.2f}"
        rows.add_row(frame.name, *(f"{value:.4f}" for value in values), settled)
    rows.caption = (
        f"the end effector moves {evaluation.displacement_m:.2f} m (path {evaluation.path_m:.2f} m) in "
        f"{evaluation.motion_s:g} s, then holds; contacts: {evaluation.contacts}; "
        + (
            f"mechanism gap of the plan: {evaluation.plan.gap_mm:.1f} mm, {evaluation.plan.gap_deg:.1f} degrees"
            if evaluation.plan
            else ""
        )
    )
    return rows


def _joints(evaluation: Evaluation) -> Table:
    rows = table("joints", "joint", "peak velocity", "of limit", "peak force", "of limit", "constraints")
    for joint in evaluation.joints:
        rows.add_row(
            joint.name,
            f"{joint.peak_velocity:.3f}",
            _share(joint.peak_velocity, joint.velocity_limit),
            f"{joint.peak_force:.1f}",
            _share(joint.peak_force, joint.force_limit),
            f"{joint.peak_constraint_force:.1f}",
        )
    return rows


def _share(value: float, limit: float) -> str:
    return "-" if limit == float("inf") else f"{value / limit:.0%}"


def _recoveries(evaluation: Evaluation) -> Table:
    rows = table("pushes", "body", "from s", "to s", "peak mm", "deg", "recovered after s")
    for push in evaluation.recoveries:
        recovered = "never" if push.recovery_s is None else f"{push.recovery_s:.2f}"
        peaks = (f"{push.peak_deviation_mm:.3f}", f"{push.peak_deviation_deg:.4f}")
        rows.add_row(push.body, f"{push.start_s:g}", f"{push.end_s:g}", *peaks, recovered)
    rows.caption = "peak: largest error of any link frame against its reference"
    return rows


def _conditions(evaluation: Evaluation) -> str:
    """Disturbances unknown to the controller, and the rate of its reference; empty if there is nothing to report."""
    changes, said = evaluation.disturbances, []
    if evaluation.reference_rate is not None:
        said.append(f"reference held at {evaluation.reference_rate:g} Hz")
    if changes.mass_scale != 1.0:
        said.append(f"masses times {changes.mass_scale:g}")
    if changes.payload:
        said.append(f"payload {changes.payload:g} kg")
    if changes.position_noise:
        said.append(f"position noise {changes.position_noise:g}")
    if changes.velocity_noise:
        said.append(f"velocity noise {changes.velocity_noise:g}")
    return f"conditions: {', '.join(said)}" if said else ""


def _forces(evaluation: Evaluation) -> str:
    said = []
    if evaluation.contacts:
        said.append(f"contact force up to {evaluation.peak_contact_force_n:.1f} N")
    force, torque = evaluation.peak_weld_force_n, evaluation.peak_weld_torque_n_m
    if force or torque:
        said.append(f"welds up to {force:.1f} N and {torque:.1f} N m")
    if evaluation.scene != "free" and evaluation.clearance_mm is not None:
        said.append(f"least clearance {evaluation.clearance_mm:.1f} mm")
    return "; ".join(said)


def _causes(evaluation: Evaluation) -> tuple[str, ...]:
    if not evaluation.causes:
        return ()
    error = f"final error {evaluation.final_worst_mm:.3g} mm and {evaluation.final_worst_deg:.3g} degrees"
    return (f"{error}:", *(f"- {cause}" for cause in evaluation.causes))
