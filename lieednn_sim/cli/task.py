"""The task of a run: arm, start, target, duration, and planner."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer import ImportOptions
from lieednn_sim.errors import FileError
from lieednn_sim.planning.motion import Motion
from lieednn_sim.validation import as_floats, as_positive, as_seed
from lieednn_sim.versions import versions

# The planner of certified networks.
CERTIFIED = "lieednn-certified"
# What the tasks of other commands have for a planner: of ``train`` and of ``learn --arm``.
TRAINED, DEMONSTRATED = "train", "learn"


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
        planner: a name of `planning.PLANNERS`, `TRAINED` for ``train``, or `DEMONSTRATED` for ``learn``.
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
    planner: str = CERTIFIED
    reason: str = ""
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""
    motion: str = ""
    versions: Mapping[str, str] = field(default_factory=lambda: versions(optional=True))

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
            texts = {name: value[name] for name in ("arm", "scene", "planner", "reason", "model", "motion")}
            if not all(isinstance(text, str) for text in texts.values()):
                raise TypeError("names must be strings")
            if not all(isinstance(value[name], dict) for name in ("imported", "options", "versions")):
                raise TypeError("imported, options and versions must be objects")
            if unknown := value["imported"].keys() - ImportOptions.__optional_keys__:
                raise TypeError(f"no options of an import: {', '.join(sorted(unknown))}")
            return cls(
                **texts,
                imported=value["imported"],
                start=_position(value["start"], "start"),
                target=_position(value["target"], "target"),
                duration=as_positive("duration", value["duration"]),
                scene_seed=as_seed("scene_seed", value["scene_seed"]),
                seed=as_seed("seed", value["seed"]),
                options=value["options"],
                versions=value["versions"],
            )
        except KeyError as error:
            raise FileError(f"{path} is not a valid task (it has no {error}); make the run again") from None
        except (TypeError, ValueError, OverflowError) as error:
            raise FileError(f"{path} is not a valid task ({type(error).__name__}: {error})") from None


def _position(value: Any, what: str) -> tuple[float, ...]:
    if not isinstance(value, list) or any(isinstance(x, str | bool) for x in value):
        raise TypeError(f"{what} must be a list of numbers")
    return tuple(as_floats(what, value, ("n",)).tolist())
