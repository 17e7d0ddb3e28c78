"""Loads that swing: planners with and without time laws that settle, on two cranes, with other loads than planned for.

    python scripts/settling.py [--tasks NAME,...] [--planners NAME,...] [--output results/settling]

On the crane of ``assets/tasks/crane`` in 8 and in 12 s, on the luffing `telescopic_crane` in 16 s, and on the boom of
``assets/tasks/boom`` with a section that bends: five motions for each planner and each of no law, ZV, ZVD, EI and least
energy (`planning.SettlingOptions`). Each plan, made for the model's load, is simulated with masses and lengths from -20
to +20 % of it; its swing in ten seconds after the motion is compared with that after a trapezoidal speed along the path
as planned without a law, in the same time. Writes a JSON file for each task, so that interrupted runs can be continued,
and the table `settling.md`.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from task_cases import ASSETS, Boom, Crane, SlowCrane, trapezoidal
from tasks import PLANNERS

import lieednn_sim as ls
from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import with_load
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.evaluation.load import LoadMetrics, load_metrics

METHODS = (None, "zv", "zvd", "ei", "least-energy")
LOADS = (
    *(("as planned", 1.0, 1.0), ("-20 % mass", 0.8, 1.0), ("+20 % mass", 1.2, 1.0)),
    *(("-20 % length", 1.0, 0.8), ("+20 % length", 1.0, 1.2)),
)
CASES = 5
_HOLD = 10.0  # [s]


class LuffingCrane:
    """The luffing crane with its hook on a link, from home to random targets between poles."""

    title = "Luffing telescopic_crane, hook on a link, in 16 s"
    duration: float | tuple[float, float] = 16.0
    fastest = False
    loads: tuple[tuple[str, float, float], ...] = LOADS

    def arm_and_goal(self, case: int) -> tuple[ls.Arm, Any]:
        """The arm and the goal of a case."""
        arm = ls.Arm.load("telescopic_crane").with_scene("poles", seed=case)
        return arm, ls.draw_target(arm, seed=case)


class TimberCrane(LuffingCrane):
    """The crane of the task, with its bending last stage."""

    title = "Timber crane with an elastic last stage, in 8 s"
    task = Crane()
    duration = Crane.duration

    def arm_and_goal(self, case: int) -> tuple[ls.Arm, Any]:
        """The arm and the goal of a case."""
        done = self.task.start(case)
        return ls.Arm.of(done.model, done.data, self.task.joints, tip="tip"), np.array(self.task.goals[case])


class SlowTimberCrane(TimberCrane):
    """The same in 12 s."""

    title = "Timber crane with an elastic last stage, in 12 s"
    duration = SlowCrane.duration


class BendingBoom(LuffingCrane):
    """The boom of the task with springs of our own before its third section: 6e5 Nm/rad, 0.8 Hz, damped by 1 %.

    Nothing hangs, so that there are no other loads, and what is left is its bending.
    """

    title = "Boom of 22 m whose third section bends, as fast as its limits allow"
    duration = (60.0, 240.0)
    fastest = True
    loads = LOADS[:1]

    def arm_and_goal(self, case: int) -> tuple[ls.Arm, Any]:
        """The arm and the goal of a case."""
        spec = mujoco.MjSpec.from_file(str(ASSETS / "boom/scene.xml"))
        for key in spec.keys:
            spec.delete(key)
        for name, axis in (("bend_down", [0, 1, 0]), ("bend_aside", [0, 0, 1])):
            spring: dict[str, Any] = {"stiffness": 6e5, "damping": 2e3, "armature": 0.0}
            spec.body("section3").add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, **spring)
        model = spec.compile()
        data = mujoco.MjData(model)
        for name in ("carriage", "telescope", "follow", "reach"):
            data.joint(name).qpos = 0.02
        arm = ls.Arm.of(model, data, Boom.joints, tip="tip", clearance=0.033)
        return arm, np.array(Boom.goals[case])


TASKS: dict[str, type[LuffingCrane]] = {
    "crane": TimberCrane,
    "slow_crane": SlowTimberCrane,
    "luffing": LuffingCrane,
    "boom": BendingBoom,
}


def attempt(task: LuffingCrane, case: int, planner: str) -> dict[str | None, dict[str, Any]]:
    """A planner's row in a case by method: swing left in degrees, and fractions of a trapezoid's, by load."""
    arm, goal = task.arm_and_goal(case)
    timing: dict[str, Any] = {"duration": task.duration, "fastest": task.fastest}
    rows: dict[str | None, dict[str, Any]] = {}
    theirs: dict[str, float] = {}
    for method in METHODS:
        begun = time.process_time()
        try:
            with ls.time_limit(60.0):
                found = ls.plan(arm, goal, planner=planner, seed=case, settle=method, **timing)
        except ls.LieEDNNError as error:
            rows[method] = {"failure": str(error)}
            if method is None:
                return dict.fromkeys(METHODS, rows[method])
            continue
        row: dict[str, Any] = {"time_s": float(found.t[-1]), "cpu_s": time.process_time() - begun}
        row |= {"left": {}, "ratio": {}}
        for name, mass, length in task.loads:
            loaded = with_load(arm, mass, length)
            if method is None:
                theirs[name] = moved(left_by(loaded, trapezoidal(found.motion)))
            left = left_by(loaded, found)
            row["left"][name], row["ratio"][name] = moved(left), moved(left) / theirs[name]
            if mass == length == 1.0:
                row |= {"bend_mm": left.bending_mm, "settling_s": left.settling_s}
        rows[method] = row
    return rows


def left_by(arm: ls.Arm, motion: Any) -> LoadMetrics:
    """What a motion of an arm leaves in simulation."""
    left = load_metrics(ls.simulate(arm, motion, hold=_HOLD), clearance=False)
    assert left is not None
    return left


def moved(left: LoadMetrics) -> float:
    """The angle by which the load swings, or where nothing does, the distance by which the arm bends [degrees, mm]."""
    return left.swing_deg or left.bending_mm


def as_markdown(results: dict[str, dict[str, Any]]) -> str:
    """The table: a section for each task, a row for each planner and method, means over the cases planned."""
    lines = [
        "# Loads that swing",
        "",
        "Swing left in ten seconds after the motion, as a fraction of what a trapezoidal speed leaves with the same "
        "load on the path as planned without a law, in that plan's time: means over the cases planned, with masses and "
        "lengths of the load that the planner does not know. CPU: time of planning.",
    ]
    for name, rows in results.items():
        cells = []
        for planner, method in dict.fromkeys((row["planner"], row["method"]) for row in rows.values()):
            cases = [row for row in rows.values() if (row["planner"], row["method"]) == (planner, method)]
            done = [row for row in cases if "ratio" in row]
            figures = ["-"] * (len(LOADS) + 5)
            if done:
                few = [np.mean([row[key] for row in done]) for key in ("time_s", "bend_mm", "cpu_s")]
                swing = np.mean([row["left"]["as planned"] for row in done])
                ratios = [np.mean([row["ratio"].get(load, np.nan) for row in done]) for load, _, _ in LOADS]
                calm = sum(row["settling_s"] is not None and row["settling_s"] < 1.0 for row in done)
                numbers = [*few[:1], swing, *ratios, few[1]]
                figures = ["-" if np.isnan(number) else f"{number:.2f}" for number in numbers] + [
                    f"{calm} of {len(done)}",
                    f"{few[2]:.2f}",
                ]
            cells.append([planner, method or "-", f"{len(done)} of {len(cases)}", *figures])
        heads = ["planner", "law", "planned", "time [s]", "left [deg, mm]", *(load for load, _, _ in LOADS)]
        heads += ["bending [mm]", "settled within 1 s", "CPU [s]"]
        lines += ["", f"## {TASKS[name].title}", "", *markdown_table(heads, cells)]
    return "\n".join(lines) + "\n"


def main(words: list[str] | None = None) -> None:
    """Do the cases that are not done yet; the table is written after each task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--planners", default=",".join(PLANNERS))
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--output", type=Path, default=Path("results/settling"))
    arguments = parser.parse_args(words)
    arguments.output.mkdir(parents=True, exist_ok=True)
    results = {}
    for name in arguments.tasks.split(","):
        path = arguments.output / f"{name}.json"
        rows = json.loads(path.read_text()) if path.is_file() else {}
        for planner, case in product(arguments.planners.split(","), range(arguments.cases)):
            if f"{planner} None {case}" in rows:
                continue
            for method, row in attempt(TASKS[name](), case, planner).items():
                rows[f"{planner} {method} {case}"] = {"planner": planner, "method": method, "case": case} | row
                print(name, planner, case + 1, method, row, flush=True)
            io.save_json(path, rows)
        results[name] = rows
        with io.atomic_text(arguments.output / "settling.md") as stream:
            stream.write(as_markdown(results))


if __name__ == "__main__":
    main()
