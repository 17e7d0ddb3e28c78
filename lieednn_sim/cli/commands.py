"""``demo``, the commands that read a run directory and write into it, and ``export``."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Annotated, Any

from lieednn_sim import io
from lieednn_sim.cli.arguments import Look, Planning, Simulating, still_look
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.kinds import Directory, File
from lieednn_sim.cli.planning import plan_run, print_plan
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError, LieEDNNError, RenderingUnavailableError, SimulationError
from lieednn_sim.evaluation import Evaluation
from lieednn_sim.evaluation.metrics import evaluate as evaluate_rollout
from lieednn_sim.exports import export as export_sources
from lieednn_sim.exports.formats import record
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.registry import FORMATS
from lieednn_sim.rendering import opengl
from lieednn_sim.rendering.camera import check_view
from lieednn_sim.rendering.video import check_rate, render_video
from lieednn_sim.simulation import Rollout
from lieednn_sim.simulation import simulate as simulate_motion
from lieednn_sim.validation import as_path


def demo(
    *,
    planning: Planning,
    output: Directory = "results/demo",
    simulating: Simulating,
    look: Look,
    plots: str = "png",
    page: bool = True,
    video: bool = True,
    verbose: bool = False,
) -> None:
    """Run everything: plan a motion to a target, simulate it, evaluate it, make a page and a video.

    Without a target, the arm goes to its keyframe 'extended', or to a random target among obstacles. The option
    bias_magnitudes of lieednn-certified is 0.125 here, as in the paper, and 24 networks are drawn at once.

    Args:
        planning: the motion.
        output: directory for the files of the run.
        simulating: the simulation.
        look: the video.
        plots: format of the plots: png, pdf or svg.
        page: make motion.html, a page that plays the motion in 3D.
        video: make video.mp4.
        verbose: print every stability condition, all bounds, all metrics, and the whole report of an imported arm.
    """
    start = time.perf_counter()
    # Check options before any work.
    arm = planning.load()
    simulating.all_disturbances(arm)
    if video:
        check_view(arm, **still_look(look))
        check_rate(look.get("fps", 25), "video.mp4")
    run = RunDirectory(output, plots)
    with run.at_work():
        # The paper's bias leaves more to the weights.
        plan, head, written = plan_run(run, planning, ["bias_magnitudes=0.125", "n_first=24"])
        arrival, clearance, told = "not evaluated", plan.clearance, list[Any]()
        try:
            written += _simulate(run, simulating)
            rollout, evaluation, files = _evaluate(run)
            arrival, clearance, written = evaluation.arrival, rollout.clearance or clearance, written + files
            told, head = [evaluation] if verbose else evaluation.notes, f"{head}; controller: {rollout.controller}"
        finally:
            print_plan(plan, head, clearance, arrival, verbose=verbose)
            for each in told:
                console.print(each)
            wrote(*written)
        pictures = (("page", run.page, page, LieEDNNError), ("video", run.video, video, RenderingUnavailableError))
        for what, path, wanted, failure in pictures:
            try:
                if wanted:
                    _render(run, path, look)
            except failure as error:
                console.print(f"no {what}: {error}")
    shown = shlex.quote(str(output))
    console.print(f"done in {time.perf_counter() - start:.1f} s; metrics: lieednn-sim evaluate {shown}")


def simulate(run: Directory, *, simulating: Simulating) -> None:
    """Simulate the motion of a run, optionally with disturbances.

    A new simulation replaces the previous one of the run.

    Args:
        run: run directory, made by 'plan', 'train', 'learn --arm' or 'demo'.
        simulating: the simulation.
    """
    directory = RunDirectory(run).existing()
    with directory.at_work():
        wrote(*_simulate(directory, simulating))


def evaluate(run: Directory, *, plots: str = "png") -> None:
    """Compute metrics and plots of the simulation of a run.

    The metrics are printed; both are written into the run directory.

    Args:
        run: run directory.
        plots: format of the plots: png, pdf or svg.
    """
    directory = RunDirectory(run, plots).existing()
    with directory.at_work(shared=True):
        _, evaluation, files = _evaluate(directory)
        console.print(evaluation)
        wrote(*files)


def render(run: Directory, *, output: File | None = None, look: Look) -> None:
    """Make a video, a picture or a page of the simulation of a run.

    Videos and pictures need OpenGL (see 'lieednn-sim doctor'), but no display; pages need the extra 'view'.

    Args:
        run: run directory.
        output: an .mp4 or .gif file, .html for a page that plays in 3D, or .png for a picture that shows the arm at
            five instants (default: video.mp4 in the run directory).
        look: the video or picture.
    """
    directory = RunDirectory(run).existing()
    path = directory.video if output is None else as_path("the name of an output", output)
    if path.suffix not in (".mp4", ".gif", ".html", ".png"):
        raise InputError(f"an output must end in .mp4, .gif, .html or .png, got {path.name!r}")
    io.check_outputs([path])
    # A run of somebody else, which may be read-only, can be rendered into one's own folder.
    with directory.at_work(shared=True) if output is None else io.locked(directory.path, shared=True):
        _render(directory, path, look)


def export(
    runs: list[File] = [],  # noqa: B006, it is not changed
    *,
    format: str,
    rate: float | None = None,
    output: Directory = "results/export",
    episodes: int | None = None,
    recorded: Annotated[dict[str, Any], record, "arm", "scene", "scene_seed", "planner", "seed"],
) -> None:
    """Write runs or comparisons in the file formats of other tools, or episodes of an expert.

    Runs must have been simulated. The directory must be new, empty, or one of exports.

    Args:
        runs: run directories, or for plannerarena directories of 'compare'; none with --episodes.
        format: a name of `FORMATS`.
        rate: samples per second (default: every step of the simulation).
        output: directory of the files.
        episodes: number of successful episodes to record instead, of the expert of the learning environment
            TelescopicReach-v0; for lerobot.
        recorded: the episodes.
    """
    chosen = FORMATS.require(format)
    if episodes is not None:
        if format != "lerobot" or runs:
            raise InputError("--episodes are recorded in the format lerobot, and of no runs")
        with progress("record"):
            written = record(output, episodes, **recorded)
        wrote(*written)
        return
    if recorded:
        raise InputError(f"--{next(iter(recorded)).replace('_', '-')} is for --episodes")
    if not runs:
        raise InputError("name the directories to export, or the number of --episodes to record")
    sources: dict[str, Any] = {}
    for text in runs:
        path = as_path("the name of a run directory", text)
        name = path.resolve().name
        if name in sources:
            raise InputError(f"two of the directories are called {name!r}; export them into different directories")
        if chosen.of_comparison:
            sources[name] = path
            continue
        run = RunDirectory(path).existing()
        with io.locked(run.path, shared=True):
            sources[name] = run.load_rollout(*run.load_task())
    with progress("export"):
        written = export_sources(sources, output, format=format, rate=rate)
    wrote(*written)


def _simulate(run: RunDirectory, simulating: Simulating) -> list[Path]:
    task, arm = run.load_task()
    changes = simulating.all_disturbances(arm)
    with progress("check"):
        motion = run.load_motion(task)
        check_motion(arm, motion)
    try:
        with progress("simulate"):
            rollout = simulate_motion(
                arm,
                motion,
                target=task.target,
                controller=simulating.controller,
                hold=simulating.hold,
                reference_rate=simulating.reference_rate,
                disturbances=changes,
            )
    except SimulationError as error:
        if error.rollout is None:
            raise
        error.rollout.save(run.divergence)
        raise SimulationError(f"{error}; the run up to there is in {run.divergence} (Rollout.load reads it)") from None
    run.save_rollout(rollout)
    return [run.rollout]


def _evaluate(run: RunDirectory) -> tuple[Rollout, Evaluation, list[Path]]:
    from lieednn_sim.evaluation import plots

    rollout = run.load_rollout(*run.load_task())
    evaluation = evaluate_rollout(rollout)
    drawn = {run.plot(name): draw for name, draw in plots.plots_of(rollout).items()}
    outputs = [run.metrics_json, run.metrics_csv, *drawn]
    with io.atomic_paths(outputs) as (metrics_json, metrics_csv, *pictures):
        evaluation.save_json(metrics_json)
        evaluation.save_csv(metrics_csv)
        for plot, picture in zip(drawn.values(), pictures, strict=True):
            plot(rollout, picture)
    return rollout, evaluation, outputs


def _render(run: RunDirectory, path: Path, look: Look) -> None:
    """Write a page, a picture or a video, by the suffix of the path."""
    task, arm = run.load_task()
    rollout = run.load_rollout(task, arm)
    if path.suffix != ".html":
        backend = opengl.require()
        console.print(f"rendering with {backend.name}: {backend.detail}")
    with progress("render"), io.atomic_path(path) as temporary:
        if path.suffix == ".png":
            from lieednn_sim.rendering.still import render_still

            render_still(rollout, temporary, **still_look(look))
        elif path.suffix == ".html":
            from lieednn_sim.rendering.page import render_page

            render_page(rollout, temporary, camera=look.get("camera"), title=task.planner)
        else:
            render_video(rollout, temporary, **look, title=task.planner)
    wrote(path)
