"""The comparison of planners: arms, scenes, planners, controllers and seeds in one table; for its cases see `case`."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from lieednn_sim.arm import arm_names
from lieednn_sim.errors import InputError
from lieednn_sim.registry import CONTROLLERS, DEFAULT_ARMS, PLANNERS, SCENES, SLOW
from lieednn_sim.studies.comparison.case import FREE, Settings, failed_case, run_case, settings_of
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.study import Study, compute
from lieednn_sim.studies.table import SUFFIX, Table
from lieednn_sim.studies.user_files import ARM, SCENE, UserFiles, resolve
from lieednn_sim.validation import as_choice, as_count, as_path
from lieednn_sim.values import StrPath, check_fields, set_fields

DEFAULT_CONTROLLERS = ("position-servo", "inverse-dynamics")
DEFAULT_SCENES = (FREE, "window")


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

    A case is planned once for all controllers. Cases of one arm among the same obstacles follow each other, slow
    planners first, so that a worker loads the arm once.

    Attributes:
        planners: a name of `PLANNERS`, or several, or ``file.py:function`` of your own; by default all installed ones.
        arms: a name of `ARMS`, or several, or files, as for `Arm.load`; by default telescopic_compound, telescopic_pr
            and telescopic_rrp.
        scenes: a name of `SCENES`, or several, or files of obstacles; by default free,window.
        controllers: a name of `CONTROLLERS`, or several; by default position-servo,inverse-dynamics.
        seeds: number of seeds for each arm, scene and planner.
        first_seed: the first seed; change it for fresh problems.
        user_files: the arms and scenes that come from files; those given here can be referred to by name.
        slow_seeds: number of seeds for planners whose cases take more than a second, at most ``seeds``, the default.
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
        for registry in (PLANNERS, CONTROLLERS):
            for value in getattr(self, registry.plural):
                registry.find(value)  # which adds those of files
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

    `studies.report.write_page` makes its page. The arguments and errors are those of `Comparison` (whose ``common`` is
    ``settings`` here) and `study.compute`, which together do the same for a part of the cases, or fewer seeds for slow
    planners.
    """
    common = Settings() if settings is None else settings
    study = Comparison(planners, arms, scenes, controllers, seeds=seeds, common=common)
    return compute(study, directory, jobs=jobs)
