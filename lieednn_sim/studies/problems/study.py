"""Planners on published problems.

Columns are named as in robometrics (A. Fishman et al., github.com/fishbotics/robometrics); skipped problems are counted
separately from failed ones.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.budget import as_time_budget, cpu_time, one_blas_thread, time_limit
from lieednn_sim.errors import InputError, LieEDNNError, PlanError
from lieednn_sim.planning import Plan, plan, retime
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.guides import GuideOptions
from lieednn_sim.planning.motion import least_duration
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.registry import PLANNERS, optional_module
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets
from lieednn_sim.studies.rows import TableRow, column
from lieednn_sim.studies.study import Study
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import as_count
from lieednn_sim.values import Floats, check_fields, set_fields

SKIPPED = "skipped"
_TIMED = importlib.util.find_spec("toppra") is not None  # whether paths can be retimed to the arm's limits
# Starts and goals are close to obstacles, and the time budget is the only limit of the search. These values were chosen
# on problems that are not among the 100 of `PublishedProblems`.
_SEARCH = RrtConnectOptions(
    margin=0.002,
    max_collision_checks=(100_000_000,),
    longest_edge=0.025,
    spacings=(0.05, 0.02, 0.008),
    balanced=True,
    fastest=_TIMED,
)
OPTIONS: Mapping[str, PlannerOptions] = {
    "rrt-connect": _SEARCH,
    # Its guide is minimum jerk, or else the same search, for a fair comparison with it. A network may deviate a little,
    # since the check of its motion finds contacts. Fewer neurons rarely suffice for paths this long.
    "lieednn-shaped": ShapedOptions(
        guide=GuideOptions(optimised=False, search=_SEARCH), guides=100, deviation=1e-2, neurons=(64,)
    ),
}


@dataclass(frozen=True, slots=True)
class Solution(TableRow):
    """The result of a planner on a published problem.

    The reason of a failure begins with "skipped" if start or goal are invalid, with "plan" if the planner failed, with
    "problem" if the problem could not be read, and with "error" for anything else.
    """

    _key = ("problem", "number", "planner")

    problem: str  # name of the problem's set
    number: int  # number of the problem in its set
    planner: str
    success: bool = field(default=True, init=False)  # whether there is a motion within all limits and free of contact
    reason: str = ""
    solve_time: float | None = column(
        "solve time [s]",
        "CPU time of the planner, stopped at its budget; the one column that differs between runs",
        timed=True,
    )
    motion_time: float | None = column("motion time [s]", "that the motion takes")
    cspace_path_length: float | None = column(
        "C-space path [rad]", "Euclidean length of the path in joint coordinates, of slides in metres"
    )
    proved_fraction: float | None = column(
        "proved", "fraction of the motion's time over which it is proved, for every instant, that nothing touches"
    )

    @property
    def skipped(self) -> bool:
        """Whether the problem was skipped."""
        return self.reason.startswith(SKIPPED)


def solve(folder: str, name: str, number: int, planner: str, budget: float) -> list[Solution]:
    """The row of a planner and a problem, with the reason for a failure; bugs are raised."""
    with one_blas_thread():
        try:
            arm, start, goal = _sets(folder).problem(name, number)
        except LieEDNNError as error:
            return failed(folder, name, number, planner, budget, f"problem: {error}")
        try:
            for what, q in (("start", start), ("goal", goal)):
                arm.check_reachable(q, what)
        except InputError as error:
            return failed(folder, name, number, planner, budget, f"{SKIPPED}: {error}")
        if _TIMED:
            optional_module("toppra")  # which loads Matplotlib, once in a process
        started = cpu_time()
        try:
            with time_limit(budget):
                result = _planned(arm, start, goal, planner)
        except LieEDNNError as error:
            return failed(folder, name, number, planner, budget, f"plan: {error}")
        result = replace(result, cpu_time=cpu_time() - started)
        return [Solution(name, number, planner, **measured(result))]


def _planned(arm: Arm, start: Floats, goal: Floats, planner: str) -> Plan:
    """A plan, retimed to the arm's limits where toppra is installed."""
    least = max(0.1, least_duration(arm, start, goal))
    result = plan(
        arm, goal, planner=planner, start=start, duration=(least, 100.0 * least), options=OPTIONS.get(planner)
    )
    if _TIMED and planner not in OPTIONS:  # those planners retime their motions themselves
        # Not plan(fastest=True), which rejects the plan if a path that barely clears an obstacle touches it at its new
        # samples; here the motion is then kept as it is.
        with contextlib.suppress(PlanError):
            result = replace(result, motion=retime(arm, result.motion))
    return result


def failed(_folder: str, name: str, number: int, planner: str, _budget: float, reason: str) -> list[Solution]:
    """The row of a failed problem, with the reason."""
    return [Solution(name, number, planner, reason=reason)]


# Cached, since a process solves the problems of one robot.
_sets = lru_cache(maxsize=1)(ProblemSets)


def measured(result: Plan) -> dict[str, Any]:
    """The measured columns of a plan."""
    motion = result.motion
    return {
        "solve_time": result.cpu_time,
        "motion_time": float(motion.t[-1]),
        "cspace_path_length": float(np.linalg.norm(np.diff(motion.q, axis=0), axis=1).sum()),
        "proved_fraction": result.clearance.proved_fraction,
    }


@dataclass(frozen=True)
class PublishedProblems(Study[Solution]):
    """Planners on the published problems of one robot."""

    name, kind = "problems", Solution
    run, failed = staticmethod(solve), staticmethod(failed)

    sets: ProblemSets
    planners: Sequence[str] = ("minimum-jerk", "rrt-connect", "lieednn-shaped")  # names of `PLANNERS`
    problems: int | None = 100  # how many, chosen by `ProblemSets.selection`; None for all
    time_budget: float = 10.0  # CPU time for each problem [s]

    def __post_init__(self) -> None:
        chosen = list(dict.fromkeys(self.planners))
        for name in chosen:
            PLANNERS.require(name)
        set_fields(self, planners=chosen, time_budget=as_time_budget("time_budget", self.time_budget))
        if self.problems is not None:
            check_fields(self, as_count, "problems")

    def settings(self) -> Mapping[str, Any]:
        """See `Study`."""
        return {"robot": self.sets.robot, "data": self.sets.fingerprint, "time_budget": self.time_budget}

    def todo(self, table: Table[Solution]) -> list[tuple[str, str, int, str, float]]:
        """See `Study`."""
        target = [(*key, name) for key in self.sets.selection(self.problems) for name in self.planners]
        return [(str(self.sets.folder), *key, self.time_budget) for key in target if key not in table.rows]
