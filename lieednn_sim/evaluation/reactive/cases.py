"""One case of the reactive benchmark: an arm in a scene, a leader, a disturbance and a seed, in the closed loop."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm.targets import LIMIT_MARGIN
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.cases import FREE, arm_and_target
from lieednn_sim.evaluation.entries import Entry
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.evaluation.reactive.leaders import LEADERS
from lieednn_sim.evaluation.reactive.protocol import Assignment, Leader, Setpoints
from lieednn_sim.evaluation.reactive.recovery import PUSH_TIME, Path, pushing_force
from lieednn_sim.evaluation.rows import TableRow, column, columns_of, outcome
from lieednn_sim.planning import plan
from lieednn_sim.planning.filtering import FilterOptions
from lieednn_sim.simulation import Disturbances, Feedback, Push, Rollout, Simulation
from lieednn_sim.simulation.closed_loop import closed_loop
from lieednn_sim.values import Floats

DISTURBANCES = ("none", "push", "payload", "target")
# Simulated time [s], control rate [Hz], and the share of the leader's own path at which it is disturbed.
_DURATION, _RATE, _AT = 7.0, 100.0, 0.35
# Weight of the payload [N], largest step of the target as a share of the ranges, and tries to draw one.
_WEIGHT, _STEP, _DRAWS = 10.0, 0.1, 100


@dataclass(frozen=True, slots=True)
class Reaction(TableRow):
    """A row of the benchmark.

    Attributes:
        arm: name of the arm; together with the next four, the key of the row.
        scene: name of its scene.
        leader: a name of `LEADERS`.
        disturbance: a name of `DISTURBANCES`.
        seed: seed of target, obstacles and disturbance.
        success: whether every link ends within 1 mm and 0.1 degrees of the target without contact.
        reason: why it does not; begins with "problem", "plan", "simulation", "contact", "arrival" or "error".
    """

    _key = ("arm", "scene", "leader", "disturbance", "seed")
    _digits = 4

    arm: str
    scene: str
    leader: str
    disturbance: str
    seed: int
    success: bool = outcome()
    reason: str = ""
    push_n: float | None = column("push [N]", "force that takes a joint a tenth of its range off that way")
    final_mm: float | None = column("final [mm]", "distance of the worst link from its target at the end")
    off: float | None = column("off [ranges]", "largest deviation of a joint from the leader's undisturbed way")
    back_s: float | None = column(
        "back after [s]", "time after the disturbance until it stays within a tenth of that; none where it does not"
    )
    back_share: float | None = column("of the way left", "of the way that was left, how much was gone then")
    effort: float | None = column("effort [s]", "integral of the mean squared actuator force in units of the limits")
    velocity_share: float | None = column("velocity / limit", "largest joint velocity in units of its limit")
    force_share: float | None = column(
        "force / limit", "largest actuator force in units of its limit in the weaker direction"
    )
    step_us: float | None = column("control step [us]", "median CPU time of a control step")


MEASURED = columns_of(Reaction)


def run_reactions(arm: str, scene: str, leader: str, seed: int, *, entries: tuple[Entry, ...] = ()) -> list[Reaction]:
    """One row for each disturbance of a leader, with the reason for a failure.

    Arms and scenes from files are found by their names among the entries.
    """
    with one_blas_thread():
        try:
            task = _task(arm, scene, seed, entries)
        except LieEDNNError as error:
            return failed_reactions(arm, scene, leader, seed, f"problem: {error}")
        try:
            nominal, steps = _run(task, LEADERS[leader](task), task.target[None])
        except LieEDNNError as error:
            return failed_reactions(arm, scene, leader, seed, f"plan: {error}")
        path = Path(task.arm, nominal.q)
        _, gone = path.nearest(nominal.q)
        begin = float(nominal.t[np.argmax(gone >= _AT)])
        rows = [_row(task, scene, leader, "none", nominal, steps)]
        for disturbance in DISTURBANCES[1:]:
            try:
                targets, changes, end = _disturbed(task, leader, disturbance, begin, path)
                rollout, steps = _run(task, LEADERS[leader](task), targets, changes)
            except LieEDNNError as error:
                rows.append(Reaction(arm, scene, leader, disturbance, seed, reason=f"simulation: {error}"))
                continue
            row = _row(task, scene, leader, disturbance, rollout, steps)
            if changes is not None:
                recovery = path.recovery(rollout.t, rollout.q, begin, end)
                row = replace(row, off=recovery.off, back_s=recovery.time_s, back_share=recovery.share)
            if disturbance == "push" and changes is not None:
                row = replace(row, push_n=float(np.linalg.norm(changes.pushes[0].force)))
            rows.append(row)
        return rows


def failed_reactions(arm: str, scene: str, leader: str, seed: int, reason: str) -> list[Reaction]:
    """Rows of a leader that could not be run, with the reason."""
    return [Reaction(arm, scene, leader, name, seed, reason=reason) for name in DISTURBANCES]


@lru_cache(maxsize=2)
def _task(name: str, scene: str, seed: int, entries: tuple[Entry, ...]) -> Assignment:
    arm, target = arm_and_target(name, scene, seed, entries)
    # The motion of the shaped networks' teacher, which is the same for all leaders that learn from one.
    shown = plan(arm, target, planner="lieednn-shaped", seed=seed)
    feedback = Feedback(safety=None if scene == FREE else FilterOptions())
    steps = round(1.0 / (_RATE * arm.timestep))
    motion = shown.motion if shown.teacher is None else shown.teacher.motion
    return Assignment(arm, arm.keyframe("home"), target, motion, steps, feedback, seed)


def _run(
    task: Assignment, leader: Leader, targets: Floats, changes: Disturbances | None = None, duration: float = _DURATION
) -> tuple[Rollout, list[float]]:
    """A rollout, with its final target, and the CPU times of its control steps [s]."""
    spent: list[float] = []

    def lead(target: Floats, simulation: Simulation) -> Setpoints:
        begun = time.thread_time()
        rows = leader(target, simulation)
        spent.append(time.thread_time() - begun)
        return rows

    rollout, seen = closed_loop(
        task.arm,
        lead,
        targets,
        duration,
        start=task.start,
        period=task.steps,
        controller="inverse-dynamics",
        disturbances=changes,
    )
    return replace(rollout, target=seen[-1]), spent


def _row(task: Assignment, scene: str, leader: str, disturbance: str, rollout: Rollout, spent: list[float]) -> Reaction:
    evaluation = evaluate(rollout, clearance=False)
    use = np.mean((rollout.force / rollout.arm.force_limits) ** 2, axis=1)
    return Reaction(
        task.arm.name,
        scene,
        leader,
        disturbance,
        task.seed,
        reason=evaluation.shortfall,
        final_mm=evaluation.final_worst_mm,
        effort=float(use.sum() * rollout.timestep),
        velocity_share=evaluation.velocity_share,
        force_share=evaluation.force_share,
        step_us=1e6 * float(np.median(spent)),
    )


def _disturbed(
    task: Assignment, leader: str, disturbance: str, begin: float, path: Path
) -> tuple[Floats, Disturbances | None, float]:
    """Targets, disturbances, and the time at which they are over [s]."""
    arm, rng = task.arm, np.random.default_rng([task.seed, DISTURBANCES.index(disturbance)])
    if disturbance == "push":
        link, direction = int(rng.integers(arm.n_links)), rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        end = begin + PUSH_TIME

        def pushed(force: float) -> Disturbances:
            return Disturbances(pushes=(Push(arm.link_names[link], (*(force * direction),), begin, PUSH_TIME),))

        def off(force: float) -> float:
            rollout, _ = _run(task, LEADERS[leader](task), task.target[None], pushed(force), end + PUSH_TIME)
            return path.recovery(rollout.t, rollout.q, begin, end).off

        return task.target[None], pushed(pushing_force(off)), end
    if disturbance == "payload":
        push = Push("end effector", (0.0, 0.0, -_WEIGHT), begin, _DURATION)
        return task.target[None], Disturbances(pushes=(push,)), begin
    # As far from the limits as other random targets, since the safety filter stops short of limits.
    inset = LIMIT_MARGIN * arm.ranges[:, None] * [1.0, -1.0]
    inner = replace(arm, position_limits=arm.position_limits + inset)
    moved = task.target
    for _ in range(_DRAWS):
        drawn = task.target + _STEP * arm.ranges * rng.uniform(-1.0, 1.0, arm.n_joints)
        drawn = inner.within_angles(np.clip(drawn, *inner.position_limits.T))
        if not arm.near_contacts(drawn):
            moved = drawn
            break
    rows = np.arange(round(_DURATION / arm.timestep) + 1) * arm.timestep < begin
    return np.where(rows[:, None], task.target, moved), None, begin
