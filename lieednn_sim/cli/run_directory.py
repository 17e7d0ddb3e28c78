"""The directory of a run, and its task.

Task, network, motion, rollout and metrics are made in this order, each from those before it. A new task, network and
motion replace those of an older run together, and its other results are removed. The task identifies the motion that
was made for it, and a rollout the motion that it followed, so that files of different runs are never mixed.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.arm.models import chosen
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.training import History
from lieednn_sim.network import BlockNetwork
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_choice, as_floats, as_path, as_positive, as_seed
from lieednn_sim.values import StrPath, check_fields, set_fields
from lieednn_sim.versions import versions

__all__ = ["RunDirectory", "Task"]

# Formats of the plots; the first is the default.
PLOT_KINDS = ("png", "pdf", "svg")
# The first two are plots of demonstrations, the third of a training, the others of a rollout.
_PLOTS = ("demonstrations", "starts", "training", "network", "tracking", "joints", "clearance", "modes", "channels")


@dataclass(frozen=True)
class Task:
    """The task of a run, which makes it reproducible; arm, scene, seed and import options are as for `Arm.load`."""

    arm: str
    start: tuple[float, ...]  # joint position at rest [rad, m]
    target: tuple[float, ...]  # joint target [rad, m]
    duration: float  # duration of the motion [s]
    scene: str = "free"
    scene_seed: int = 0
    imported: ImportOptions = field(default_factory=ImportOptions)
    planner: str = "lieednn-certified"  # a name of `planning.PLANNERS`, or ``train`` or ``learn``, the commands
    reason: str = ""  # why this planner was chosen
    seed: int = 0  # seed of the planner's random draws
    options: Mapping[str, Any] = field(default_factory=dict)  # its other options by name, as JSON values
    model: str = ""  # `Arm.fingerprint` of the arm
    motion: str = ""  # `fingerprint` with the motion that was made for the task; empty without one
    # Versions of the packages with which the task was made.
    versions: Mapping[str, str] = field(default_factory=lambda: versions(optional=True))

    def __post_init__(self) -> None:
        check_fields(self, as_positive, "duration")
        check_fields(self, as_seed, "scene_seed", "seed")
        for name in ("start", "target"):
            set_fields(self, **{name: tuple(as_floats(name, getattr(self, name), ("n",)).tolist())})
        set_fields(self, imported=chosen(self.imported))

    def fingerprint(self, motion: Motion) -> str:
        """Fingerprint of all values and of a motion for them; see `io.fingerprint`."""
        return io.fingerprint(vars(motion), {**asdict(self), "motion": ""})

    def load_arm(self) -> Arm:
        """The arm among its obstacles, with its payload; raises as `Arm.load`."""
        arm = Arm.load(self.arm, self.scene, self.scene_seed, **self.imported)
        return arm.with_payload(self.options.get("payload", 0.0))

    def save(self, path: StrPath) -> None:
        """Write as JSON, atomically."""
        io.save_json(path, asdict(self))

    @classmethod
    def load(cls, path: StrPath) -> Task:
        """Read a file of `save`; `FileError` says what is wrong with it."""
        value = io.load_json(path, "task")
        try:
            return cls(**{entry.name: value[entry.name] for entry in fields(cls)})
        except KeyError as error:
            raise FileError(f"{path} is not a valid task (it has no {error}); make the run again") from None
        except InputError as error:
            raise FileError(f"{path} is not a valid task: {error}") from None


class RunDirectory:
    """The files of one run, with plots in one of `PLOT_KINDS`; writes and reads them, and checks that they match."""

    def __init__(self, path: StrPath, plots: str = PLOT_KINDS[0]) -> None:
        self._plots = as_choice("plots", plots, PLOT_KINDS)
        self.path = as_path("the name of a run directory", path)
        self.task = self.path / "task.json"
        self.network = self.path / "network.npz"
        self.motion = self.path / "motion.npz"
        self.rollout = self.path / "rollout.npz"
        self.divergence = self.path / "divergence.npz"
        self.video = self.path / "video.mp4"
        self.page = self.path / "motion.html"
        self.history = self.path / "history.npz"
        self.report = self.path / "report.json"
        self.metrics_json = self.path / "metrics.json"
        self.metrics_csv = self.path / "metrics.csv"

    @property
    def results(self) -> list[Path]:
        """Files made from a rollout, which are outdated when there is a new one."""
        plots = self._plots_of(*_PLOTS[3:])
        return [self.metrics_json, self.metrics_csv, *plots, self.video, self.page, self.divergence]

    def plot(self, name: str) -> Path:
        """The file of a plot."""
        return self.path / f"{name}.{self._plots}"

    def _plots_of(self, *names: str) -> list[Path]:
        return [self.path / f"{name}.{kind}" for name in names for kind in PLOT_KINDS]

    def at_work(self, *, shared: bool = False) -> AbstractContextManager[Path]:
        """The directory, created if needed and locked against other commands; raises as `io.output_folder`.

        A shared lock admits other commands that, like this one, only write results.
        """
        return io.output_folder(self.path, "run", shared=shared)

    def existing(self) -> RunDirectory:
        """Return self, or raise `FileError` if there is no such run."""
        if not io.is_file(self.task):
            hint = "make one with 'lieednn-sim plan' or 'train'"
            if io.is_file(self.report):
                hint = f"put a learned motion on an arm by 'lieednn-sim plan --learned {self.path} --arm NAME_OR_FILE'"
            raise FileError(f"{self.path} holds no run (no {self.task.name}); {hint}")
        return self

    def load_task(self) -> tuple[Task, Arm]:
        """The task and its arm, with start and target checked against the arm's limits."""
        task = Task.load(self.task)
        arm = task.load_arm()
        if arm.fingerprint != task.model:
            now, then = versions()["mujoco"], task.versions.get("mujoco")
            raise FileError(
                f"arm {task.arm!r} in scene {task.scene!r} is not the one for which {self.task} was made (fingerprint "
                f"{io.short(arm.fingerprint)}, not {io.short(task.model)}"
                + ("" if now == then else f"; MuJoCo {now}, not {then}")
                + "): its model has changed since; make the run again"
            )
        try:
            arm.check_position(task.start, "start")
            arm.check_position(task.target, "target")
        except InputError as error:
            raise FileError(f"{self.task} does not fit arm {arm.name!r}: {error}") from None
        return task, arm

    def load_motion(self, task: Task) -> Motion:
        """The motion of the task; `FileError` if there is none, or it was made for another task."""
        if not io.is_file(self.motion):
            raise FileError(f"no such file: {self.motion}; the arm cannot follow the network of this run, make another")
        motion = Motion.load(self.motion)
        if (result := task.fingerprint(motion)) != task.motion:
            raise FileError(
                f"{self.motion} and {self.task} are of different runs, or one was changed (fingerprint "
                f"{io.short(result)}, not {io.short(task.motion)}); 'lieednn-sim plan' makes both again"
            )
        return motion

    def load_rollout(self, task: Task, arm: Arm) -> Rollout:
        """The rollout with its motion, which must belong together and to the task."""
        if not io.is_file(self.rollout):
            how = shlex.join(["lieednn-sim", "simulate", str(self.path)])
            raise FileError(f"no such file: {self.rollout}; make it with: {how}")
        return Rollout.load(self.rollout, arm, self.load_motion(task))

    def save_network(
        self, task: Task, network: BlockNetwork | None, motion: Motion | None = None, history: History | None = None
    ) -> list[Path]:
        """Write the task and the results for it, and remove all other files of the run.

        The task is removed first and written last: a process that is killed in between leaves no run, rather than a
        mixture of two. Returns the files written.
        """
        if motion is not None:
            task = replace(task, motion=task.fingerprint(motion))
        given: dict[Path, Any] = {self.network: network, self.motion: motion, self.history: history, self.task: task}
        items = {path: item for path, item in given.items() if item is not None}
        named = [path for name, path in vars(self).items() if isinstance(path, Path) and name != "path"]
        with io.atomic_paths(list(items), [self.task, *named, *self._plots_of(*_PLOTS)]) as temporaries:
            for item, temporary in zip(items.values(), temporaries, strict=True):
                item.save(temporary)
        return [self.task, *(path for path in items if path != self.task)]

    def save_rollout(self, rollout: Rollout) -> None:
        """Write a rollout, and remove results of an older one."""
        with io.atomic_paths([self.rollout], self.results) as (temporary,):
            rollout.save(temporary)


typecheck_public(globals())
