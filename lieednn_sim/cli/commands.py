"""The commands of the pipeline, each of which reads a run directory and writes into it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import disturbances, load_arm, size
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError, LieEDNNError, RenderingUnavailableError, SimulationError
from lieednn_sim.evaluation.metrics import evaluate as evaluate_rollout
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.rendering import opengl
from lieednn_sim.simulation import simulate as simulate_motion
from lieednn_sim.validation import as_path


def demo(arguments: argparse.Namespace) -> None:
    """Run the whole pipeline: plan, simulate, evaluate and render."""
    from lieednn_sim.cli.planning import make_plan

    begun = time.perf_counter()
    # Check options before any work.
    arm = load_arm(arguments)
    disturbances(arm, arguments)
    if not arguments.no_video:
        _check_video(arm, arguments)
    run = RunDirectory(arguments.output, arguments.plots)
    with run.at_work():
        make_plan(run, arguments)
        _simulate(run, arguments)
        _evaluate(run)
        if not arguments.no_page:
            try:
                _render(run, arguments, run.page)
            except LieEDNNError as error:
                console.print(f"no page: {error}")
        if not arguments.no_video:
            try:
                _render(run, arguments, run.video)
            except RenderingUnavailableError as error:
                console.print(f"no video: {error}")
    console.print(f"done in {time.perf_counter() - begun:.1f} s")


def plan(arguments: argparse.Namespace) -> None:
    """Plan a motion to the target, and write it, or the network that generates it."""
    from lieednn_sim.cli.planning import make_plan

    run = RunDirectory(arguments.output)
    with run.at_work():
        make_plan(run, arguments)


def synthesize(arguments: argparse.Namespace) -> None:
    """As `plan`, but only with planners that make a network."""
    plan(arguments)


def simulate(arguments: argparse.Namespace) -> None:
    """Simulate the run's motion, and write the rollout."""
    run = RunDirectory(arguments.run).existing()
    with run.at_work():
        _simulate(run, arguments)


def evaluate(arguments: argparse.Namespace) -> None:
    """Evaluate the rollout, and write metrics and plots."""
    run = RunDirectory(arguments.run, arguments.plots).existing()
    with run.at_work(shared=True):
        _evaluate(run)


def render(arguments: argparse.Namespace) -> None:
    """Render the rollout, and write a video, a page or a picture."""
    run = RunDirectory(arguments.run).existing()
    given = [as_path("the name of an output", name) for name in (arguments.still, arguments.output) if name is not None]
    paths = given or [run.video]
    io.check_outputs(paths)
    with run.at_work(shared=True):
        for path in paths:
            _render(run, arguments, path, still=arguments.still is not None and path == given[0])


def _simulate(run: RunDirectory, arguments: argparse.Namespace) -> None:
    task, arm = run.load_task()
    changes = disturbances(arm, arguments)
    with progress("check"):
        motion = run.load_motion(task)
        check_motion(arm, motion)
    end = motion.t[-1] + arguments.hold
    for push in changes.pushes:
        # No step begins at the end; times are rounded to the nearest step.
        if push.start >= end - 0.5 * arm.timestep:
            raise InputError(
                f"the push on {push.body!r} at {push.start:g} s would begin when the run is over, at {end:g} s"
            )
    try:
        with progress("simulate") as report:
            rollout = simulate_motion(
                arm,
                motion,
                target=task.target,
                controller=arguments.controller,
                hold=arguments.hold,
                reference_rate=arguments.reference_rate,
                disturbances=changes,
                progress=report,
            )
    except SimulationError as error:
        if error.rollout is None:
            raise
        error.rollout.save(run.divergence)
        raise SimulationError(f"{error}; the run up to there is in {run.divergence} (Rollout.load reads it)") from None
    run.save_rollout(rollout)
    wrote(run.rollout)


def _evaluate(run: RunDirectory) -> None:
    from lieednn_sim.evaluation import plots

    task, arm = run.load_task()
    rollout = run.load_rollout(task, arm)
    evaluation = evaluate_rollout(rollout)
    console.print(evaluation)
    network = run.load_network() if run.network.exists() else None
    *outputs, channels_plot = run.evaluated
    if rollout.channels:
        outputs.append(channels_plot)
    with io.atomic_paths(outputs) as (
        metrics_json,
        metrics_csv,
        network_plot,
        tracking_plot,
        joints_plot,
        *more,
    ):
        evaluation.save_json(metrics_json)
        evaluation.save_csv(metrics_csv)
        plots.plot_network(rollout, network_plot, network=network)
        plots.plot_tracking(rollout, tracking_plot)
        plots.plot_joints(rollout, joints_plot)
        for path in more:
            plots.plot_channels(rollout, path)
    wrote(*outputs)


def _render(run: RunDirectory, arguments: argparse.Namespace, path: Path, *, still: bool = False) -> None:
    """Write a picture, or what the suffix of the path says: a page or a video."""
    task, arm = run.load_task()
    rollout = run.load_rollout(task, arm)
    page = not still and path.suffix == ".html"
    if not page:
        backend = opengl.require()
        console.print(f"rendering with {backend.name}: {backend.detail}")
    view = {"size": size(arguments.size), "preset": arguments.preset}
    with progress("render") as report, io.atomic_path(path) as temporary:
        if still:
            from lieednn_sim.rendering.still import render_still

            render_still(rollout, temporary, camera=arguments.camera, **view)
        elif page:
            from lieednn_sim.rendering.page import render_page

            render_page(rollout, temporary, camera=arguments.camera, title=task.planner, progress=report)
        else:
            from lieednn_sim.rendering.video import render_video

            given = {"camera": arguments.camera, "fps": arguments.fps, "title": task.planner, "progress": report}
            render_video(rollout, temporary, **view, **given)
    wrote(path)


def _check_video(arm: Arm, arguments: argparse.Namespace) -> None:
    """Check the video options before any work."""
    from lieednn_sim.rendering.video import check_rate, check_view

    check_view(arm, camera=arguments.camera, size=size(arguments.size), preset=arguments.preset)
    check_rate(arguments.fps, "video.mp4")
