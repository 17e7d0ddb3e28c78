"""One case of a comparison: an arm in a scene, a planner and a seed, planned once and tracked by each controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, cpu_time
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.evaluation import Evaluation, MotionMetrics
from lieednn_sim.evaluation.metrics import evaluate, motion_metrics
from lieednn_sim.planning import Plan, find_tube, plan, reference_network
from lieednn_sim.simulation import Disturbances, Rollout, simulate
from lieednn_sim.simulation.tracking import as_hold
from lieednn_sim.studies.comparison.rows import BY_NAME, Case, Row
from lieednn_sim.studies.user_files import SCENE, UserFile, load
from lieednn_sim.validation import as_positive
from lieednn_sim.values import Floats, check_fields, set_fields

FREE = "free"


@dataclass(frozen=True)
class Settings:
    """Settings shared by all rows of a table.

    Attributes:
        duration: duration of every motion [s].
        hold: time simulated after it [s].
        mass_scale: true masses relative to those that the controller knows.
        time_budget: largest CPU time for planning a case [s].

    Raises:
        InputError: a value is out of range.
    """

    duration: float = 4.0
    hold: float = 1.0
    mass_scale: float = 1.0
    time_budget: float = DEFAULT_TIME_BUDGET

    def __post_init__(self) -> None:
        check_fields(self, as_positive, "duration", "mass_scale", "time_budget")
        set_fields(self, hold=as_hold(self.hold))


@lru_cache(maxsize=4)
def load_arm(name: str, scene: str, seed: int, user_files: tuple[UserFile, ...] = ()) -> Arm:
    """The arm in its scene; warms up what is computed once per process, so that no planning time includes it."""
    arm = load(name, scene, seed, user_files)
    try:
        reference_network(arm)
        plan(arm, arm.keyframe("home"), planner="minimum-jerk", duration=100 * arm.timestep)
    except LieEDNNError:
        pass  # reported where it is needed
    return arm


def arm_and_target(name: str, scene: str, seed: int, user_files: tuple[UserFile, ...] = ()) -> tuple[Arm, Floats]:
    """The arm, and a random target ``(n,)`` for its scene; the same for every planner.

    Args:
        name: name of the arm.
        scene: name of the scene.
        seed: seed of obstacles and target.
        user_files: arms and scenes from files, by their names.

    Raises:
        FileError: a file no longer exists.
        InputError: the arm or scene is unknown, or they do not fit together.
        NoSolutionError: no target was found.
    """
    result = _arm_and_target(name, scene, seed, tuple(user_files))
    if isinstance(result, LieEDNNError):
        raise result
    return result


@lru_cache(maxsize=4)
def _arm_and_target(
    name: str, scene: str, seed: int, user_files: tuple[UserFile, ...]
) -> tuple[Arm, Floats] | LieEDNNError:
    """`arm_and_target`, or its error, so that a failed search is not repeated for each planner."""
    # Without random obstacles the arm does not depend on the seed, and is shared.
    drawn = scene != FREE and (SCENE, scene) not in {file[:2] for file in user_files}
    try:
        arm = load_arm(name, scene, seed if drawn else 0, user_files)
        return arm, draw_target(arm, seed)
    except LieEDNNError as error:
        return error


def _plan(case: Case, arm: Arm, target: Floats, settings: Settings) -> Plan:
    return plan(
        arm,
        target,
        planner=case.planner,
        duration=settings.duration,
        seed=case.seed,
        time_budget=settings.time_budget,
    )


def run_case(
    case: Case, controllers: Sequence[str], settings: Settings, *, user_files: tuple[UserFile, ...] = ()
) -> list[Row]:
    """Plan once and track with every controller: one row each, with the reason for a failure; bugs are raised.

    Arms and scenes from files are found by their names in ``user_files``. The planning time is CPU time of this
    thread, with one BLAS thread.
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
            spent = cpu_time() - start
            return failed_case(case, controllers, settings, f"plan: {error}", planning_s=spent)
        except Exception as error:
            error.add_note(f"while planning the case {case}")
            raise
        planned = {"planning_s": cpu_time() - start, **_stability(plan.network)}
        planned |= {"tube_mm": _tube_mm(arm, plan), **_measured(motion_metrics(arm, plan.motion))}
        rows = []
        for name in controllers:
            try:
                evaluation = evaluate(_simulate(arm, plan, name, settings))
            except LieEDNNError as error:
                rows += failed_case(case, [name], settings, f"simulation: {error}", **planned)
            else:
                values = _measured(evaluation) | planned
                rows.append(_row(case, name, settings, evaluation.shortfall, **values))
        return rows


def failed_case(case: Case, controllers: Sequence[str], settings: Settings, reason: str, **values: Any) -> list[Row]:
    """Rows of a failed case, with the reason and the values measured before."""
    return [_row(case, name, settings, reason, **values) for name in controllers]


def _row(case: Case, controller: str, settings: Settings, reason: str, **values: Any) -> Row:
    keys = {**asdict(case), "controller": controller, "mass_scale": settings.mass_scale}
    return Row(**keys, reason=reason, **values)


def replay(case: Case, controller: str, settings: Settings, *, user_files: tuple[UserFile, ...] = ()) -> Rollout:
    """Plan and simulate a case again, to render or plot it.

    Raises:
        LieEDNNError: it cannot be planned or simulated.
    """
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
    local = "local" if verdict.level == "local" else "none"
    return {"stability": "global" if verdict.globally_stable else local, "stability_level": verdict.level}


def _tube_mm(arm: Arm, result: Plan) -> float | None:
    """Size of the plan's tube [mm]; None if it has none."""
    try:
        return 1e3 * find_tube(arm, result).size
    except LieEDNNError:
        return None


def _measured(metrics: MotionMetrics | Evaluation) -> dict[str, Any]:
    return {name: getattr(metrics, name) for name in BY_NAME if hasattr(metrics, name)}
