"""The task of a run: arm, start, target, duration, and planner."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.planning.motion import Motion
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_floats, as_positive, as_seed
from lieednn_sim.values import check_fields, set_fields
from lieednn_sim.versions import versions

__all__ = ["Task"]


@dataclass(frozen=True)
class Task:
    """The task of a run, which makes it reproducible.

    Attributes:
        arm: name of an arm of the package, or a model file.
        start: joint position at rest [rad, m].
        target: joint target [rad, m].
        duration: duration of the motion [s].
        scene: the obstacles around the arm, see `Arm.load`.
        scene_seed: seed of the obstacles' positions.
        imported: import options of a model file, see `Arm.load`.
        planner: a name of `planning.PLANNERS`, or ``train`` or ``learn``, the commands.
        reason: why this planner was chosen.
        seed: seed of its random draws.
        options: its other options by name, as JSON values.
        model: `Arm.fingerprint` of the arm.
        motion: `fingerprint` with the motion that was made for the task; empty without one.
        versions: versions of the packages with which the task was made.
    """

    arm: str
    start: tuple[float, ...]
    target: tuple[float, ...]
    duration: float
    scene: str = "free"
    scene_seed: int = 0
    imported: ImportOptions = field(default_factory=ImportOptions)
    planner: str = "lieednn-certified"
    reason: str = ""
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""
    motion: str = ""
    versions: Mapping[str, str] = field(default_factory=lambda: versions(optional=True))

    def __post_init__(self) -> None:
        check_fields(self, as_positive, "duration")
        check_fields(self, as_seed, "scene_seed", "seed")
        for name in ("start", "target"):
            set_fields(self, **{name: tuple(as_floats(name, getattr(self, name), ("n",)).tolist())})
        if unknown := self.imported.keys() - ImportOptions.__optional_keys__:
            raise InputError(f"no options of an import: {', '.join(sorted(unknown))}")

    def fingerprint(self, motion: Motion) -> str:
        """Fingerprint of all values and of a motion for them; see `io.fingerprint`."""
        return io.fingerprint(vars(motion), {**asdict(self), "motion": ""})

    def load_arm(self) -> Arm:
        """The arm among its obstacles; raises as `Arm.load`."""
        return Arm.load(self.arm, self.scene, self.scene_seed, **self.imported)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, atomically."""
        io.save_json(path, asdict(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Task:
        """Read a file of `save`; `FileError` says what is wrong with it."""
        value = io.load_json(path, "task")
        try:
            return cls(**{entry.name: value[entry.name] for entry in fields(cls)})
        except KeyError as error:
            raise FileError(f"{path} is not a valid task (it has no {error}); make the run again") from None
        except InputError as error:
            raise FileError(f"{path} is not a valid task: {error}") from None


typecheck_public(globals())
