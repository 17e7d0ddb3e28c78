"""How a case of the comparison is computed: an arm in a scene, a planner and a seed, planned once, and tracked."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, cpu_time, one_blas_thread, time_limit
from lieednn_sim.errors import FileError, InputError, LieEDNNError, NoSolutionError
from lieednn_sim.evaluation.evaluation import Evaluation, MotionMetrics
from lieednn_sim.evaluation.metrics import evaluate, motion_metrics
from lieednn_sim.planning import Plan, find_tube, plan, reference_network
from lieednn_sim.simulation import Disturbances, Rollout, simulate
from lieednn_sim.simulation.tracking import as_hold
from lieednn_sim.studies.comparison.rows import BY_NAME, Case, Row
from lieednn_sim.studies.table import Table
from lieednn_sim.studies.user_files import SCENE, UserFiles, load
from lieednn_sim.validation import as_positive
from lieednn_sim.values import Floats, check_fields, set_fields

FREE = "free"


@dataclass(frozen=True)
class Settings:
    """Settings shared by all rows of a table.

    Attributes:
        duration: duration of every motion [s].
        hold: time simulated after the motion [s].
        mass_scale: true masses relative to those that the controller knows.
        time_budget: largest CPU time for planning a case [s].
    """

    duration: float = 4.0
    hold: float = 1.0
    mass_scale: float = 1.0
    time_budget: float = DEFAULT_TIME_BUDGET

    def __post_init__(self) -> None:
        check_fields(self, as_positive, "duration", "mass_scale", "time_budget")
        set_fields(self, hold=as_hold(self.hold))


@lru_cache(maxsize=4)
def load_arm(name: str, scene: str, seed: int, user_files: UserFiles = ()) -> Arm:
    """The arm in its scene; also makes what a process computes only once, so that no planning time includes it."""
    arm = load(name, scene, seed, user_files)
    with contextlib.suppress(LieEDNNError):  # the cases report it
        reference_network(arm)
        plan(arm, (arm.keyframe("home") + 0.01).clip(*arm.position_limits.T), planner="lieednn-shaped")
    return arm


def arm_and_target(name: str, scene: str, seed: int, user_files: UserFiles = ()) -> tuple[Arm, Floats]:
    """The arm, and a random target ``(n,)`` in its scene, the same for every planner; raises if there is none."""
    result = _arm_and_target(name, scene, seed, tuple(user_files))
    if isinstance(result, str):
        raise NoSolutionError(result)
    return result


@lru_cache(maxsize=4)
def _arm_and_target(name: str, scene: str, seed: int, user_files: UserFiles) -> tuple[Arm, Floats] | str:
    """`arm_and_target`, or its error's message, so that a failed search is not repeated for each planner."""
    # Without random obstacles the arm does not depend on the seed, and is shared.
    drawn = scene != FREE and (SCENE, scene) not in {file[:2] for file in user_files}
    try:
        arm = load_arm(name, scene, seed if drawn else 0, user_files)
        return arm, draw_target(arm, seed)
    except LieEDNNError as error:
        return str(error)


def _plan(case: Case, arm: Arm, target: Floats, settings: Settings) -> Plan:
    with time_limit(settings.time_budget):
        return plan(arm, target, planner=case.planner, duration=settings.duration, seed=case.seed)


def run_case(case: Case, controllers: Sequence[str], settings: Settings, *, user_files: UserFiles = ()) -> list[Row]:
    """Plan once and track with every controller: one row each, with the reason for a failure; bugs are raised.

    Arms and scenes from files are found by their names in ``user_files``. Planning times are CPU times of one thread.
    """
    with one_blas_thread():
        try:
            arm, target = arm_and_target(case.arm, case.scene, case.seed, user_files)
        except LieEDNNError as error:
            return failed_case(case, controllers, settings, f"problem: {error}")
        start = cpu_time()
        try:
            plan = _plan(case, arm, target, settings)
        except LieEDNNError as error:
            return failed_case(case, controllers, settings, f"plan: {error}", planning_s=cpu_time() - start)
        except Exception as error:
            error.add_note(f"while planning the case {case}")
            raise
        planned = {"planning_s": cpu_time() - start, **_stability(plan.network)}
        planned |= {**_measured(motion_metrics(arm, plan.motion)), "proved_fraction": plan.clearance.proved_fraction}
        if plan.clearance.bound > 0.0:
            planned["proved_clearance_mm"] = 1e3 * plan.clearance.bound
        with contextlib.suppress(LieEDNNError):  # the plan has no tube
            planned["tube_mm"] = 1e3 * find_tube(arm, plan).size
        rows = []
        for name in controllers:
            try:
                evaluation = evaluate(_simulate(arm, plan, name, settings))
                reason, values = evaluation.shortfall, _measured(evaluation) | planned
            except LieEDNNError as error:
                reason, values = f"simulation: {error}", planned
            rows += failed_case(case, [name], settings, reason, **values)
        return rows


def failed_case(case: Case, controllers: Sequence[str], settings: Settings, reason: str, **values: Any) -> list[Row]:
    """Rows of a failed case, with the reason and the values measured before."""
    shared = {**asdict(case), "mass_scale": settings.mass_scale, "reason": reason, **values}
    return [Row(controller=name, **shared) for name in controllers]


def replay(case: Case, controller: str, settings: Settings, *, user_files: UserFiles = ()) -> Rollout:
    """Plan and simulate a case again, to render or plot it; `LieEDNNError` if it cannot be planned or simulated."""
    with one_blas_thread():
        arm, target = arm_and_target(case.arm, case.scene, case.seed, user_files)
        return _simulate(arm, _plan(case, arm, target, settings), controller, settings)


def _simulate(arm: Arm, result: Plan, controller: str, settings: Settings) -> Rollout:
    heavier = Disturbances(mass_scale=settings.mass_scale)
    return simulate(arm, result, controller=controller, hold=settings.hold, disturbances=heavier)


def _stability(network: Any) -> dict[str, Any]:
    """The network's proven stability, global, local or none, and its level; "-" without a network."""
    if network is None:
        return {"stability": "-", "stability_level": "-"}
    verdict = network.assess()
    proved = "global" if verdict.globally_stable else "local" if verdict.level == "local" else "none"
    return {"stability": proved, "stability_level": verdict.level}


def _measured(metrics: MotionMetrics | Evaluation) -> dict[str, Any]:
    return {name: getattr(metrics, name) for name in BY_NAME if hasattr(metrics, name)}


def settings_of(table: Table[Row]) -> Settings:
    """The settings of a comparison's rows; `FileError` if its table holds none."""
    try:
        return Settings(**table.settings)
    except (TypeError, InputError) as error:
        raise FileError(f"{table.path} holds no settings of a comparison: {error}") from None
