"""Files that describe a sequence: a model, the joints of its arm, and the steps, in YAML or JSON."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.loading import compile_spec, read_model
from lieednn_sim.arm.importer.locking import pose
from lieednn_sim.arm.models import is_arm_file
from lieednn_sim.arm.obstacles import read_pose
from lieednn_sim.errors import InputError
from lieednn_sim.planning.sequence import PlanSequence, plan_sequence
from lieednn_sim.planning.steps import Actuate, Move
from lieednn_sim.validation import as_choice, as_floats, as_path, as_seed, quoted

# Entries of the file besides those that are arguments of `plan_sequence` as they are.
_SOURCES = ("model", "arm", "scene", "scene_seed", "keyframe", "joints", "steps")
_COMMON = ("tip", "limits", "clearance", "planner", "duration", "max_time_scale", "seed", "time_budget", "fastest")
_GOALS = ("keyframe", "joints", "pose")
_MOVE = ("name", "holding", "touching", "clearance", "planner", "duration", "max_time_scale", "time_budget", "fastest")
_ACTUATE = ("name", "seconds", "until")


@dataclass(frozen=True, eq=False)
class SequenceFile:
    """A sequence as a file describes it.

    Attributes:
        model: its model.
        data: the state in which it begins.
        joints: names of the arm's joints.
        steps: the steps.
        options: further arguments of `plan_sequence`.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    joints: tuple[str, ...]
    steps: tuple[Move | Actuate, ...]
    options: Mapping[str, Any]

    def plan(self) -> PlanSequence:
        """Plan it; raises as `plan_sequence`."""
        return plan_sequence(self.model, self.data, self.joints, self.steps, **self.options)


def load_sequence(path: str | os.PathLike[str]) -> SequenceFile:
    """Read a file that describes a sequence.

    It names a ``model``, an MJCF file relative to it or absolute, or an ``arm`` of the package with its ``scene`` and
    ``scene_seed``; the ``keyframe`` in which the model begins, by default that named ``home``, if there is one; the
    ``joints`` of the arm, by default all of the package's arm; and the ``steps``. Further entries are ``tip``,
    ``limits``, ``clearance``, ``planner``, ``duration``, ``max_time_scale``, ``seed``, ``time_budget`` and ``fastest``,
    as of `plan_sequence`.

    A step is a move or changes controls. A move has ``keyframe``, ``joints`` or ``pose`` as its goal, a pose by
    ``position`` [m] and ``rpy_degrees``, ``rpy`` [rad] or ``quaternion``; and optionally ``name``, ``holding``,
    ``touching``, and what differs from the whole. A step with ``actuate`` has controls by the names of actuators, and
    optionally ``name``, ``seconds`` and ``until``, which is ``settled`` or a list of two bodies.

    Raises:
        FileError: the file or its model is missing, or cannot be read.
        InputError: an entry is unknown or malformed; the message names it.
    """
    source = as_path("the name of a sequence's file", path)
    content: dict[str, Any] = io.load_description(source, "description of a sequence")
    _check_entries(source, content, (*_SOURCES, *_COMMON))
    try:
        model, names, tip = _model(source, content)
        data = mujoco.MjData(model)
        keys = [model.key(k).name for k in range(model.nkey)]
        if "keyframe" in content or "home" in keys:
            mujoco.mj_resetDataKeyframe(
                model, data, keys.index(as_choice("keyframe", content.get("keyframe", "home"), keys))
            )
        joints = content.get("joints", names)
        if not isinstance(joints, list) or not joints or not all(isinstance(name, str) for name in joints):
            raise InputError(f"joints must be a list of names, got {quoted(joints)}")
        steps = content.get("steps")
        if not isinstance(steps, list) or not steps:
            raise InputError(f"steps must be a list of at least one step, got {quoted(steps)}")
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    options = {name: content[name] for name in _COMMON if name in content}
    if tip is not None:
        options.setdefault("tip", tip)
    found = [_step(source, k, entry) for k, entry in enumerate(steps, 1)]
    return SequenceFile(model, data, tuple(joints), tuple(found), options)


def _model(source: Path, content: Mapping[str, Any]) -> tuple[mujoco.MjModel, list[str] | None, str | None]:
    """The model, and of an arm of the package its joints and the site of its end effector."""
    if ("model" in content) == ("arm" in content):
        raise InputError("it needs either a model, an MJCF file, or an arm of the package")
    if "model" in content:
        if alone := [name for name in ("scene", "scene_seed") if name in content]:
            raise InputError(f"{', '.join(alone)}: only an arm of the package takes a scene, not a model")
        return compile_spec(read_model(source.parent / as_path("model", content["model"]))), None, None
    if is_arm_file(str(content["arm"])):
        raise InputError(f"arm must be one of the package, got {quoted(content['arm'])}; a file is a model")
    arm = Arm.load(content["arm"], content.get("scene", "free"), as_seed("scene_seed", content.get("scene_seed", 0)))
    names = [arm.model.joint(k).name for k in range(arm.model.njnt)]
    return arm.model, names, arm.model.site(int(arm.site_ids[-1])).name


def _step(source: Path, number: int, entry: Any) -> Move | Actuate:
    where = f"{source}: step {number}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} must have entries by name, got {quoted(entry)}")
    kinds = [name for name in (*_GOALS, "actuate") if name in entry]
    if len(kinds) != 1:
        given = " and ".join(kinds) or "none"
        raise InputError(f"{where} needs one of {', '.join(_GOALS)} and actuate, and has {given}")
    (kind,) = kinds
    _check_entries(where, entry, (kind, *(_ACTUATE if kind == "actuate" else _MOVE)))
    more = {name: value for name, value in entry.items() if name != kind}
    try:
        if kind == "actuate":
            if isinstance(more.get("until"), list):
                more["until"] = tuple(more["until"])
            return Actuate(entry[kind], **more)
        return Move(_goal(kind, entry[kind]), **more)
    except (InputError, KeyError) as error:
        what = f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{where}, {kind}: {what}") from None


def _goal(kind: str, value: Any) -> Any:
    if kind == "keyframe":
        if not isinstance(value, str):
            raise InputError(f"it must be the name of a keyframe, got {quoted(value)}")
        return value
    if kind == "joints":
        return value
    if not isinstance(value, dict):
        raise InputError(f"it needs a position, and rpy_degrees, rpy or quaternion, got {quoted(value)}")
    _check_entries("it", value, ("position", "rpy_degrees", "rpy", "quaternion"))
    if "rpy_degrees" in value:
        # A right angle in radians has no end, and an arm of few joints reaches no pose beside it.
        value = {**value, "rpy": np.deg2rad(as_floats("rpy_degrees", value["rpy_degrees"], (3,)))}
    found = read_pose(value)
    return pose(found["pos"], found.get("quat", np.array([1.0, 0.0, 0.0, 0.0])))


def _check_entries(where: object, content: Mapping[Any, Any], allowed: Sequence[str]) -> None:
    if unknown := [str(name) for name in content if name not in allowed]:
        raise InputError(f"{where}: unknown {', '.join(map(quoted, unknown))}; allowed: {', '.join(allowed)}")
