"""The command ``train``, which learns a network for a target."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import Goal
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, one_norm, print_stability, progress, wrote
from lieednn_sim.cli.kinds import Directory
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import TRAINED, Task
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.evaluation import plot_training
from lieednn_sim.evaluation.display import table
from lieednn_sim.learning import TrainingOptions, TrainingResult
from lieednn_sim.learning import train as learn
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.network_path import make_motion
from lieednn_sim.registry import ALGORITHMS
from lieednn_sim.synthesis import bias_for
from lieednn_sim.validation import as_count, as_positive
from lieednn_sim.values import Floats

Learner = Callable[[int], TrainingResult]
Candidates = Sequence[Callable[[], TrainingResult]]


@dataclass(frozen=True)
class Learning:
    """How a network is learned; stored in the task.

    Attributes:
        algorithm: learning algorithm: a name of `ALGORITHMS`.
        candidates: largest number of seeds to try until the motion of a network is within the arm's limits.
        period: number of epochs between two projections onto scaled adjoints (default: that of the algorithm).
        epochs: largest number of epochs (default: 25000).
        tolerance: largest allowed error of the equilibrium [rad, units of length of the arm].
        bias: rule that chooses the network's bias: uniform or sign-matched.
        bias_magnitude: magnitude of the bias.
    """

    algorithm: str = "tracked"
    candidates: int = 4
    period: int | None = None
    epochs: int | None = None
    tolerance: float = 1e-5
    bias: str = "sign-matched"
    bias_magnitude: float = 0.125


def train(*, goal: Goal, learning: Learning, output: Directory = "results/run", plots: str = "png") -> int:
    """Learn a network for a target with the algorithm of the paper, or an improved one, in a run directory.

    Continue with 'simulate', 'evaluate' and 'render'. The exit code is 1 if no network was learned.

    Args:
        goal: the motion.
        learning: how it is learned.
        output: directory for the files of the run.
        plots: format of the plot: png, pdf or svg.
    """
    run = RunDirectory(output, plots)
    with run.at_work():
        return _train(run, *_begin(goal, learning))


def _begin(goal: Goal, learning: Learning) -> tuple[Task, Arm, Candidates]:
    """The task, its arm, and learners of a network for it from consecutive seeds."""
    arm = goal.load()
    start, aim = goal.start_and_goal(arm)
    target = next(candidates(arm, aim, start))
    arm.check_position(target, "target")
    count = as_count("candidates", learning.candidates)
    about = {"planner": TRAINED, "reason": "asked for", "options": asdict(learning)}
    task = goal.task(arm, start, target, goal.duration, goal.seed, **about)
    learner = _learner(learning, arm.encode(target))
    print_import_report(arm)
    return task, arm, [functools.partial(learner, task.seed + k) for k in range(count)]


def _train(run: RunDirectory, task: Task, arm: Arm, learners: Candidates) -> int:
    """Learn from one seed after the other."""
    result, refusal = _choose(learners, run, arm, task)
    _report(result, arm.encode(task.target))
    if not result.success:
        # A run's previous files stay as they are.
        console.print("no network was written; try another --seed, more --epochs, or --algorithm stability-aware")
        return 1
    wrote(*(path for path in (run.task, run.network, run.motion, run.history, run.training_plot) if path.exists()))
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
        motion, refusal = _motion(result, arm, task)
        if best is None or not best[0].success or (result.success and refusal is None):
            best = result, refusal
            if result.success and isinstance(result.network, LieEDNN):
                run.save_network(task, result.network, motion, result.history)
                with io.atomic_path(run.training_plot) as temporary:
                    plot_training.plot_training(result.history, xi, result.tolerance, temporary)
        if result.success and refusal is None:
            break
    if best is None:
        raise InputError("there is no candidate to learn")
    return best


def _motion(result: TrainingResult, arm: Arm, task: Task) -> tuple[Motion | None, str | None]:
    """The motion of the network, if there is one, and why the arm cannot use it, or None."""
    motion = None
    if result.success and isinstance(result.network, LieEDNN):
        try:
            motion = make_motion(arm, result.network, task.start, task.duration, arm.timestep)
            check_motion(arm, motion)
        except PlanError as error:
            return motion, str(error)
    return motion, None


def _learner(asked: Learning, xi: Floats) -> Learner:
    """A function that learns a network from a seed, with a progress bar."""
    make = ALGORITHMS.find(asked.algorithm).load()
    changes = {"period": asked.period, "max_epochs": asked.epochs, "tolerance": asked.tolerance}
    given = {key: value for key, value in changes.items() if value is not None}
    if len(given) > 1 and not isinstance(make(), TrainingOptions):
        raise InputError(
            f"--period and --epochs are for the algorithms literal, repaired and tracked, not for {asked.algorithm}"
        )
    options = make(**given)
    if asked.bias == "solved":
        raise InputError("the solved bias needs no learning; use 'lieednn-sim plan --option bias=solved'")
    magnitude = as_positive("bias magnitude", asked.bias_magnitude)
    bias = bias_for(asked.bias, xi, ACTIVATIONS[DEFAULT_ACTIVATION].phi(xi), 1.0, magnitude)

    def learner(seed: int) -> TrainingResult:
        with progress("train") as report:
            return learn(xi, options, bias=bias, seed=seed, progress=report)

    return learner


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
