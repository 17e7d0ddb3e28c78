"""What the commands do: each step of the road reads its run directory and writes into it."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from lieednn_sim import opengl
from lieednn_sim.arm import Arm, reach
from lieednn_sim.errors import FileError, InputError, RenderingUnavailableError
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


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # `main` knows what to do; rich would exit with 1


_console = _Console(highlight=False, soft_wrap=True)


def demo(arguments: argparse.Namespace) -> None:
    """The whole road in one command."""
    begun = time.perf_counter()
    if not arguments.no_video:
        _check_video(Arm.load(arguments.arm), arguments)
    run = _synthesize(arguments)
    _simulate(run, arguments.hold)
    _evaluate(run)
    if not arguments.no_video:
        try:
            _render(run, arguments, str(run.video))
        except RenderingUnavailableError as error:
            _console.print(f"no video: {error}")
    _console.print(f"done in {time.perf_counter() - begun:.1f} s")


def synthesize(arguments: argparse.Namespace) -> None:
    """Target to certified network."""
    _synthesize(arguments)


def simulate(arguments: argparse.Namespace) -> None:
    """Network to rollout."""
    _simulate(RunDirectory(arguments.run).existing(), arguments.hold)


def evaluate(arguments: argparse.Namespace) -> None:
    """Rollout to metrics and plots."""
    _evaluate(RunDirectory(arguments.run).existing())


def render(arguments: argparse.Namespace) -> None:
    """Rollout to video."""
    run = RunDirectory(arguments.run).existing()
    _render(run, arguments, arguments.output or str(run.video))


def doctor(arguments: argparse.Namespace) -> int:
    """Report on the installation; 1 when something is missing."""
    from lieednn_sim.cli.doctor import report

    return report(_console, as_json=arguments.json)


def _synthesize(arguments: argparse.Namespace) -> RunDirectory:
    run = RunDirectory(arguments.output)
    arm = Arm.load(arguments.arm)
    start = arm.check_position(_joint_position(arm, arguments.start, "start"), "start")
    if arguments.position is not None:
        target = reach(arm, _numbers(arguments.position, "position", 3), start=start)
    else:
        target = _joint_position(arm, arguments.target, "target")
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
    table = _table("network", "quantity", "value")
    table.add_row("certificate", str(chosen.network.certificate))
    table.add_row("bias", f"{arguments.bias}, largest entry {np.abs(chosen.network.bias).max():.3g}")
    table.add_row("candidates", f"{chosen.candidates} networks drawn, {chosen.within_limits} keep the joint limits")
    table.add_row("mechanism gap", f"{1e3 * chosen.motion.gap_translation.max():.1f} mm on the way, 0 at the target")
    table.add_row(
        "1-norm of W",
        f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
    )
    _console.print(table)
    _wrote(run.task, run.network)
    return run


def _plan(arm: Arm, target: Floats, start: Floats, arguments: argparse.Namespace) -> Plan:
    with _progress("synthesize") as progress:
        return plan(
            arm,
            target,
            start=start,
            duration=arguments.duration,
            bias=arguments.bias,
            bias_magnitude=arguments.bias_magnitude,
            candidates=arguments.candidates,
            seed=arguments.seed,
            progress=progress,
        )


def _simulate(run: RunDirectory, hold: float) -> None:
    task, arm = _load_task(run)
    network = LieEDNN.load(run.network)
    if network.n_neurons == arm.n_links and np.abs(network.vector_field(arm.encode(task.target))).max() > _SAME:
        raise FileError(f"{run.network} has another equilibrium than the target in {run.task}; synthesize again")
    motion = make_motion(arm, network, task.start, task.duration, arm.model.opt.timestep)
    check_motion(arm, motion)
    with _progress("simulate") as progress:
        rollout = simulate_motion(arm, motion, hold=hold, dump_directory=run.path, progress=progress)
    motion.save(run.motion)
    rollout.save(run.rollout)
    _wrote(run.motion, run.rollout)


def _evaluate(run: RunDirectory) -> None:
    from lieednn_sim import plots

    task, arm = _load_task(run)
    rollout, motion = _load_rollout(run, task), Motion.load(run.motion)
    evaluation = evaluate_rollout(arm, rollout, task.target, motion)
    _console.print(_frames_table(evaluation))
    _console.print(_joints_table(evaluation))
    evaluation.save_json(run.metrics_json)
    evaluation.save_csv(run.metrics_csv)
    plots.plot_network(motion, run.network_plot)
    plots.plot_tracking(arm, rollout, task.target, run.tracking_plot)
    plots.plot_joints(arm, rollout, run.joints_plot)
    _wrote(run.metrics_json, run.metrics_csv, run.network_plot, run.tracking_plot, run.joints_plot)


def _render(run: RunDirectory, arguments: argparse.Namespace, path: str) -> None:
    from lieednn_sim.render.video import render_video

    task, arm = _load_task(run)
    backend = opengl.require()
    _console.print(f"rendering with {backend.name}: {backend.detail}")
    with _progress("render") as progress:
        render_video(
            arm,
            _load_rollout(run, task),
            task.target,
            path,
            camera=arguments.camera,
            size=_size(arguments.size),
            fps=arguments.fps,
            preset=arguments.preset,
            progress=progress,
        )
    _wrote(path)


def _load_task(run: RunDirectory) -> tuple[Task, Arm]:
    """The task and its arm, with start and target checked against the arm's limits."""
    task = Task.load(run.task)
    arm = Arm.load(task.arm)
    try:
        arm.check_position(task.start, "start")
        arm.check_position(task.target, "target")
    except InputError as error:
        raise FileError(f"{run.task} does not fit arm {arm.name!r}: {error}") from None
    return task, arm


def _load_rollout(run: RunDirectory, task: Task) -> Rollout:
    """The rollout, when it is of this task."""
    rollout = Rollout.load(run.rollout)
    if rollout.q.shape[1] != len(task.target) or np.abs(rollout.q_ref[-1] - task.target).max() > _SAME:
        raise FileError(f"{run.rollout} was simulated for another target than {run.task} says; simulate again")
    return rollout


def _check_video(arm: Arm, arguments: argparse.Namespace) -> None:
    """Refuse bad video options before the work that comes first."""
    from lieednn_sim.render.video import check_rate, check_view

    check_view(arm, camera=arguments.camera, size=_size(arguments.size), preset=arguments.preset)
    check_rate(arguments.fps, "video.mp4")


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise InputError(f"size must look like 1280x720, got {text!r}")
    return int(width), int(height)


def _joint_position(arm: Arm, text: str, what: str) -> Floats:
    if text and (text[0].isalpha() or text[0] == "_"):
        return arm.keyframe(text)
    return _numbers(text, what, arm.n_joints)


def _numbers(text: str, what: str, count: int) -> Floats:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {text!r}") from None
    if len(values) != count:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {len(values)}: {text!r}")
    return np.array(values)


def _frames_table(evaluation: Evaluation) -> Table:
    table = _table("tracking error", "frame", "final mm", "deg", "RMS mm", "deg", "max mm", "deg", "settled s")
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
        table.add_row(frame.name, *(f"{value:.4f}" for value in values), settled)
    gap = evaluation.max_gap_translation_mm
    table.caption = (
        f"the end effector moves {evaluation.displacement:.2f} m (path {evaluation.travel:.2f} m) in "
        f"{evaluation.motion_end:g} s, then holds; contacts: {evaluation.contacts}; "
        + (f"mechanism gap of the plan: {gap:.1f} mm" if gap is not None else "")
    )
    return table


def _joints_table(evaluation: Evaluation) -> Table:
    table = _table("joints", "joint", "peak velocity", "of limit", "peak force", "of limit")
    for joint in evaluation.joints:
        table.add_row(
            joint.name,
            f"{joint.peak_velocity:.3f}",
            f"{joint.peak_velocity / joint.velocity_limit:.0%}",
            f"{joint.peak_force:.1f}",
            f"{joint.peak_force / joint.force_limit:.0%}",
        )
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", no_wrap=index == 0)
    return table


@contextlib.contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        shown = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(shown, completed=done, total=total)


def _wrote(*paths: object) -> None:
    for path in paths:
        _console.print(f"wrote {path}")
