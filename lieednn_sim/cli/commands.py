"""What the commands do: each step of the road reads its run directory and writes into it."""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from lieednn_sim import opengl
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import size, start_and_target
from lieednn_sim.cli.console import console, progress, table, wrote
from lieednn_sim.errors import FileError, RenderingUnavailableError
from lieednn_sim.evaluate import Evaluation
from lieednn_sim.evaluate import evaluate as evaluate_rollout
from lieednn_sim.motion import Motion, check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import Plan, plan
from lieednn_sim.simulate import Rollout
from lieednn_sim.simulate import simulate as simulate_motion
from lieednn_sim.task import RunDirectory, Task

Floats = NDArray[np.float64]

# Targets that differ by less [rad, m] are the same: a trained network may miss its target by its tolerance.
_SAME = 1e-3


def demo(arguments: argparse.Namespace) -> None:
    """The whole road in one command."""
    begun = time.perf_counter()
    if not arguments.no_video:
        _check_video(Arm.load(arguments.arm), arguments)
    run = _synthesize(arguments)
    _simulate(run, arguments)
    _evaluate(run)
    if not arguments.no_video:
        try:
            _render(run, arguments, str(run.video))
        except RenderingUnavailableError as error:
            console.print(f"no video: {error}")
    console.print(f"done in {time.perf_counter() - begun:.1f} s")


def synthesize(arguments: argparse.Namespace) -> None:
    """Target to certified network."""
    _synthesize(arguments)


def train(arguments: argparse.Namespace) -> int:
    """Target to learned network; 1 when it was not learned."""
    from lieednn_sim.cli.training import train

    return train(arguments)


def simulate(arguments: argparse.Namespace) -> None:
    """Network to rollout."""
    _simulate(RunDirectory(arguments.run).existing(), arguments)


def evaluate(arguments: argparse.Namespace) -> None:
    """Rollout to metrics and plots."""
    _evaluate(RunDirectory(arguments.run).existing())


def render(arguments: argparse.Namespace) -> None:
    """Rollout to video."""
    run = RunDirectory(arguments.run).existing()
    _render(run, arguments, arguments.output or str(run.video))


def compare(arguments: argparse.Namespace) -> None:
    """Many planned and simulated motions to one table and one page."""
    from lieednn_sim.cli.comparison import run

    run(arguments, arguments.words)


def doctor(arguments: argparse.Namespace) -> int:
    """Report on the installation; 1 when something is missing."""
    from lieednn_sim.cli.doctor import report

    return report(console, as_json=arguments.json)


def _synthesize(arguments: argparse.Namespace) -> RunDirectory:
    run = RunDirectory(arguments.output)
    arm = Arm.load(arguments.arm)
    start, target = start_and_target(arm, arguments)
    made = not run.path.exists()
    run.create()
    try:
        chosen = _plan(arm, target, start, arguments)
    except BaseException:
        if made:
            run.path.rmdir()
        raise
    run.forget_results()
    Task(arm.name, tuple(start.tolist()), tuple(chosen.target.tolist()), arguments.duration).save(run.task)
    chosen.network.save(run.network)
    conditions = chosen.network.norm_conditions(arm.encode(chosen.target))
    rows = table("network", "quantity", "value")
    rows.add_row("certificate", str(chosen.network.certificate))
    rows.add_row("bias", f"{arguments.bias}, largest entry {np.abs(chosen.network.bias).max():.3g}")
    rows.add_row("candidates", f"{chosen.candidates} networks drawn, {chosen.within_limits} keep the joint limits")
    rows.add_row("mechanism gap", f"{1e3 * chosen.motion.gap_translation.max():.1f} mm on the way, 0 at the target")
    rows.add_row(
        "1-norm of W",
        f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
    )
    console.print(rows)
    wrote(run.task, run.network)
    return run


def _plan(arm: Arm, target: Floats, start: Floats, arguments: argparse.Namespace) -> Plan:
    with progress("synthesize") as report:
        return plan(
            arm,
            target,
            start=start,
            duration=arguments.duration,
            bias=arguments.bias,
            bias_magnitude=arguments.bias_magnitude,
            candidates=arguments.candidates,
            seed=arguments.seed,
            progress=report,
        )


def _simulate(run: RunDirectory, arguments: argparse.Namespace) -> None:
    task, arm = run.load_task()
    network = LieEDNN.load(run.network)
    if network.n_neurons == arm.n_links and np.abs(network.vector_field(arm.encode(task.target))).max() > _SAME:
        raise FileError(f"{run.network} has another equilibrium than the target in {run.task}; synthesize again")
    motion = make_motion(arm, network, task.start, task.duration, arm.model.opt.timestep)
    check_motion(arm, motion)
    with progress("simulate") as report:
        rollout = simulate_motion(
            arm,
            motion,
            controller=arguments.controller,
            hold=arguments.hold,
            mass_scale=arguments.mass_scale,
            dump_directory=run.path,
            progress=report,
        )
    motion.save(run.motion)
    rollout.save(run.rollout)
    wrote(run.motion, run.rollout)


def _evaluate(run: RunDirectory) -> None:
    from lieednn_sim import plots

    task, arm = run.load_task()
    rollout, motion = _load_rollout(run, task), Motion.load(run.motion)
    evaluation = evaluate_rollout(arm, rollout, task.target, motion)
    console.print(_frames_table(evaluation))
    console.print(_joints_table(evaluation))
    evaluation.save_json(run.metrics_json)
    evaluation.save_csv(run.metrics_csv)
    plots.plot_network(motion, run.network_plot)
    plots.plot_tracking(arm, rollout, task.target, run.tracking_plot)
    plots.plot_joints(arm, rollout, run.joints_plot)
    wrote(run.metrics_json, run.metrics_csv, run.network_plot, run.tracking_plot, run.joints_plot)


def _render(run: RunDirectory, arguments: argparse.Namespace, path: str) -> None:
    from lieednn_sim.render.video import render_video

    task, arm = run.load_task()
    backend = opengl.require()
    console.print(f"rendering with {backend.name}: {backend.detail}")
    with progress("render") as report:
        render_video(
            arm,
            _load_rollout(run, task),
            task.target,
            path,
            camera=arguments.camera,
            size=size(arguments.size),
            fps=arguments.fps,
            preset=arguments.preset,
            progress=report,
        )
    wrote(path)


def _load_rollout(run: RunDirectory, task: Task) -> Rollout:
    """The rollout, when it is of this task."""
    rollout = Rollout.load(run.rollout)
    if rollout.q.shape[1] != len(task.target) or np.abs(rollout.q_ref[-1] - task.target).max() > _SAME:
        raise FileError(f"{run.rollout} was simulated for another target than {run.task} says; simulate again")
    return rollout


def _check_video(arm: Arm, arguments: argparse.Namespace) -> None:
    """Refuse bad video options before the work that comes first."""
    from lieednn_sim.render.video import check_rate, check_view

    check_view(arm, camera=arguments.camera, size=size(arguments.size), preset=arguments.preset)
    check_rate(arguments.fps, "video.mp4")


def _frames_table(evaluation: Evaluation) -> Table:
    rows = table(
        f"tracking error, {evaluation.controller}",
        "frame",
        "final mm",
        "deg",
        "RMS mm",
        "deg",
        "max mm",
        "deg",
        "settled s",
    )
    for frame in evaluation.frames:
        values = (
            frame.final_translation_mm,
            frame.final_rotation_deg,
            frame.rms_translation_mm,
            frame.rms_rotation_deg,
            frame.max_translation_mm,
            frame.max_rotation_deg,
        )
        settled = "never" if frame.settling_time is None else f"{frame.settling_time:.2f}"
        rows.add_row(frame.name, *(f"{value:.4f}" for value in values), settled)
    gap = evaluation.max_gap_translation_mm
    rows.caption = (
        f"the end effector moves {evaluation.displacement:.2f} m (path {evaluation.travel:.2f} m) in "
        f"{evaluation.motion_end:g} s, then holds; contacts: {evaluation.contacts}; "
        + (f"mechanism gap of the plan: {gap:.1f} mm" if gap is not None else "")
    )
    return rows


def _joints_table(evaluation: Evaluation) -> Table:
    rows = table("joints", "joint", "peak velocity", "of limit", "peak force", "of limit", "constraints")
    for joint in evaluation.joints:
        rows.add_row(
            joint.name,
            f"{joint.peak_velocity:.3f}",
            f"{joint.peak_velocity / joint.velocity_limit:.0%}",
            f"{joint.peak_force:.1f}",
            f"{joint.peak_force / joint.force_limit:.0%}",
            f"{joint.peak_constraint_force:.1f}",
        )
    return rows
