"""Entries of a comparison from the user's files: arms and scenes, with their fingerprints."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from lieednn_sim import storage
from lieednn_sim.arm import Arm
from lieednn_sim.arm.models import is_arm_file
from lieednn_sim.arm.obstacles import check_home, describe, is_scene_file, load_obstacles, scene_label
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import FileError, InputError, LieEDNNError
from lieednn_sim.manifest import Manifest

FILE = "entries.json"
ARM, SCENE = "arm", "scene"


class Entry(NamedTuple):
    """An arm or a scene from a file.

    Attributes:
        kind: `ARM` or `SCENE`.
        name: its name in tables.
        source: its file, as `Arm.load` takes it, with an absolute path.
        fingerprint: fingerprint of the arm or obstacles; rows with another one belong to another entry.
    """

    kind: str
    name: str
    source: str
    fingerprint: str


# Cleared by `enter`, which reads the files of arms anew.
@lru_cache(maxsize=8)
def bare_arm(source: str) -> Arm:
    """An arm without obstacles; cached, since its import may take seconds."""
    return Arm.load(source)


def enter(kind: str, values: Sequence[str | os.PathLike[str]], known: Sequence[str]) -> tuple[list[str], list[Entry]]:
    """Names of arms or scenes, and the entries among them.

    Args:
        kind: `ARM` or `SCENE`.
        values: names, or files as `Arm.load` takes them.
        known: names in the package.

    Raises:
        FileError: a file is missing or cannot be read.
        InputError: it holds no arm or scene, or its name is taken or not allowed.
    """
    names: list[str] = []
    entries: list[Entry] = []
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
            entry = Entry(kind, name, source, fingerprint)
            if any(one in name for one in ":/\n"):
                raise InputError(f"no {kind} in a table can be called {name!r}; rename {value}{_or_describe(kind)}")
            if name in known or any(other.name == name and other != entry for other in entries):
                raise InputError(f"there is another {kind} {name!r}; rename {value}{_or_describe(kind)}")
            entries.append(entry)
        names.append(name if own else value)  # type: ignore[arg-type]
    return list(dict.fromkeys(names)), list(dict.fromkeys(entries))


def _or_describe(kind: str) -> str:
    return ", or describe the arm in a YAML file" if kind == ARM else ""


def record(directory: str | os.PathLike[str], entries: Iterable[Entry]) -> None:
    """Record the entries beside the tables of a directory, with those of earlier runs.

    Raises:
        FileError: the directory's rows belong to another arm or scene of the same name.
    """
    folder = Path(directory)
    known = {entry[:2]: entry for entry in recorded(folder)}
    for entry in entries:
        old = known.get(entry[:2], entry)
        if old.fingerprint != entry.fingerprint:
            raise FileError(
                f"rows in {folder} belong to another {entry.kind} {entry.name!r} (fingerprint "
                f"{storage.short(old.fingerprint)}, that of {entry.source} is {storage.short(entry.fingerprint)}); "
                "choose another --output, or another name for the file"
            )
        known[entry[:2]] = entry
    if known:
        with Manifest(folder).writing(folder / FILE) as temporary:
            storage.save_json(temporary, {"entries": [list(known[key]) for key in sorted(known)]})


def recorded(directory: str | os.PathLike[str]) -> tuple[Entry, ...]:
    """The entries of a directory whose tables have rows; `FileError` when they cannot be read."""
    path = Path(directory) / FILE
    if not path.exists() or not any(Path(directory).glob("*.csv")):
        return ()
    try:
        found = tuple(Entry(*entry) for entry in storage.load_json(path, "list of entries")["entries"])
        if not all(isinstance(value, str) for entry in found for value in entry):
            raise TypeError("it must hold texts")
    except (KeyError, TypeError) as error:
        raise FileError(f"{path} is not a valid list of entries ({error}); choose another --output") from None
    return found


def load(name: str, scene: str, seed: int, entries: Iterable[Entry]) -> Arm:
    """The arm in its scene, from the package or from files; raises as `Arm.load`, and `FileError` if a file changed."""
    found = {entry[:2]: entry for entry in entries}
    of_arm, of_scene = found.get((ARM, name)), found.get((SCENE, scene))
    arm = bare_arm(of_arm.source if of_arm else name)
    if of_arm:
        _check_unchanged(of_arm, arm.fingerprint)
    if not of_scene:
        return arm.among(scene, seed)
    obstacles = load_obstacles(of_scene.source)
    _check_unchanged(of_scene, describe(obstacles)[1])
    arm = arm.amid(obstacles, of_scene.name)
    check_home(arm, of_scene.name)
    return arm


def _check_unchanged(entry: Entry, fingerprint: str) -> None:
    if entry.fingerprint != fingerprint:
        raise FileError(f"{entry.source} has changed since the comparison began; start again with another --output")


def findings(arms: Iterable[str], scenes: Iterable[str], entries: Sequence[Entry]) -> list[str]:
    """Summaries of the scenes, and the pairs of an arm and a scene without any target; a line for each."""
    own = {entry.name for entry in entries}
    lines = [
        f"scene {one.name}: {describe(load_obstacles(one.source))[0]}, from {one.source}"
        for one in entries
        if one.kind == SCENE
    ]
    for arm in arms:
        for scene in scenes:
            if own.isdisjoint((arm, scene)):
                continue
            try:
                draw_target(load(arm, scene, 0, entries))
            except LieEDNNError as error:
                lines.append(f"no case of arm {arm} in scene {scene} with seed 0: {error}")
    return lines
