"""Conversion of command-line arguments."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from lieednn_sim.arm import Arm, TaskSpaceRegion, solve_ik
from lieednn_sim.arm.importer import ImportOptions
from lieednn_sim.arm.models import chosen, is_arm_file
from lieednn_sim.arm.obstacles import is_scene_file
from lieednn_sim.arm.targets import draw_target, goes_to_extended
from lieednn_sim.cli.options import decimal
from lieednn_sim.cli.task import Task
from lieednn_sim.errors import InputError
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.motion import count_steps, steps_of_rate
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation import Disturbances, Push
from lieednn_sim.simulation.tracking import as_hold
from lieednn_sim.validation import as_positive, as_seed
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    _Goal = Floats | TaskSpaceRegion | list[RigidTransform]

# Prefix of the seed of a random joint position.
RANDOM = "random:"


def load_arm(arguments: argparse.Namespace) -> Arm:
    """The arm of --arm and the options of a model file, among the obstacles of --scene and --scene-seed."""
    return Arm.load(arguments.arm, arguments.scene, arguments.scene_seed, **import_options(arguments))


def import_options(arguments: argparse.Namespace) -> ImportOptions:
    """The options for importing an MJCF or URDF file."""
    return chosen(
        {
            "links": list(names(arguments.links)),
            "joints": list(names(arguments.joints)),
            "tip": arguments.tip,
            "base": arguments.base,
            "keyframe": arguments.keyframe,
            "home": named_numbers(arguments.home, "home"),
            "servos": arguments.servos,
            "floor": _floor(arguments.floor),
        }
    )


def _floor(text: str) -> float | str:
    """A height, or a word that the importer checks."""
    return float(numbers(text, "floor", 1)[0]) if text[-1:].isdigit() or text[-1:] == "." else text


def make_task(
    arm: Arm,
    start: Floats,
    target: Floats,
    arguments: argparse.Namespace,
    *,
    planner: str,
    reason: str,
    options: Mapping[str, Any],
) -> Task:
    """The task of a run directory from the arguments; files by their absolute paths."""
    count_steps(arguments.duration, arm.timestep)
    return Task(
        arm=str(Path(arguments.arm).resolve()) if is_arm_file(arguments.arm) else arm.name,
        start=tuple(start.tolist()),
        target=tuple(target.tolist()),
        duration=as_positive("duration", arguments.duration),
        scene=str(Path(arguments.scene).resolve()) if is_scene_file(arguments.scene) else arm.scene,
        scene_seed=arm.scene_seed,
        imported=import_options(arguments),
        planner=planner,
        reason=reason,
        seed=as_seed("seed", arguments.seed),
        options=options,
        model=arm.fingerprint,
    )


def start_and_target(arm: Arm, arguments: argparse.Namespace) -> tuple[Floats, Floats]:
    """Joint positions from --start, and from --target, --position or --pose."""
    start, goal = start_and_goal(arm, arguments)
    return start, next(candidates(arm, goal, start))


def start_and_goal(arm: Arm, arguments: argparse.Namespace, *, place: bool = False) -> tuple[Floats, _Goal]:
    """Joint position from --start, and the goal of --target, --position or --pose.

    A position is a joint position with it or, if ``place`` is true, the region of all poses there.
    """
    start = arm.check_position(joint_position(arm, arguments.start, "start"), "start")
    if arguments.position is not None:
        position = numbers(arguments.position, "position", 3)
        return start, TaskSpaceRegion.box(position, position) if place else solve_ik(arm, position, start=start)
    if arguments.pose is not None:
        return start, [_pose(text) for text in arguments.pose]
    return start, joint_position(arm, arguments.target, "target")


def _pose(text: str) -> RigidTransform:
    pose = numbers(text, "pose", 6)
    rotation = scipy.spatial.transform.Rotation.from_rotvec(pose[3:])
    return scipy.spatial.transform.RigidTransform.from_components(pose[:3], rotation)


def kept_region(arm: Arm, start: Floats, goal: _Goal, keep: str | None) -> TaskSpaceRegion | None:
    """The region of --keep, between a start and a goal of `start_and_goal`."""
    if keep is None:
        return None
    here = arm.link_poses(start)[-1]
    if keep == "orientation":
        return TaskSpaceRegion.orientation(here.rotation)
    if isinstance(goal, list):
        if len(goal) > 1:
            raise InputError(f"--keep line takes one goal, got {len(goal)} of --pose")
        there = goal[0].translation
    else:
        there = goal.project(here).translation if isinstance(goal, TaskSpaceRegion) else arm.tip(goal)
    return TaskSpaceRegion.line(here.translation, there)


def usual_target(arm: Arm, seed: int) -> str:
    """The keyframe ``extended``; among obstacles, or where there is none, a random target."""
    return "extended" if goes_to_extended(arm) else f"{RANDOM}{seed}"


def joint_position(arm: Arm, text: str, what: str) -> Floats:
    """A keyframe's name, ``random:SEED``, or comma-separated numbers."""
    if text.startswith(RANDOM):
        seed = text.removeprefix(RANDOM)
        if not (seed.isascii() and seed.isdecimal()):
            raise InputError(f"a random {what} must look like {RANDOM}7, with a seed >= 0, got {text!r}")
        return draw_target(arm, int(seed))
    if text in arm.keyframes or (text and (text[0].isalpha() or text[0] == "_")):
        return arm.keyframe(text)
    return numbers(text, what, arm.n_joints)


def numbers(text: str, what: str, count: int) -> Floats:
    """``count`` comma-separated numbers."""
    try:
        values = [decimal(part.strip(" ")) for part in text.split(",")]
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {text!r}: one {error}") from None
    if len(values) != count:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {len(values)}: {text!r}")
    return np.array(values)


def names(text: str | None) -> tuple[str, ...]:
    """Comma-separated names; empty for None."""
    return () if text is None else tuple(text.split(","))


def named_numbers(text: str | None, what: str) -> dict[str, float]:
    """Numbers by name, from ``NAME=1,OTHER=2``; empty for None."""
    pairs = [] if text is None else [part.rpartition("=") for part in text.split(",")]
    try:
        return {name.strip(" "): decimal(value.strip(" ")) for name, _, value in pairs}
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{what} must look like JOINT=0.3,OTHER=-1, got {text!r}: a number {error}") from None


def size(text: str) -> tuple[int, int]:
    """Width and height in pixels."""
    width, _, height = text.partition("x")
    if not (text.isascii() and width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise InputError(f"size must look like 1280x720, got {text!r}")
    return int(width), int(height)


def push(text: str) -> Push:
    """A force on a body: its name, three components [N], start and duration [s]."""
    body, _, rest = text.partition(",")
    try:
        x, y, z, start, duration = (decimal(part.strip(" ")) for part in rest.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise InputError(
            f"a push must look like BODY,FX,FY,FZ,START,DURATION, e.g. 'link 2,0,50,0,1.5,0.2', got {text!r}"
        ) from None
    return Push(body, (x, y, z), start, duration)


def disturbances(arm: Arm, arguments: argparse.Namespace) -> Disturbances:
    """The disturbances of the simulation's options; checks the other options too."""
    CONTROLLERS.find(arguments.controller)
    as_hold(arguments.hold)
    if arguments.reference_rate is not None:
        steps_of_rate("reference_rate", arguments.reference_rate, arm.timestep)
    made = Disturbances(
        pushes=tuple(push(text) for text in arguments.push),
        payload=arguments.payload,
        mass_scale=arguments.mass_scale,
        position_noise=arguments.position_noise,
        velocity_noise=arguments.velocity_noise,
        seed=arguments.noise_seed,
    )
    for one in made.pushes:
        one.body_id(arm, arm.model)
    return made
