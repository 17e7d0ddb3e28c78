"""Measure `lieednn-shaped` against its own guide, with one row for each arm, scene and seed.

    python scripts/shaped.py [--arms NAME ...] [--scenes NAME ...] [--seeds 50] [--output results/shaped]

Free space has twice as many seeds. Writes ``summary.md``; an interrupted run goes on. Times are CPU seconds of one core
with one BLAS thread.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import options, saved_rows, write

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.evaluation.metrics import motion_metrics
from lieednn_sim.planning.motion import Motion
from lieednn_sim.registry import DEFAULT_ARMS

HEADINGS = (
    *("arm", "scene", "motions", "certified", "off the path [mm]", "gap [mm]", "joint jerk", "effector jerk", "path"),
    *("effort", "clearance [mm]", "guide's", "fit [ms]", "planning [s]"),
)
# Forces and clearance are evaluated at every tenth sample.
STRIDE = 10


def effort(arm: ls.Arm, motion: Motion) -> float:
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


def measured(arm: str, scene: str, seed: int) -> dict[str, Any]:
    """Plan a case and compare it with its guide; ratios are those of the network's motion to the guide's."""
    room = ls.Arm.load(arm, scene, seed)
    plan = ls.plan(room, ls.draw_target(room, seed), planner="lieednn-shaped", seed=seed)
    assert isinstance(plan.network, ls.LieEDNN)
    assert plan.guide is not None
    motion, guide = plan.motion, plan.guide.motion
    with tempfile.TemporaryDirectory() as folder:  # loading verifies the certificate again
        plan.network.save(path := Path(folder) / "network.npz")
        certified = ls.LieEDNN.load(path).certified
    mine, given = motion_metrics(room, motion), motion_metrics(room, guide)
    near = [1e3 * Collisions(room).clearance(each.q[::STRIDE]) for each in (motion, guide)]
    return {
        "guide": plan.guide.planner,
        "certified": int(certified),
        "deviation_mm": 1e3 * plan.details.deviation,
        "gap_mm": mine.gap_mm,
        "jerk": mine.jerk_joints / given.jerk_joints,
        "effector_jerk": mine.jerk_effector / given.jerk_effector,
        "path": mine.path_ranges / given.path_ranges,
        "effort": effort(room, motion) / effort(room, guide),
        "clearance_mm": near[0],
        "guide_clearance_mm": near[1],
        "fit_ms": 1e3 * plan.details.fit_time,
        "planning_s": plan.cpu_time,
    }


def summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A Markdown table of medians and worst values, by arm and scene, and the failures."""
    kinds = sorted({(row["arm"], row["scene"]) for row in rows})
    groups = {kind: [row for row in rows if (row["arm"], row["scene"]) == kind] for kind in kinds}
    groups["all", "obstacles"] = [row for row in rows if row["scene"] != "free"]
    groups["all", "free"] = [row for row in rows if row["scene"] == "free"]
    cells = []
    for (arm, scene), chosen in groups.items():
        good = [row for row in chosen if not row["reason"]]
        if not good:
            continue
        worst = {
            name: f"{np.median(values):.3g} / {(min if 'clearance' in name else max)(values):.3g}"
            for name, value in good[0].items()
            if isinstance(value, float) and (values := [row[name] for row in good])
        }
        cells.append([arm, scene, f"{len(good)} of {len(chosen)}", f"{sum(row['certified'] for row in good):.0f}"])
        cells[-1] += [worst[name] for name in ("deviation_mm", "gap_mm", "jerk", "effector_jerk", "path", "effort")]
        cells[-1] += [worst["clearance_mm"], worst["guide_clearance_mm"]]
        cells[-1] += [worst[name] for name in ("fit_ms", "planning_s")]
    yield from markdown_table(HEADINGS, cells)
    obstacles = [row for row in groups["all", "obstacles"] if not row["reason"]]
    if obstacles:
        off = np.array([row["deviation_mm"] for row in obstacles])
        near, all_near = np.mean(off < 1.0), np.mean(off < 5.0)
        yield f"\nAmong obstacles, {near:.1%} stay within 1 mm of the guide's path and {all_near:.1%} within 5 mm."
        guides = [row["guide"] for row in obstacles]
        yield f"Motions by guide: {', '.join(f'{name} {guides.count(name)}' for name in sorted(set(guides)))}."
    for row in rows:
        if row["reason"]:
            yield f"\n- {row['arm']}, {row['scene']}, seed {row['seed']:.0f}: {row['reason']}"


def main(arguments: list[str] | None = None) -> None:
    """Measure missing cases, then write the summary."""
    scenes = ("window", "shelf", "poles", "free")
    given = options(arguments, __doc__, "results/shaped", arms=DEFAULT_ARMS, scenes=scenes, seeds=50)
    # Seeds in the outer loop, so that an interrupted run covers all arms and scenes.
    cases = [
        {"arm": arm, "scene": scene, "seed": seed}
        for seed, arm, scene in product(range(2 * given.seeds), given.arms, given.scenes)
        if seed < given.seeds or scene == "free"
    ]
    rows = saved_rows(given.output / "runs", cases, measured)
    head = (
        "Cells are median / worst of the planned motions. Jerk, path and effort are ratios to the guide's. All motions "
        "are those of universal networks: their weights are the same for all paths, and the start of the hidden "
        "neurons encodes a path. The column fit is the time to find this start. Target, obstacles and planner share "
        "one seed, counted from 0. Every network was saved, loaded and verified again. Times are CPU times of one core."
    )
    write(given.output / "summary.md", ["# Shaped networks against their guides", "", head, *summary(rows)])


if __name__ == "__main__":
    main()
