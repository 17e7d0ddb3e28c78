"""The command ``train``: target to learned network, resumable."""

from __future__ import annotations

import argparse
import contextlib
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
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
    TrainingOptions,
    TrainingResult,
    resume,
    train_riemannian,
)
from lieednn_sim.learning import train as learn
from lieednn_sim.learning.checkpoint import KIND as CHECKPOINT_KIND
from lieednn_sim.learning.checkpoint import load as load_checkpoint
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.planning.network_path import make_motion
from lieednn_sim.synthesis import bias_for
from lieednn_sim.validation import as_choice, as_count, as_positive
from lieednn_sim.values import Floats

# Algorithms on the manifold, and whether with a certificate; without checkpoints, since they take seconds.
RIEMANNIAN = {"riemannian": False, "stability-aware": True}

# Options stored in the task.
_OPTIONS = ("algorithm", "period", "epochs", "tolerance", "bias", "bias_magnitude", "candidates")

Learner = Callable[[int], TrainingResult]
Candidates = Iterable[Callable[[], TrainingResult]]


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
    as_count("candidates", options["candidates"])
    task = make_task(arm, start, target, arguments, planner=TRAINED, reason="asked for", options=options)
    learner = _learner(arguments, arm.encode(target), run.pending)
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
    return task, arm, (functools.partial(learner, task.seed + k) for k in itertools.count())


def _train(run: RunDirectory, task: Task, arm: Arm, learners: Candidates) -> int:
    """Learn from consecutive seeds, as many as the task allows."""
    pending = run.pending
    try:
        candidates = as_count("candidates", task.options["candidates"])
        result, refusal = _choose(itertools.islice(learners, candidates), run, arm, task)
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


def _learner(arguments: argparse.Namespace, xi: Floats, pending: RunDirectory) -> Learner:
    """A function that learns a network from a seed."""
    name = as_choice("algorithm", arguments.algorithm, [*ALGORITHMS, *RIEMANNIAN])
    bias = _bias(xi, arguments)
    if name in RIEMANNIAN:
        if arguments.period is not None or arguments.epochs is not None:
            raise InputError(f"--period and --epochs are for the algorithms {', '.join(ALGORITHMS)}, not for {name}")
        riemannian = RiemannianOptions(certified=RIEMANNIAN[name], tolerance=arguments.tolerance)
        return lambda seed: _shown(train_riemannian, xi, riemannian, bias=bias, seed=seed)
    options = _training_options(arguments)
    return lambda seed: _shown(learn, xi, options, bias=bias, seed=seed, checkpoint=pending.checkpoint)


def _training_options(arguments: argparse.Namespace) -> TrainingOptions:
    changes = {"period": arguments.period, "max_epochs": arguments.epochs, "tolerance": arguments.tolerance}
    return ALGORITHMS[arguments.algorithm](**{key: value for key, value in changes.items() if value is not None})


def _shown(learn: Callable[..., TrainingResult], *arguments: Any, **named: Any) -> TrainingResult:
    """Run a learner with a progress bar."""
    with progress("train") as report:
        return learn(*arguments, **named, progress=report)


def _resumed(pending: RunDirectory, task: Task, xi: Floats) -> Iterator[Callable[[], TrainingResult]]:
    """The interrupted candidate first, then those after it."""
    problem, options, *_ = load_checkpoint(pending.checkpoint)
    if problem.group is not None or problem.target.shape != xi.shape or np.abs(problem.target - xi).max() > 1e-9:
        raise FileError(f"{pending.checkpoint} was learning another target than {pending.task} says; train again")
    try:
        asked = argparse.Namespace(**task.options)
        same = options == _training_options(asked) and bool(np.allclose(problem.bias, _bias(xi, asked), atol=1e-9))
    except (AttributeError, KeyError, TypeError, InputError) as error:
        raise FileError(f"{pending.task} does not say how the training was begun ({error}); train again") from None
    if not same or not 0 <= problem.seed - task.seed < task.options["candidates"]:
        raise FileError(f"{pending.checkpoint} was learning with other options than {pending.task} says; train again")
    again = functools.partial(_shown, learn, problem.target, options, bias=problem.bias, checkpoint=pending.checkpoint)
    # The candidates before it were learned, and rejected or worse.
    others = range(problem.seed + 1, task.seed + task.options["candidates"])
    return itertools.chain(
        [functools.partial(_shown, resume, pending.checkpoint)],
        (functools.partial(again, seed=seed) for seed in others),
    )


def _bias(xi: Floats, arguments: argparse.Namespace) -> Floats:
    if arguments.bias == "solved":
        raise InputError("the solved bias needs no learning; use 'lieednn-sim synthesize --bias solved'")
    magnitude = as_positive("bias magnitude", arguments.bias_magnitude)
    return bias_for(arguments.bias, xi, np.tanh(xi), 1.0, magnitude)


def _report(result: TrainingResult, xi: Floats) -> None:
    network = result.network if result.success and isinstance(result.network, LieEDNN) else None
    rows = table("training", "quantity", "value")
    rows.add_row("outcome", result.message)
    rows.add_row("time", f"{result.seconds:.2f} s, {1e6 * result.seconds / max(result.epochs, 1):.0f} us an epoch")
    if network is not None:
        rows.add_row("1-norm of W", one_norm(network, xi))
        rows.add_row("largest |t|", f"{np.linalg.norm(network.translation, axis=-1).max():.2f}")
    console.print(rows)
    if network is not None:
        print_stability(network, xi)
