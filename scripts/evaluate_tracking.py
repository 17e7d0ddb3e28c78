"""Compare planners and controllers on random reachable targets of the arm.

    python scripts/evaluate_tracking.py [--seeds 20] [--planners ...] [--controllers ...] [--output results/comparison]

Writes one CSV row for each planner, controller and seed, and a Markdown summary. Rows that the CSV has are not computed
again, so an interrupted run goes on where it was, and a larger --seeds adds to it; remove the CSV after a change of the
code. All columns but the planning time are the same on every run.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import os
import sys
import time
from collections.abc import Iterable
from concurrent.futures import as_completed
from functools import lru_cache
from pathlib import Path

# Before NumPy loads: matrices here are far too small for threads, and the workers inherit this.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console
from workers import exit_code, progress_bar, worker_pool

from lieednn_sim import storage
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.evaluate import SETTLED_ROTATION, SETTLED_TRANSLATION, Evaluation, evaluate
from lieednn_sim.motion import Motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.planners import PLANNERS, PlanningProblem, plan_network, plan_with, reference_network
from lieednn_sim.simulate import CONTROLLERS, simulate

ARM = "telescopic_pr"
DURATION = 4.0
# Targets keep this share of a joint's range from its limits.
MARGIN = 0.05

# Of a motion, the same for every controller: column, heading of the summary.
MOTION_COLUMNS = {
    "planning_s": "planning [s CPU]",
    "gap_mm": "gap [mm]",
    "gap_deg": "gap [deg]",
    "path_ranges": "joint path [ranges]",
    "jerk_rms": "RMS jerk [ranges/s^3]",
}
ROLLOUT_COLUMNS = {
    "final_effector_mm": "final, effector [mm]",
    "final_effector_deg": "[deg]",
    "final_worst_mm": "final, worst link [mm]",
    "final_worst_deg": "[deg]",
    "tracking_rms_mm": "tracking RMS [mm]",
    "tracking_rms_deg": "[deg]",
    "tracking_max_mm": "tracking max [mm]",
    "tracking_max_deg": "[deg]",
    "velocity_share": "peak velocity / limit",
    "force_share": "peak force / limit",
}
KEYS = ("planner", "controller", "seed")
COLUMNS = (*KEYS, "success", "reason", "certified", *MOTION_COLUMNS, *ROLLOUT_COLUMNS)

Row = dict[str, str]
Key = tuple[str, str, int]


@lru_cache(maxsize=1)
def _arm() -> Arm:
    """The arm, after what is made once for a process, so that no planning time counts it."""
    arm = Arm.load(ARM)
    reference_network(arm)
    plan_with("minimum-jerk", PlanningProblem(arm, arm.keyframe("home"), arm.keyframe("extended"), DURATION))
    return arm


def draw_problem(arm: Arm, seed: int) -> PlanningProblem:
    """From home to a random joint position within the limits and free of contact."""
    rng = np.random.default_rng(seed)
    low, high = arm.position_limits.T
    inset = MARGIN * (high - low)
    while True:
        target = rng.uniform(low + inset, high - inset)
        if not arm.contacts(target):
            return PlanningProblem(arm, arm.keyframe("home"), target, DURATION, seed)


def run(planner: str, seed: int, controllers: list[str]) -> list[Row]:
    """Plan once and track with every controller: one row each."""
    arm = _arm()
    problem = draw_problem(arm, seed)
    begun = time.process_time()
    try:
        network, motion = plan_network(planner, problem)
    except LieEDNNError as error:
        failed: Row = {"success": "no", "reason": f"plan: {error}", "planning_s": _text(time.process_time() - begun)}
        return [_row(planner, name, seed, failed) for name in controllers]
    planned = {"planning_s": _text(time.process_time() - begun), **_of_motion(arm, motion, network)}
    return [_row(planner, name, seed, planned | _track(problem, motion, name)) for name in controllers]


def _track(problem: PlanningProblem, motion: Motion, controller: str) -> Row:
    try:
        result = evaluate(problem.arm, simulate(problem.arm, motion, controller=controller), problem.target, motion)
    except LieEDNNError as error:
        return {"success": "no", "reason": f"simulation: {error}"}
    reason = _miss(result)
    return {"success": "no" if reason else "yes", "reason": reason, **_of_rollout(result)}


def _miss(result: Evaluation) -> str:
    """Why a rollout is no success, or an empty string."""
    if result.contacts:
        return f"contact: up to {result.contacts} at a time"
    for frame in result.frames:
        far = frame.final_translation_mm > 1e3 * SETTLED_TRANSLATION
        if far or frame.final_rotation_deg > np.rad2deg(SETTLED_ROTATION):
            return (
                f"arrival: {frame.name} ends {frame.final_translation_mm:.3g} mm and "
                f"{frame.final_rotation_deg:.3g} deg off"
            )
    return ""


def _of_motion(arm: Arm, motion: Motion, network: LieEDNN | None) -> Row:
    ranges = arm.position_limits[:, 1] - arm.position_limits[:, 0]
    jerk = np.diff(motion.qd / ranges, n=2, axis=0) / motion.timestep**2
    return {
        "certified": "-" if network is None else "yes" if network.certified else "no",
        "gap_mm": _text(1e3 * motion.gap_translation.max()),
        "gap_deg": _text(np.rad2deg(motion.gap_rotation.max())),
        "path_ranges": _text(np.linalg.norm(np.diff(motion.q / ranges, axis=0), axis=1).sum()),
        "jerk_rms": _text(np.sqrt(np.mean(jerk**2))),
    }


def _of_rollout(result: Evaluation) -> Row:
    values = {
        "velocity_share": max(joint.peak_velocity / joint.velocity_limit for joint in result.joints),
        "force_share": max(joint.peak_force / joint.force_limit for joint in result.joints),
    }
    for unit, kind in (("mm", "translation_mm"), ("deg", "rotation_deg")):
        values[f"final_effector_{unit}"] = getattr(result.end_effector, f"final_{kind}")
        for column, field in (("final_worst", "final"), ("tracking_rms", "rms"), ("tracking_max", "max")):
            values[f"{column}_{unit}"] = max(getattr(frame, f"{field}_{kind}") for frame in result.frames)
    return {name: _text(value) for name, value in values.items()}


def _text(value: float) -> str:
    return f"{value:.6g}"


def _row(planner: str, controller: str, seed: int, values: Row) -> Row:
    return dict.fromkeys(COLUMNS, "") | {"planner": planner, "controller": controller, "seed": str(seed)} | values


def read_rows(path: Path) -> dict[Key, Row]:
    """Rows of an earlier run by planner, controller and seed; none when there is no file."""
    if not path.is_file():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream, strict=True)
            rows = list(reader)
        if tuple(reader.fieldnames or ()) != COLUMNS or any(None in {*row, *row.values()} for row in rows):
            raise ValueError("it has other columns")
        found = {(row["planner"], row["controller"], int(row["seed"])): row for row in rows}
        for row in rows:
            [float(row[name]) for name in (*MOTION_COLUMNS, *ROLLOUT_COLUMNS) if row[name]]
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"cannot go on from {path}: {error}; remove it or choose another --output") from None
    return found


def write_rows(path: Path, rows: dict[Key, Row]) -> None:
    with storage.atomic_text(path) as stream:
        writer = csv.DictWriter(stream, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in sorted(rows))


def write_summary(path: Path, rows: dict[Key, Row]) -> None:
    """Success and medians by planner and by controller, and why what failed did."""
    lines = [
        "# Planners and controllers compared",
        "",
        f"`scripts/evaluate_tracking.py`, arm {ARM}, from home to random reachable targets in {DURATION:g} s. Success: "
        f"a rollout without contact whose every link ends within {1e3 * SETTLED_TRANSLATION:g} mm and "
        f"{np.rad2deg(SETTLED_ROTATION):g} deg of the target. Tracking is measured against the planned joints; the "
        "gap, what joints cannot follow of the planned poses, is no part of it. Of both, the worst link counts. "
        "Medians are over the seeds that have the value: a planner that fails on hard targets is judged by the easy.",
        "",
        "## Motions",
        "",
        *_head(["planner", "made", "certified", *MOTION_COLUMNS.values()]),
    ]
    for planner in sorted({key[0] for key in rows}):
        # What belongs to the motion is the same for all controllers.
        own = {key[2]: row for key, row in sorted(rows.items()) if key[0] == planner}.values()
        made = [row for row in own if not row["reason"].startswith("plan:")]
        verdicts = [row["certified"] for row in made if row["certified"] != "-"]
        certified = f"{verdicts.count('yes')} of {len(verdicts)}" if verdicts else "-"
        cells = [planner, f"{len(made)} of {len(own)}", certified]
        lines.append(_line(cells + [_median(made, name) for name in MOTION_COLUMNS]))
    lines += ["", "## Tracking", "", *_head(["planner", "controller", "success", *ROLLOUT_COLUMNS.values()])]
    for planner, controller in sorted({key[:2] for key in rows}):
        group = [row for key, row in rows.items() if key[:2] == (planner, controller)]
        success = sum(row["success"] == "yes" for row in group)
        cells = [planner, controller, f"{success} of {len(group)}"]
        lines.append(_line(cells + [_median(group, name) for name in ROLLOUT_COLUMNS]))
    # A planner's failure is the same for all controllers, and said once.
    reasons = [
        ", ".join([key[0], *([] if row["reason"].startswith("plan:") else [key[1]]), f"seed {key[2]}: {row['reason']}"])
        for key, row in sorted(rows.items())
        if row["reason"]
    ]
    lines += ["", "## Failures", "", *(f"- {reason}" for reason in dict.fromkeys(reasons or ["none"]))]
    with storage.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")


def _median(rows: Iterable[Row], name: str) -> str:
    values = [float(row[name]) for row in rows if row[name]]
    return f"{np.median(values):.3g}" if values else "-"


def _head(cells: list[str]) -> list[str]:
    return [_line(cells), "|" + " --- |" * len(cells)]


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def compare(options: argparse.Namespace, console: Console) -> Path:
    """Compute the rows that are missing; returns the path of the summary."""
    directory = storage.make_directory(options.output)
    table, summary = directory / "comparison.csv", directory / "comparison.md"
    rows = read_rows(table)
    wanted = {
        (planner, seed): [name for name in dict.fromkeys(options.controllers) if (planner, name, seed) not in rows]
        for seed, planner in itertools.product(range(options.seeds), options.planners)
    }
    jobs = [(*job, missing) for job, missing in wanted.items() if missing]
    if jobs:
        with worker_pool(min(options.jobs, len(jobs))) as pool, progress_bar(console) as progress:
            shown = progress.add_task("motions", total=len(jobs))
            for future in as_completed([pool.submit(run, *job) for job in jobs]):
                rows |= {(row["planner"], row["controller"], int(row["seed"])): row for row in future.result()}
                write_rows(table, rows)
                progress.update(shown, advance=1)
    write_summary(summary, rows)
    return summary


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="targets, from seed 0 on (default: %(default)s)")
    for name, known in (("planners", PLANNERS), ("controllers", CONTROLLERS)):
        parser.add_argument(f"--{name}", nargs="+", choices=list(known), default=list(known), help="(default: all)")
    parser.add_argument("--output", default="results/comparison", help="directory (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="worker processes (default: all cores)")
    options = parser.parse_args(arguments)
    for name in ("seeds", "jobs"):
        if getattr(options, name) < 1:
            parser.error(f"argument --{name}: must be at least 1, got {getattr(options, name)}")
    console = Console(stderr=True)
    return exit_code(lambda: compare(options, console), console, "rows")


if __name__ == "__main__":
    sys.exit(main())
