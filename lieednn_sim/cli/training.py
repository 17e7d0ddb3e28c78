"""The command ``train``, which learns a network for a target and can be resumed."""

from __future__ import annotations

import argparse
import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import filesystem
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import load_arm, make_task, start_and_target
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, one_norm, print_stability, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import TRAINED, Task
from lieednn_sim.errors import FileError, InputError, PlanError
from lieednn_sim.evaluation import plot_training
from lieednn_sim.evaluation.display import table
from lieednn_sim.learning import (
    ALGORITHMS,
    RiemannianOptions,
    TrainingResult,
    train_riemannian,
)
from lieednn_sim.learning import train as projected_train
from lieednn_sim.learning.checkpoint import KIND as CHECKPOINT_KIND
from lieednn_sim.learning.checkpoint import seed_of
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.planning.network_path import make_motion
from lieednn_sim.synthesis import bias_for
from lieednn_sim.validation import as_count, as_positive
from lieednn_sim.values import Floats

# Options stored in the task.
_OPTIONS = ("algorithm", "period", "epochs", "tolerance", "bias", "bias_magnitude", "candidates")

Learner = Callable[..., TrainingResult]
Candidates = Sequence[Callable[[], TrainingResult]]


def train(arguments: argparse.Namespace) -> int:
    """Learn a network for a target in a run directory; returns 1 when none was learned."""
    if arguments.resume is not None:
        _require_no_others(arguments.words)
    run = RunDirectory(arguments.output if arguments.resume is None else arguments.resume, arguments.plots)
    if arguments.resume is None:
        with run.made():
            return _train(run, *_begin(run, arguments))
    if not filesystem.is_file(run.pending.checkpoint):
        raise FileError(f"{run.path} holds no interrupted training (no {run.pending.checkpoint})")
    with run.at_work(), run.pending.at_work():
        task, arm = run.pending.load_task()
        return _train(run, task, arm, _resumed(run.pending, task, arm.encode(task.target)))


def _require_no_others(words: Sequence[str]) -> None:
    """Refuse options beside ``--resume``, which would change nothing."""
    given = [word.partition("=")[0] for word in words if word.startswith("--")]
    # Options may be abbreviated.
    others = [name for name in given if not any(known.startswith(name) for known in ("--resume", "--plots"))]
    if others:
        raise InputError(f"--resume continues a training with its own options; leave out {', '.join(others)}")


def _begin(run: RunDirectory, arguments: argparse.Namespace) -> tuple[Task, Arm, Candidates]:
    """The task, its arm, and learners of a network for it from consecutive seeds."""
    arm = load_arm(arguments)
    start, target = start_and_target(arm, arguments)
    arm.check_position(target, "target")
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    candidates = as_count("candidates", options["candidates"])
    task = make_task(arm, start, target, arguments, planner=TRAINED, reason="asked for", options=options)
    learner = _learner(options, arm.encode(target), run.pending.checkpoint)
    pending = run.pending
    if pending.path.exists():
        pending.manifest.check(pending.files)
        # An interrupted training that is not resumed.
        pending.remove()
    filesystem.check_outputs([pending.path])
    with filesystem.created(pending.path):
        pending.manifest.expect(pending.checkpoint, CHECKPOINT_KIND)
        with pending.manifest.writing(pending.task) as temporary:
            task.save(temporary)
    print_import_report(arm)
    return task, arm, [functools.partial(learner, task.seed + k) for k in range(candidates)]


def _train(run: RunDirectory, task: Task, arm: Arm, learners: Candidates) -> int:
    """Learn from one seed after the other."""
    pending = run.pending
    try:
        result, refusal = _choose(learners, run, arm, task)
    except BaseException:
        # Whatever ended it, a full disk or the user, what was learned is kept.
        if pending.checkpoint.is_file():
            console.print(f"what was learned so far is kept; continue with: lieednn-sim train --resume {run.path}")
        else:
            with contextlib.suppress(FileError):
                pending.remove()
        raise
    if result.success:
        pending.remove()
    else:
        # The run's previous files stay as they are.
        outputs = [pending.history, pending.training_plot]
        with pending.manifest.replacing(outputs, [pending.checkpoint]) as (history, training_plot):
            result.history.save(history, {"task": task.fingerprint})
            plot_training.plot_training(result.history, arm.encode(task.target), result.tolerance, training_plot)
    _report(result, arm.encode(task.target))
    if not result.success:
        wrote(pending.history, pending.training_plot)
        console.print("no network was written; try another --seed, more --epochs, or --algorithm stability-aware")
        return 1
    wrote(run.task, run.network, run.history, run.training_plot)
    if refusal is not None:
        console.print(f"the network is learned, but its motion will be rejected: {refusal}")
    return 0


def _choose(learners: Candidates, run: RunDirectory, arm: Arm, task: Task) -> tuple[TrainingResult, str | None]:
    """The first network whose motion keeps the limits, else the first one learned, else the last failure.

    A network is saved as soon as it is the best so far. The second value is why its motion would be rejected, or None.
    """
    xi = arm.encode(task.target)
    best: tuple[TrainingResult, str | None] | None = None
    for learner in learners:
        result = learner()
        if result.success and isinstance(result.network, LieEDNN):
            # Learning does not need a proof; the network is saved and reported with one where it is found.
            result = replace(result, network=result.network.try_certify())
        refusal = _refusal(result, arm, task)
        if best is None or not best[0].success or (result.success and refusal is None):
            best = result, refusal
            if result.success and isinstance(result.network, LieEDNN):
                run.save_network(task, result.network, history=result.history)
                with run.manifest.writing(run.training_plot) as temporary:
                    plot_training.plot_training(result.history, xi, result.tolerance, temporary)
        if result.success and refusal is None:
            break
    if best is None:
        raise InputError("there is no candidate to learn")
    return best


def _refusal(result: TrainingResult, arm: Arm, task: Task) -> str | None:
    """Why the arm cannot use the network's motion; None if it can, or without a network."""
    if not result.success or not isinstance(result.network, LieEDNN):
        return None
    try:
        check_motion(arm, make_motion(arm, result.network, task.start, task.duration, arm.timestep))
    except PlanError as error:
        return str(error)
    return None


def _learner(options: Mapping[str, Any], xi: Floats, checkpoint: Path) -> Learner:
    """A function that learns a network from a seed, with a progress bar."""
    asked = argparse.Namespace(**options)
    make = ALGORITHMS.find(asked.algorithm).load()
    changes = {"period": asked.period, "max_epochs": asked.epochs, "tolerance": asked.tolerance}
    given = {key: value for key, value in changes.items() if value is not None}
    learn: Callable[..., TrainingResult]
    if not isinstance(make(), RiemannianOptions):
        learn = functools.partial(projected_train, xi, make(**given), checkpoint=checkpoint)
    elif len(given) > 1:
        raise InputError(f"--period and --epochs are for the algorithms of the paper, not for {asked.algorithm}")
    else:
        learn = functools.partial(train_riemannian, xi, make(**given))
    bias = _bias(xi, asked)

    def learner(seed: int, **resume: bool) -> TrainingResult:
        with progress("train") as report:
            return learn(bias=bias, seed=seed, progress=report, **resume)

    return learner


def _resumed(pending: RunDirectory, task: Task, xi: Floats) -> Candidates:
    """The interrupted candidate first, then those after it; those before it were learned, and rejected or worse."""
    seed = seed_of(pending.checkpoint)
    try:
        learner = _learner(task.options, xi, pending.checkpoint)
        later = range(seed + 1, task.seed + task.options["candidates"])
    except (AttributeError, KeyError, TypeError, InputError) as error:
        raise FileError(f"{pending.task} does not say how the training was begun ({error}); train again") from None
    return [functools.partial(learner, seed, resume=True), *(functools.partial(learner, one) for one in later)]


def _bias(xi: Floats, arguments: argparse.Namespace) -> Floats:
    if arguments.bias == "solved":
        raise InputError("the solved bias needs no learning; use 'lieednn-sim synthesize --bias solved'")
    magnitude = as_positive("bias magnitude", arguments.bias_magnitude)
    return bias_for(arguments.bias, xi, ACTIVATIONS[DEFAULT_ACTIVATION].phi(xi), 1.0, magnitude)


def _report(result: TrainingResult, xi: Floats) -> None:
    network = result.network if result.success and isinstance(result.network, LieEDNN) else None
    rows = table("training", "quantity", "value")
    rows.add_row("outcome", result.message)
    each = 1e6 * result.cpu_time / max(result.epochs, 1)
    rows.add_row("CPU time", f"{result.cpu_time:.2f} s, {each:.0f} us an epoch")
    if network is not None:
        rows.add_row("1-norm of W", one_norm(network, xi))
        rows.add_row("largest |t|", f"{np.linalg.norm(network.translation, axis=-1).max():.2f}")
    console.print(rows)
    if network is not None:
        print_stability(network, xi)
