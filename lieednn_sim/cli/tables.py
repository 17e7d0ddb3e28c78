"""An evaluation on the terminal."""

from __future__ import annotations

from rich.table import Table

from lieednn_sim.cli.console import console, table
from lieednn_sim.evaluation.metrics import Evaluation
from lieednn_sim.simulation import Rollout


def print_evaluation(evaluation: Evaluation, rollout: Rollout, clearance: float | None = None) -> None:
    """Tables of frames, joints and pushes, and what disturbed the run; ``clearance`` [m] is the least on the way."""
    console.print(_frames(evaluation))
    console.print(_joints(evaluation))
    if evaluation.recoveries:
        console.print(_recoveries(evaluation))
    for line in (_conditions(rollout), _forces(evaluation, clearance)):
        if line:
            console.print(line)


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
            frame.final_translation_mm,
            frame.final_rotation_deg,
            frame.rms_translation_mm,
            frame.rms_rotation_deg,
            frame.max_translation_mm,
            frame.max_rotation_deg,
        )
        settled = "never" if frame.settling_time is None else f"{frame.settling_time:.2f}"
        rows.add_row(frame.name, *(f"{value:.4f}" for value in values), settled)
    gap = evaluation.max_gap_translation_mm
    rows.caption = (
        f"the end effector moves {evaluation.displacement:.2f} m (path {evaluation.travel:.2f} m) in "
        f"{evaluation.motion_end:g} s, then holds; contacts: {evaluation.contacts}; "
        + (f"mechanism gap of the plan: {gap:.1f} mm" if gap is not None else "")
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
        recovered = "never" if push.recovery_time is None else f"{push.recovery_time:.2f}"
        peaks = (f"{push.peak_deviation_mm:.3f}", f"{push.peak_deviation_deg:.4f}")
        rows.add_row(push.body, f"{push.start:g}", f"{push.end:g}", *peaks, recovered)
    rows.caption = "peak: largest error of any link frame against its reference"
    return rows


def _conditions(rollout: Rollout) -> str:
    """What the controller did not know of, and what it saw of the reference; empty where there is nothing to say."""
    changes, said = rollout.disturbances, []
    if rollout.reference_rate is not None:
        said.append(f"reference held at {rollout.reference_rate:g} Hz")
    if changes.mass_scale != 1.0:
        said.append(f"masses times {changes.mass_scale:g}")
    if changes.payload:
        said.append(f"payload {changes.payload:g} kg")
    if changes.position_noise:
        said.append(f"position noise {changes.position_noise:g}")
    if changes.velocity_noise:
        said.append(f"velocity noise {changes.velocity_noise:g}")
    return f"conditions: {', '.join(said)}" if said else ""


def _forces(evaluation: Evaluation, clearance: float | None) -> str:
    said = []
    if evaluation.contacts:
        said.append(f"contact force up to {evaluation.peak_contact_force:.1f} N")
    if evaluation.peak_weld_force or evaluation.peak_weld_torque:
        said.append(f"welds up to {evaluation.peak_weld_force:.1f} N and {evaluation.peak_weld_torque:.1f} N m")
    if clearance is not None:
        said.append(f"least clearance {1e3 * clearance:.1f} mm")
    return "; ".join(said)
