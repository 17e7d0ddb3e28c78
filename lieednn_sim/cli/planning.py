"""The command ``synthesize``: target to network, and to its motion where a planner makes that, too."""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import RANDOM, load_arm, make_task, start_and_target, usual_target
from lieednn_sim.cli.arms import print_adoption
from lieednn_sim.cli.console import console, progress, table, wrote
from lieednn_sim.errors import InputError
from lieednn_sim.motion import Motion
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planners import NETWORK_PLANNERS, PlanningProblem, obstacle_planner, plan_network
from lieednn_sim.planning import Plan, plan
from lieednn_sim.task import RunDirectory
from lieednn_sim.validation import as_choice

Floats = NDArray[np.float64]

# The planner whose network draws its motion by itself: `simulate` makes it from the network alone.
CERTIFIED = "lieednn-certified"
_BIAS, _CANDIDATES = "sign-matched", 24


def synthesize(arguments: argparse.Namespace) -> RunDirectory:
    """Make a run directory with a task, a network, and a planner's motion."""
    run = RunDirectory(arguments.output)
    arm = load_arm(arguments)
    planner = _planner(arm, arguments)
    if arguments.target is None and arguments.position is None:
        arguments.target = usual_target(arm, arguments.seed)
        if arguments.target.startswith(RANDOM):
            console.print(f"target: {arguments.target}")
    start, target = start_and_target(arm, arguments)
    made = not run.path.exists()
    run.create()
    try:
        if planner == CERTIFIED:
            chosen, motion = _plan(arm, target, start, arguments), None
            task = make_task(arm, start, chosen.target, arguments)
            network: ComponentwiseNetwork = chosen.network
        else:
            console.print(f"planning with {planner} ...")
            made_by, motion = plan_network(
                planner, PlanningProblem(arm, start, target, arguments.duration, arguments.seed, arguments.time_budget)
            )
            if made_by is None:
                raise InputError(f"planner {planner!r} runs no network; allowed: {', '.join(NETWORK_PLANNERS)}")
            network = made_by
            task = make_task(arm, start, target, arguments, planner)
    except BaseException:
        if made:
            run.path.rmdir()
        raise
    run.forget_results()
    task.save(run.task)
    network.save(run.network)
    print_adoption(arm)
    if motion is None:
        _print_choice(arm, chosen, arguments)
        wrote(run.task, run.network)
    else:
        motion.save(run.motion)
        _print_outcome(arm, planner, network, motion)
        wrote(run.task, run.network, run.motion)
    return run


def _planner(arm: Arm, arguments: argparse.Namespace) -> str:
    """The planner that is asked for, or fits the scene; the search's options are for one alone."""
    usual = CERTIFIED if arm.scene == "free" else obstacle_planner()
    name = as_choice("planner that runs a network", arguments.planner or usual, NETWORK_PLANNERS)
    given = [
        option
        for option in ("bias", "bias_magnitude", "candidates")
        if name != CERTIFIED and getattr(arguments, option) is not None
    ]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is for --planner {CERTIFIED}; {name} chooses by itself")
    return name


def _plan(arm: Arm, target: Floats, start: Floats, arguments: argparse.Namespace) -> Plan:
    magnitude = arguments.usual_bias_magnitude if arguments.bias_magnitude is None else arguments.bias_magnitude
    with progress("synthesize") as report:
        return plan(
            arm,
            target,
            start=start,
            duration=arguments.duration,
            bias=_bias(arguments),
            bias_magnitude=magnitude,
            candidates=_CANDIDATES if arguments.candidates is None else arguments.candidates,
            seed=arguments.seed,
            time_budget=arguments.time_budget,
            progress=report,
        )


def _bias(arguments: argparse.Namespace) -> str:
    return _BIAS if arguments.bias is None else str(arguments.bias)


def _print_choice(arm: Arm, chosen: Plan, arguments: argparse.Namespace) -> None:
    conditions = chosen.network.norm_conditions(arm.encode(chosen.target))
    rows = table("network", "quantity", "value")
    rows.add_row("certificate", str(chosen.network.certificate))
    rows.add_row("bias", f"{_bias(arguments)}, largest entry {np.abs(chosen.network.bias).max():.3g}")
    rows.add_row("candidates", f"{chosen.candidates} networks drawn, {chosen.within_limits} keep the joint limits")
    rows.add_row("mechanism gap", _gap(chosen.motion))
    rows.add_row(
        "1-norm of W",
        f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
    )
    console.print(rows)


def _print_outcome(arm: Arm, planner: str, network: ComponentwiseNetwork, motion: Motion) -> None:
    rows = table("plan", "quantity", "value")
    rows.add_row("planner", planner)
    rows.add_row("duration", f"{motion.t[-1]:.2f} s")
    rows.add_row("mechanism gap", _gap(motion))
    console.print(rows)
    console.print(f"stability: {network.assess(motion.xi_target)}", markup=False)


def _gap(motion: Motion) -> str:
    return f"{1e3 * motion.gap_translation.max():.1f} mm on the way, 0 at the target"
