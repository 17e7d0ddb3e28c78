"""The function that writes any format, the simplest format, what writers share, and recorded episodes of an expert."""

from __future__ import annotations

import importlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.budget import report
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.expert import Expert
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.errors import InputError, NoSolutionError, NotCertifiedError, PlanError
from lieednn_sim.planning.motion import steps_of_rate
from lieednn_sim.registry import FORMATS
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import Seed, as_count, as_path, as_seed, quoted
from lieednn_sim.values import Floats, StrPath

_ATTEMPTS = 20  # seeds tried for each episode that is wanted
_SCRATCH = f".export{io.UNFINISHED}"  # begins the name of the folder in which libraries write


class Episode(NamedTuple):
    """An episode of a data set for imitation learning."""

    frames: Mapping[str, NDArray[Any]]  #: features ``(T,)`` or ``(T, k)`` by name, of numbers or booleans
    about: Mapping[str, Any]  #: further values, such as its seed, for the table of episodes


def export(
    source: Rollout | StrPath | Mapping[str, Any], directory: StrPath, *, format: str = "csv", rate: float | None = None
) -> list[Path]:
    """Write rollouts or comparisons in the format of another tool; returns the files written.

        ls.exports.export(rollout, "out", format="csv")             # out/motion.csv

    All files of a call appear together when they are complete.

    Args:
        source: a rollout, the directory of a comparison for a format of comparisons, or several of them by name.
            Files are called by these names; a single one is called ``motion`` or ``comparison``.
        directory: where to write; it is created if it is missing.
        format: a name of `FORMATS`.
        rate: samples per second [Hz], which must divide the rate of the simulation; by default all samples are written.

    Raises:
        InputError: an argument is malformed, or a source does not suit the format.
        FileError: the files cannot be written, or the directory holds anything but exports of this package.
        LieEDNNError: a library that the format needs is not installed.
    """
    chosen = FORMATS.require(format)
    kinds: Any
    kinds, expected, alone = Rollout, "a rollout", "motion"
    if chosen.of_comparison:
        kinds, expected, alone = (str, os.PathLike), "the directory of a comparison", "comparison"
        if rate is not None:
            raise InputError(f"the format {format} has no rate")
    sources = source if isinstance(source, Mapping) else {alone: source}
    if not sources:
        raise InputError("there is nothing to export")
    for name, item in sources.items():
        if not isinstance(item, kinds):
            raise InputError(f"the format {format} is made from {expected}, got {quoted(item)}")
        if not isinstance(name, str) or name in ("", ".", "..") or as_path("the name of an export", name).name != name:
            raise InputError(f"the name of an export must be that of a file, without folders, got {quoted(name)}")
    more = {} if chosen.of_comparison else {"rate": rate}
    with exporting(directory) as (folder, written):
        chosen.load()(sources, folder, **more)
    return written


def samples(rollout: Rollout, rate: float | None) -> slice:
    """The rows of a rollout at a rate [Hz], or all; `InputError` if the rate does not divide the simulation's."""
    return slice(None, None, 1 if rate is None else steps_of_rate("rate", rate, rollout.timestep))


def write_csv(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write ``<name>.csv`` for each rollout; see `export`.

    The columns are the time, for each joint coordinate its planned and measured position and velocity, and the
    measured pose of the end effector in the world, its rotation as a unit quaternion without jumps of sign, all exact.
    """
    for name, rollout in rollouts.items():
        arm, rows = rollout.arm, samples(rollout, rate)
        header, columns = ["time [s]"], [rollout.t]
        for j, joint in enumerate(arm.joint_names):
            for what, values, unit in (
                ("planned position", rollout.q_ref, arm.unit(j)),
                ("measured position", rollout.q, arm.unit(j)),
                ("planned velocity", rollout.qd_ref, f"{arm.unit(j)}/s"),
                ("measured velocity", rollout.qd, f"{arm.unit(j)}/s"),
            ):
                header.append(f"{joint} {what} [{unit}]")
                columns.append(values[:, j])
        header += [f"end effector {axis} [m]" for axis in "xyz"] + [f"end effector q{part} [1]" for part in "wxyz"]
        pose = np.hstack([rollout.link_position[:, -1], rollout.link_quaternion[:, -1]])
        io.save_csv(folder / f"{name}.csv", [header, *np.column_stack([*columns, pose])[rows].tolist()])


@contextmanager
def exporting(directory: StrPath) -> Iterator[tuple[Path, list[Path]]]:
    """Yield a folder for files, and the list to which their final paths are added when the block succeeds."""
    written: list[Path] = []
    # Libraries choose names in a folder of their own, on the same disk: the system's temporary folder may be small or
    # read-only. Only complete files are moved to where they are asked for.
    with io.output_folder(directory, "export") as target, tempfile.TemporaryDirectory("", _SCRATCH, target) as scratch:
        folder = Path(scratch)
        yield folder, written
        result = sorted(path for path in folder.rglob("*") if path.is_file())
        paths = [target / path.relative_to(folder) for path in result]
        for parent in sorted({path.parent for path in paths}):
            io.make_directory(parent)
        with io.atomic_paths(paths) as temporaries:
            for path, temporary in zip(result, temporaries, strict=True):
                path.replace(temporary)
        written += paths


def record(
    directory: StrPath,
    episodes: int,
    *,
    arm: StrPath | Arm = "telescopic_pr",
    scene: StrPath = "free",
    scene_seed: int = 0,
    planner: str | None = None,
    seed: Seed = 0,
) -> list[Path]:
    """Record successful episodes of `environments.expert.Expert` as a LeRobot 3.0 data set; returns its files.

    An episode of ``LieEDNN/TelescopicReach-v0`` is kept if a motion was planned and the arm rests at its target at the
    end. It is that of ``reset(seed=seed)`` with the seed that the table of episodes holds, beside the target and, as
    ``certificate``, the proof of stability of the network that planned it. Of the observations of `ArmTask`,
    ``observation.state`` has positions, velocities and commanded positions of the joints, and
    ``observation.environment_state`` what is left to the target: ``position_error``, ``approach`` and ``pose_error``.

    Args:
        directory: directory of the data set; it is created if it is missing.
        episodes: number of episodes.
        arm: an arm, the name of one of the package, or a model file.
        scene: obstacles: a name of `arm.scenes.SCENES` or a file, see `Arm.with_scene`.
        scene_seed: seed of the obstacles' positions.
        planner: planner of the expert; by default the arm's `default_planner`.
        seed: seed of the first attempt; each further one has the next seed, and attempts that fail are left out.

    Raises:
        InputError: an argument is malformed.
        FileError: the files cannot be written, or the directory holds anything but exports of this package.
        NoSolutionError: too few episodes succeed.
        LieEDNNError: pyarrow is not installed.
    """
    # Those of a data set are held in memory: at 300 frames each, 3 GB.
    count, first = as_count("episodes", episodes, most=50_000), as_seed("seed", seed)
    FORMATS.require("lerobot")
    dataset = importlib.import_module("lieednn_sim.exports.lerobot")
    task = make_task("reach", arm, scene=scene, scene_seed=scene_seed)
    expert = Expert(task, planner=planner)
    result: list[Episode] = []
    with exporting(directory) as (folder, written):
        for attempt in range(_ATTEMPTS * count):
            if (episode := _episode(task, expert, first + attempt)) is not None:
                result.append(episode)
                report(len(result), count)
                if len(result) == count:
                    break
        else:
            raise NoSolutionError(f"only {len(result)} of {_ATTEMPTS * count} episodes succeeded, {count} are wanted")
        joints, twist = task.arm.joint_names, [f"pose_error {part}" for part in ("wx", "wy", "wz", "vx", "vy", "vz")]
        names = {
            "observation.state": dataset.state_names(joints, "position", "velocity", "command"),
            "observation.environment_state": [*dataset.state_names(joints, "error", "approach"), *twist],
            "action": list(joints),
        }
        about = {"fps": 1.0 / task.control_timestep, "robot": task.arm.name}
        dataset.write_dataset(folder, result, names, task="Come to rest at the target.", **about)
    return written


def _episode(task: ArmTask, expert: Expert, seed: int) -> Episode | None:
    """The episode of a seed; None if no motion is planned, or the arm is not at its target at the end."""
    observation, steps = task.begin(np.random.default_rng(seed)), []
    while not task.over:
        try:
            action = expert.act()
        except (PlanError, NotCertifiedError):
            return None
        before, (observation, reward, _, _, info) = observation, task.step(action)
        steps.append((before, action, reward, info["success"]))
    if not task.state.success:
        return None

    def joined(*names: str) -> Floats:
        return np.array([np.concatenate([seen[name].ravel() for name in names]) for seen, *_ in steps])

    frames = {
        "observation.state": joined("position", "velocity", "command"),
        "observation.environment_state": joined("position_error", "approach", "pose_error"),
        "action": np.array([action for _, action, _, _ in steps]),
        "next.reward": np.array([reward for *_, reward, _ in steps]),
        "next.done": np.arange(len(steps)) == len(steps) - 1,
        "next.success": np.array([success for *_, success in steps]),
    }
    return Episode(frames, {"seed": seed, "target": task.target(0.0).tolist(), "certificate": expert.certificate})
