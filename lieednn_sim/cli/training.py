"""The command ``train``, which learns a network for a target."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass

from lieednn_sim import io
from lieednn_sim.cli.arguments import Goal
from lieednn_sim.cli.console import console, print_import_report, print_stability, progress, wrote
from lieednn_sim.cli.kinds import Directory
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.evaluation import plots as figures
from lieednn_sim.learning import TrainingOptions, TrainingResult
from lieednn_sim.learning import train as learn
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.registry import ALGORITHMS
from lieednn_sim.synthesis import bias_for
from lieednn_sim.validation import as_count, as_positive
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class Learning:
    """How a network is learned; stored in the task.

    Attributes:
        algorithm: learning algorithm, a name of `ALGORITHMS`.
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


def train(
    *, goal: Goal, learning: Learning, output: Directory = "results/run", plots: str = "png", verbose: bool = False
) -> int:
    """Learn a network for a target with the algorithm of the paper, or an improved one, in a run directory.

    Continue with 'simulate', 'evaluate' and 'render'. The exit code is 1 if no network was learned.

    Args:
        goal: the motion.
        learning: how it is learned.
        output: directory for the files of the run.
        plots: format of the plot: png, pdf or svg.
        verbose: print every stability condition, all bounds, and the whole report of an imported arm.
    """
    run = RunDirectory(output, plots)
    with run.at_work():
        return _train(run, goal, learning, verbose)


def _train(run: RunDirectory, goal: Goal, learning: Learning, verbose: bool) -> int:
    """Learn from seed after seed; save the first network, and the first one whose motion keeps the limits."""
    arm = goal.load()
    start, aim = goal.start_and_goal(arm)
    target = next(candidates(arm, aim, start))
    arm.check_position(target, "target")
    count = as_count("candidates", learning.candidates)
    about = {"planner": "train", "reason": "asked for", "options": asdict(learning)}
    task = goal.task(arm, start, target, goal.asked_duration, goal.seed, **about)
    xi = arm.encode(target)
    learner = _learner(learning, xi)
    saved: LieEDNN | None = None
    for seed in range(task.seed, task.seed + count):
        with progress("train"):
            result = learner(seed=seed)
        # Learning does not need a proof; the network is saved and reported with one where it is found.
        network = result.network.try_certify() if result.success and isinstance(result.network, LieEDNN) else None
        motion = refusal = None
        if network is not None:
            try:
                motion = NetworkPath.integrate(arm, network, task.start).timed(task.duration, arm.timestep)
                check_motion(arm, motion)
            except PlanError as error:
                refusal = str(error)
        accepted = network is not None and refusal is None
        if saved is None or accepted:
            outcome, rejected, saved = result, refusal, network
            if network is not None:
                written = run.save_network(task, network, motion, result.history)
                with io.atomic_path(run.plot("training")) as temporary:
                    figures.plot_training(result.history, xi, result.tolerance, temporary)
        if accepted:
            break
    _report(outcome, saved, xi, verbose)
    print_import_report(arm, whole=verbose)
    if saved is None:
        # A run's previous files stay as they are.
        console.print("no network was written; try another --seed, more --epochs, or --algorithm stability-aware")
        return 1
    wrote(*written, run.plot("training"))
    if rejected is not None:
        console.print(f"the network is learned, but its motion will be rejected: {rejected}")
    return 0


def _learner(asked: Learning, xi: Floats) -> Callable[..., TrainingResult]:
    """A function that learns a network from the argument ``seed``."""
    make = ALGORITHMS.find(asked.algorithm).load()
    changes = {"period": asked.period, "max_epochs": asked.epochs, "tolerance": asked.tolerance}
    given = {key: value for key, value in changes.items() if value is not None}
    if len(given) > 1 and not isinstance(make(), TrainingOptions):
        others = "the algorithms literal, repaired and tracked"
        raise InputError(f"--period and --epochs are for {others}, not for {asked.algorithm}")
    if asked.bias == "solved":
        raise InputError("the solved bias needs no learning; use 'lieednn-sim plan --option bias=solved'")
    magnitude = as_positive("bias magnitude", asked.bias_magnitude)
    bias = bias_for(asked.bias, xi, ACTIVATIONS[DEFAULT_ACTIVATION].phi(xi), 1.0, magnitude)
    return functools.partial(learn, xi, make(**given), bias=bias)


def _report(result: TrainingResult, network: LieEDNN | None, xi: Floats, verbose: bool) -> None:
    proof = "" if network is None else "; certified" if network.certified else "; not certified"
    each = 1e6 * result.cpu_time / max(result.epochs, 1)
    console.print(f"{result.message}{proof}; {result.cpu_time:.2f} s of CPU time, {each:.0f} us an epoch")
    if network is not None:
        print_stability(network, xi, whole=verbose)
