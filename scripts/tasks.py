"""Plan and simulate four tasks of the field with several planners: pass or fail, beside published figures.

    python scripts/tasks.py [--menagerie FOLDER ...] [--tasks NAME,...] [--planners NAME,...] [--output results/tasks]

The scenes are in ``assets/tasks``; the README of each has the sources of its numbers and its pass mark. The robot of
the task `shelf` is `hello_robot_stretch_3` of MuJoCo Menagerie, in a folder given or in the package
mujoco_menagerie; without either the task is left out. Every planner gets five cases of every task. Writes a JSON file
for each task, so that interrupted runs can be continued, the table `tasks.md`, and a film and a page that turns of each
task. Seconds of planning are CPU time. A planner's name may be followed by a time law that settles the load, as in
``lieednn-shaped+least-energy``, for the crane.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import options, write
from PIL import Image
from task_cases import Boom, Crane, Harvester, LeftOutError, Outcome, SlowCrane, Task
from task_shelf import Shelf

import lieednn_sim as ls
from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.rendering import opengl

TASKS: dict[str, type[Task]] = {
    "boom": Boom,
    "harvester": Harvester,
    "crane": Crane,
    "slow_crane": SlowCrane,
    "shelf": Shelf,
}

PLANNERS = (
    "lieednn-certified",
    "lieednn-shaped",
    "minimum-jerk",
    "rrt-connect",
    "sscbirrt",
    "stomp",
    "trajectory-optimisation",
)
SETTLED = "lieednn-shaped+least-energy"
FILMED = "lieednn-shaped"
CASES = 5
_ROWS = (  # of a simulation
    *("q", "qd", "q_ref", "qd_ref", "qpos", "ctrl", "force", "constraint_force"),
    *("link_position", "link_quaternion", "contacts", "contact_force"),
)


def attempt(task: Task, case: int, planner: str) -> tuple[dict[str, Any], Outcome | None]:
    """The row of a planner in a case of a task, and what happened in simulation if all of its motions were planned."""
    done = task.start(case)
    try:
        task.play(done, case, planner)
    except ls.LieEDNNError as error:
        return {"failure": f"motion {len(done.plans) + 1}: {error}", "cpu_s": done.cpu_time}, None
    figures = task.judge(done, case)
    missed = [f"{name} {figures[name]:.3g}" for name in task.missed(figures)]
    return {"figures": figures, "missed": missed, "cpu_s": done.cpu_time}, done


def write_film(path: Path, done: Outcome, frames: int = 60, size: tuple[int, int] = (640, 360)) -> None:
    """Write a GIF of all that happened, as the scene's camera sees it."""
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
    """Write a page that turns for each stretch of simulations in one model."""
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


def as_markdown(results: dict[str, dict[str, Any]]) -> str:
    """The table: a section for each task, a row for each planner."""
    lines = [
        "# Tasks of the field",
        "",
        "Five cases of each task. Passed: the pass mark in the task's README, stated before anything was measured. "
        "Planned: all of a case's motions were found. Figures are means over the cases planned, of what the simulation "
        "did; CPU seconds are those of planning a case, also where it failed.",
    ]
    for name, rows in results.items():
        task, cells, failures = TASKS[name], [], []
        for planner in dict.fromkeys(row["planner"] for row in rows.values()):
            cases = [row for row in rows.values() if row["planner"] == planner]
            figures = [row["figures"] for row in cases if "figures" in row]
            missed = [(row["case"] + 1, row.get("failure") or ", ".join(row["missed"])) for row in cases]
            missed = [(case, why) for case, why in missed if why]
            means = [float(np.mean([one[key] for one in figures])) for key in task.columns] if figures else []
            shown = [f"{mean:.0f}" if abs(mean) >= 20.0 else f"{mean:.2f}" for mean in means] or ["-"] * len(
                task.columns
            )
            passed, cpu = f"{len(cases) - len(missed)} of {len(cases)}", np.mean([row["cpu_s"] for row in cases])
            cells.append([planner, passed, len(figures), *shown, f"{cpu:.2f}"])
            if missed:
                case, why = missed[0]
                failures.append(f"- {planner}, {len(missed)} of {len(cases)}, such as case {case}: {why}")
        headings = ["planner", "passed", "planned", *task.columns.values(), "CPU [s]"]
        lines += ["", f"## {task.title}", "", task.published, *markdown_table(headings, cells)]
        lines += ["", "What failed:", "", *failures] if failures else ["", "Nothing failed."]
    return "\n".join(lines) + "\n"


def main(words: list[str] | None = None) -> None:
    """Do the cases that are not done yet; the table is written after each task."""
    defaults: dict[str, Any] = {"menagerie": ("",), "tasks": tuple(TASKS), "planners": (*PLANNERS, SETTLED)}
    given = options(words, __doc__, "results/tasks", **defaults)
    folder, results = io.make_directory(given.output), {}
    for name in given.tasks:
        try:
            task = TASKS[name]([Path(one) for one in given.menagerie if one])
        except LeftOutError as error:
            print(f"{name}: left out: {error}")
            continue
        path, film = folder / f"{name}.json", folder / f"tasks_{name}.gif"
        rows = json.loads(path.read_text()) if path.is_file() else {}
        planners = [planner for planner in given.planners if "+" not in planner or isinstance(task, Crane)]
        for planner, case in product(planners, range(CASES)):
            key = f"{planner} {case}"
            filmed = planner == FILMED and case == 0 and not film.is_file()
            if key in rows and not filmed:
                continue
            row, done = attempt(task, case, planner)
            rows[key] = {"planner": planner, "case": case} | row
            io.save_json(path, rows)
            print(f"{name}, {planner}, case {case + 1}: {row}", flush=True)
            if filmed and done is not None:
                write_film(film, done)
                write_pages(folder, name, done)
        results[name] = rows
        write(folder / "tasks.md", as_markdown(results))


if __name__ == "__main__":
    main()
