"""Prove motions free of collision in continuous time, in the scenes of planners with reachable sets.

    python scripts/provers.py ARMOUR SPARROWS [--sets armour sparrows] [--planners NAME ...] [--jobs 1]
                              [--output results/provers]

The folders are checkouts of roahmlab/armour and roahmlab/sparrows, which are not part of this project;
docs/howto/published_problems.md says how the problems are posed. Writes a Markdown table, ``provers.md``; exits with
status 1 if anything is nearer than proved. Rows are kept in ``OUTPUT/runs``, so an interrupted run goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from common import options, saved_runs, spread, write
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.obstacles import shapes
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.evaluation import evaluate
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.planning import Plan, find_tube, plan
from lieednn_sim.simulation import simulate
from lieednn_sim.studies.problems.motion_bench_maker import PublishedProblem
from lieednn_sim.values import Floats

SETS = {"armour": "kinova_src/saved_worlds/random", "sparrows": "kinova_scenarios"}
MODEL = "urdfs/kinova_arm/kinova_without_gripper.urdf"
PLANNERS = ("lieednn-shaped", "rrt-connect", "lieednn-certified", "minimum-jerk")
# Number of instants of each motion at which the proof is tested, and the distance up to which it is [m].
INSTANTS, FAR = 100, 0.1
_NOTHING = 1e6
METHOD = (
    "A planner with its default options plans from the published start to the published joint goal. The motion must "
    "keep the ranges and velocities of the robot's model and stay at least 2 mm from contact.\n\n- **proved at every "
    "instant**: the motion has a continuous-time collision certificate, which covers every instant and not only the "
    "samples.\n- **runs inside the proof**: the simulated joints stay so near to the plan that the certificate covers "
    "them.\n- **clearance**: the lower bound that the certificate proves of all distances; distances above "
    f"{1e3 * FAR:g} mm count as {1e3 * FAR:g} mm.\n- **tube**: the largest shift, of all links at once and at any "
    "instant, after which the network is proved to end at its target without contact. Only certified networks have "
    "one.\n- **CPU**: times of one core; planning includes the proof.\n\nThree numbers are median / least / largest. "
    "[How the scenes are posed, and what the authors of the scenes report](../../docs/howto/published_problems.md)."
)
HEADINGS = (
    *("set", "planner", "solved", "proved at every instant", "runs inside the proof", "clearance [mm]", "with a tube"),
    *("tube [mm]", "motion time [s]", "planning CPU [s]", "tube CPU [s]"),
)


@lru_cache(maxsize=1)
def robot(model: Path) -> Arm:
    """The Kinova Gen3, without a floor, as the planners with reachable sets have it."""
    return Arm.from_xml(model, "gen3", floor="none")


def problem(model: Path, file: Path) -> PublishedProblem:
    """The problem of a file: lines of start, of goal, of NaN, and of the centre and the edges of each box [rad, m]."""
    values = np.genfromtxt(file, delimiter=",")
    boxes = [{"shape": "box", "position": row[:3].tolist(), "size": row[3:6].tolist()} for row in values[3:]]
    return PublishedProblem(robot(model).with_obstacles(shapes({"obstacles": boxes}, file), file.stem), *values[:2])


def least_distance(arm: Arm, q: Floats) -> float:
    """Least distance [m] of geoms that MuJoCo lets meet at joints ``(K, n)``, by `mj_geomDistance`, at most `FAR`."""
    model = arm.copied_spec().compile()
    # With this margin MuJoCo lists all pairs of geoms that are near.
    model.geom_margin[:] = FAR
    data, least = mujoco.MjData(model), FAR
    for data.qpos[:] in arm.qpos(q):
        mujoco.mj_fwdPosition(model, data)
        for pair in {tuple(pair) for pair in data.contact.geom.tolist()}:
            least = min(least, mujoco.mj_geomDistance(model, data, *pair, FAR, None))
    return least


def attacked(arm: Arm, made: Plan) -> float:
    """Least distance [m] at random proved instants of a plan; `_NOTHING` if no instant is proved."""
    motion, unproved = made.motion, made.clearance.unproved
    t = np.random.default_rng(0).uniform(0.0, motion.t[-1], INSTANTS)
    t = t[~((t[:, None] >= unproved[:, 0]) & (t[:, None] <= unproved[:, 1])).any(axis=1)]
    return least_distance(arm, CubicHermiteSpline(motion.t, motion.q, motion.qd)(t)) if len(t) else _NOTHING


def prove(name: str, planner: str, model: Path, file: Path) -> dict[str, Any]:
    """The row of a planner in a scene of a set: what is proved, times [s], distances [mm]; or why it has no motion."""
    row = {"set": name, "planner": planner, "scene": file.stem.removeprefix("scene_")}
    try:
        arm, start, goal = problem(model, file)
        begin = cpu_time()
        made = plan(arm, goal, planner=planner, start=start)
        clearance = made.clearance
    except LieEDNNError as error:
        return row | {"reason": str(error)}
    planned = cpu_time()
    try:
        tube = 1e3 * find_tube(arm, made).size
    except LieEDNNError:
        tube = None
    return row | {
        "reason": "",
        "fraction": clearance.proved_fraction,
        "clearance": 1e3 * clearance.bound,
        "tube_time": cpu_time() - planned,
        "tube": tube,
        "found": 1e3 * attacked(arm, made),
        "inside": bool(evaluate(simulate(arm, made)).proved),
        "motion_time": float(made.motion.t[-1]),
        "planning_time": planned - begin,
    }


def report(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The statistics of each set and planner, the test of the proofs, and what was not solved."""

    def numbers(of: Sequence[dict[str, Any]], name: str) -> str:
        """The median, least and largest of a column."""
        return " / ".join(spread([row[name] for row in of], 0.5, 0.0, 1.0)) if of else "-"

    cells, lost = [], []
    for key in dict.fromkeys((row["set"], row["planner"]) for row in rows):
        own = [row for row in rows if (row["set"], row["planner"]) == key]
        solved = [row for row in own if not row["reason"]]
        tubes = [row for row in solved if row["tube"] is not None]
        sure = [sum(row["fraction"] == 1.0 for row in solved), sum(row["inside"] for row in solved)]
        cells.append([key[0], f"`{key[1]}`", f"{len(solved)} of {len(own)}", *(f"{n} of {len(solved)}" for n in sure)])
        cells[-1] += [numbers(solved, "clearance"), f"{len(tubes)} of {len(solved)}"]
        cells[-1] += [numbers([row for row in tubes if row["tube"]], "tube"), numbers(solved, "motion_time")]
        cells[-1] += [numbers(solved, "planning_time"), numbers(tubes, "tube_time")]
        ways = [" would come within ", " would touch "]
        blocked = [row["scene"] for row in own if any(way in row["reason"] for way in ways)]
        lost += [f"- {key[0]}, `{key[1]}`, something in the way: {', '.join(blocked)}"] if blocked else []
        others = [row for row in own if row["reason"] and row["scene"] not in blocked]
        lost += [f"- {key[0]}, `{key[1]}`, {row['scene']}: {row['reason']}" for row in others]
    solved = [row for row in rows if not row["reason"]]
    sharp = [row["clearance"] / row["found"] for row in solved if 0.0 < row["found"] < 999.0 * FAR] or [np.nan]
    return [
        "# Continuous-time collision certificates",
        "",
        METHOD,
        *markdown_table(HEADINGS, cells),
        "",
        f"MuJoCo measured the least distance at {INSTANTS} random instants of each of these {len(solved)} motions, "
        f"mostly between samples. It was below the proved clearance in {len(broken(rows))} motions. In the median, the "
        f"proved clearance is {np.median(sharp):.0%} of the measured distance.",
        *("", "What was not solved:", "", *(lost or ["- nothing"])),
    ]


def broken(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Motions in which something was found nearer than proved."""
    return [row for row in rows if not row["reason"] and row["found"] < row["clearance"] - 1e-6]


def main(arguments: list[str] | None = None) -> int:
    """Plan and prove in every scene, then write the table."""
    defaults = {"sets": tuple(SETS), "planners": PLANNERS, "jobs": 1}
    given = options(arguments, __doc__, "results/provers", ["armour", "sparrows"], {"sets": SETS}, **defaults)
    files = {name: sorted((getattr(given, name) / SETS[name]).glob("scene_*.csv")) for name in given.sets}
    if missing := [name for name in given.sets if not files[name]]:
        raise FileError(f"{getattr(given, missing[0])} has no {SETS[missing[0]]}/scene_*.csv")
    asked = {
        f"{name}-{planner}-{file.stem}": (name, planner, given.armour / MODEL, file)
        for name in given.sets
        for planner in given.planners
        for file in files[name]
    }
    rows = saved_runs(given.output / "runs", asked, prove, given.jobs)
    write(given.output / "provers.md", report(rows))
    return 1 if broken(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
