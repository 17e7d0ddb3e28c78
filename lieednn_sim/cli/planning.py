"""The planning of ``plan``, ``synthesize`` and ``demo``: a motion to the target, and the network if there is one."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import RANDOM, kept_region, load_arm, make_task, start_and_goal, usual_target
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, one_norm, print_stability, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import CERTIFIED
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import rounded, table
from lieednn_sim.planning import (
    OBSTACLE_PLANNER,
    CertifiedOptions,
    Plan,
    default_planner,
    plan,
)
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.shaped import ShapedDetails
from lieednn_sim.registry import PLANNERS


def make_plan(run: RunDirectory, arguments: argparse.Namespace) -> None:
    """Plan, and write the task, the motion, and the network if the planner makes one."""
    arm = load_arm(arguments)
    planner, reason = _planner(arm, arguments)
    console.print(f"planner: {planner} ({reason}), at most {arguments.time_budget:g} s of CPU time")
    if arguments.target is arguments.position is arguments.pose is None:
        arguments.target = usual_target(arm, arguments.seed)
        if arguments.target.startswith(RANDOM):
            console.print(f"target: {arguments.target}")
    start, goal = start_and_goal(arm, arguments, place=arguments.keep is not None)
    keep = kept_region(arm, start, goal, arguments.keep)
    chosen, shown = _options(arguments) if planner == CERTIFIED else (None, {})
    # JSON has no infinity.
    budget = None if arguments.time_budget == math.inf else arguments.time_budget
    shown |= {"time_budget": budget} | ({"fastest": True} if arguments.fastest else {})
    shown |= {"keep": arguments.keep} if keep is not None else {}
    task = make_task(arm, start, start, arguments, planner=planner, reason=reason, options=shown)
    with progress("synthesize" if planner == CERTIFIED else "plan") as report:
        made = plan(
            arm,
            goal,
            planner=planner,
            start=start,
            duration=arguments.duration,
            max_time_scale=1.0 if planner == CERTIFIED and not arguments.fastest else 3.0,
            seed=arguments.seed,
            time_budget=arguments.time_budget,
            options=chosen,
            fastest=arguments.fastest,
            keep=keep,
            progress=report,
        )
    if arguments.command == "synthesize" and made.network is None:
        raise _no_network(planner)
    task = replace(task, target=tuple(made.target.tolist()))
    written = run.save_network(task, made.network, made.motion)
    print_import_report(arm)
    if planner == CERTIFIED:
        _print_choice(arm, made, shown["bias"])
    else:
        print_outcome(made)
    wrote(*written)


def _planner(arm: Arm, arguments: argparse.Namespace) -> tuple[str, str]:
    """The requested planner, or the default for the arm and scene, and why; checks the options for it.

    The default does not depend on what is installed: if it cannot run, that is an error.
    """
    name, reason = default_planner(arm) if arguments.planner is None else (arguments.planner, "asked for")
    if arguments.planner is None and arguments.keep is not None:
        name, reason = OBSTACLE_PLANNER, "the default where a region is kept"
    PLANNERS.find(name)
    if arguments.command == "synthesize" and PLANNERS[name].own and not PLANNERS[name].network:
        raise _no_network(name)
    PLANNERS.require(name)
    given = [
        option
        for option in ("bias", "bias_magnitude", "n_networks")
        if name != CERTIFIED and getattr(arguments, option) is not None
    ]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} applies to --planner {CERTIFIED} alone, not to {name}")
    return name, reason


def _no_network(planner: str) -> InputError:
    return InputError(f"the planner {planner} makes no network; use: lieednn-sim plan --planner {planner}")


def _options(arguments: argparse.Namespace) -> tuple[CertifiedOptions, dict[str, Any]]:
    """Options of the search for certified networks, and their values for the task."""
    magnitude = arguments.usual_bias_magnitude if arguments.bias_magnitude is None else arguments.bias_magnitude
    given = {name: getattr(arguments, name) for name in ("bias", "n_networks") if getattr(arguments, name) is not None}
    if magnitude is not None:
        given["bias_magnitudes"] = (magnitude,)
    options = CertifiedOptions(**given)
    return options, {"bias": options.bias, "bias_magnitude": magnitude, "n_networks": options.n_networks}


def _print_choice(arm: Arm, made: Plan, bias: str) -> None:
    network = made.network
    assert network is not None
    goal = network.goal(arm.encode(made.target))
    rows = table("network", "quantity", "value")
    rows.add_row("certificate", str(network.certificate))
    rows.add_row("robustness", str(network.robustness()))
    rows.add_row("bias", f"{bias}, largest entry {np.abs(network.bias).max():.3g}")
    drawn = made.details
    rows.add_row("networks", f"{drawn.n_networks} networks drawn, {drawn.within_limits} keep the joint limits")
    rows.add_row("duration", f"{made.motion.t[-1]:.2f} s")
    rows.add_row("mechanism gap", _gap(made.motion))
    rows.add_row("1-norm of W", one_norm(network, goal))
    warning = network.assess(goal).warning
    if warning is not None:
        rows.add_row("warning", warning)
    console.print(rows)


def print_outcome(made: Plan) -> None:
    """Print a plan's duration, mechanism gap, teacher and stability."""
    rows = table("plan", "quantity", "value")
    rows.add_row("planner", made.planner)
    rows.add_row("duration", f"{made.motion.t[-1]:.2f} s")
    rows.add_row("mechanism gap", _gap(made.motion))
    if isinstance(made.details, ShapedDetails) and made.teacher is not None:
        rows.add_row("teacher", made.teacher.planner)
        rows.add_row("off its path", f"{1e3 * made.details.deviation:.2g} mm at the end effector")
    console.print(rows)
    if made.network is not None:
        print_stability(made.network, made.network.goal(made.motion.xi_target))


def _gap(motion: Motion) -> str:
    angle = np.rad2deg(motion.gap_rotation.max())
    return f"{rounded(1e3 * motion.gap_translation.max())} mm and {rounded(angle)} degrees at most, 0 at the target"
