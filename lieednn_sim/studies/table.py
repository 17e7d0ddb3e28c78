"""The table of a study: an SQLite file with its rows, and with the settings and versions that they share."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any, Generic, Self

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.studies.rows import R, TableRow, columns_of
from lieednn_sim.studies.user_files import UserFile
from lieednn_sim.validation import as_path
from lieednn_sim.values import StrPath
from lieednn_sim.versions import commit, versions

SUFFIX = ".sqlite"
# Types of columns by the annotations of a row's fields.
_TYPES = {"str": "TEXT", "bool": "INTEGER", "int": "INTEGER", "float": "REAL"}
_LONGEST = 1_000_000  # most bytes of a value that is read


class Table(Generic[R]):
    """Rows of one kind by their keys, in a file; added rows are on the disk at once.

    Several processes may add rows at once. Memory does not grow with added rows: `rows` is read again on access.

    Args:
        path: the file, made by `begin`.
        kind: class of the rows.

    Attributes:
        path: the file.
        settings: settings of all rows.
        versions: versions of the packages that made all rows, by their names.
        commits: commits of the checkouts that made rows, if any.
        user_files: the user's arms and scenes in the rows.

    Raises:
        FileError: the file is missing, cannot be read, or is no table of this kind.
    """

    def __init__(self, path: StrPath, kind: type[R]) -> None:
        self.path, self._kind = as_path("the name of a table's file", path), kind
        self._rows: dict[tuple[Any, ...], R] | None = None
        with _connected(self.path) as base:
            if dict(base.execute("SELECT name, sql FROM sqlite_schema")) != _statements(kind):
                raise FileError(f"{self.path} holds no table of {kind.__name__} rows; choose another --output")
            # In tables whose types are strict this also checks the type of each value.
            if base.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
                raise FileError(f"the table {self.path} is damaged; remove it, or choose another --output")
            about = dict(base.execute("SELECT name, value FROM about"))
        try:
            self.settings: dict[str, Any] = dict(json.loads(about["settings"]))
            self.versions: dict[str, str] = dict(json.loads(about["versions"]))
            self.commits: list[str] = list(json.loads(about["commits"]))
            self.user_files = tuple(UserFile(*map(str, file)) for file in json.loads(about["user_files"]))
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise FileError(f"{self.path} does not tell how it was made ({type(error).__name__}: {error})") from None

    @classmethod
    def begin(
        cls, path: StrPath, kind: type[R], settings: Mapping[str, Any], user_files: Iterable[UserFile] = ()
    ) -> Self:
        """Open the table in a file to add rows; the file is made if it is missing.

        Args:
            path: the file, in an existing directory.
            kind: class of the rows.
            settings: settings of all rows, as JSON can hold them.
            user_files: arms and scenes of the user in the new rows; recorded beside those of earlier rows.

        Raises:
            FileError: the file has rows of other settings, versions, arms or scenes, or is no such table.
            InputError: JSON cannot hold the settings.
        """
        file = as_path("the name of a table's file", path)
        io.check_outputs([file])
        try:
            described = {"settings": json.dumps(settings), "versions": json.dumps(versions())}
        except (TypeError, ValueError) as error:
            raise InputError(f"settings must hold values that JSON can hold: {error}") from None
        with _connected(file, "rwc") as base:
            # Locked, so that only one of several processes makes the tables.
            base.execute("BEGIN IMMEDIATE")
            if base.execute("SELECT 1 FROM sqlite_schema").fetchone() is None:
                for statement in _statements(kind).values():
                    base.execute(statement)
                values = {**described, "commits": "[]", "user_files": "[]"}
                base.executemany("INSERT INTO about VALUES (?, ?)", values.items())
        table = cls(file, kind)
        table._require_same(json.loads(described["settings"]), versions(), "now")
        table._record(user_files, [now] if (now := commit()) else [])
        return table

    @property
    def rows(self) -> dict[tuple[Any, ...], R]:
        """All rows by their keys, in the order of the keys."""
        if self._rows is None:
            given = [entry.name for entry in fields(self._kind) if entry.init]
            columns, key = (", ".join(map(_quoted, names)) for names in (given, self._kind._key))
            with _connected(self.path) as base:
                every = base.execute(f"SELECT {columns} FROM rows ORDER BY {key}")
                rows = (self._kind(**dict(zip(given, values, strict=True))) for values in every)
                self._rows = {row.key: row for row in rows}
        return self._rows

    def add(self, rows: Sequence[R]) -> None:
        """Add rows, replacing those with the same keys; either all of them are added, or none."""
        names = [entry.name for entry in fields(self._kind)]
        self._rows = None
        insert = f"INSERT OR REPLACE INTO rows VALUES ({', '.join('?' * len(names))})"
        with _connected(self.path) as base:
            base.executemany(insert, ([getattr(row, name) for name in names] for row in rows))

    def merge(self, other: Table[R]) -> None:
        """Add the rows of another table, except those whose keys are in this table.

        Raises:
            FileError: the other table has other settings, versions, arms or scenes, or a row that differs from the one
                here in more than measured times; no row is added.
        """
        if self.path.samefile(other.path):
            return
        other._require_same(self.settings, self.versions, f"in {self.path}")
        key = ", ".join(map(_quoted, self._kind._key))
        timed = [column.name for column in columns_of(self._kind) if column.timed]
        names = [_quoted(entry.name) for entry in fields(self._kind) if entry.name not in timed]
        differ = " OR ".join(f"mine.{name} IS NOT its.{name}" for name in names)
        attach = "ATTACH ? AS part", (f"{other.path.resolve().as_uri()}?mode=rw",)
        with _connected(self.path) as base:
            base.execute(*attach)
            both = f"SELECT {key} FROM rows AS mine JOIN part.rows AS its USING ({key}) WHERE {differ} LIMIT 1"
            if result := base.execute(both).fetchone():
                what = ", ".join(map(str, result))
                raise FileError(f"{self.path} and {other.path} disagree on {what}; remove one of them")
        self._record(other.user_files, other.commits)
        self._rows = None
        with _connected(self.path) as base:
            base.execute(*attach)
            base.execute("INSERT OR IGNORE INTO rows SELECT * FROM part.rows")

    def write_csv(self, path: StrPath) -> None:
        """Write a CSV file: the names of the columns, then all rows in the order of their keys."""
        names = [entry.name for entry in fields(self._kind)]
        io.save_csv(path, chain([names], ([getattr(row, name) for name in names] for row in self.rows.values())))

    def _require_same(self, settings: Mapping[str, Any], packages: Mapping[str, str], where: str) -> None:
        """Raise `FileError` if the rows were made with other settings or versions."""
        old, new = {**self.settings, **self.versions}, {**settings, **packages}
        if differ := [f"{k} {old.get(k)}, {where} {new.get(k)}" for k in {**old, **new} if old.get(k) != new.get(k)]:
            raise FileError(f"{self.path} was made with {'; '.join(differ)}; choose another --output, or remove it")

    def _record(self, user_files: Iterable[UserFile], commits: Iterable[str]) -> None:
        """Record files of the user and commits; `FileError` if a recorded file has the same name but other content."""
        known = {file[:2]: file for file in self.user_files}
        for file in user_files:
            old = known.get(file[:2], file)
            if old.fingerprint != file.fingerprint:
                raise FileError(
                    f"rows in {self.path} belong to another {file.kind} {file.name!r} (fingerprint "
                    f"{io.short(old.fingerprint)}, that of {file.source} is {io.short(file.fingerprint)}); "
                    "choose another --output, or another name for the file"
                )
            known[file[:2]] = file
        self.user_files = tuple(known[key] for key in sorted(known))
        self.commits = list(dict.fromkeys([*self.commits, *commits]))
        values = [(json.dumps(self.user_files), "user_files"), (json.dumps(self.commits), "commits")]
        with _connected(self.path) as base:
            base.executemany("UPDATE about SET value = ? WHERE name = ?", values)


def _statements(kind: type[TableRow]) -> dict[str, str]:
    """The statements that make the tables of a file, by their names, as SQLite keeps them."""
    columns = []
    for entry in fields(kind):
        name, _, empty = str(entry.type).partition(" | ")
        if name not in _TYPES or empty not in ("", "None"):
            raise InputError(f"a column must be one of {', '.join(_TYPES)}, or None; {entry.name} is {entry.type}")
        columns.append(f"{_quoted(entry.name)} {_TYPES[name]}{'' if empty else ' NOT NULL'}")
    key = ", ".join(map(_quoted, kind._key))
    return {
        "about": "CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID",
        "rows": f"CREATE TABLE rows ({', '.join(columns)}, PRIMARY KEY ({key})) STRICT, WITHOUT ROWID",
    }


def _quoted(name: str) -> str:
    """Quote a name, since it may be a keyword of SQL."""
    return f'"{name}"'


@contextlib.contextmanager
def _connected(path: Path, mode: str = "rw") -> Iterator[sqlite3.Connection]:
    """A connection to a file, for one transaction; the default journal also works on disks that machines share."""
    if mode == "rw" and not io.is_file(path):
        raise FileError(f"no such file: {path}")
    address = f"{path.resolve().as_uri()}?mode={mode}"
    try:
        # Waits up to a minute for other processes that write.
        with contextlib.closing(sqlite3.connect(address, uri=True, timeout=60.0)) as base, base:
            # Anyone may have made the file, so it is not trusted.
            base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
            base.execute("PRAGMA trusted_schema = OFF")
            yield base
    except sqlite3.DataError as error:
        raise FileError(f"cannot read the table {path}: {error}; at most {_LONGEST} bytes per value are read") from None
    except sqlite3.Error as error:
        raise FileError(f"cannot use the table {path}: {error}") from None
