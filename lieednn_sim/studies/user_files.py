"""Arms and scenes of a comparison that come from the user's own files, with their fingerprints."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from lieednn_sim.arm import Arm
from lieednn_sim.arm.models import is_arm_file
from lieednn_sim.arm.obstacles import check_home, describe, is_scene_file, load_obstacles, scene_label
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.values import StrPath

ARM, SCENE = "arm", "scene"


class UserFile(NamedTuple):
    """An arm or a scene from a file."""

    kind: str  #: `ARM` or `SCENE`
    name: str  #: name in tables
    source: str  #: its file, as `Arm.load` takes it, with an absolute path
    fingerprint: str  #: fingerprint of the arm or obstacles; must equal that of rows made earlier


UserFiles = tuple[UserFile, ...]


# Cleared by `resolve`, which reads the files of arms anew.
@lru_cache(maxsize=8)
def bare_arm(source: str) -> Arm:
    """An arm without obstacles; cached, since its import may take seconds."""
    return Arm.load(source)


def resolve(kind: str, values: Sequence[StrPath], known: Sequence[str]) -> tuple[list[str], list[UserFile]]:
    """The names of arms or scenes in tables, and the `UserFile` of each one that comes from a file.

    Each value is one of the ``known`` names of the package, or a file as `Arm.load` takes it. `FileError` if a file is
    missing or cannot be read, `InputError` if it holds no arm or scene, or its name is taken or not allowed.
    """
    names: list[str] = []
    user_files: list[UserFile] = []
    instead = ", or describe the arm in a YAML file" if kind == ARM else ""
    if kind == ARM:
        bare_arm.cache_clear()
    for value in values:
        own = isinstance(value, str | os.PathLike) and (is_arm_file if kind == ARM else is_scene_file)(os.fspath(value))
        if own:
            source = str(Path(value).resolve())
            if kind == ARM:
                name, fingerprint = bare_arm(source).name, bare_arm(source).fingerprint
            else:
                name, fingerprint = scene_label(source), describe(load_obstacles(source))[1]
            file = UserFile(kind, name, source, fingerprint)
            if any(item in name for item in ":/\n"):
                raise InputError(f"no {kind} in a table can be called {name!r}; rename {value}{instead}")
            if name in known or any(other.name == name and other != file for other in user_files):
                raise InputError(f"there is another {kind} {name!r}; rename {value}{instead}")
            user_files.append(file)
        names.append(name if own else value)  # type: ignore[arg-type]
    return list(dict.fromkeys(names)), list(dict.fromkeys(user_files))


def load(name: str, scene: str, seed: int, user_files: Iterable[UserFile]) -> Arm:
    """The arm in its scene, from the package or from files; raises as `Arm.load`, and `FileError` if a file changed."""
    result = {file[:2]: file for file in user_files}
    of_arm, of_scene = result.get((ARM, name)), result.get((SCENE, scene))
    arm = bare_arm(of_arm.source if of_arm else name)
    if of_arm:
        _check_unchanged(of_arm, arm.fingerprint)
    if not of_scene:
        return arm.with_scene(scene, seed)
    obstacles = load_obstacles(of_scene.source)
    _check_unchanged(of_scene, describe(obstacles)[1])
    arm = arm.with_obstacles(obstacles, of_scene.name)
    check_home(arm, of_scene.name)
    return arm


def _check_unchanged(file: UserFile, fingerprint: str) -> None:
    if file.fingerprint != fingerprint:
        raise FileError(f"{file.source} has changed since the comparison began; start again with another --output")
