"""The command ``synthesize``: target to network, and to its motion where a planner makes that, too."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import RANDOM, load_arm, make_task, start_and_target, usual_target
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, table, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import CERTIFIED
from lieednn_sim.errors import InputError
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planning import OBSTACLE_PLANNER, PLANNERS, PlanningProblem, plan_network, require_planner
from lieednn_sim.planning.certified import Plan, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.validation import as_choice

Floats = NDArray[np.float64]

_BIAS, _CANDIDATES = "sign-matched", 24


def synthesize(run: RunDirectory, arguments: argparse.Namespace) -> None:
    """Fill a run directory with a task, a network where the planner has one, and the planner's motion."""
    arm = load_arm(arguments)
    planner, reason = _planner(arm, arguments)
    console.print(f"planner: {planner} ({reason}), at most {arguments.time_budget:g} s of CPU time")
    if arguments.target is None and arguments.position is None:
        arguments.target = usual_target(arm, arguments.seed)
        if arguments.target.startswith(RANDOM):
            console.print(f"target: {arguments.target}")
    start, target = start_and_target(arm, arguments)
    options = _options(arguments) if planner == CERTIFIED else {}
    # JSON has no infinity.
    budget = None if arguments.time_budget == math.inf else arguments.time_budget
    task = make_task(
        arm, start, target, arguments, planner=planner, reason=reason, options={**options, "time_budget": budget}
    )
    if planner == CERTIFIED:
        chosen, motion = _plan(arm, target, start, arguments, options), None
        network: ComponentwiseNetwork | None = chosen.network
    else:
        problem = PlanningProblem(arm, start, target, arguments.duration, arguments.seed, arguments.time_budget)
        with progress("plan"):
            network, motion = plan_network(planner, problem)
    written = run.save_network(task, network, motion)
    print_import_report(arm)
    if motion is None:
        _print_choice(arm, chosen, options)
    else:
        _print_outcome(planner, network, motion)
    wrote(*written)


def _planner(arm: Arm, arguments: argparse.Namespace) -> tuple[str, str]:
    """The planner that is asked for, or fits the scene, and why; the search's options are for one alone.

    It does not depend on what is installed: where the usual one cannot run, that is an error.
    """
    if arguments.planner is not None:
        name, reason = arguments.planner, "asked for"
    elif arm.scene == "free":
        name, reason = CERTIFIED, "the default without obstacles"
    else:
        name, reason = OBSTACLE_PLANNER, "the default among obstacles"
    as_choice("planner", name, PLANNERS)
    require_planner(name)
    given = [
        option
        for option in ("bias", "bias_magnitude", "candidates")
        if name != CERTIFIED and getattr(arguments, option) is not None
    ]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is for --planner {CERTIFIED}; {name} chooses by itself")
    return name, reason


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Options of the search for certified networks by name."""
    magnitude = arguments.usual_bias_magnitude if arguments.bias_magnitude is None else arguments.bias_magnitude
    return {
        "bias": _BIAS if arguments.bias is None else arguments.bias,
        "bias_magnitude": magnitude,
        "candidates": _CANDIDATES if arguments.candidates is None else arguments.candidates,
    }


def _plan(arm: Arm, target: Floats, start: Floats, arguments: argparse.Namespace, options: Mapping[str, Any]) -> Plan:
    with progress("synthesize") as report:
        return plan(
            arm,
            target,
            start=start,
            duration=arguments.duration,
            seed=arguments.seed,
            time_budget=arguments.time_budget,
            progress=report,
            **options,
        )


def _print_choice(arm: Arm, chosen: Plan, options: Mapping[str, Any]) -> None:
    conditions = chosen.network.norm_conditions(arm.encode(chosen.target))
    rows = table("network", "quantity", "value")
    rows.add_row("certificate", str(chosen.network.certificate))
    rows.add_row("bias", f"{options['bias']}, largest entry {np.abs(chosen.network.bias).max():.3g}")
    rows.add_row("candidates", f"{chosen.candidates} networks drawn, {chosen.within_limits} keep the joint limits")
    rows.add_row("mechanism gap", _gap(chosen.motion))
    rows.add_row(
        "1-norm of W",
        f"{conditions.one_norm:.2f} (no network with this equilibrium below {conditions.smallest_one_norm:.2f})",
    )
    warning = chosen.network.assess(chosen.motion.xi_target).warning
    if warning is not None:
        rows.add_row("warning", warning)
    console.print(rows)


def _print_outcome(planner: str, network: ComponentwiseNetwork | None, motion: Motion) -> None:
    rows = table("plan", "quantity", "value")
    rows.add_row("planner", planner)
    rows.add_row("duration", f"{motion.t[-1]:.2f} s")
    rows.add_row("mechanism gap", _gap(motion))
    console.print(rows)
    if network is not None:
        console.print(f"stability: {network.assess(motion.xi_target)}")


def _gap(motion: Motion) -> str:
    return f"{1e3 * motion.gap_translation.max():.1f} mm on the way, 0 at the target"
