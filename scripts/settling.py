"""Loads that swing: planners with and without time laws that settle them, on two cranes and a boom.

    python scripts/settling.py [--tasks NAME,...] [--planners NAME,...] [--output results/settling]

The arms are the crane of ``assets/tasks/crane`` in 8 and in 12 s, the luffing `telescopic_crane`, and the boom of
``assets/tasks/boom`` with a section that bends. Each planner's motion gets each law of `planning.SettlingOptions`, for
the model's load. Loads with other masses and lengths are tried as well. Besides, the linear model of the law of least
energy is compared with simulations of random motions. Writes ``settling.md`` and ``settling.png``; an interrupted run
goes on.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import options, saved_rows, write
from task_cases import ASSETS, Boom, Crane, trapezoidal
from tasks import PLANNERS

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import with_load
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.budget import cpu_time
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.evaluation.figure_layout import drawn
from lieednn_sim.evaluation.load import LoadMetrics, load_metrics
from lieednn_sim.planning.settling import METHODS, SettlingOptions, settled
from lieednn_sim.planning.swing_model import SwingModel
from lieednn_sim.planning.time_laws import TimedCurve

LAWS = ("none", *METHODS[1:], METHODS[0])
FACTORS = (0.8, 0.9, 1.0, 1.1, 1.2)
LOADS = ({}, *({kind: factor} for kind in ("mass", "length") for factor in FACTORS if factor != 1.0))
FARTHEST = [load for load in LOADS if set(load.values()) & {FACTORS[0], FACTORS[-1]}]
VARIED = "lieednn-shaped"  # the planner tried with all loads; others are tried with the model's and the `FARTHEST`
MOTIONS = 100  # random ones of each crane
_HOLD = 5.0  # [s]
_LEFT: dict[tuple[bytes, ...], Any] = {}


def timber(case: int) -> tuple[ls.Arm, Any]:
    """The crane of the task, with its bending last stage."""
    done = Crane().start(case)
    return ls.Arm.of(done.model, done.data, Crane.joints, tip="tip"), np.array(Crane.goals[case])


def luffing(case: int) -> tuple[ls.Arm, Any]:
    """The luffing crane with its hook on a link, at home; in steps of 10 ms."""
    arm = ls.Arm.load("telescopic_crane")
    model = copy.copy(arm.model)
    model.opt.timestep = 0.01
    return replace(arm, model=model), ls.draw_target(arm, (0, 1, 8)[case])


def boom(case: int) -> tuple[ls.Arm, Any]:
    """The boom of the task with springs of our own before its third section: 6e5 Nm/rad, 0.8 Hz, damped by 1 %."""
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
    return ls.Arm.of(model, data, Boom.joints, tip="tip", clearance=0.033), np.array(Boom.goals[case])


@dataclass(frozen=True)
class Task:
    """An arm and its goals, the planner's options, the loads tried, and by how many periods laws are longer."""

    title: str
    options: dict[str, Any]
    arm_and_goal: Callable[[int], tuple[ls.Arm, Any]]
    cases: int = 5
    loads: Sequence[dict[str, float]] = LOADS
    more: float = 0.0


TASKS = {
    "crane": Task("Timber crane with an elastic last stage, in 8 s", {"duration": 8.0}, timber),
    "slow_crane": Task("Timber crane with an elastic last stage, in 12 s", {"duration": 12.0}, timber),
    "luffing": Task("Luffing telescopic_crane, hook on a link, in 8 s", {"duration": 8.0}, luffing, cases=3),
    "boom": Task(
        "Boom of 22 m whose third section bends, at its limits, laws in 1.5 periods more",
        {"duration": (60.0, 240.0), "fastest": True},
        boom,
        loads=LOADS[:1],
        more=1.5,
    ),
}


def name_of(load: dict[str, float]) -> str:
    """A load in words, as in the tables."""
    return ", ".join(f"{kind} {factor - 1.0:+.0%}" for kind, factor in load.items()) or "as planned"


@lru_cache(maxsize=1)
def planned(task: str, planner: str, case: int) -> tuple[ls.Plan, dict[str, ls.Arm], dict[str, float]] | str:
    """A plan without a law, arms with all loads, and the swing that a trapezoidal speed leaves; or why it failed."""
    arm, goal = TASKS[task].arm_and_goal(case)
    try:
        with ls.time_limit(60.0):
            found = ls.plan(arm, goal, planner=planner, seed=case, **TASKS[task].options)
    except ls.LieEDNNError as error:
        return str(error)
    loads = [load for load in TASKS[task].loads if planner == VARIED or not load or load in FARTHEST]
    arms, motion = {name_of(load): with_load(arm, **load) for load in loads}, trapezoidal(found.motion)
    return found, arms, {name: moved(left_by(each, motion)) for name, each in arms.items()}


def measured(task: str, planner: str, case: int, law: str) -> dict[str, Any]:
    """The row of a motion with a law: the swing left, and for each load its fraction of a trapezoid's."""
    made = planned(task, planner, case)
    if isinstance(made, str):
        return {"reason": made}
    (found, arms, theirs), begin = made, cpu_time()
    motion, spent = found.motion, found.cpu_time
    if law != "none":
        motion = settled(arms[name_of({})], motion, SettlingOptions(law), more=TASKS[task].more)
        spent = cpu_time() - begin
    runs = {name: left_by(arm, motion) for name, arm in arms.items()}
    nominal = runs[name_of({})]
    calm = nominal.settling_s is not None and nominal.settling_s < 1.0
    row = {"time_s": float(motion.t[-1]), "cpu_s": spent, "left": moved(nominal)}
    row |= {"bend_mm": nominal.bending_mm, "calm": float(calm)}
    return row | {name: moved(left) / theirs[name] for name, left in runs.items()}


def left_by(arm: ls.Arm, motion: Any) -> LoadMetrics:
    """The swing that a motion leaves in simulation; equal motions, as in free space, are simulated once."""
    key = tuple(part.tobytes() for part in (motion.q, arm.model.body_mass, arm.model.body_ipos))
    if key not in _LEFT:
        _LEFT[key] = load_metrics(ls.simulate(arm, motion, hold=_HOLD), clearance=False)
    return _LEFT[key]


def worst(task: str, rows: Sequence[dict[str, Any]]) -> float:
    """The mean over some cases of the largest fraction of a trapezoid's swing with a load of `FARTHEST`."""
    names = [name_of(load) for load in TASKS[task].loads if load in FARTHEST]
    return float(np.mean([max(row[name] for name in names) for row in rows])) if names else np.nan


def moved(left: LoadMetrics) -> float:
    """The swing of the load [degrees], or where nothing swings, the bending of the arm [mm]."""
    return left.swing_deg or left.bending_mm


def linear(task: str, seed: int) -> dict[str, float]:
    """Ratio of the roots of the energy that a random motion leaves, linear model over simulation, and its swing."""
    rng, (arm, _) = np.random.default_rng(seed), TASKS[task].arm_and_goal(seed % TASKS[task].cases)
    motion = None
    while motion is None:
        goal, duration = ls.draw_target(arm, int(rng.integers(1 << 31))), rng.uniform(5.0, 15.0)
        try:
            motion = ls.plan(arm, goal, planner="minimum-jerk", duration=duration).motion
        except ls.LieEDNNError:  # something is in the way
            continue
    curve, t = TimedCurve(arm, motion), np.linspace(0.0, motion.t[-1], 1000)
    law = [np.asarray(curve.own(t, k))[:, None] for k in range(3)]
    expected = float(np.linalg.norm(SwingModel([arm], curve.q).left(t[1], law)[0]))
    run, passive = ls.simulate(arm, motion, hold=0.0), PassiveJoints(arm)
    rest = passive.at_rest(arm.qpos(motion.q[-1:]))
    x = passive.away(run.qpos, rest[0])
    v = (x[-1] - x[-3]) / (2.0 * run.timestep)
    stiffness, inertia = (passive.slopes(over, rest)[0] for over in ("position", "acceleration"))
    found = float(np.sqrt(x[-2] @ stiffness @ x[-2] + v @ inertia @ v))
    some = slice(None, None, 20)
    away = passive.away(run.qpos[some], passive.at_rest(arm.qpos(run.q_ref[some])))
    most = np.rad2deg(np.abs(away[:, ~passive.sprung]).max())
    left = found / np.sqrt(np.diag(stiffness)[~passive.sprung].max())
    return {"ratio": expected / found, "left_deg": np.rad2deg(left), "most_deg": float(most)}


def section(task: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    """The table of a task: a row for each planner and law, means over the cases planned."""
    cells = []
    for planner, law in dict.fromkeys((row["planner"], row["law"]) for row in rows):
        cases = [row for row in rows if (row["planner"], row["law"]) == (planner, law)]
        done = [row for row in cases if not row["reason"]]
        if done:
            keys = ("time_s", "left", "as planned", "bend_mm", "calm", "cpu_s")
            means = [f"{np.mean([row[key] for row in done]):.{4 if key == 'left' else 3}g}" for key in keys]
            means.insert(3, f"{worst(task, done):.3g}".replace("nan", "-"))
            cells.append([planner, law, f"{len(done)} of {len(cases)}", *means])
        elif law == LAWS[0]:
            cells.append([planner, law, f"0 of {len(cases)}", *7 * "-"])
    heads = ["planner", "law", "planned", "time [s]", "left [deg, mm]", "of a trapezoid's", "other load"]
    heads += ["bending [mm]", "settled within 1 s", "CPU [s]"]
    each = {(row["planner"], row["case"], row["law"]): row for row in rows if not row["reason"]}
    pairs = [(row, each.get((*key[:2], "ei"))) for key, row in each.items() if key[2] == LAWS[-1]]
    ratios = [one["left"] / ei["left"] for one, ei in pairs if ei and one["time_s"] < 1.01 * ei["time_s"]]
    lines = ["", f"## {TASKS[task].title}", *markdown_table(heads, cells)]
    calmer = sum(ratio <= 1.0 for ratio in ratios)
    said = f"Where it takes no longer than EI, least energy leaves no more than EI in {calmer} of {len(ratios)} plans"
    return [*lines, "", f"{said}. The median ratio is {np.median(ratios):.2g}."] if ratios else lines


def varied(rows: Sequence[dict[str, Any]]) -> dict[tuple[str, str], list[float]]:
    """Mean fractions of a trapezoid's swing, by task and law, for each of `LOADS`."""
    done = [row for row in rows if row["planner"] == VARIED and not row["reason"] and len(TASKS[row["task"]].loads) > 1]
    keys = dict.fromkeys((row["task"], row["law"]) for row in done)
    own = {key: [row for row in done if (row["task"], row["law"]) == key] for key in keys}
    return {key: [float(np.mean([row[name_of(load)] for row in own[key]])) for load in LOADS] for key in keys}


def agreement(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The linear model beside simulations of random motions, and the motions where they differ most."""
    cells, far = [], []
    for task in dict.fromkeys(row["task"] for row in rows):
        own = [row for row in rows if row["task"] == task]
        ratios, off = [row["ratio"] for row in own], [row for row in own if abs(row["ratio"] - 1.0) > 0.2]
        spread = (f"{value:.2f}" for value in np.quantile(ratios, (0.05, 0.5, 0.95)))
        cells.append([task, len(own), len(own) - len(off), *spread])
        far += [
            f"- {task}, motion {row['seed']:.0f}: ratio {row['ratio']:.2f}; in simulation the load swings by "
            f"{row['most_deg']:.3g} degrees on the way and by {row['left_deg']:.2g} degrees at the end"
            for row in off
        ]
    return [
        *("", "## The linear model beside simulation", ""),
        "`minimum-jerk` plans motions from rest to random targets in 5 to 15 s, or longer where the limits require it. "
        "The table compares the square root of the energy that a motion leaves: the linear model's value divided by "
        "the simulation's.",
        *markdown_table(["task", "motions", "within 20 %", "5 %", "median", "95 %"], cells),
        *(("", "Motions whose ratio is more than 20 % from 1:", "", *far) if far else ()),
    ]


def report(rows: Sequence[dict[str, Any]], motions: Sequence[dict[str, Any]]) -> list[str]:
    """All tables."""
    lines = [
        "# Loads that swing",
        "",
        f"Values are means over the planned cases.\n\n- **left**: how far the load swings in the {_HOLD:g} s after the "
        "motion, or, where nothing swings, how far the arm bends.\n- **of a trapezoid's**: this as a fraction of what "
        "a trapezoidal speed leaves on the same path, in the time planned without a law.\n- **other load**: the "
        "largest such fraction of loads with 20 % more or less mass or length than planned for.\n- **settled within 1 "
        "s**: the fraction of cases that stay within 1 degree and 5 mm from 1 s after the motion on.\n- **CPU**: the "
        "time of planning for the law none, and for the others that of finding the law alone.",
    ]
    for task in dict.fromkeys(row["task"] for row in rows):
        lines += section(task, [row for row in rows if row["task"] == task])
    if others := varied(rows):
        cells = [[*key, *(f"{value:.3f}" for value in values)] for key, values in others.items()]
        lines += ["", "## Other loads than planned for", ""]
        lines += [f"Motions of `{VARIED}`, as fractions of what a trapezoidal speed leaves with the same load."]
        lines += markdown_table(["task", "law", *map(name_of, LOADS)], cells)
    return lines + (agreement(motions) if motions else [])


def plot(others: dict[tuple[str, str], list[float]], rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Plot the swing left over the error of mass and length, and by planner; a column for each task."""
    tasks = list(dict.fromkeys(task for task, _ in others))
    with drawn(path, 3.0 * len(tasks) + 1.0, 8.0) as figure:
        axes = figure.subplots(3, len(tasks), sharey=True, squeeze=False)
        for (column, task), law in product(enumerate(tasks), LAWS):
            done = [row for row in rows if (row["task"], row["law"]) == (task, law) and not row["reason"]]
            planners = dict.fromkeys(row["planner"] for row in done)
            far = [worst(task, [row for row in done if row["planner"] == planner]) for planner in planners]
            axes[2, column].plot([*planners], far, marker=".", ls="")
            axes[2, column].tick_params(axis="x", rotation=90)
        for (row, kind), (column, task) in product(enumerate(("mass", "length")), enumerate(tasks)):
            axis, at = axes[row, column], [k for k, load in enumerate(LOADS) if not load or kind in load]
            at.sort(key=lambda k: LOADS[k].get(kind, 1.0))
            for law in LAWS:
                left = np.array(others[task, law])[at]
                axis.plot(100.0 * (np.array(FACTORS) - 1.0), left, marker=".", ls="-", label=law)
            axis.axhline(1.0, color="0.6", lw=0.8)
            axis.set(yscale="log", xlabel=f"error of the {kind} [%]", title=task.replace("_", " ") if not row else "")
        for axis, what in zip(axes[:, 0], ("left", "left", "left, worst load"), strict=True):
            axis.set_ylabel(f"{what}, of a trapezoid's")
        axes[0, 0].legend(ncols=2, fontsize=7)


def main(words: list[str] | None = None) -> None:
    """Measure what is missing, and write tables and figure."""
    given = options(words, __doc__, "results/settling", tasks=tuple(TASKS), planners=(*PLANNERS, "mjpl"))
    folder, tasks = given.output, given.tasks
    cases = [
        {"task": task, "planner": planner, "case": case, "law": law}
        for task, planner in product(tasks, given.planners)
        for case, law in product(range(TASKS[task].cases), LAWS)
    ]
    rows = saved_rows(folder / "runs", cases, measured)
    cranes = [task for task in ("crane", "luffing") if task in tasks]
    random = [{"task": task, "seed": seed} for task, seed in product(cranes, range(MOTIONS))]
    motions = saved_rows(folder / "linear", random, linear)
    write(folder / "settling.md", report(rows, motions))
    if others := varied(rows):
        plot(others, rows, folder / "settling.png")


if __name__ == "__main__":
    main()
