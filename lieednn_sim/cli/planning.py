"""The command ``plan``: a motion to a target, or one that was learned, with its network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.budget import time_limit
from lieednn_sim.cli.arguments import Planning, joint_position, read_options
from lieednn_sim.cli.console import console, print_import_report, print_stability, progress, wrote
from lieednn_sim.cli.kinds import Directory
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import LearnedMotion
from lieednn_sim.planning import OBSTACLE_PLANNER, Plan, default_planner, plan_learned
from lieednn_sim.planning import plan as plan_motion
from lieednn_sim.planning.certified import CertifiedDetails
from lieednn_sim.planning.clearance import Clearance
from lieednn_sim.planning.problem import USUAL_DURATION
from lieednn_sim.planning.shaped import ShapedDetails
from lieednn_sim.registry import PLANNERS
from lieednn_sim.values import rounded


def plan(*, planning: Planning, payload: float = 0.0, output: Directory = "results/run", verbose: bool = False) -> None:
    """Plan a motion to a target with any planner, in a run directory, with a certified network if it makes one.

    Continue with 'simulate', 'evaluate' and 'render'.

    Args:
        planning: the motion.
        payload: mass at the end effector that the plan and its simulations know [kg].
        output: directory for the files of the run.
        verbose: print every stability condition, all bounds, and the whole report of an imported arm.
    """
    run = RunDirectory(output)
    with run.at_work():
        result, head, written = plan_run(run, planning, payload=payload)
        print_plan(result, head, result.clearance, f"arrives in {result.motion.t[-1]:.3g} s", verbose=verbose)
        wrote(*written)


def plan_run(
    run: RunDirectory, planning: Planning, usual: Sequence[str] = (), payload: float = 0.0
) -> tuple[Plan, str, list[Path]]:
    """Plan, and write the results; ``usual`` are options of ``lieednn-certified`` that ``planning`` may override.

    Returns the plan, a line on planner and target, and the files written.
    """
    arm = planning.load().with_payload(payload)
    if planning.learned is not None:
        return _plan_learned(run, arm, planning)
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
    about = {"planner": planner, "reason": reason, "options": shown}
    task = planning.task(arm, start, start, planning.asked_duration, planning.seed, **about)
    with progress("plan"), time_limit(planning.time_budget):
        result = plan_motion(
            arm,
            goal,
            planner=planner,
            start=start,
            duration=USUAL_DURATION if planning.duration is None else planning.duration,
            seed=planning.seed,
            options=options,
            fastest=planning.fastest,
            path_constraint=path_constraint,
            settle=planning.settle,
        )
    task = replace(task, target=tuple(result.target.tolist()))
    aim = planning.usual_target(arm) or planning.target or planning.position or "a pose"
    return result, f"planner: {planner}, {reason}; target: {aim}", run.save_network(task, result.network, result.motion)


def _plan_learned(run: RunDirectory, arm: Arm, planning: Planning) -> tuple[Plan, str, list[Path]]:
    """Plan a learned motion of the end effector, and write the results."""
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
            goal = goal.lower[:3]
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
    task = planning.task(arm, q[0], result.target, lasts, planning.seed, **about)
    return result, f"planner: {result.planner}, as shown", run.save_network(task, result.network, result.motion)


def print_plan(result: Plan, head: str, clearance: Clearance, arrival: str, *, verbose: bool = False) -> None:
    """Print a verdict in one line and the main facts of a plan; if verbose, all that is known and proved about it.

    ``head`` is the line of `plan_run`; clearance and arrival are those of the plan, or of a run that followed it.
    """
    network, motion = result.network, result.motion
    proof = "certified" if network is not None and network.certified else "no certificate"
    console.print(f"{proof}; {clearance.at()}; {arrival}")
    if network is not None:
        console.print(f"certificate: {network.certificate}")
    console.print(f"clearance: {clearance}")
    if result.load_clearance is not None:
        console.print(f"what hangs, as it swings by its linear model: {result.load_clearance}")
    console.print(head)
    if result.leaves:
        console.print(f"leaves at the start: {result.leaves}")
    if result.arm is not None and result.arm.payload > 0.0:
        console.print(f"payload: {result.arm.payload:g} kg")
    gaps = rounded(1e3 * motion.gap_translation.max()), rounded(np.rad2deg(motion.gap_rotation.max()))
    gap = "none" if gaps == ("0", "0") else "{} mm and {} degrees at most on the way, 0 at the target".format(*gaps)
    console.print(f"mechanism gap: {gap}")
    if result.arm is not None:
        print_import_report(result.arm, whole=verbose)
    if not verbose:
        return
    if isinstance(result.details, CertifiedDetails):
        console.print(f"networks: {result.details.n_networks} drawn, {result.details.within_limits} keep the limits")
    if isinstance(result.details, ShapedDetails) and result.guide is not None:
        off = f"the plan is {1e3 * result.details.deviation:.2g} mm off its path at the end effector"
        console.print(f"guide: {result.guide.planner}; {off}")
    if network is not None:
        print_stability(network, network.goal(motion.xi_target))
