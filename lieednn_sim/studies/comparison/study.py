"""The comparison of planners: arms, scenes, planners, controllers and seeds in one table.

A case is an arm in a scene, a planner and a seed, planned once and tracked by each controller.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, cpu_time, one_blas_thread, time_limit
from lieednn_sim.errors import FileError, InputError, LieEDNNError, NoSolutionError
from lieednn_sim.evaluation.evaluation import Evaluation, MotionMetrics
from lieednn_sim.evaluation.metrics import evaluate, motion_metrics
from lieednn_sim.planning import Plan, find_tube, plan, reference_network
from lieednn_sim.registry import CONTROLLERS, DEFAULT_ARMS, PLANNERS, SCENES, SLOW
from lieednn_sim.simulation import Disturbances, Rollout, simulate
from lieednn_sim.simulation.tracking import as_hold
from lieednn_sim.studies.comparison.rows import BY_NAME, Case, Row
from lieednn_sim.studies.study import Study, compute
from lieednn_sim.studies.table import SUFFIX, Table
from lieednn_sim.studies.user_files import ARM, SCENE, UserFiles, load, resolve
from lieednn_sim.validation import as_choice, as_count, as_path, as_positive
from lieednn_sim.values import Floats, StrPath, check_fields, set_fields

FREE = "free"
DEFAULT_CONTROLLERS = ("position-servo", "inverse-dynamics")
DEFAULT_SCENES = (FREE, "window")


@dataclass(frozen=True)
class Settings:
    """Settings shared by all rows of a table.

    Attributes:
        duration: duration of every motion [s].
        hold: time simulated after it [s].
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
    """The arm in its scene; warms up what is computed once per process, so that no planning time includes it."""
    arm = load(name, scene, seed, user_files)
    with contextlib.suppress(LieEDNNError):  # reported where it is needed
        reference_network(arm)
        plan(arm, (arm.keyframe("home") + 0.01).clip(*arm.position_limits.T), planner="lieednn-shaped")
    return arm


def arm_and_target(name: str, scene: str, seed: int, user_files: UserFiles = ()) -> tuple[Arm, Floats]:
    """The arm, and a random target ``(n,)`` for its scene, the same for every planner; raises if there is none."""
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


@dataclass(frozen=True)
class Shard:
    """A part of a comparison's cases, for a machine that shares only a disk; `InputError` if there is no such shard.

    The shard of a case depends on the name of the case alone; numbers start at 1.
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if as_count("the number of a shard", self.number) > as_count("the number of shards", self.of):
            raise InputError(f"there is no shard {self}: shards are numbered from 1 to {self.of}")

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``K/N``; `InputError` if the text is not of that form."""
        number, _, of = text.partition("/")
        if not (text.isascii() and number.isdecimal() and of.isdecimal() and len(text) < 20):
            raise InputError(f"a shard must look like 3/10, the third of ten, got {text!r}")
        return cls(int(number), int(of))

    def holds(self, case: Case) -> bool:
        """Whether a case is in the shard."""
        digest = hashlib.sha256(str(case).encode()).digest()
        return int.from_bytes(digest[:8], "big") % self.of + 1 == self.number

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


@dataclass(frozen=True)
class Comparison(Study[Row]):
    """The study of `compare`: all combinations of planners, arms, scenes, controllers and seeds.

    An empty list means all planners, `DEFAULT_ARMS`, `DEFAULT_SCENES` and `DEFAULT_CONTROLLERS`.

    A case is planned once for all controllers. Cases of one arm among the same obstacles follow each other, slow
    planners first, so that a worker loads the arm once.

    Attributes:
        planners: a name of `PLANNERS`, or several, or ``file.py:function`` of your own; by default all whose packages
            are installed.
        arms: a name of `ARMS`, or several, or files, as for `Arm.load`; by default telescopic_compound, telescopic_pr
            and telescopic_rrp.
        scenes: a name of `SCENES`, or several, or files of obstacles; by default free,window.
        controllers: a name of `CONTROLLERS`, or several; by default position-servo,inverse-dynamics.
        seeds: number of seeds for each arm, scene and planner.
        first_seed: the first seed; change it for fresh problems.
        user_files: the arms and scenes that come from files; those given here can be referred to by name.
        slow_seeds: number of seeds for planners whose cases take more than a second, at most ``seeds``; by default as
            many.
        common: settings of all rows.
        shard: the shard of the cases that is computed; None for all.

    Raises:
        FileError: a file is missing or cannot be read.
        InputError: a name is unknown (the message lists the known ones), a file holds no arm or scene, or
            ``slow_seeds`` is larger than ``seeds``.
    """

    name, kind = "comparison", Row
    run, failed = staticmethod(run_case), staticmethod(failed_case)

    planners: Sequence[str] = ()
    arms: Sequence[str] = ()
    scenes: Sequence[str] = ()
    controllers: Sequence[str] = ()
    seeds: int = 3
    first_seed: int = 0
    user_files: UserFiles = ()
    slow_seeds: int | None = None
    common: Settings = field(default_factory=Settings)
    shard: Shard | None = None

    def __post_init__(self) -> None:
        user_files = list(self.user_files)
        for value in self.planners:
            PLANNERS.find(value)  # which adds those of files
        for value in self.controllers:
            CONTROLLERS.find(value)
        for name, known, default in (
            ("planners", list(PLANNERS), list(PLANNERS)),
            ("arms", arm_names(), list(DEFAULT_ARMS)),
            ("scenes", list(SCENES), list(DEFAULT_SCENES)),
            ("controllers", list(CONTROLLERS), list(DEFAULT_CONTROLLERS)),
        ):
            given = getattr(self, name) or default
            kind = name.removesuffix("s")
            if kind in (ARM, SCENE):
                known += [file.name for file in user_files if file.kind == kind]
                given, own = resolve(kind, given, known)
                user_files += own
                known += [file.name for file in own]
            chosen = tuple(dict.fromkeys(given))
            for value in chosen:
                as_choice(kind, value, known)
            set_fields(self, **{name: chosen})
        set_fields(self, user_files=tuple(user_files))
        check_fields(self, as_count, "seeds")
        check_fields(self, as_count, "first_seed", least=0)
        if self.slow_seeds is not None and as_count("slow_seeds", self.slow_seeds) > self.seeds:
            raise InputError(f"slow_seeds must be at most seeds, {self.seeds}, got {self.slow_seeds}")

    @property
    def absent(self) -> dict[str, str]:
        """Chosen planners whose package is missing, with the reason."""
        return {name: reason for name, reason in PLANNERS.missing().items() if name in self.planners}

    def settings(self) -> Mapping[str, Any]:
        """See `Study`."""
        return asdict(self.common)

    @classmethod
    def read(cls, directory: StrPath) -> Table[Row]:
        """The table of a comparison in a directory; raises as `Table`."""
        return Table(as_path("the name of a comparison's directory", directory) / f"{cls.name}{SUFFIX}", cls.kind)

    def cases(self) -> list[Case]:
        """The cases of the shard, or all, but for those of `absent` planners."""
        usable = [name for name in self.planners if name not in self.absent]
        few = self.first_seed + (self.seeds if self.slow_seeds is None else self.slow_seeds)
        seeds = range(self.first_seed, self.first_seed + self.seeds)
        every = itertools.starmap(Case, itertools.product(self.arms, self.scenes, usable, seeds))
        cases = [case for case in every if case.seed < few or PLANNERS[case.planner].cost <= SLOW]
        return [case for case in cases if self.shard is None or self.shard.holds(case)]

    def todo(self, table: Table[Row]) -> list[tuple[Case, list[str], Settings]]:
        """See `Study`."""
        cases = sorted(self.cases(), key=lambda case: (case.arm, case.scene, case.seed, -PLANNERS[case.planner].cost))
        jobs = []
        for c in cases:
            names = [n for n in self.controllers if (c.arm, c.scene, c.planner, n, c.seed) not in table.rows]
            jobs += [(c, names, self.common)] if names else []
        return jobs


def settings_of(table: Table[Row]) -> Settings:
    """The settings of a comparison's rows; `FileError` if its table holds none."""
    try:
        return Settings(**table.settings)
    except (TypeError, InputError) as error:
        raise FileError(f"{table.path} holds no settings of a comparison: {error}") from None


def merge(directory: StrPath, folders: Sequence[StrPath]) -> Table[Row]:
    """Add the rows of other comparisons, such as the shards of one, to the table in a directory.

    The directory is created if it is missing; it may hold rows already, which stay. The folders of the other tables may
    be incomplete or still grow. `FileError` if one holds no comparison, or cannot be merged (see `Table.merge`); the
    rows of the folders before it are kept.
    """
    if not folders:
        raise InputError("there is nothing to merge: give the folders of other comparisons")
    parts = [Comparison.read(folder) for folder in folders]
    table = Comparison(common=settings_of(parts[0])).open(directory)
    for part in parts:
        table.merge(part)
    return table


def compare(
    directory: StrPath,
    *,
    planners: Sequence[str] = (),
    arms: Sequence[str] = (),
    scenes: Sequence[str] = (),
    controllers: Sequence[str] = (),
    seeds: int = 3,
    settings: Settings | None = None,
    jobs: int = 1,
) -> Table[Row]:
    """Compare planners in a table, of which the rows that the directory lacks are computed.

    ::

        table = ls.compare("out", planners=["minimum-jerk", "lieednn-certified"], arms=["telescopic_pr"], seeds=3)
        write_page("out/comparison.html", table)     # of `studies.report`

    The arguments and errors are those of `Comparison` (whose ``common`` is ``settings`` here) and `study.compute`,
    which together do the same for a part of the cases, or fewer seeds for slow planners.
    """
    common = Settings() if settings is None else settings
    study = Comparison(planners, arms, scenes, controllers, seeds=seeds, common=common)
    return compute(study, directory, jobs=jobs)
