"""The list of the files that this package made in a directory; only these are ever replaced or removed.

The list, ``made.json``, holds the name of each file and the SHA-256 of its content. It is written before a file gets
its name, so that a process that is killed in between leaves no file that is not on the list.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from lieednn_sim import filesystem, storage
from lieednn_sim.errors import FileError

_NAME, _KIND, _FORMAT = "made.json", "made files", 1


class Manifest:
    """What the package made in a directory and below it; it is read anew by every method.

    Args:
        directory: the directory, which may not exist yet.
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.directory = Path(directory)
        self.path = self.directory / _NAME

    def check(self, paths: Iterable[Path]) -> None:
        """Raise `FileError` if one of the files exists and is not as this package made it, or cannot be written."""
        wanted = list(paths)
        filesystem.check_outputs([*wanted, self.path])
        made = self._load()
        for path in wanted:
            self._require_own(path, made)

    def made_from(self, path: Path) -> str:
        """What `replacing` was told that a file was made from; empty if it is not on the list."""
        return str(self._load().get(self._name(path), {}).get("made_from", ""))

    @contextlib.contextmanager
    def replacing(
        self, targets: Sequence[Path], outdated: Iterable[Path] = (), made_from: str = ""
    ) -> Iterator[list[Path]]:
        """Write files of the directory as `filesystem.atomic_paths` does, and enter them in the list.

        Args:
            targets: the files to write.
            outdated: files to remove.
            made_from: an identifier of what they are made from.

        Raises:
            FileError: one of them is not as this package made it; nothing is replaced or removed then.
        """
        targets, outdated = list(targets), list(outdated)
        new: dict[str, Any] = {}

        def announce(temporaries: Sequence[Path]) -> None:
            made = self._load()
            for target, temporary in zip(targets, temporaries, strict=True):
                new[self._name(target)] = {"sha256": [_digest(temporary)], "made_from": made_from}
                self._require_own(target, made, new)
            for path in outdated:
                self._require_own(path, made)
            before = {name: made[name]["sha256"] for name in new if name in made}
            both = {name: {**entry, "sha256": [*before.get(name, []), *entry["sha256"]]} for name, entry in new.items()}
            self._save({**made, **both})

        with filesystem.atomic_paths(targets, outdated, announce) as temporaries:
            yield temporaries
        gone = {self._name(path) for path in outdated}
        self._save({name: entry for name, entry in {**self._load(), **new}.items() if name not in gone})

    @contextlib.contextmanager
    def writing(self, path: Path, made_from: str = "") -> Iterator[Path]:
        """`replacing` of one file."""
        with self.replacing([path], made_from=made_from) as (temporary,):
            yield temporary

    def expect(self, path: Path, kind: str) -> None:
        """Enter a file that is written without `replacing`, perhaps often; any file of this `storage.kind` fits."""
        self._save({**self._load(), self._name(path): {"kind": kind, "sha256": []}})

    def remove(self, paths: Iterable[Path]) -> None:
        """Remove files; raises as `check`, before any is removed."""
        paths = list(paths)
        self.check(path for path in paths if os.path.lexists(path))
        for path in paths:
            path.unlink(missing_ok=True)
        gone = {self._name(path) for path in paths}
        if self.path.exists():
            self._save({name: entry for name, entry in self._load().items() if name not in gone})

    def _require_own(self, path: Path, *lists: dict[str, Any]) -> None:
        """Raise `FileError` if a file is there that is as in none of the lists."""
        if not os.path.lexists(path):
            return
        entries = [made[self._name(path)] for made in lists if self._name(path) in made]
        if any(entry.get("kind") and _kind(path) == entry["kind"] for entry in entries):
            return
        known = [digest for entry in entries for digest in entry["sha256"]]
        if known and _digest(path) in known:
            return
        if not lists[0].get(self._name(path)):
            raise FileError(
                f"{path} was not made by a command of this package, which never replaces such files; move it away, or "
                "choose another directory"
            )
        raise FileError(
            f"{path} was changed after this package made it, and such files are never replaced; move it away, or "
            "choose another directory"
        )

    def _name(self, path: Path) -> str:
        return path.relative_to(self.directory).as_posix()

    def _load(self) -> dict[str, Any]:
        if not os.path.lexists(self.path):
            return {}
        found = storage.load_json(self.path, "list of made files")
        files = found.get("files")
        if (
            (found.get("kind"), found.get("format")) != (_KIND, _FORMAT)
            or not isinstance(files, dict)
            or not all(isinstance(entry, dict) and isinstance(entry.get("sha256"), list) for entry in files.values())
        ):
            raise FileError(f"{self.path} is no list of made files; move it away, or choose another directory")
        return files

    def _save(self, files: dict[str, Any]) -> None:
        if files:
            storage.save_json(self.path, {"kind": _KIND, "format": _FORMAT, "files": dict(sorted(files.items()))})
        else:
            self.path.unlink(missing_ok=True)


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from None


def _kind(path: Path) -> str | None:
    try:
        return storage.kind(path)
    except FileError:
        return None
