"""The table of a comparison on disk: ``comparison.csv``, and ``comparison.json`` with what all its rows share."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

from lieednn_sim import storage
from lieednn_sim.errors import FileError
from lieednn_sim.evaluation.cases import Settings
from lieednn_sim.evaluation.rows import Case, Row, TableRow
from lieednn_sim.versions import versions

R = TypeVar("R", bound=TableRow)
# What a table's JSON file says of how it was made.
_DESCRIBED = ("settings", "versions", "part")


class Rows(Generic[R]):
    """Rows of one kind by their keys, kept in a directory: a row is in the file as soon as it is added.

    Memory does not grow with what is added: `rows` are read again when they are asked for.

    Args:
        directory: made when it is missing. A table in it is read and gone on with.
        name: of the files, without their suffix.
        kind: of the rows.
        shared: settings that all rows share, for the JSON file.
        part: what part of a larger table it is, if any, for the same file.

    Raises:
        FileError: the directory holds a table made with other settings, versions or code, or something else.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        name: str,
        kind: type[R],
        shared: Mapping[str, float | str],
        part: Mapping[str, Any] | None = None,
    ) -> None:
        self.directory = storage.make_directory(directory)
        self.csv, self.json = self.directory / f"{name}.csv", self.directory / f"{name}.json"
        self.versions = versions(code=True)
        self._kind, self._fields = kind, [field.name for field in fields(kind)]
        self._description: dict[str, Any] = {"kind": name, "format": 1, "settings": shared, "versions": self.versions}
        if part:
            # As it is read: tuples are lists.
            self._description["part"] = json.loads(json.dumps(part))
        self._rows: dict[tuple[Any, ...], R] | None = {}
        if self.csv.exists():
            self._check()
            self._rows = None
        storage.save_json(self.json, self._description)
        # Without the line that a killed process left half written.
        self.save()

    @property
    def rows(self) -> dict[tuple[Any, ...], R]:
        """All rows by their keys."""
        if self._rows is None:
            self._rows = read_rows(self.csv, self._kind)
        return self._rows

    def add(self, rows: Iterable[R]) -> None:
        """Add rows, at the end of the file."""
        texts = [row.as_texts() for row in rows]
        self._rows = None
        try:
            with self.csv.open("a", encoding="utf-8", newline="") as stream:
                self._writer(stream).writerows(texts)
        except OSError as error:
            raise FileError(f"cannot write {self.csv}: {error.strerror or error}") from None

    def save(self, rows: dict[tuple[Any, ...], R] | None = None) -> None:
        """Write all rows, sorted, atomically; others in their place, if given."""
        self._rows = self.rows if rows is None else rows
        with storage.atomic_text(self.csv) as stream:
            writer = self._writer(stream)
            writer.writeheader()
            writer.writerows(row.as_texts() for row in self.sorted_rows())

    def _writer(self, stream: IO[str]) -> csv.DictWriter[str]:
        return csv.DictWriter(stream, fieldnames=self._fields, lineterminator="\n")

    def sorted_rows(self) -> list[R]:
        """All rows in the order of their keys."""
        return [self.rows[key] for key in sorted(self.rows)]

    def _check(self) -> None:
        """Refuse to mix rows that were not made alike."""
        advice = f"choose another --output, or remove {self.csv}"
        try:
            differ = differences(how_made(self.json, self._description["kind"]), self._description)
        except FileError as error:
            raise FileError(
                f"cannot go on from {self.csv}, for {self.json} does not say how it was made: {error}; {advice}"
            ) from None
        if differ:
            raise FileError(f"{self.csv} was made with {'; '.join(differ)}; {advice}")


class Table(Rows[Row]):
    """Rows of a comparison by arm, scene, planner, controller and seed; arguments and errors as of `Rows`."""

    def __init__(
        self, directory: str | os.PathLike[str], settings: Settings, part: Mapping[str, Any] | None = None
    ) -> None:
        self.settings = settings
        super().__init__(directory, "comparison", Row, asdict(settings), part)
        if not self.rows:
            # Films of a table that was removed are of other settings, or other code.
            for film in (self.directory / "videos").glob("*.mp4"):
                film.unlink()

    def missing(self, case: Case, controllers: Iterable[str]) -> list[str]:
        """The controllers whose row of a case is not there yet."""
        return [name for name in controllers if (case.arm, case.scene, case.planner, name, case.seed) not in self.rows]


def how_made(path: Path, kind: str) -> dict[str, Any]:
    """What a table's JSON file says of how it was made; `FileError` when it says nothing."""
    found = storage.load_json(path, kind)
    if (found.get("kind"), found.get("format")) != (kind, 1) or not all(
        isinstance(found.get(name, {}), dict) for name in _DESCRIBED
    ):
        raise FileError(f"{path} is of another kind")
    return found


def differences(made: Mapping[str, Any], other: Mapping[str, Any], here: str = "now") -> list[str]:
    """Each setting in which two descriptions of tables differ; ``here`` says where the other is."""
    old, new = ({k: v for group in _DESCRIBED for k, v in one.get(group, {}).items()} for one in (made, other))
    names = [name for name in {**new, **old} if old.get(name) != new.get(name)]
    return [f"{name} {old.get(name)}, {here} {new.get(name)}" for name in names]


def read_rows(path: str | os.PathLike[str], kind: type[R] = Row) -> dict[tuple[Any, ...], R]:  # type: ignore[assignment]
    """Rows of a table.

    Raises:
        FileError: missing, or no such table.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="\n") as stream:
            # A process that was killed left its last line unfinished.
            reader = csv.DictReader((line for line in stream if line.endswith("\n")), strict=True)
            if list(reader.fieldnames or ()) != [field.name for field in fields(kind)]:
                raise ValueError("it has other columns")
            return {row.key: row for row in map(kind.from_texts, reader)}
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"cannot go on from {path}: {error}; remove it or choose another --output") from None
