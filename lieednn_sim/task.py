"""A task (arm, start, target, duration) and the directory that collects what is made of it."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lieednn_sim import storage
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError


@dataclass(frozen=True)
class Task:
    """What a network is made for.

    Attributes:
        arm: name of an arm of the package, or an MJCF file.
        start: joint position at rest [rad, m].
        target: joint target [rad, m].
        duration: of the motion [s].
        scene: the obstacles around the arm, see `Arm.load`.
        scene_seed: of their positions.
        links: bodies or sites that are the link frames of an MJCF file without the package's own.
        base: body or site of its base frame.
        servos: what becomes of the position servos of such a file, see `Arm.load`.
        planner: what made the motion beside the network, which is then stored with it; None where the motion is the
            one that the network draws by itself (`motion.make_motion`).
    """

    arm: str
    start: tuple[float, ...]
    target: tuple[float, ...]
    duration: float
    scene: str = "free"
    scene_seed: int = 0
    links: tuple[str, ...] = ()
    base: str | None = None
    servos: str = "keep"
    planner: str | None = None

    def load_arm(self) -> Arm:
        """The arm among its obstacles; errors as `Arm.load`."""
        return Arm.load(self.arm, self.scene, self.scene_seed, links=self.links, base=self.base, servos=self.servos)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, atomically."""
        storage.save_json(path, asdict(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Task:
        """Read a file of `save`; `FileError` says what is wrong with it."""
        try:
            value: Any = json.loads(Path(path).read_text(encoding="utf-8"))
            return cls(
                arm=str(value["arm"]),
                start=tuple(float(x) for x in value["start"]),
                target=tuple(float(x) for x in value["target"]),
                duration=float(value["duration"]),
                scene=str(value.get("scene", "free")),
                scene_seed=int(value.get("scene_seed", 0)),
                links=tuple(str(name) for name in value.get("links", ())),
                base=None if value.get("base") is None else str(value["base"]),
                servos=str(value.get("servos", "keep")),
                planner=None if value.get("planner") is None else str(value["planner"]),
            )
        except OSError as error:
            raise FileError(f"cannot read {path}: {error.strerror or error}") from None
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileError(f"{path} is not a valid task ({type(error).__name__}: {error})") from None


class RunDirectory:
    """Names of the files of one run."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.task = self.path / "task.json"
        self.network = self.path / "network.npz"
        self.motion = self.path / "motion.npz"
        self.rollout = self.path / "rollout.npz"
        self.video = self.path / "video.mp4"
        self.checkpoint = self.path / "checkpoint.npz"
        self.history = self.path / "history.npz"
        self.training_plot = self.path / "training.png"
        self.metrics_json = self.path / "metrics.json"
        self.metrics_csv = self.path / "metrics.csv"
        self.network_plot = self.path / "network.png"
        self.tracking_plot = self.path / "tracking.png"
        self.joints_plot = self.path / "joints.png"

    @property
    def pending(self) -> RunDirectory:
        """Where a training is at work, until there is a network to replace what the run holds."""
        return RunDirectory(self.path / "training")

    def create(self) -> None:
        """Make the directory if need be."""
        storage.make_directory(self.path)

    def forget_results(self) -> None:
        """Remove what was made of an earlier network, so that nothing in the directory belongs to another task."""
        for path in vars(self).values():
            if path not in (self.path, self.task, self.network):
                path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the files of the run, and the directory when nothing else is in it."""
        for path in vars(self).values():
            if path != self.path:
                path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.path.rmdir()

    def load_task(self) -> tuple[Task, Arm]:
        """The task and its arm, with start and target checked against the arm's limits."""
        task = Task.load(self.task)
        arm = task.load_arm()
        try:
            arm.check_position(task.start, "start")
            arm.check_position(task.target, "target")
        except InputError as error:
            raise FileError(f"{self.task} does not fit arm {arm.name!r}: {error}") from None
        return task, arm

    def existing(self) -> RunDirectory:
        """Return self, or raise `FileError` when there is no such run."""
        if not self.task.is_file():
            raise FileError(
                f"{self.path} holds no run (no {self.task.name}); make one with 'lieednn-sim synthesize' or 'train'"
            )
        return self
