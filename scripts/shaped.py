"""Measure `lieednn-shaped` against its own teacher: arms x scenes x seeds, one row each, resumable.

    python scripts/shaped.py [--arms ...] [--scenes ...] [--seeds 50] [--output results/shaped]

Writes a line of `rows.csv` as soon as a case is done, and skips cases that have one; then `summary.md`. Times are CPU
seconds of one core with one BLAS thread.
"""

from __future__ import annotations

import argparse
import csv
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim._blas import one_blas_thread
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.motion_metrics import motion_metrics
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion

COLUMNS = (
    *("arm", "scene", "motions", "certified", "off the path [mm]", "gap [mm]", "joint jerk", "effector jerk", "path"),
    *("effort", "clearance [mm]", "teacher's", "encoded", "encoding [ms]", "fit [s]", "planning [s]"),
)
# Forces and clearance are evaluated at every tenth sample.
STRIDE = 10


@dataclass
class Row:
    """A case; ratios are those of the shaped network's motion to its teacher's."""

    arm: str
    scene: str
    seed: int
    teacher: str = ""
    hidden: int = 0
    certified: bool = False
    deviation_mm: float = math.nan
    gap_mm: float = math.nan
    gap_deg: float = math.nan
    jerk: float = math.nan
    effector_jerk: float = math.nan
    path: float = math.nan
    effort: float = math.nan
    clearance_mm: float = math.nan
    teacher_clearance_mm: float = math.nan
    motion_s: float = math.nan
    encoded: bool = False
    encoding_ms: float = math.nan
    fit_s: float = math.nan
    teacher_s: float = math.nan
    planning_s: float = math.nan
    reason: str = ""


def effort(arm: Arm, motion: Motion) -> float:
    """Root mean square of the generalised forces that the motion needs."""
    data = mujoco.MjData(arm.model)
    qpos, qvel = arm.qpos(motion.q), arm.qvel(motion.q, motion.qd)
    qacc = np.gradient(qvel, motion.timestep, axis=0)
    squares = []
    for position, velocity, acceleration in zip(qpos[::STRIDE], qvel[::STRIDE], qacc[::STRIDE], strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, acceleration
        mujoco.mj_inverse(arm.model, data)
        squares.append(np.mean(data.qfrc_inverse**2))
    return float(np.sqrt(np.mean(squares)))


def clearance(arm: Arm, motion: Motion) -> float:
    """Least clearance along the motion [mm]."""
    collisions = Collisions(arm)
    return 1e3 * min(collisions.clearance(q) for q in motion.q[::STRIDE])


def verified_after_loading(network: LieEDNN) -> bool:
    """Whether the network is certified after saving and loading, which verifies the certificate again."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "network.npz"
        network.save(path)
        return LieEDNN.load(path).certified


def measured(arm: Arm, scene: str, seed: int) -> Row:
    """Plan a case and compare it with its teacher."""
    row = Row(arm.name, scene, seed)
    try:
        room = arm.among(scene, seed)
        target = draw_target(room, seed)
    except LieEDNNError as error:
        row.reason = f"problem: {error}"
        return row
    try:
        made = plan(room, target, planner="lieednn-shaped", seed=seed)
    except LieEDNNError as error:
        row.reason = f"plan: {error}"
        return row
    network, teacher = made.network, made.teacher
    assert isinstance(network, LieEDNN)
    assert teacher is not None
    motion, guide = made.motion, teacher.motion
    mine, given = motion_metrics(room, motion), motion_metrics(room, guide)
    row.teacher, row.hidden, row.certified = teacher.planner, network.n_hidden, verified_after_loading(network)
    row.deviation_mm, row.gap_mm, row.gap_deg = 1e3 * made.details.deviation, mine.gap_mm, mine.gap_deg
    row.jerk, row.effector_jerk = mine.jerk_joints / given.jerk_joints, mine.jerk_effector / given.jerk_effector
    row.path, row.effort = mine.path_ranges / given.path_ranges, effort(room, motion) / effort(room, guide)
    row.clearance_mm, row.teacher_clearance_mm = clearance(room, motion), clearance(room, guide)
    row.motion_s, row.fit_s = mine.motion_s, made.details.fit_time
    row.encoded, row.encoding_ms = made.details.encoded, 1e3 * made.details.encoding_time
    row.teacher_s, row.planning_s = teacher.cpu_time, made.cpu_time
    return row


def read(path: Path) -> list[Row]:
    """Rows of a file, without a truncated last one."""
    if not path.exists():
        return []
    kinds = {field.name: str(field.type) for field in fields(Row)}
    convert: dict[str, Callable[[str], Any]] = {
        "str": str,
        "int": int,
        "float": float,
        "bool": lambda text: text == "True",
    }
    with path.open(newline="") as file:
        lines = [line for line in csv.DictReader(file) if None not in line.values() and None not in line]
    return [Row(**{name: convert[kinds[name]](line[name]) for name in kinds}) for line in lines]


def summary(rows: list[Row]) -> Iterator[str]:
    """A Markdown table of medians and worst values, by arm and scene, and the failures."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "| " + " | ".join(["---"] * len(COLUMNS)) + " |"
    groups = sorted({(row.arm, row.scene) for row in rows})
    for arm, scene in [*groups, ("all", "obstacles"), ("all", "free")]:
        chosen = [
            row
            for row in rows
            if (row.arm, row.scene) == (arm, scene) or (arm == "all" and (row.scene == "free") == (scene == "free"))
        ]
        good = [row for row in chosen if not row.reason]
        if not good:
            continue

        def worst(name: str, pick: Callable[..., Any] = max, good: list[Row] = good) -> str:
            values = np.array([getattr(row, name) for row in good])
            return f"{np.median(values):.3g} / {pick(values):.3g}"

        cells = [arm, scene, f"{len(good)} of {len(chosen)}", f"{sum(row.certified for row in good)}"]
        cells += [worst(name) for name in ("deviation_mm", "gap_mm", "jerk", "effector_jerk", "path", "effort")]
        cells += [worst(name, min) for name in ("clearance_mm", "teacher_clearance_mm")]
        cells += [f"{sum(row.encoded for row in good)}"]
        cells += [worst(name) for name in ("encoding_ms", "fit_s", "planning_s")]
        yield "| " + " | ".join(cells) + " |"
    obstacles = [row for row in rows if not row.reason and row.scene != "free"]
    if obstacles:
        off = np.array([row.deviation_mm for row in obstacles])
        near, all_near = np.mean(off < 1.0), np.mean(off < 5.0)
        yield f"\nAmong obstacles {near:.1%} stay within 1 mm of the teacher's path, {all_near:.1%} within 5 mm."
        names = sorted({row.teacher for row in obstacles})
        counts = ", ".join(f"{name} {sum(row.teacher == name for row in obstacles)}" for name in names)
        yield f"Teachers: {counts}."
    for row in rows:
        if row.reason:
            yield f"\n- {row.arm}, {row.scene}, seed {row.seed}: {row.reason}"


def write_summary(rows: list[Row], path: Path) -> None:
    """The whole report."""
    head = (
        "# Shaped networks against their teachers\n\nMedian / worst of the planned "
        "motions; jerk, path and effort over the teacher's. Encoded: motions of the universal network, whose code "
        "is the hidden neurons' start; for the others a network was shaped. One seed, from 0 on, for target, obstacles "
        "and planner. Every network was saved, loaded and verified again. Times are CPU seconds of one core.\n\n"
    )
    with io.atomic_text(path) as file:
        file.write(head + "\n".join(summary(rows)) + "\n")


def main(arguments: list[str] | None = None) -> None:
    """Measure missing cases, then write the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", nargs="+", default=arm_names())
    parser.add_argument("--scenes", nargs="+", default=["window", "shelf", "poles"])
    parser.add_argument("--seeds", type=int, default=50, help="from 0 on")
    parser.add_argument("--output", type=Path, default=Path("results/shaped"))
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    path = given.output / "rows.csv"
    rows = read(path)
    done = {(row.arm, row.scene, row.seed) for row in rows}
    arms = {name: Arm.load(name) for name in given.arms}
    names = [field.name for field in fields(Row)]
    # Rewritten without a truncated line.
    with io.atomic_text(path) as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    with one_blas_thread(), path.open("a", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        # Seeds in the outer loop, so that an interrupted run covers all arms and scenes.
        for seed in range(given.seeds):
            for name in given.arms:
                for scene in given.scenes:
                    if (name, scene, seed) not in done:
                        rows.append(measured(arms[name], scene, seed))
                        writer.writerow(asdict(rows[-1]))
                        file.flush()
    write_summary(rows, given.output / "summary.md")


if __name__ == "__main__":
    main()
