"""The reactive benchmark: each policy on an arm in a scene, under each disturbance; see `summary.METHOD`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import LIMIT_MARGIN
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.planning import Plan, ShapedOptions, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies import FilteredPolicy, Policy, make_policy
from lieednn_sim.policies.making import FOLLOWERS
from lieednn_sim.registry import POLICIES
from lieednn_sim.simulation import Disturbances, Following, Push, follow
from lieednn_sim.studies.comparison.case import FREE, arm_and_target
from lieednn_sim.studies.reactions.disturbing import PUSH_TIME, UndisturbedPath, pushing_force, walking_pole
from lieednn_sim.studies.rows import TableRow, column, columns_of
from lieednn_sim.studies.study import Study
from lieednn_sim.studies.table import Table
from lieednn_sim.studies.user_files import UserFiles
from lieednn_sim.validation import as_count
from lieednn_sim.values import Floats, check_fields, frozen


class ComparedPolicy(NamedTuple):
    """A policy of the benchmark: a name of `POLICIES`, and whether it needs the safety filter among obstacles."""

    policy: str
    options: PlannerOptions | None = None
    filtered: bool = True


COMPARED: dict[str, ComparedPolicy] = {
    **{f"lieednn-shaped, rho {r:g}": ComparedPolicy("lieednn-shaped", ShapedOptions(rate=r)) for r in (1, 0.3, 0.1)},
    "lieednn-certified": ComparedPolicy("lieednn-certified"),
    "lieednn-replanning": ComparedPolicy("lieednn-replanning", filtered=False),
    "linear-attractor": ComparedPolicy("linear-attractor"),
    "dmp": ComparedPolicy("dmp"),
    "fabric": ComparedPolicy("fabric", filtered=False),
    "mppi": ComparedPolicy("mppi", filtered=False),
    "tracker": ComparedPolicy("tracker", filtered=False),
}
DISTURBANCES = ("none", "push", "payload", "target", "obstacle")


@dataclass(frozen=True, slots=True)
class Reaction(TableRow):
    """A row of the benchmark of disturbed policies: one rollout.

    Attributes:
        arm, scene: names; together with the next three, the key of the row.
        policy, disturbance: names of `COMPARED` or `POLICIES`, and of `DISTURBANCES`.
        seed: seed of target, obstacles and disturbance.
        success: whether every link ends within 1 mm and 0.1 degrees of the target without contact.
        reason: why the rollout failed; begins with "problem", "plan", "simulation", "contact", "arrival" or "error".
    """

    _key = ("arm", "scene", "policy", "disturbance", "seed")

    arm: str
    scene: str
    policy: str
    disturbance: str
    seed: int
    success: bool = field(default=True, init=False)
    reason: str = ""
    push_n: float | None = column("push [N]", "force that takes a joint a tenth of its range off that path")
    final_mm: float | None = column("final [mm]", "distance of the worst link from its target at the end")
    deviation: float | None = column("deviation [ranges]", "largest distance of a joint from the undisturbed path")
    back_s: float | None = column(
        "back after [s]", "time after the disturbance until it stays within a tenth of that; none where it does not"
    )
    back_fraction: float | None = column("of path left", "covered by then, as a fraction of the path that was left")
    effort: float | None = column("effort [s]", "integral of the mean squared actuator force in units of the limits")
    velocity_fraction: float | None = column("velocity / limit", "largest joint velocity in units of its limit")
    force_fraction: float | None = column(
        "force / limit", "largest actuator force in units of its limit in the weaker direction"
    )
    path_m: float | None = column("path [m]", "length of the end effector's path")
    settled_s: float | None = column("settled after [s]", "time from which it stays within 1 mm and 0.1 degrees")
    step_us: float | None = column("control step [us]", "median CPU time of a control step", timed=True)

    @property
    def posed(self) -> bool:
        """Whether there was a problem to solve; a pole may find no place in the arm's way."""
        return not self.reason.startswith("problem")


MEASURED = columns_of(Reaction)
_DURATION = 7.0  # duration of a simulation [s]


@frozen
class Task:
    """An arm among its obstacles, a joint target ``(n,)``, and the guide's motion to it that policies imitate."""

    arm: Arm
    scene: str
    target: Floats
    motion: Motion
    seed: int  # of target, obstacles, disturbances and policies

    def policy(self, name: str, *, obstructed: bool = False) -> Policy:
        """A policy for this task, or for one with a moving obstacle; those of users get no safety filter."""
        kind, options, filtered = COMPARED.get(name) or ComparedPolicy(name, filtered=POLICIES.find(name).own)
        goal = Plan(self.motion, target=self.target) if kind in FOLLOWERS else self.target
        policy = make_policy(kind, self.arm, goal, rate=100.0, convergence_rate=2.0, options=options, seed=self.seed)
        if filtered and (obstructed or self.scene != FREE):
            policy = FilteredPolicy(policy)
            policy.reset(self.motion.q[0])
        return policy


def run_reactions(arm: str, scene: str, policy: str, seed: int, *, user_files: UserFiles = ()) -> list[Reaction]:
    """As `run_case`: run a policy under each disturbance, one row each, with the reason for a failure."""
    with one_blas_thread():
        try:
            task = _task(arm, scene, seed, user_files)
        except LieEDNNError as error:
            return failed_reactions(arm, scene, policy, seed, f"problem: {error}")
        try:
            result = task.policy(policy)
            nominal = _run(result, task.target)
        except LieEDNNError as error:
            return failed_reactions(arm, scene, policy, seed, f"plan: {error}")
        path = UndisturbedPath(task.arm, nominal.rollout.q)
        _, gone = path.nearest(nominal.rollout.q)
        begin = float(nominal.rollout.t[np.argmax(gone >= 0.35)])
        rows = [_row(task, policy, "none", nominal)]
        for disturbance in DISTURBANCES[1:]:
            if disturbance == "obstacle":
                rows.append(_obstructed(task, policy, nominal, gone, begin))
                continue
            try:
                targets, changes, end = _disturbed(task, result, disturbance, begin, path)
                following = _run(result, targets, changes)
            except LieEDNNError as error:
                rows.append(Reaction(arm, scene, policy, disturbance, seed, reason=f"simulation: {error}"))
                continue
            row = _row(task, policy, disturbance, following)
            if changes is not None:
                back = path.recovery(following.rollout.t, following.rollout.q, begin, end)
                row = replace(row, deviation=back.deviation, back_s=back.time_s, back_fraction=back.fraction)
                if disturbance == "push":
                    row = replace(row, push_n=float(np.linalg.norm(changes.pushes[0].force)))
            rows.append(row)
        return rows


def failed_reactions(arm: str, scene: str, policy: str, seed: int, reason: str) -> list[Reaction]:
    """Rows of a policy that could not be run, with the reason."""
    return [Reaction(arm, scene, policy, name, seed, reason=reason) for name in DISTURBANCES]


@lru_cache(maxsize=2)
def _task(name: str, scene: str, seed: int, user_files: UserFiles) -> Task:
    arm, target = arm_and_target(name, scene, seed, user_files)
    shown = plan(arm, target, planner="lieednn-shaped", seed=seed)
    return Task(arm, scene, target, (shown.guide or shown).motion, seed)


def _run(policy: Policy, targets: Floats, changes: Disturbances | None = None, lasts: float = _DURATION) -> Following:
    return follow(policy, targets, lasts, controller="inverse-dynamics", disturbances=changes)


def _row(task: Task, policy: str, disturbance: str, following: Following) -> Reaction:
    rollout = following.rollout
    evaluation = evaluate(rollout, clearance=False)
    use = np.mean((rollout.force / rollout.arm.force_limits) ** 2, axis=1)
    key = task.arm.name, task.scene, policy, disturbance, task.seed
    return Reaction(
        *key,
        reason=evaluation.shortfall,
        final_mm=evaluation.final_worst_mm,
        effort=float(use.sum() * rollout.timestep),
        velocity_fraction=evaluation.velocity_fraction,
        force_fraction=evaluation.force_fraction,
        path_m=evaluation.path_m,
        settled_s=evaluation.settling_s,
        step_us=1e6 * float(np.median(following.step_time)),
    )


def _obstructed(task: Task, policy: str, nominal: Following, gone: Floats, begin: float) -> Reaction:
    """The row of a run in which a pole walks into the arm's way; until then the run is the undisturbed one."""
    kind, ran = "obstacle", nominal.rollout
    rng = np.random.default_rng([task.seed, DISTURBANCES.index(kind)])
    step = "problem"
    try:
        arm, pole = walking_pole(task.arm, ran.t, ran.q, gone, begin, rng)
        step = "simulation"
        result = replace(task, arm=arm).policy(policy, obstructed=True)
        following = _run(result, task.target, Disturbances(obstacles=(pole,)))
    except LieEDNNError as error:
        return Reaction(task.arm.name, task.scene, policy, kind, task.seed, reason=f"{step}: {error}")
    return _row(task, policy, kind, following)


def _disturbed(
    task: Task, policy: Policy, disturbance: str, begin: float, path: UndisturbedPath
) -> tuple[Floats, Disturbances | None, float]:
    """Targets, disturbances, and the time at which the disturbances end [s]."""
    arm, rng = task.arm, np.random.default_rng([task.seed, DISTURBANCES.index(disturbance)])
    if disturbance == "push":
        link, direction = int(rng.integers(arm.n_links)), rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        end = begin + PUSH_TIME

        def pushed(force: float) -> Disturbances:
            return Disturbances(pushes=(Push(arm.link_names[link], (*(force * direction),), begin, PUSH_TIME),))

        def deviation_under(force: float) -> float:
            rollout = _run(policy, task.target, pushed(force), end + PUSH_TIME).rollout
            return path.recovery(rollout.t, rollout.q, begin, end).deviation

        return task.target, pushed(pushing_force(deviation_under)), end
    if disturbance == "payload":
        push = Push("end effector", (0.0, 0.0, -10.0), begin, _DURATION)
        return task.target, Disturbances(pushes=(push,)), begin
    # Targets keep the distance from limits that other random targets have: the safety filter stops before limits.
    inset = LIMIT_MARGIN * arm.ranges[:, None] * [1.0, -1.0]
    inner = replace(arm, position_limits=arm.position_limits + inset)
    moved = task.target
    for _ in range(100):
        drawn = task.target + 0.1 * arm.ranges * rng.uniform(-1.0, 1.0, arm.n_joints)
        drawn = inner.within_angles(np.clip(drawn, *inner.position_limits.T))
        if not arm.near_contacts(drawn):
            moved = drawn
            break
    rows = np.arange(round(_DURATION / arm.timestep) + 1) * arm.timestep < begin
    return np.where(rows[:, None], task.target, moved), None, begin


@dataclass(frozen=True)
class Reactions(Study[Reaction]):
    """The reactive benchmark: each policy on all arms in all scenes, under each of `DISTURBANCES`."""

    name, kind = "reactions", Reaction
    run, failed = staticmethod(run_reactions), staticmethod(failed_reactions)

    arms: Sequence[str]  # names
    scenes: Sequence[str]
    seeds: int  # number of them, starting at 0
    policies: Sequence[str] = tuple(COMPARED)  # names of `COMPARED` or `POLICIES`, or ``file.py:function``
    user_files: UserFiles = ()  # arms and scenes from files, by their names; see `Comparison.user_files`

    def __post_init__(self) -> None:
        check_fields(self, as_count, "seeds")
        for name in sorted({*self.policies} - {*COMPARED}):
            POLICIES.find(name)  # which adds those of files

    def todo(self, table: Table[Reaction]) -> list[tuple[str, str, str, int]]:
        """See `Study`; seeds first, so that an early stop leaves all policies on all arms."""
        return [
            (arm, scene, policy, seed)
            for seed, arm, scene, policy in itertools.product(range(self.seeds), self.arms, self.scenes, self.policies)
            if any((arm, scene, policy, name, seed) not in table.rows for name in DISTURBANCES)
        ]
