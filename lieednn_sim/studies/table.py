"""The table of a study on disk: a CSV file, and a JSON file of the same name with settings and versions."""

from __future__ import annotations

import csv
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.studies.rows import TableRow
from lieednn_sim.versions import versions

R = TypeVar("R", bound=TableRow)
# Parts of a table's JSON file that describe how it was made.
_DESCRIBED = ("settings", "versions", "part")
# The last column of every table's file.
_CHECKSUM = "checksum"


class Table(Generic[R]):
    """Rows of one kind by their keys, in a directory; added rows are in the file at once.

    Memory does not grow with added rows: `rows` is read again on access.

    Args:
        directory: created if missing; a table in it is continued.
        name: name of the files, without suffix.
        kind: class of the rows.
        settings: settings of all rows, for the JSON file.
        part: description of the part of a larger table that this is, if any, for the same file.

    Raises:
        FileError: the directory holds a table made with other settings, versions or code, or an invalid one.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        name: str,
        kind: type[R],
        settings: Mapping[str, Any],
        part: Mapping[str, Any] | None = None,
    ) -> None:
        self.directory = io.make_directory(directory)
        self.csv, self.json = self.directory / f"{name}.csv", self.directory / f"{name}.json"
        self.versions = versions(code=True)
        self.settings, self._kind = settings, kind
        self._description: dict[str, Any] = {"kind": name, "format": 1, "settings": settings, "versions": self.versions}
        if part:
            # As it will be read: with lists for tuples.
            try:
                self._description["part"] = json.loads(json.dumps(part))
            except (TypeError, ValueError) as error:
                raise InputError(f"part must hold what JSON can: {error}") from None
        self._rows: dict[tuple[Any, ...], R] | None = {}
        if os.path.lexists(self.csv):
            self._check()
            self._rows = None
        io.save_json(self.json, self._description)
        # Removes a line that a killed process left unfinished.
        self.save()

    @property
    def fingerprint(self) -> str:
        """Fingerprint of how the rows are made: settings, versions and code."""
        return io.fingerprint({}, self._description)

    @property
    def rows(self) -> dict[tuple[Any, ...], R]:
        """All rows by their keys."""
        if self._rows is None:
            self._rows = read_rows(self.csv, self._kind)
        return self._rows

    def add(self, rows: Sequence[R]) -> None:
        """Append rows to the file."""
        texts = [_with_checksum(row) for row in rows]
        self._rows = None
        try:
            with self.csv.open("a", encoding="utf-8", newline="") as stream:
                self._writer(stream).writerows(texts)
        except OSError as error:
            raise FileError(f"cannot write {self.csv}: {error.strerror or error}") from None

    def save(self, rows: dict[tuple[Any, ...], R] | None = None) -> None:
        """Write all rows, or the given ones in their place, sorted and atomically."""
        self._rows = self.rows if rows is None else rows
        with io.atomic_text(self.csv) as stream:
            writer = self._writer(stream)
            writer.writeheader()
            writer.writerows(map(_with_checksum, self.sorted_rows()))

    def _writer(self, stream: IO[str]) -> csv.DictWriter[str]:
        return csv.DictWriter(stream, fieldnames=_columns(self._kind), lineterminator="\n")

    def sorted_rows(self) -> list[R]:
        """All rows in the order of their keys."""
        return [self.rows[key] for key in sorted(self.rows)]

    def _check(self) -> None:
        """Raise `FileError` if the existing rows were made differently."""
        advice = f"choose another --output, or remove {self.csv}"
        try:
            differ = differences(how_made(self.json, self._description["kind"]), self._description)
        except FileError as error:
            raise FileError(
                f"cannot continue {self.csv}, since {self.json} does not tell how it was made: {error}; {advice}"
            ) from None
        if differ:
            raise FileError(f"{self.csv} was made with {'; '.join(differ)}; {advice}")


def how_made(path: Path, kind: str) -> dict[str, Any]:
    """The description in a table's JSON file; `FileError` if it is invalid."""
    found = io.load_json(path, kind)
    if (found.get("kind"), found.get("format")) != (kind, 1) or not all(
        isinstance(found.get(name, {}), dict) for name in _DESCRIBED
    ):
        raise FileError(f"{path} is of another kind")
    return found


def differences(made: Mapping[str, Any], other: Mapping[str, Any], here: str = "now") -> list[str]:
    """The settings in which two descriptions of tables differ; ``here`` labels the second."""
    old, new = ({k: v for group in _DESCRIBED for k, v in one.get(group, {}).items()} for one in (made, other))
    names = [name for name in {**new, **old} if old.get(name) != new.get(name)]
    return [f"{name} {old.get(name)}, {here} {new.get(name)}" for name in names]


def _columns(kind: type[TableRow]) -> list[str]:
    return [*(field.name for field in fields(kind)), _CHECKSUM]


def _with_checksum(row: TableRow) -> dict[str, str]:
    texts = row.as_texts()
    return {**texts, _CHECKSUM: checksum(texts)}


def checksum(texts: Mapping[str, str]) -> str:
    """CRC-32 of a row's cells, by which a changed row is known; rows are added and sorted one by one."""
    # A damaged line may have more or fewer cells, which are a list or None here.
    return f"{zlib.crc32(json.dumps(list(texts.items())).encode()):08x}"


def read_rows(path: str | os.PathLike[str], kind: type[R]) -> dict[tuple[Any, ...], R]:
    """Rows of a table, by their keys.

    Raises:
        FileError: the file is missing or not such a table.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="\n") as stream:
            # A killed process may have left its last line unfinished.
            reader = csv.DictReader((line for line in stream if line.endswith("\n")), strict=True)
            if list(reader.fieldnames or ()) != _columns(kind):
                raise ValueError("it has other columns")
            found = {}
            for texts in reader:
                if texts.pop(_CHECKSUM) != checksum(texts):
                    raise ValueError(f"line {reader.line_num} was changed after it was written")
                row = kind.from_texts(texts)
                found[row.key] = row
            return found
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"cannot continue {path}: {error}; remove it or choose another --output") from None
