"""The command ``train``: target to learned network, resumable."""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import plots
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import start_and_target
from lieednn_sim.cli.console import console, progress, table, wrote
from lieednn_sim.errors import FileError, InputError, NotCertifiedError, PlanError
from lieednn_sim.learning import ALGORITHMS, TrainingOptions, TrainingResult, resume
from lieednn_sim.learning import train as learn
from lieednn_sim.motion import check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import bias_for
from lieednn_sim.task import RunDirectory, Task
from lieednn_sim.validation import as_choice, as_positive

Floats = NDArray[np.float64]


def train(arguments: argparse.Namespace) -> int:
    """Learn a network for a target into a run directory; 1 when it was not learned."""
    if arguments.resume is not None:
        run = RunDirectory(arguments.resume).existing()
        task, arm = run.load_task()
        if not run.checkpoint.is_file():
            raise FileError(f"{run.path} holds no interrupted training (no {run.checkpoint.name})")
        begin = None
    else:
        run = RunDirectory(arguments.output)
        arm = Arm.load(arguments.arm)
        start, target = start_and_target(arm, arguments)
        arm.check_position(target, "target")
        as_positive("duration", arguments.duration)
        options, bias = _options(arguments), _bias(arm.encode(target), arguments)
        task = Task(arm.name, tuple(start.tolist()), tuple(target.tolist()), arguments.duration)
        run.create()
        run.forget_results()
        run.network.unlink(missing_ok=True)
        task.save(run.task)
        begin = (options, bias)
    xi = arm.encode(task.target)
    try:
        with progress("train") as report:
            if begin is None:
                result = resume(run.checkpoint, progress=report)
            else:
                result = learn(
                    xi, begin[0], bias=begin[1], seed=arguments.seed, checkpoint=run.checkpoint, progress=report
                )
    except KeyboardInterrupt:
        console.print(f"interrupted; go on with: lieednn-sim train --resume {run.path}")
        raise
    result.history.save(run.history)
    plots.plot_training(result.history, xi, result.tolerance, run.training_plot)
    if result.success and isinstance(result.network, LieEDNN):
        _with_proof(result.network).save(run.network)
    run.checkpoint.unlink(missing_ok=True)
    _report(result, arm, task)
    wrote(run.task, *([run.network] if result.success else []), run.history, run.training_plot)
    if not result.success:
        console.print("no network was written; try another --seed, more --epochs, or --algorithm tracked")
    return 0 if result.success else 1


def _options(arguments: argparse.Namespace) -> TrainingOptions:
    named = ALGORITHMS[as_choice("algorithm", arguments.algorithm, ALGORITHMS)]
    changes = {"period": arguments.period, "max_epochs": arguments.epochs, "tolerance": arguments.tolerance}
    return named(**{name: value for name, value in changes.items() if value is not None})


def _bias(xi: Floats, arguments: argparse.Namespace) -> Floats:
    if arguments.bias == "solved":
        raise InputError("the solved bias needs no learning; use 'lieednn-sim synthesize --bias solved'")
    magnitude = as_positive("bias magnitude", arguments.bias_magnitude)
    return bias_for(arguments.bias, xi, np.tanh(xi), 1.0, magnitude)


def _with_proof(network: LieEDNN) -> LieEDNN:
    """The network with a certificate, if there is one; learning does not ask for it."""
    try:
        return network.certify()
    except NotCertifiedError:
        return network


def _report(result: TrainingResult, arm: Arm, task: Task) -> None:
    rows = table("training", "quantity", "value")
    rows.add_row("outcome", result.message)
    rows.add_row("time", f"{result.seconds:.2f} s, {1e6 * result.seconds / max(result.epochs, 1):.0f} us an epoch")
    if isinstance(result.network, LieEDNN):
        conditions = result.network.norm_conditions(arm.encode(task.target))
        rows.add_row(
            "1-norm of W",
            f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
        )
        rows.add_row("largest |t|", f"{np.linalg.norm(result.network.translation, axis=-1).max():.2f}")
    console.print(rows)
    if result.success and isinstance(result.network, LieEDNN):
        console.print(f"stability: {result.network.assess(arm.encode(task.target))}")
        try:
            check_motion(arm, make_motion(arm, result.network, task.start, task.duration, arm.model.opt.timestep))
        except PlanError as error:
            console.print(f"the network is learned, but its motion will be refused: {error}")
