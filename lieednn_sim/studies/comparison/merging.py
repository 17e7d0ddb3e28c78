"""Merging of the shards of a comparison."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.studies.comparison.cases import Settings
from lieednn_sim.studies.comparison.rows import TIMING, Case, Row
from lieednn_sim.studies.comparison.study import SELECTION, Comparison, Shard, missing
from lieednn_sim.studies.table import Table, differences, how_made, read_rows
from lieednn_sim.studies.user_files import UserFile, record_files
from lieednn_sim.versions import versions


@dataclass(frozen=True)
class Merged:
    """A merged comparison.

    Attributes:
        table: the table of all rows.
        absent: planners that were not compared, with the reason.
        missing: for each incomplete shard, the cases that lack rows.
        shards: the shards by folder.
    """

    table: Table[Row]
    absent: Mapping[str, str]
    missing: Mapping[Shard, Sequence[Case]]
    shards: Mapping[Path, Shard]


def merge(directory: str | os.PathLike[str], folders: Sequence[str | os.PathLike[str]]) -> Merged:
    """Merge the tables of shards; the result depends neither on their order nor on repetition.

    Of a row that was computed twice, the one with the shorter planning time is kept.

    Args:
        directory: directory of the whole table, which may hold rows already.
        folders: folders of shards of one comparison, which may be incomplete or unfinished.

    Raises:
        InputError: there are no folders.
        FileError: a folder holds no shard of the same comparison made by this code, or rows disagree; see `Table`.
    """
    if not folders:
        raise InputError("there is nothing to merge: give the folders of the shards")
    read = {Path(folder): how_made(Path(folder) / "comparison.json", "comparison") for folder in folders}
    first, whole = next(iter(read.items()))
    now = {"versions": versions(code=True)}
    for folder, found in read.items():
        if differ := differences(_without_number(found), _without_number(whole), f"in {first}"):
            raise FileError(f"{folder} belongs to another comparison: {'; '.join(differ)}")
        if differ := differences({"versions": found.get("versions", {})}, now):
            raise FileError(f"{folder} was made with {'; '.join(differ)}; merge with the versions that made it")
    try:
        part = whole["part"]
        shards = {folder: Shard(found["part"]["shard"], part["shards"]) for folder, found in read.items()}
        settings = Settings(**whole["settings"])
        user_files = [UserFile(*file) for file in part["user_files"]]
        chosen = {name: part[name] for name in SELECTION} | {"user_files": tuple(user_files)}
        study = Comparison(**chosen, common=settings)
        absent = {str(name): str(reason) for name, reason in part["absent"].items()}
    except (AttributeError, KeyError, TypeError, InputError) as error:
        raise FileError(f"{first} holds no shard of a comparison ({type(error).__name__}: {error})") from None
    rows: dict[tuple[Any, ...], tuple[Row, Path]] = {}
    target = Path(directory)
    if (target / "comparison.csv").exists():
        rows = {key: (row, target) for key, row in read_rows(target / "comparison.csv", Row).items()}
    for folder, shard in shards.items():
        for row in read_rows(folder / "comparison.csv", Row).values():
            if Shard.holding(row.case, shard.of) != shard:
                raise FileError(f"{folder} is shard {shard}, but holds the case {row.case} of another")
            rows[row.key] = _agreed(row, folder, *rows.get(row.key, (row, folder)))
    record_files(io.make_directory(target), study.user_files)
    table = study.open(target)
    table.save({key: row for key, (row, _) in rows.items()})
    lacking: dict[Shard, list[Case]] = {}
    for case in study.cases(absent):
        if missing(table, case, study.controllers):
            lacking.setdefault(Shard.holding(case, part["shards"]), []).append(case)
    return Merged(table, absent, lacking, shards)


def _without_number(description: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a description that all shards of a comparison share."""
    part = description.get("part", {})
    # Files may be elsewhere on other machines; their fingerprints identify them.
    user_files = [[*file[:2], *file[3:]] for file in part.get("user_files", [])]
    return {**description, "part": {**part, "shard": None, "user_files": user_files}}


def _agreed(row: Row, folder: Path, other: Row, elsewhere: Path) -> tuple[Row, Path]:
    """One of two rows that are equal except for their times, independent of their order."""
    timing = dict.fromkeys(TIMING, "")
    if {**row.as_texts(), **timing} != {**other.as_texts(), **timing}:
        raise FileError(f"{elsewhere} and {folder} disagree on {row.case} with {row.controller}; remove one of them")
    return min((row, folder), (other, elsewhere), key=lambda one: one[0].planning_s or 0.0)
