"""What the commands do: each step of the road reads its run directory and writes into it."""

from __future__ import annotations

import argparse
import time

import numpy as np

from lieednn_sim import opengl
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import disturbances, load_arm, size
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.errors import FileError, InputError, RenderingUnavailableError
from lieednn_sim.evaluate import evaluate as evaluate_rollout
from lieednn_sim.motion import LIMIT_TOLERANCE, Motion, check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.simulate import Rollout
from lieednn_sim.simulate import simulate as simulate_motion
from lieednn_sim.task import RunDirectory, Task

# Targets that differ by less [rad, m] are the same: a trained network may miss its target by its tolerance.
_SAME = 1e-3


def demo(arguments: argparse.Namespace) -> None:
    """The whole road in one command."""
    from lieednn_sim.cli.planning import synthesize

    begun = time.perf_counter()
    # Bad options stop before the work that comes first.
    arm = load_arm(arguments)
    disturbances(arm, arguments)
    if not arguments.no_video:
        _check_video(arm, arguments)
    run = synthesize(arguments)
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
    from lieednn_sim.cli.planning import synthesize

    synthesize(arguments)


def train(arguments: argparse.Namespace) -> int:
    """Target to learned network; 1 when it was not learned."""
    from lieednn_sim.cli.training import train

    return train(arguments)


def simulate(arguments: argparse.Namespace) -> None:
    """Network, or a planner's motion, to rollout."""
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


def arms(arguments: argparse.Namespace) -> None:
    """What arms there are."""
    from lieednn_sim.cli.arms import arms

    arms(arguments)


def doctor(arguments: argparse.Namespace) -> int:
    """Report on the installation; 1 when something is missing."""
    from lieednn_sim.cli.doctor import report

    return report(console, as_json=arguments.json)


def _simulate(run: RunDirectory, arguments: argparse.Namespace) -> None:
    task, arm = run.load_task()
    changes = disturbances(arm, arguments)
    drawn = task.planner is None
    motion = _network_motion(run, task, arm) if drawn else _planned_motion(run, task, arm)
    check_motion(arm, motion)
    end = motion.t[-1] + arguments.hold
    for push in changes.pushes:
        if push.start > end:
            raise InputError(f"the push on {push.body!r} at {push.start:g} s comes after the run's end at {end:g} s")
    with progress("simulate") as report:
        rollout = simulate_motion(
            arm,
            motion,
            controller=arguments.controller,
            hold=arguments.hold,
            reference_rate=arguments.reference_rate,
            disturbances=changes,
            dump_directory=run.path,
            progress=report,
        )
    if drawn:
        motion.save(run.motion)
    rollout.save(run.rollout)
    wrote(*([run.motion] if drawn else []), run.rollout)


def _network_motion(run: RunDirectory, task: Task, arm: Arm) -> Motion:
    """What the run's network draws by itself."""
    network = LieEDNN.load(run.network)
    if network.n_neurons == arm.n_links and np.abs(network.vector_field(arm.encode(task.target))).max() > _SAME:
        raise FileError(f"{run.network} has another equilibrium than the target in {run.task}; synthesize again")
    return make_motion(arm, network, task.start, task.duration, arm.model.opt.timestep)


def _planned_motion(run: RunDirectory, task: Task, arm: Arm) -> Motion:
    """What the task's planner made, when it leads where the task says."""
    motion = Motion.load(run.motion)
    ends = ((motion.q[0], task.start), (motion.q[-1], task.target))
    if motion.q.shape[1] != arm.n_joints or any(np.abs(q - wanted).max() > LIMIT_TOLERANCE for q, wanted in ends):
        raise FileError(f"{run.motion} was planned for another start or target than {run.task} says; synthesize again")
    return motion


def _evaluate(run: RunDirectory) -> None:
    from lieednn_sim import plots
    from lieednn_sim.cli.tables import print_evaluation

    task, arm = run.load_task()
    rollout, motion = _load_rollout(run, task), Motion.load(run.motion)
    evaluation = evaluate_rollout(arm, rollout, task.target, motion)
    print_evaluation(evaluation, rollout, None if arm.scene == "free" else _clearance(arm, rollout))
    evaluation.save_json(run.metrics_json)
    evaluation.save_csv(run.metrics_csv)
    plots.plot_network(motion, run.network_plot)
    plots.plot_tracking(arm, rollout, task.target, run.tracking_plot)
    plots.plot_joints(arm, rollout, run.joints_plot)
    wrote(run.metrics_json, run.metrics_csv, run.network_plot, run.tracking_plot, run.joints_plot)


def _clearance(arm: Arm, rollout: Rollout) -> float:
    from lieednn_sim.arm.collision import Collisions
    from lieednn_sim.compare.metrics import least_clearance

    return least_clearance(rollout, Collisions(arm))


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
