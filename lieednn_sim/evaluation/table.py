"""The table of a comparison on disk: ``comparison.csv``, and ``comparison.json`` with what all its rows share."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from lieednn_sim import storage
from lieednn_sim.errors import FileError
from lieednn_sim.evaluation.cases import Settings
from lieednn_sim.evaluation.rows import Case, Row, TableRow
from lieednn_sim.versions import versions

# The file is written anew at most so often [s]; a killed process loses no more, an interrupted one nothing.
_WRITE_INTERVAL = 2.0


R = TypeVar("R", bound=TableRow)


class Rows(Generic[R]):
    """Rows of one kind by their keys, kept in a directory.

    Args:
        directory: made when it is missing. A table in it is read and gone on with.
        name: of the files, without their suffix.
        kind: of the rows.
        shared: settings that all rows share, for the JSON file.

    Raises:
        FileError: the directory holds a table made with other settings or versions, or something else.
    """

    def __init__(
        self, directory: str | os.PathLike[str], name: str, kind: type[R], shared: Mapping[str, float]
    ) -> None:
        self.directory = storage.make_directory(directory)
        self.csv, self.json = self.directory / f"{name}.csv", self.directory / f"{name}.json"
        self.versions = versions()
        self._name, self._shared, self._fields = name, shared, [field.name for field in fields(kind)]
        self.rows: dict[tuple[Any, ...], R] = {}
        if self.csv.exists():
            self._check()
            self.rows = read_rows(self.csv, kind)
        self._written = time.monotonic()
        storage.save_json(self.json, self._description())

    def add(self, rows: Iterable[R]) -> None:
        """Add rows; they are on disk after the next `save`, or soon."""
        self.rows |= {row.key: row for row in rows}
        if time.monotonic() - self._written > _WRITE_INTERVAL:
            self.save()

    def save(self) -> None:
        """Write all rows, sorted, atomically."""
        with storage.atomic_text(self.csv) as stream:
            writer = csv.DictWriter(stream, fieldnames=self._fields, lineterminator="\n")
            writer.writeheader()
            writer.writerows(row.as_texts() for row in self.sorted_rows())
        self._written = time.monotonic()

    def sorted_rows(self) -> list[R]:
        """All rows in the order of their keys."""
        return [self.rows[key] for key in sorted(self.rows)]

    def _description(self) -> dict[str, Any]:
        return {"kind": self._name, "format": 1, "settings": self._shared, "versions": self.versions}

    def _check(self) -> None:
        """Refuse to mix rows that were not made alike."""
        advice = f"choose another --output, or remove {self.csv}"
        try:
            found = storage.load_json(self.json, self._name)
            made = {**found["settings"], **found["versions"]}
            if found["kind"] != self._name or found["format"] != 1:
                raise ValueError("it is of another kind")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FileError(
                f"cannot go on from {self.csv}, for {self.json} does not say how it was made: {error}; {advice}"
            ) from None
        now = {**self._shared, **self.versions}
        differ = [f"{name} {made.get(name)}, now {value}" for name, value in now.items() if made.get(name) != value]
        if differ:
            raise FileError(f"{self.csv} was made with {'; '.join(differ)}; {advice}")


class Table(Rows[Row]):
    """Rows of a comparison by arm, scene, planner, controller and seed; arguments and errors as of `Rows`."""

    def __init__(self, directory: str | os.PathLike[str], settings: Settings) -> None:
        self.settings = settings
        super().__init__(directory, "comparison", Row, asdict(settings))
        if not self.rows:
            # Films of a table that was removed are of other settings, or other code.
            for film in (self.directory / "videos").glob("*.mp4"):
                film.unlink()

    def missing(self, case: Case, controllers: Iterable[str]) -> list[str]:
        """The controllers whose row of a case is not there yet."""
        return [name for name in controllers if (case.arm, case.scene, case.planner, name, case.seed) not in self.rows]


def read_rows(path: str | os.PathLike[str], kind: type[R] = Row) -> dict[tuple[Any, ...], R]:  # type: ignore[assignment]
    """Rows of a table.

    Raises:
        FileError: missing, or no such table.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream, strict=True)
            texts = list(reader)
        names = [field.name for field in fields(kind)]
        if list(reader.fieldnames or ()) != names or any(None in {*row, *row.values()} for row in texts):
            raise ValueError("it has other columns")
        return {row.key: row for row in map(kind.from_texts, texts)}
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"cannot go on from {path}: {error}; remove it or choose another --output") from None
