"""The command ``sequence``: the steps of a file are planned, simulated in its model, and shown."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.cli.arguments import size
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.errors import LieEDNNError, RenderingUnavailableError
from lieednn_sim.planning.sequence import PlanSequence
from lieednn_sim.planning.sequence_file import load_sequence
from lieednn_sim.simulation import ModelRun, run_in


def sequence(arguments: argparse.Namespace) -> None:
    """Plan, simulate, report and render."""
    from lieednn_sim.rendering.video import check_rate, check_view

    described = load_sequence(arguments.file)
    view = {"camera": arguments.camera, "size": size(arguments.size), "preset": arguments.preset}
    check_view(described.model, **view)
    check_rate(arguments.fps, "video.mp4")
    with io.output_folder(arguments.output, "sequence") as directory:
        outputs = [directory / name for name in ("sequence.npz", "run.npz", "report.json", "run.html", "video.mp4")]
        plan, run, report, page, video = outputs
        for path in outputs:
            path.unlink(missing_ok=True)
        with progress("plan"):
            found = described.plan()
        found.save(plan)
        console.print(str(found))
        wrote(plan)
        with progress("simulate") as shown:
            done = run_in(described.model, described.data, found, hold=arguments.hold, progress=shown)
        with io.atomic_paths([run, report]) as temporaries:
            done.save(temporaries[0])
            io.save_json(temporaries[1], _report(found, done))
        _print(done, found)
        wrote(run, report)
        if not arguments.no_page:
            _show(page, done, {"camera": arguments.camera})
        if not arguments.no_video:
            _show(video, done, {**view, "fps": arguments.fps})


def _show(path: Path, run: ModelRun, how: dict[str, Any]) -> None:
    """Write a page or a video, or say why there is none."""
    from lieednn_sim.rendering.page import render_page
    from lieednn_sim.rendering.video import render_video

    render: Any = render_page if path.suffix == ".html" else render_video
    try:
        with progress("render") as report, io.atomic_path(path) as temporary:
            render(run, temporary, progress=report, **how)
    except RenderingUnavailableError as error:
        console.print(f"no {path.name}: {error}")
    except LieEDNNError as error:
        if path.suffix != ".html":
            raise
        console.print(f"no {path.name}: {error}")
    else:
        wrote(path)


def _report(found: PlanSequence, run: ModelRun) -> dict[str, Any]:
    """Times and proofs of the steps, tracking errors, and where free bodies ended."""
    steps = [
        {
            "name": part.step.name,
            "planned_begin_s": float(found.t[part.first]),
            "planned_end_s": float(found.t[part.last]),
            "simulated_begin_s": begin,
            "planning_cpu_s": None if part.plan is None else part.plan.cpu_time,
            "proof": str(part),
        }
        for part, (begin, _) in zip(found.parts, run.steps, strict=True)
    ]
    objects = {
        name: {
            "planned": planned.tolist(),
            "simulated": there.tolist(),
            "distance_m": float(np.linalg.norm(there - planned)),
        }
        for name, planned, there in _ends(run)
    }
    errors = dict(zip(run.joint_names, np.abs(run.tracking_error).max(axis=0).tolist(), strict=True))
    return {
        "planned_s": float(found.t[-1]),
        "simulated_s": run.motion_end,
        "steps": steps,
        "largest_tracking_error": errors,
        "objects": objects,
    }


def _ends(run: ModelRun) -> list[tuple[str, Any, Any]]:
    """Names of the bodies with a free joint, and where they were to end and ended, ``(3,)`` each."""
    model, found = run.model, []
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        first = model.jnt_qposadr[joint]
        place = slice(first, first + 3)
        name = model.body(model.jnt_bodyid[joint]).name or f"body {model.jnt_bodyid[joint]}"
        found.append((name, run.planned[-1, place], run.qpos[-1, place]))
    return found


def _print(run: ModelRun, found: PlanSequence) -> None:
    console.print(f"simulated: {run.motion_end:.2f} s, planned {found.t[-1]:.2f} s")
    console.print(f"largest tracking error of a joint: {np.abs(run.tracking_error).max():.2g} rad or m")
    for name, planned, there in _ends(run):
        console.print(f"{name} ended {1e3 * np.linalg.norm(there - planned):.1f} mm from where it was planned to")
