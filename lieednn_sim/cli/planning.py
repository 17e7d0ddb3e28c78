"""The planning of ``plan`` and ``demo``: a motion to the target, and the network if there is one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import RANDOM, Planning, read_options
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, one_norm, print_stability, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import rounded, table
from lieednn_sim.planning import OBSTACLE_PLANNER, Plan, default_planner, plan
from lieednn_sim.planning.certified import CertifiedDetails
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.shaped import ShapedDetails
from lieednn_sim.registry import PLANNERS


def make_plan(run: RunDirectory, planning: Planning, usual: Sequence[str] = ()) -> None:
    """Plan, and write the task, the motion, and the network if the planner makes one.

    Args:
        run: the directory to write into.
        planning: the arm, the goal and the planner.
        usual: options of the planner ``lieednn-certified`` if no others are given.
    """
    arm = planning.load()
    planner, reason = _planner(arm, planning)
    options = _options(planner, [*usual, *planning.option] if planner == "lieednn-certified" else planning.option)
    console.print(f"planner: {planner} ({reason}), at most {planning.time_budget:g} s of CPU time")
    target = planning.usual_target(arm)
    if target is not None and target.startswith(RANDOM):
        console.print(f"target: {target}")
    start, goal = planning.start_and_goal(arm, place=planning.path_constraint is not None)
    path_constraint = planning.constraint_region(arm, start, goal)
    shown = {
        # JSON has no infinity.
        "time_budget": None if planning.time_budget == math.inf else planning.time_budget,
        "fastest": planning.fastest,
        "path_constraint": planning.path_constraint,
        "option": {} if options is None else asdict(options),
    }
    about = {"planner": planner, "reason": reason, "options": shown}
    task = planning.task(arm, start, start, planning.duration, planning.seed, **about)
    with progress("plan") as report:
        result = plan(
            arm,
            goal,
            planner=planner,
            start=start,
            duration=planning.duration,
            max_time_scale=1.0 if planner == "lieednn-certified" and not planning.fastest else 3.0,
            seed=planning.seed,
            time_budget=planning.time_budget,
            options=options,
            fastest=planning.fastest,
            path_constraint=path_constraint,
            progress=report,
        )
    task = replace(task, target=tuple(result.target.tolist()))
    written = run.save_network(task, result.network, result.motion)
    print_import_report(arm)
    print_outcome(result)
    wrote(*written)


def _planner(arm: Arm, planning: Planning) -> tuple[str, str]:
    """The requested planner, or the default for the arm and scene, and why.

    The default does not depend on what is installed: if it cannot run, that is an error.
    """
    name, reason = default_planner(arm) if planning.planner is None else (planning.planner, "asked for")
    if planning.planner is None and planning.path_constraint is not None:
        name, reason = OBSTACLE_PLANNER, "the default where a region is kept"
    PLANNERS.find(name)
    PLANNERS.require(name)
    return name, reason


def _options(planner: str, texts: Sequence[str]) -> PlannerOptions | None:
    """Options of a planner from ``NAME=VALUE``; None for a planner without options."""
    kind = PLANNERS[planner].options
    if kind is None:
        if texts:
            raise InputError(f"the planner {planner} has no options, got {texts[0]!r}")
        return None
    return read_options(kind(), texts)


def print_outcome(result: Plan) -> None:
    """Print a plan's duration, mechanism gap and network, how it was found, and what is proved of it."""
    network, details = result.network, result.details
    rows = table("plan", "quantity", "value")
    rows.add_row("planner", result.planner)
    rows.add_row("duration", f"{result.motion.t[-1]:.2f} s")
    rows.add_row("mechanism gap", _gap(result.motion))
    if isinstance(details, CertifiedDetails):
        rows.add_row("networks", f"{details.n_networks} networks drawn, {details.within_limits} keep the joint limits")
    if isinstance(details, ShapedDetails) and result.guide is not None:
        rows.add_row("guide", result.guide.planner)
        rows.add_row("off its path", f"{1e3 * details.deviation:.2g} mm at the end effector")
    if network is None:
        rows.add_row("proof", "none, as this planner makes no network")
        console.print(rows)
        return
    goal = network.goal(result.motion.xi_target)
    rows.add_row("largest bias", f"{np.abs(network.bias).max():.3g}")
    rows.add_row("1-norm of W", one_norm(network, goal))
    console.print(rows)
    print_stability(network, goal)


def _gap(motion: Motion) -> str:
    angle = np.rad2deg(motion.gap_rotation.max())
    return f"{rounded(1e3 * motion.gap_translation.max())} mm and {rounded(angle)} degrees at most, 0 at the target"
