"""The command ``plan``: a motion to a target, or one that was learned, with its network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.budget import time_limit
from lieednn_sim.cli.arguments import RANDOM, Planning, joint_position, read_options
from lieednn_sim.cli.console import console, one_norm, print_import_report, print_stability, progress, wrote
from lieednn_sim.cli.kinds import Directory
from lieednn_sim.cli.run_directory import RunDirectory, Task
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import rounded, table
from lieednn_sim.learning.demonstrations import LearnedMotion
from lieednn_sim.lie import transforms
from lieednn_sim.planning import OBSTACLE_PLANNER, Plan, default_planner, plan_learned
from lieednn_sim.planning import plan as plan_motion
from lieednn_sim.planning.certified import CertifiedDetails
from lieednn_sim.planning.shaped import ShapedDetails
from lieednn_sim.registry import PLANNERS


def plan(*, planning: Planning, payload: float = 0.0, output: Directory = "results/run") -> None:
    """Plan a motion to a target with any planner, in a run directory, with a certified network if it makes one.

    Continue with 'simulate', 'evaluate' and 'render'.

    Args:
        planning: the motion.
        payload: mass at the end effector that the plan and its simulations know [kg].
        output: directory for the files of the run.
    """
    run = RunDirectory(output)
    with run.at_work():
        plan_run(run, planning, payload=payload)


def plan_run(run: RunDirectory, planning: Planning, usual: Sequence[str] = (), payload: float = 0.0) -> None:
    """Plan, and write what is made; ``usual`` are options of ``lieednn-certified`` if no others are given."""
    arm = planning.load().with_payload(payload)
    if planning.learned is not None:
        _plan_learned(run, arm, planning)
        return
    # The default does not depend on what is installed: if it cannot run, that is an error.
    if planning.planner is not None:
        planner, reason = planning.planner, "asked for"
    elif planning.path_constraint is not None:
        planner, reason = OBSTACLE_PLANNER, "the default where a region is kept"
    else:
        planner, reason = default_planner(arm)
    kind = PLANNERS.require(planner).options
    texts = [*usual, *planning.option] if planner == "lieednn-certified" else planning.option
    if kind is None and texts:
        raise InputError(f"the planner {planner} has no options, got {texts[0]!r}")
    options = None if kind is None else read_options(kind(), texts)
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
        "settle": planning.settle,
        "path_constraint": planning.path_constraint,
        "payload": payload,
        "option": {} if options is None else asdict(options),
    }
    about, lasts = {"planner": planner, "reason": reason, "options": shown}, planning.asked_duration
    task = planning.task(arm, start, start, lasts, planning.seed, **about)
    own = planner == "lieednn-certified" and not planning.fastest and planning.settle is None
    with progress("plan"), time_limit(planning.time_budget):
        result = plan_motion(
            arm,
            goal,
            planner=planner,
            start=start,
            duration=(lasts, lasts) if own else lasts,
            seed=planning.seed,
            options=options,
            fastest=planning.fastest,
            path_constraint=path_constraint,
            settle=planning.settle,
        )
    _save(run, arm, replace(task, target=tuple(result.target.tolist())), result)


def _plan_learned(run: RunDirectory, arm: Arm, planning: Planning) -> None:
    """Plan a motion of the end effector that was learned, and write what is made."""
    if planning.planner or planning.option or planning.path_constraint or planning.settle:
        raise InputError("--learned takes no --planner, --option, --path-constraint or --settle: the motion is known")
    learned, goal = LearnedMotion.load(planning.learned or ""), None
    if planning.usual_target(arm) is None:
        goal = planning.start_and_goal(arm, place=True)[1]
        if isinstance(goal, list):
            goal, *others = goal
            if others:
                raise InputError("--learned takes one goal, give --pose once")
        elif isinstance(goal, TaskSpaceRegion):
            goal = transforms(learned.goal.rotation.as_matrix(), goal.lower[:3])
        else:
            goal = arm.link_poses(goal)[-1]
    start = None if planning.start is None else joint_position(arm, planning.start, "start")
    with progress("plan"), time_limit(planning.time_budget):
        result = plan_learned(
            arm,
            learned,
            start=start,
            goal=goal,
            turning=planning.turning,
            duration=planning.duration,
            fastest=planning.fastest,
            seed=planning.seed,
        )
    made = {"learned": str(Path(planning.learned or "").resolve()), "turning": planning.turning, "payload": arm.payload}
    about = {"planner": result.planner, "reason": "learned", "options": {**made, "fastest": planning.fastest}}
    q, lasts = result.motion.q, float(result.motion.t[-1])
    _save(run, arm, planning.task(arm, q[0], result.target, lasts, planning.seed, **about), result)


def _save(run: RunDirectory, arm: Arm, task: Task, result: Plan) -> None:
    """Write a plan, and print what was read and found."""
    written = run.save_network(task, result.network, result.motion)
    print_import_report(arm)
    print_plan(result)
    wrote(*written)


def print_plan(result: Plan) -> None:
    """Print a plan's duration, mechanism gap and network, how it was found, and what is proved of it."""
    network, motion, details = result.network, result.motion, result.details
    millimetres, degrees = 1e3 * motion.gap_translation.max(), np.rad2deg(motion.gap_rotation.max())
    rows = table("plan", "quantity", "value")
    rows.add_row("planner", result.planner)
    rows.add_row("duration", f"{motion.t[-1]:.2f} s")
    if result.leaves:
        rows.add_row("leaves at the start", result.leaves)
    if result.arm is not None and result.arm.payload > 0.0:
        rows.add_row("payload", f"{result.arm.payload:g} kg")
    rows.add_row("mechanism gap", f"{rounded(millimetres)} mm and {rounded(degrees)} degrees at most, 0 at the target")
    if isinstance(details, CertifiedDetails):
        rows.add_row("networks", f"{details.n_networks} networks drawn, {details.within_limits} keep the joint limits")
    if isinstance(details, ShapedDetails) and result.guide is not None:
        rows.add_row("guide", result.guide.planner)
        rows.add_row("off its path", f"{1e3 * details.deviation:.2g} mm at the end effector")
    if network is None:
        rows.add_row("proof", "none, as this planner makes no network")
    else:
        rows.add_row("largest bias", f"{np.abs(network.bias).max():.3g}")
        rows.add_row("1-norm of W", one_norm(network, goal := network.goal(motion.xi_target)))
    console.print(rows)
    console.print(f"clearance: {result.clearance}")
    if result.load_clearance is not None:
        console.print(f"what hangs, as it swings by its linear model: {result.load_clearance}")
    if network is not None:
        print_stability(network, goal)
