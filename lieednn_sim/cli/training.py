"""The command ``train``: target to learned network, resumable."""

from __future__ import annotations

import argparse
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import plots
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import start_and_target
from lieednn_sim.cli.console import console, progress, table, wrote
from lieednn_sim.errors import FileError, InputError, NotCertifiedError, PlanError
from lieednn_sim.learning import (
    ALGORITHMS,
    RiemannianOptions,
    TrainingOptions,
    TrainingResult,
    resume,
    train_riemannian,
)
from lieednn_sim.learning import train as learn
from lieednn_sim.learning.checkpoint import load as load_checkpoint
from lieednn_sim.motion import check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import bias_for
from lieednn_sim.task import RunDirectory, Task
from lieednn_sim.validation import as_choice, as_count, as_positive

Floats = NDArray[np.float64]


# Learning on the manifold, and whether with a certificate; it keeps no checkpoint, for it takes seconds.
RIEMANNIAN = {"riemannian": False, "stability-aware": True}

Learner = Callable[[int], TrainingResult]


def train(arguments: argparse.Namespace) -> int:
    """Learn a network for a target into a run directory; 1 when none was learned."""
    candidates = as_count("candidates", arguments.candidates)
    run = RunDirectory(arguments.resume or arguments.output)
    if arguments.resume is not None:
        task, arm = run.existing().load_task()
        learners = _resumed(run)
    else:
        arm = Arm.load(arguments.arm)
        start, target = start_and_target(arm, arguments)
        arm.check_position(target, "target")
        learner = _learner(arguments, arm.encode(target), run)
        duration = as_positive("duration", arguments.duration)
        task = Task(arm.name, tuple(start.tolist()), tuple(target.tolist()), duration)
        run.create()
        run.forget_results()
        run.network.unlink(missing_ok=True)
        task.save(run.task)
        learners = (functools.partial(learner, arguments.seed + k) for k in itertools.count())
    try:
        result, refusal = _choose(itertools.islice(learners, candidates), arm, task)
    except KeyboardInterrupt:
        if run.checkpoint.is_file():
            console.print(f"interrupted; go on with: lieednn-sim train --resume {run.path}")
        raise
    result.history.save(run.history)
    plots.plot_training(result.history, arm.encode(task.target), result.tolerance, run.training_plot)
    network = _with_proof(result.network) if result.success and isinstance(result.network, LieEDNN) else None
    if network is not None:
        network.save(run.network)
    run.checkpoint.unlink(missing_ok=True)
    _report(result, network, arm.encode(task.target))
    wrote(run.task, *([run.network] if network else []), run.history, run.training_plot)
    if network is None:
        console.print("no network was written; try another --seed, more --epochs, or --algorithm stability-aware")
        return 1
    if refusal is not None:
        console.print(f"the network is learned, but its motion will be refused: {refusal}")
    return 0


def _choose(
    learners: Iterable[Callable[[], TrainingResult]], arm: Arm, task: Task
) -> tuple[TrainingResult, str | None]:
    """The first network whose motion keeps the limits, else the first one learned, else the last failure."""
    chosen: tuple[TrainingResult, str | None] | None = None
    for learner in learners:
        result = learner()
        refusal = _refusal(result, arm, task)
        if chosen is None or not chosen[0].success:
            chosen = result, refusal
        if result.success and refusal is None:
            return result, None
    assert chosen is not None
    return chosen


def _refusal(result: TrainingResult, arm: Arm, task: Task) -> str | None:
    """Why the arm cannot use the network's motion; None where it can, or where there is no network."""
    if not result.success or not isinstance(result.network, LieEDNN):
        return None
    try:
        check_motion(arm, make_motion(arm, result.network, task.start, task.duration, arm.model.opt.timestep))
    except PlanError as error:
        return str(error)
    return None


def _learner(arguments: argparse.Namespace, xi: Floats, run: RunDirectory) -> Learner:
    """What learns a network from a seed."""
    name = as_choice("algorithm", arguments.algorithm, [*ALGORITHMS, *RIEMANNIAN])
    bias = _bias(xi, arguments)
    if name in RIEMANNIAN:
        if arguments.period is not None or arguments.epochs is not None:
            raise InputError(f"--period and --epochs are for the algorithms {', '.join(ALGORITHMS)}, not for {name}")
        riemannian = RiemannianOptions(certified=RIEMANNIAN[name], tolerance=arguments.tolerance)

        def learn_on_manifold(seed: int) -> TrainingResult:
            with progress("train") as report:
                return train_riemannian(xi, riemannian, bias=bias, seed=seed, progress=report)

        return learn_on_manifold
    changes = {"period": arguments.period, "max_epochs": arguments.epochs, "tolerance": arguments.tolerance}
    options = ALGORITHMS[name](**{key: value for key, value in changes.items() if value is not None})
    return functools.partial(_learn, xi, options, bias, run)


def _learn(xi: Floats, options: TrainingOptions, bias: Floats, run: RunDirectory, seed: int) -> TrainingResult:
    with progress("train") as report:
        return learn(xi, options, bias=bias, seed=seed, checkpoint=run.checkpoint, progress=report)


def _resumed(run: RunDirectory) -> Iterator[Callable[[], TrainingResult]]:
    """The interrupted candidate first, then those after it."""
    if not run.checkpoint.is_file():
        raise FileError(f"{run.path} holds no interrupted training (no {run.checkpoint.name})")
    problem, options, *_ = load_checkpoint(run.checkpoint)

    def go_on() -> TrainingResult:
        with progress("train") as report:
            return resume(run.checkpoint, progress=report)

    others = (problem.seed + k for k in itertools.count(1))
    return itertools.chain(
        [go_on], (functools.partial(_learn, problem.target, options, problem.bias, run, seed) for seed in others)
    )


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


def _report(result: TrainingResult, network: LieEDNN | None, xi: Floats) -> None:
    rows = table("training", "quantity", "value")
    rows.add_row("outcome", result.message)
    rows.add_row("time", f"{result.seconds:.2f} s, {1e6 * result.seconds / max(result.epochs, 1):.0f} us an epoch")
    if network is not None:
        conditions = network.norm_conditions(xi)
        rows.add_row(
            "1-norm of W",
            f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
        )
        rows.add_row("largest |t|", f"{np.linalg.norm(network.translation, axis=-1).max():.2f}")
    console.print(rows)
    if network is not None:
        console.print(f"stability: {network.assess(xi)}")
