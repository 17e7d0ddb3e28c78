"""Planning by the name of a planner: `plan`, the default planner, and registering a planner of one's own."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.budget import cpu_time, default_limit, one_blas_thread
from lieednn_sim.entries import PlannerEntry
from lieednn_sim.errors import InputError, LieEDNNError, NoSolutionError, NotCertifiedError, PlanError
from lieednn_sim.planning.goals import Goal, candidates
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.options import PlannerOptions, given_options
from lieednn_sim.planning.path_constraints import check_path_constraint
from lieednn_sim.planning.problem import USUAL_DURATION, Duration, Plan, PlanningProblem, durations, in_time
from lieednn_sim.planning.settling import SettlingOptions, settled
from lieednn_sim.planning.statics import check_held
from lieednn_sim.planning.time_laws import retime
from lieednn_sim.registry import PLANNERS, optional_module
from lieednn_sim.validation import Seed, as_seed

_Solve = TypeVar("_Solve", bound=Callable[..., Plan | Motion])


def register_planner(name: str, options: type[PlannerOptions] | None = None) -> Callable[[_Solve], _Solve]:
    """Decorator that registers a function as a planner for `plan`, `compare` and the command line.

    The function takes a `PlanningProblem`. It returns a `Motion` (see `planning.joint_motion`) or a `Plan` with its
    network, and raises `PlanError` if it finds none. Limits, clearance, start, target and the region to keep are
    checked for every motion; if it is too fast, the function is called again with the duration that it needs. Worker
    processes and the command line find planners that an installed package declares as entry points of the group
    ``lieednn_sim.planners``; a function declared like this needs the decorator only if it takes options.

    Args:
        name: name of the planner, in lower-case letters, digits and hyphens.
        options: class of its options, which are its second argument.

    Raises:
        InputError: the name is malformed or taken, or the options are no subclass of `PlannerOptions`.
    """
    return PLANNERS.register(name, options)


def _solved(entry: PlannerEntry, problem: PlanningProblem, *options: PlannerOptions) -> Plan:
    """A planner's plan; that of a planner from another package is checked for what every planner guarantees."""
    solve = entry.load()
    result = in_time(solve, problem, *options) if entry.own else in_time(_checked, problem, solve, *options)
    return Plan(result) if isinstance(result, Motion) else result


def _checked(problem: PlanningProblem, solve: Callable[..., Plan | Motion], *options: PlannerOptions) -> Plan | Motion:
    """The result of a registered planner, checked."""
    try:
        result = solve(problem, *options)
    except LieEDNNError:
        raise
    except Exception as error:
        *_, last = traceback.extract_tb(error.__traceback__)
        where = f"{Path(last.filename).name}, line {last.lineno}"
        raise PlanError(f"the planner failed: {type(error).__name__}: {error} ({where})") from error
    if not isinstance(result, Plan | Motion):
        raise PlanError(f"the planner returned {type(result).__name__}, neither a Motion nor a Plan")
    motion = result if isinstance(result, Motion) else result.motion
    given, needed = (motion.q.shape[1], motion.timestep), (problem.arm.n_joints, problem.timestep)
    if not np.allclose(given, needed, rtol=1e-6):
        raise PlanError(
            "the planner's motion has {} joints and a time step of {:g} s, ".format(*given)
            + "the arm has {} joints and its model steps of {:g} s".format(*needed)
        )
    end_tolerance = 1e-3  # distance of a motion's ends from the start and target asked for [rad, m]
    for which, there, asked in (("begins", motion.q[0], problem.start), ("ends", motion.q[-1], problem.target)):
        missed = float(np.abs(there - asked).max())
        if missed > end_tolerance:
            raise PlanError(f"the planner's motion {which} {missed:.2g} (rad or m) from where it was asked to")
    check_motion(problem.arm, motion)
    return result


#: The default planner among obstacles: the LieEDNN planner with most successes and the smoothest motions there.
OBSTACLE_PLANNER = "lieednn-shaped"


def default_planner(arm: Arm) -> tuple[str, str]:
    """Name of the default planner for an arm in its scene, and the reason for the choice.

    Where three or more hinges move one link, the arm often cannot follow a network's own path, since the configuration
    nearest to it changes abruptly. There, and among obstacles, the default planner follows a guide's motion. Obstacles
    of an imported arm are also its floor, and whatever else of its model stands beside it.
    """
    among = arm.scene != "free" or arm.state is not None
    if arm.import_report is not None and not among:
        collisions = Collisions(arm)
        robots = arm.geometry.body_rootid[arm.geometry.geom_bodyid[collisions.pairs[~collisions.own]]]
        among = bool((robots[:, 0] != robots[:, 1]).any())
    if among:
        return OBSTACLE_PLANNER, "the default among obstacles"
    hinges = ({i for f in joint.factors if f.kind == "hinge" for i in f.indices} for joint in arm.joints.joints)
    redundant = 3  # hinges that move one link
    if any(len(turning) >= redundant for turning in hinges):
        return OBSTACLE_PLANNER, "the default where three or more hinges move a link"
    return "lieednn-certified", "the default without obstacles"


def plan(
    arm: Arm,
    target: Goal,
    *,
    planner: str | None = None,
    start: ArrayLike | str = "home",
    duration: Duration = USUAL_DURATION,
    seed: Seed = 0,
    options: PlannerOptions | None = None,
    fastest: bool = False,
    path_constraint: TaskSpaceRegion | None = None,
    payload: float = 0.0,
    settle: str | SettlingOptions | None = None,
) -> Plan:
    """Plan a motion from rest to rest within the arm's limits and free of contact.

    It may take a minute of CPU time, or what a surrounding `time_limit` allows. Planners that draw a fixed number of
    candidates report progress (`budget.reporting`).

    Args:
        arm: the arm, in its scene.
        target: a goal: joint target ``(n,)`` [rad, m], a keyframe's name, a pose of the end effector in the world, or
            a region of poses (`TaskSpaceRegion`). Or a set of goals: joint targets ``(m, n)``, poses of shape ``(m,)``,
            or a list of goals. A pose or region has several joint positions (`arm.ik_candidates`). The plan's target
            is, of all those to which the planner finds a motion, the one that is reached soonest
            (`motion.least_duration`).
        planner: a name of `PLANNERS`, or ``file.py:function`` of one's own; by default the `default_planner`, or
            ``lieednn-shaped`` where a region is kept.
        start: joint position at rest ``(n,)`` [rad, m], or a keyframe's name; ``home`` of a view is its state. A start
            beyond a limit by at most `Arm.start_tolerance` is moved to it. If the start is closer to something than the
            clearance, or at most that tolerance deep in it, the motion leads away from it (`Arm.leaving`), and
            `Plan.leaves` says what it is.
        duration: duration of the motion [s], rounded to a whole number of the model's time steps; or a pair of it and
            the longest duration that the motion may take if the arm's limits require it, which for a single number is
            three times as long. Learned networks always keep the duration.
        seed: seed of randomised planners; the same seed gives the same plan.
        options: options of the planner, of its class in `PLANNERS`; by default that class's defaults.
        fastest: retime the planned path to the arm's limits (`retime`). ``duration`` is then that of the motion
            before it is retimed, which is refused if the arm is too slow for it; so leave it out for slow arms.
        path_constraint: region in which the end effector stays on the way, such as a line or an orientation; start and
            target must be in it. Up to 0.5 mm and 0.1 degrees outside it are allowed. Only some planners can keep one.
        payload: mass at the end effector [kg]; the plan's arm has it, too (`Arm.with_payload`). With or without a
            payload, motions that need more force than the actuators have take longer.
        settle: a name of `settling.METHODS` or `SettlingOptions`: a time law on the planned path that leaves hanging or
            elastic parts nearly at rest (`settling.settled`). It keeps the duration if the limits and the swinging
            load's clearance allow that; with ``fastest`` it adds half a period of the slowest oscillation.

    Raises:
        InputError: a value is malformed, the planner is unknown, the options belong to another planner, start or target
            cannot be used, or ``settle`` is given but nothing in the model swings or bends.
        NoSolutionError: no goal can be reached.
        NotCertifiedError: no network could be certified.
        PlanError: the motion breaks a limit of the arm, or does not arrive; `TooFastError` if more time would suffice.
        OutOfTimeError: the time budget is spent.
        LieEDNNError: a library that the planner needs is not installed (see `PLANNERS.missing`).
    """
    if planner is None:
        planner = default_planner(arm)[0] if path_constraint is None else OBSTACLE_PLANNER
    entry = PLANNERS.find(planner)
    if path_constraint is not None and not entry.path_constraints:
        able = ", ".join(name for name, each in PLANNERS.items() if each.path_constraints)
        raise InputError(f"the planner {planner!r} cannot keep a region on the way; planners that can: {able}")
    given = given_options(f"the planner {planner!r}", entry.options, options)
    settling = SettlingOptions(settle) if isinstance(settle, str) else settle
    if fastest:
        optional_module("toppra")  # fail early if it is not installed
    begin, number = cpu_time(), as_seed("seed", seed)
    arm = arm.with_payload(payload)
    q = arm.check_start(start)
    free, leaves = arm.leaving(q)
    # Refuse a bad problem before searching for goals.
    shortest, longest = durations(duration)
    first = PlanningProblem(free, q, q, shortest, number, longest, path_constraint)
    check_held(arm, first.start[None], ["the start"])
    refusals: list[LieEDNNError] = [NoSolutionError("there is no goal")]
    # The matrices are so small that threads would only wait for each other.
    with default_limit(), one_blas_thread():
        for goal in candidates(arm, target, q, number, path_constraint):
            try:
                check_held(arm, goal[None], ["the target"])
                result = _solved(entry, replace(first, target=goal), *given)
                motion = retime(free, result.motion) if fastest else result.motion
                if settling is not None:
                    motion = settled(free, motion, settling, math.inf if fastest else longest, 0.5 * fastest)
                check_path_constraint(arm, path_constraint, motion)
            except (PlanError, NotCertifiedError) as error:
                if leaves:
                    error.args = (f"{error}; from the start the motion must leave what is near: {leaves}",)
                # A traceback refers to frames and these to their variables: it would keep the arm alive in a cycle.
                refusals = [error.with_traceback(None)]
            else:
                spent = cpu_time() - begin
                result = replace(result, motion=motion, target=goal, planner=planner, cpu_time=spent)
                return replace(result, arm=arm, leaves=leaves)
    raise refusals.pop()
