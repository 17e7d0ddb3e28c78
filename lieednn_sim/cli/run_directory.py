"""The directory of a run.

Task, network, motion, rollout and metrics are made from each other in that order, and each file carries the
fingerprints of those before it. `RunDirectory.check` compares them, so that files of different runs are never mixed.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from lieednn_sim import filesystem, storage
from lieednn_sim.arm import Arm
from lieednn_sim.cli.task import Task
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.history import History
from lieednn_sim.manifest import Manifest
from lieednn_sim.network import BlockNetwork, ComponentwiseNetwork, LieEDNN
from lieednn_sim.network.hopfield import HopfieldNetwork
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.network_path import make_motion
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import as_choice, as_path
from lieednn_sim.versions import versions

# Formats of the plots; the first is the default.
PLOT_KINDS = ("png", "pdf", "svg")
# The first two are plots of demonstrations, the third of a training, the others of a rollout.
_PLOTS = ("demonstrations", "starts", "training", "network", "tracking", "joints", "channels")
# Classes of networks by the kind of their files.
_NETWORKS: dict[str, type[ComponentwiseNetwork]] = {network._kind: network for network in (LieEDNN, HopfieldNetwork)}


class RunDirectory:
    """The files of one run; writes them, reads them, and checks that they belong together.

    Args:
        path: path of the directory.
        plots: format of plots, one of `PLOT_KINDS`.
    """

    def __init__(self, path: str | os.PathLike[str], plots: str = PLOT_KINDS[0]) -> None:
        as_choice("plots", plots, PLOT_KINDS)
        self.path = as_path("the name of a run directory", path)
        self.manifest = Manifest(self.path)
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
        self.demonstrations_plot, self.starts_plot, self.training_plot, *others = (
            self.path / f"{name}.{plots}" for name in _PLOTS
        )
        self.network_plot, self.tracking_plot, self.joints_plot, self.channels_plot = others

    @property
    def files(self) -> list[Path]:
        """All files that a run may hold."""
        named = [path for name, path in vars(self).items() if isinstance(path, Path) and name != "path"]
        return named + [path for path in self._plots_of(*_PLOTS) if path not in named]

    @property
    def results(self) -> list[Path]:
        """Files made from a rollout, which are outdated when there is a new one."""
        plots = self._plots_of(*_PLOTS[3:])
        return [self.metrics_json, self.metrics_csv, *plots, self.video, self.page, self.divergence]

    @property
    def evaluated(self) -> list[Path]:
        """Files that the command ``evaluate`` writes; the last one only if the rollout has channels."""
        plots = [self.network_plot, self.tracking_plot, self.joints_plot, self.channels_plot]
        return [self.metrics_json, self.metrics_csv, *plots]

    def _plots_of(self, *names: str) -> list[Path]:
        return [self.path / f"{name}.{kind}" for name in names for kind in PLOT_KINDS]

    @contextlib.contextmanager
    def made(self) -> Iterator[None]:
        """Create the directory if needed, and lock it as `at_work` does; if it stays empty it is removed."""
        with filesystem.created(self.path), self.at_work():
            yield

    @contextlib.contextmanager
    def at_work(self, *, shared: bool = False, outputs: Iterable[Path] | None = None) -> Iterator[None]:
        """Lock the run against other commands while the block runs.

        Args:
            shared: let other commands in that only write results, as this one does.
            outputs: the files that the command writes; by default all files of the run.

        Raises:
            FileError: another command is at work there, or one of ``outputs`` cannot be written or was not made by
                this package.
        """
        with filesystem.locked(self.path, shared=shared):
            self.manifest.check(self.files if outputs is None else outputs)
            if not shared:
                self._remove_unfinished()
            yield

    def remove(self) -> None:
        """Remove the files of the run, and the directory if nothing else is in it; only within `at_work`."""
        self._remove_unfinished()
        self.manifest.remove(self.files)
        with contextlib.suppress(OSError):
            self.path.rmdir()

    def _remove_unfinished(self) -> None:
        """Remove the temporary files of a command that was killed; no other one is at work here."""
        for path in (*self.files, self.manifest.path):
            for left in filesystem.unfinished(path):
                left.unlink(missing_ok=True)

    def existing(self) -> RunDirectory:
        """Return self, or raise `FileError` if there is no such run."""
        if not filesystem.is_file(self.task):
            raise FileError(
                f"{self.path} holds no run (no {self.task.name}); make one with 'lieednn-sim plan' or 'train'"
            )
        return self

    def load_task(self) -> tuple[Task, Arm]:
        """The task and its arm, with start and target checked against the arm's limits."""
        task = Task.load(self.task)
        arm = task.load_arm()
        if arm.fingerprint != task.model:
            now, then = versions()["mujoco"], task.versions.get("mujoco")
            raise FileError(
                f"arm {task.arm!r} in scene {task.scene!r} is not the one for which {self.task} was made (fingerprint "
                f"{storage.short(arm.fingerprint)}, not {storage.short(task.model)}"
                + ("" if now == then else f"; MuJoCo {now}, not {then}")
                + "): its model has changed since; make the run again"
            )
        try:
            arm.check_position(task.start, "start")
            arm.check_position(task.target, "target")
        except InputError as error:
            raise FileError(f"{self.task} does not fit arm {arm.name!r}: {error}") from None
        return task, arm

    def load_network(self, task: Task) -> ComponentwiseNetwork:
        """The network, after checking that it was made for the task."""
        self.check(task, "network")
        return _NETWORKS.get(storage.kind(self.network), LieEDNN).load(self.network)

    def load_motion(self, task: Task) -> Motion:
        """The motion, after checking that it was made for the task and from the network."""
        self.check(task, "network", "motion")
        return Motion.load(self.motion)

    def motion_of(self, task: Task, arm: Arm) -> Motion:
        """The motion, generated by the network if it is not stored; checked as by `load_motion`."""
        if task.drawn:
            return make_motion(arm, self.load_network(task), task.start, task.duration, arm.timestep)
        return self.load_motion(task)

    def load_rollout(self, task: Task, arm: Arm) -> Rollout:
        """The rollout, after checking that it, the motion and the network belong together and to the task."""
        self.check(task, "network", "motion", "rollout")
        # In a run that was not simulated, the missing file to report is the rollout.
        motion = Motion.load(self.motion) if self.rollout.exists() else None
        if not filesystem.is_file(self.rollout):
            raise FileError(f"no such file: {self.rollout}; make it with 'lieednn-sim simulate {self.path}'")
        return Rollout.load(self.rollout, arm, motion)

    def check(self, task: Task, *names: str) -> dict[str, str]:
        """Fingerprints of the task and of the named files that exist, in the order in which they were made.

        Raises:
            FileError: a file was made from another file than the present one; the message names both.
        """
        found = {"task": task.fingerprint}
        for name in names:
            path: Path = getattr(self, name)
            if not path.exists():
                continue
            own, made_from = storage.origin(path)
            for source in found:
                then, now = made_from.get(source), found[source]
                if then != now:
                    raise FileError(
                        f"{path} was made from another {source} than {getattr(self, source)} (fingerprint "
                        f"{storage.short(then)}, not {storage.short(now)}): files of different runs are mixed, or one "
                        f"was changed; 'lieednn-sim {'simulate' if name == 'rollout' else 'plan'}' makes it again"
                    )
            found[name] = own
        return found

    def save_network(
        self, task: Task, network: BlockNetwork | None, motion: Motion | None = None, history: History | None = None
    ) -> list[Path]:
        """Write the task and the results for it, and remove all other files of the run.

        Returns:
            The files written.
        """
        made_from = {"task": task.fingerprint}
        savers: dict[str, Callable[[Path], None]] = {"task": task.save}
        for name, made in (("network", network), ("motion", motion), ("history", history)):
            if made is not None:
                savers[name] = _saver(made, name, made_from)
        targets: list[Path] = [getattr(self, name) for name in savers]
        outdated = [path for path in self.files if path not in targets]
        with self.manifest.replacing(targets, outdated) as temporaries:
            for save, temporary in zip(savers.values(), temporaries, strict=True):
                save(temporary)
        return targets

    def save_rollout(self, task: Task, rollout: Rollout) -> list[Path]:
        """Write a rollout, with its motion if the network generated that, and remove results of an older one.

        Returns:
            The files written.
        """
        made_from = self.check(task, "network", *([] if task.drawn else ["motion"]))
        motion = rollout.motion if task.drawn else None
        targets = [self.rollout] if motion is None else [self.motion, self.rollout]
        with self.manifest.replacing(targets, self.results) as temporaries:
            if motion is not None:
                _saver(motion, "motion", made_from)(temporaries[0])
            rollout.save(temporaries[-1], made_from)
        return targets


def _saver(made: BlockNetwork | Motion | History, name: str, made_from: dict[str, str]) -> Callable[[Path], None]:
    """A function that saves an object and adds its fingerprint to ``made_from``, for files made from it."""

    def save(path: Path) -> None:
        made.save(path, dict(made_from))
        made_from[name] = storage.origin(path)[0]

    return save
