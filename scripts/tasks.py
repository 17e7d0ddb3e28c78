"""Plan and simulate four real tasks with several planners: pass or fail, beside published figures.

    python scripts/tasks.py [--menagerie FOLDER ...] [--tasks NAME,...] [--planners NAME,...] [--output results/tasks]

The scenes are in ``assets/tasks``; the README of each has the sources of its numbers and its pass mark. The robot of
the task `shelf` is `hello_robot_stretch_3` of MuJoCo Menagerie, in a given folder or the package mujoco_menagerie;
without either the task is left out. For the crane, a planner's name may be followed by a time law that settles the
load, as in ``lieednn-shaped+least-energy``. Writes the table `tasks.md`, and a film and an interactive page of each
task; an interrupted run goes on.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import options, saved_runs, write
from PIL import Image
from task_cases import Boom, Crane, Harvester, LeftOutError, Outcome, SlowCrane, Task
from task_shelf import Shelf

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.rendering import opengl

TASKS = {"boom": Boom, "harvester": Harvester, "crane": Crane, "slow_crane": SlowCrane, "shelf": Shelf}
PLANNERS = (
    *("lieednn-certified", "lieednn-shaped", "minimum-jerk", "rrt-connect", "sscbirrt", "stomp"),
    "trajectory-optimisation",
)
SETTLED = "lieednn-shaped+least-energy"
FILMED = "lieednn-shaped"
CASES = 5
_ROWS = (  # of a simulation
    *("q", "qd", "q_ref", "qd_ref", "qpos", "ctrl", "force", "constraint_force"),
    *("link_position", "link_quaternion", "contacts", "contact_force"),
)


@cache
def made(name: str, *menagerie: Path) -> Task:
    """A task by its name; `LeftOutError` if its robot is missing."""
    return TASKS[name](menagerie)


def attempt(name: str, planner: str, case: int, folder: Path, *menagerie: Path) -> dict[str, Any]:
    """The row of a planner in a case of a task; the first case of `FILMED` also gets a film and pages in the folder."""
    task, row = made(name, *menagerie), {"planner": planner, "case": case}
    done = task.start(case)
    try:
        task.play(done, case, planner)
    except ls.LieEDNNError as error:
        return row | {"missed": f"motion {len(done.plans) + 1}: {error}", "cpu_s": done.cpu_time}
    if planner == FILMED and case == 0:
        write_film(folder / f"tasks_{name}.gif", done)
        write_pages(folder, name, done)
    figures = task.judge(done, case)
    missed = ", ".join(f"{name} {figures[name]:.3g}" for name in task.missed(figures))
    return row | {"figures": figures, "missed": missed, "cpu_s": done.cpu_time}


def write_film(path: Path, done: Outcome, frames: int = 60, size: tuple[int, int] = (640, 360)) -> None:
    """Write a GIF of all simulations of a case, seen by the scene's camera."""
    opengl.require()
    whole, pictures = sum(t[-1] for _, t, _, _ in done.shots), []
    for model, t, qpos, riding in done.shots:
        data = mujoco.MjData(model)
        with mujoco.Renderer(model, size[1], size[0]) as renderer:
            for row in np.linspace(0, len(t) - 1, max(2, round(frames * t[-1] / whole))).astype(int):
                data.qpos[:] = qpos[row]
                mujoco.mj_forward(model, data)
                if riding:
                    tip = data.site("tip")
                    data.mocap_pos[model.body(riding).mocapid] = tip.xpos + 0.04 * tip.xmat.reshape(3, 3)[:, 0]
                    mujoco.mj_forward(model, data)
                renderer.update_scene(data, "side")
                pictures.append(Image.fromarray(renderer.render()))
    # One palette for all frames, whose colours would flicker otherwise.
    palette = pictures[len(pictures) // 2].quantize(200)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    pause = min(200.0, 1e3 * whole / len(reduced))
    reduced[0].save(path, save_all=True, append_images=reduced[1:], duration=pause, loop=0)


def write_pages(folder: Path, name: str, done: Outcome) -> None:
    """Write an interactive page for each sequence of simulations in one model."""
    stretches: list[list[Any]] = []
    for run in done.runs:
        if stretches and stretches[-1][-1].arm.model.nq == run.arm.model.nq:
            stretches[-1].append(run)
        else:
            stretches.append([run])
    for k, runs in enumerate(stretches):
        ends = np.cumsum([run.t[-1] + run.timestep for run in runs])
        rows = {key: np.concatenate([getattr(run, key) for run in runs]) for key in _ROWS}
        rows["t"] = np.arange(len(rows["qpos"])) * runs[0].timestep
        end = float(ends[-1] - runs[-1].t[-1] + runs[-1].motion_end)
        whole = replace(runs[0], **rows, motion_end=end, motion=None, target=runs[-1].target)
        ls.render_page(whole, folder / f"{name}{k + 1 if k else ''}.html", camera="side", title=name)


def as_markdown(results: dict[str, list[dict[str, Any]]]) -> list[str]:
    """The table: a section for each task, a row for each planner."""
    lines = [
        "# Tasks of the field",
        "",
        "Each task has five cases. A case is passed if it meets the pass mark in the task's README, which was stated "
        "before anything was measured. It is planned if the planner found all its motions. The other figures are "
        "measured in simulation, and are means over the planned cases. CPU is the time to plan a case, also where "
        "planning failed.",
    ]
    for name, rows in results.items():
        task, cells, failures = TASKS[name], [], []
        for planner in dict.fromkeys(row["planner"] for row in rows):
            cases = [row for row in rows if row["planner"] == planner]
            figures = [row["figures"] for row in cases if "figures" in row]
            missed = [row for row in cases if row["missed"]]
            means = [np.mean([one[key] for one in figures]) if figures else np.nan for key in task.columns]
            shown = [f"{mean:.0f}" if abs(mean) >= 20.0 else f"{mean:.2f}".replace("nan", "-") for mean in means]
            passed, cpu = f"{len(cases) - len(missed)} of {len(cases)}", np.mean([row["cpu_s"] for row in cases])
            cells.append([planner, passed, len(figures), *shown, f"{cpu:.2f}"])
            for row in missed[:1]:
                such = f"{len(missed)} of {len(cases)}, such as case {row['case'] + 1}: {row['missed']}"
                failures.append(f"- {planner}, {such}")
        headings = ["planner", "passed", "planned", *task.columns.values(), "CPU [s]"]
        lines += ["", f"## {task.title}", "", task.published, *markdown_table(headings, cells)]
        lines += ["", "What failed:", "", *failures] if failures else ["", "Nothing failed."]
    return lines


def main(words: list[str] | None = None) -> None:
    """Do the cases that are not done yet; the table is written after each task."""
    defaults: dict[str, Any] = {"menagerie": ("",), "tasks": tuple(TASKS), "planners": (*PLANNERS, SETTLED)}
    given = options(words, __doc__, "results/tasks", **defaults)
    menagerie, results = [Path(one) for one in given.menagerie if one], {}
    for name in given.tasks:
        try:
            task = made(name, *menagerie)
        except LeftOutError as error:
            print(f"{name}: left out: {error}")
            continue
        planners = [planner for planner in given.planners if "+" not in planner or isinstance(task, Crane)]
        runs = {
            f"{name}-{planner}-{case}": (name, planner, case, given.output, *menagerie)
            for planner, case in product(planners, range(CASES))
        }
        results[name] = saved_runs(given.output / "runs", runs, attempt, 1)
        write(given.output / "tasks.md", as_markdown(results))


if __name__ == "__main__":
    main()
