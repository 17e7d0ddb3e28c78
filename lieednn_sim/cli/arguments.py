"""Groups of options that several commands take, and what they stand for."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from inspect import formatannotation
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
import scipy

from lieednn_sim.arm import Arm, TaskSpaceRegion, solve_ik
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.arm.models import is_arm_file
from lieednn_sim.arm.obstacles import is_scene_file
from lieednn_sim.arm.targets import draw_target, goes_to_extended
from lieednn_sim.budget import DEFAULT_TIME_BUDGET
from lieednn_sim.cli.kinds import KINDS, Directory, Force, Joints, Point, Pose, Setting, kind_of, numbers
from lieednn_sim.cli.run_directory import Task
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import count_steps, steps_of_rate
from lieednn_sim.planning.problem import USUAL_DURATION
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.rendering.video import render_video
from lieednn_sim.simulation.disturbances import Disturbances, Push
from lieednn_sim.simulation.tracking import as_hold
from lieednn_sim.validation import TURN, as_choice, as_floats
from lieednn_sim.values import Floats

_Goal: TypeAlias = "Floats | TaskSpaceRegion | list[scipy.spatial.transform.RigidTransform]"

#: The look of videos and pictures.
Look = Annotated[dict[str, Any], render_video, "preset", "size", "camera", "fps"]

# Prefix of the seed of a random joint position.
RANDOM = "random:"


@dataclass(frozen=True)
class ChosenArm:
    """An arm among obstacles.

    Attributes:
        arm: a name of `ARMS`, or an MJCF, URDF or YAML file.
        scene: obstacles: a name of `SCENES`, or an MJCF or YAML file.
        scene_seed: seed of the obstacles' positions.
        imported: how a model file is imported.
    """

    arm: str = "telescopic_pr"
    scene: str = "free"
    scene_seed: int = 0
    imported: Annotated[ImportOptions, "*"] = field(default_factory=ImportOptions, kw_only=True)

    def load(self) -> Arm:
        """The arm; raises as `Arm.load`."""
        return Arm.load(self.arm, self.scene, self.scene_seed, **self.imported)

    def task(self, arm: Arm, start: Floats, target: Floats, duration: float, seed: int, **more: Any) -> Task:
        """The task of a run directory, with files by their absolute paths; ``more`` are other fields of `Task`."""
        count_steps(duration, arm.timestep)
        return Task(
            arm=str(Path(self.arm).resolve()) if is_arm_file(self.arm) else arm.name,
            start=tuple(start.tolist()),
            target=tuple(target.tolist()),
            duration=duration,
            scene=str(Path(self.scene).resolve()) if is_scene_file(self.scene) else arm.scene,
            scene_seed=arm.scene_seed,
            imported=self.imported,
            seed=seed,
            model=arm.fingerprint,
            **more,
        )


@dataclass(frozen=True)
class Goal(ChosenArm):
    """An arm, from where to where it goes, and in which time.

    Attributes:
        target: joint target: the name of a keyframe, random:SEED, or joint coordinates separated by commas [rad, m]
            (default: extended; among obstacles, or without such a keyframe, random: and the seed).
        position: target position of the end effector in the world [m], instead of --target.
        pose: target pose of the end effector in the world, instead of --target: position [m] and rotation vector
            [rad]; of several, the one that is reached soonest.
        start: joints at the start, given as for --target (default: home).
        duration: duration of the motion [s] (default: 4; plans of slow arms get up to 60).
        seed: seed of random draws.
    """

    target: Joints | None = None
    position: Point | None = None
    pose: tuple[Pose, ...] = ()
    start: Joints | None = None
    duration: float | None = None
    seed: int = 0

    @property
    def asked_duration(self) -> float:
        """The duration, if need be the shortest by default [s]."""
        return USUAL_DURATION[0] if self.duration is None else self.duration

    def usual_target(self, arm: Arm) -> str | None:
        """The target if none is given: ``extended``; a random one among obstacles, or without such a keyframe."""
        if self.target is not None or self.position is not None or self.pose:
            return None
        return "extended" if goes_to_extended(arm) else f"{RANDOM}{self.seed}"

    def start_and_goal(self, arm: Arm, *, place: bool = False) -> tuple[Floats, _Goal]:
        """Joint position of the start, and the goal.

        A position is a joint position with it or, if ``place`` is true, the region of all poses there. `InputError` for
        several kinds of goals, or one that the arm has not.
        """
        if (self.target is not None) + (self.position is not None) + bool(self.pose) > 1:
            raise InputError("give one of --target, --position and --pose")
        start = arm.check_start(joint_position(arm, self.start or "home", "start"))
        if self.position is not None:
            there = self.position
            return start, TaskSpaceRegion.box(there, there) if place else solve_ik(arm, there, start=start)
        if self.pose:
            for at in self.pose:
                as_floats("the rotation vector of --pose, in radians,", at[3:], (3,), largest=TURN)
            transforms, rotation = scipy.spatial.transform.RigidTransform, scipy.spatial.transform.Rotation
            return start, [transforms.from_components(at[:3], rotation.from_rotvec(at[3:])) for at in self.pose]
        return start, joint_position(arm, self.usual_target(arm) or self.target or "", "target")


@dataclass(frozen=True)
class Planning(Goal):
    """A motion to plan.

    Attributes:
        planner: one of your own as FILE.py:FUNCTION, or a name of `PLANNERS` (default:
            lieednn-certified; lieednn-shaped among obstacles, an imported arm's floor included, with --path-constraint,
            or where three hinges move a link).
        option: an option of the planner; --planner NAME --help lists them.
        path_constraint: line or orientation: keep the end effector on a straight line, or at its orientation.
        fastest: follow the planned path as fast as the arm's limits allow; no --duration is needed.
        settle: time law on the same path after which hanging loads and bending stages hardly swing: least-energy, zv,
            zvd or ei.
        learned: directory of 'learn' with a motion that the end effector repeats, in the duration of the recordings;
            from where they began or from --start; to their goal, or to --target, --position or --pose.
        turning: keep the recorded orientations of the motion of --learned.
        time_budget: largest CPU time for planning [s]; inf for no limit.
    """

    planner: str | None = None
    option: tuple[Setting, ...] = ()
    path_constraint: str | None = None
    fastest: bool = False
    settle: str | None = None
    learned: Directory | None = None
    turning: bool = True
    time_budget: float = DEFAULT_TIME_BUDGET

    def constraint_region(self, arm: Arm, start: Floats, goal: _Goal) -> TaskSpaceRegion | None:
        """The region to keep between a start and a goal of `start_and_goal`."""
        if self.path_constraint is None:
            return None
        here = arm.link_poses(start)[-1]
        if as_choice("path_constraint", self.path_constraint, ("line", "orientation")) == "orientation":
            return TaskSpaceRegion.orientation(here.rotation)
        if isinstance(goal, list):
            if len(goal) > 1:
                raise InputError(f"--path-constraint line takes one goal, got {len(goal)} of --pose")
            there = goal[0].translation
        else:
            there = goal.project(here).translation if isinstance(goal, TaskSpaceRegion) else arm.tip(goal)
        return TaskSpaceRegion.line(here.translation, there)


@dataclass(frozen=True)
class Simulating:
    """How a motion is simulated.

    Attributes:
        controller: one of your own as FILE.py:CLASS, or a name of `CONTROLLERS` (default: position-servo for arms of
            the package, inverse-dynamics with a known payload and for others that servos drive, else
            feedback-linearisation).
        reference_rate: rate at which the controller gets references, held in between [Hz] (default: every time step).
        hold: time simulated after the motion [s].
        push: force [N] on a body or link ("link 1", ..., "end effector") from START for DURATION [s].
        disturbances: the other disturbances.
    """

    controller: str | None = None
    reference_rate: float | None = None
    hold: float = 1.0
    push: tuple[Force, ...] = ()
    disturbances: Annotated[Disturbances, "*", "seed as noise_seed"] = field(default_factory=Disturbances)

    def all_disturbances(self, arm: Arm) -> Disturbances:
        """The disturbances, with the pushes; checks the other options too."""
        if self.controller is not None:
            CONTROLLERS.find(self.controller)
        as_hold(self.hold)
        if self.reference_rate is not None:
            steps_of_rate("reference_rate", self.reference_rate, arm.timestep)
        pushes = tuple(Push(body, (x, y, z), begin, lasts) for body, (x, y, z, begin, lasts) in self.push)
        for push in pushes:
            push.body_id(arm, arm.model)
        return replace(self.disturbances, pushes=pushes)


def still_look(look: Look) -> dict[str, Any]:
    """The options of a look that pictures have, too."""
    return {name: value for name, value in look.items() if name != "fps"}


def joint_position(arm: Arm, text: str, what: str) -> Floats:
    """A keyframe's name, ``random:SEED``, or comma-separated numbers."""
    if text.startswith(RANDOM):
        seed = text.removeprefix(RANDOM)
        if not (seed.isascii() and seed.isdecimal()):
            raise InputError(f"a random {what} must look like {RANDOM}7, with a seed >= 0, got {text!r}")
        return draw_target(arm, int(seed))
    if text in arm.keyframes or ((text[:1].isalpha() or text[:1] == "_") and "," not in text):
        return arm.keyframe(text)
    try:
        return np.array(numbers(text, arm.n_joints))
    except ArgumentTypeError as error:
        raise InputError(f"{what} {error}") from None


def read_options(options: Any, texts: Sequence[str]) -> Any:
    """Options of a dataclass with values from ``NAME=VALUE``, or ``NAME.OTHER=VALUE``; or `InputError`."""
    known = {entry.name: entry for entry in fields(options)}
    changes: dict[str, Any] = {}
    inner: dict[str, list[str]] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        head, dot, rest = name.partition(".")
        if not equals or head not in known or bool(dot) != is_dataclass(getattr(options, head)):
            raise InputError(f"{text!r} must be NAME=VALUE with a name of {', '.join(option_names(options))}")
        if dot:
            inner.setdefault(head, []).append(f"{rest}={value}")
            continue
        told = known[head].type
        kind = kind_of(told if isinstance(told, str) else formatannotation(told))
        if not kind:
            raise InputError(f"option {head} cannot be read from a text, since it is of type {told}")
        try:
            changes[head] = KINDS[kind].read(value)
        except ArgumentTypeError as error:
            raise InputError(f"option {head} {error}") from None
    for head, more in inner.items():
        changes[head] = read_options(getattr(options, head), more)
    return replace(options, **changes)


def option_names(options: Any) -> Iterator[str]:
    """The names of the options of a dataclass, and of those within them."""
    for entry in fields(options):
        value = getattr(options, entry.name)
        if is_dataclass(value):
            yield from (f"{entry.name}.{name}" for name in option_names(value))
        else:
            yield entry.name
