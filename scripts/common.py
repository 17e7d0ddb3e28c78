"""What the studies have in common: their options, the files they write, and rows with which they go on."""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.studies.study import worker_pool


def options(
    words: Sequence[str] | None,
    about: str | None,
    output: str,
    folders: Sequence[str] = (),
    choices: Mapping[str, Iterable[str]] | None = None,
    **defaults: Any,
) -> argparse.Namespace:
    """What a command line says: folders, several with a plus, ``--output`` and options with their defaults' types.

    Options of several values take them with blanks or commas between; ``choices`` are those that some allow.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in folders:
        parser.add_argument(name.rstrip("+"), type=Path, nargs="+" if name.endswith("+") else None)
    several = {name: default for name, default in defaults.items() if isinstance(default, list | tuple)}
    for name, default in defaults.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
        else:
            kind = str if name in several else type(default)
            parser.add_argument(f"--{name}", type=kind, default=default, nargs="+" if name in several else None)
    if output:
        parser.add_argument("--output", type=Path, default=Path(output))
    given = parser.parse_args(words)
    for name, default in several.items():
        kind, value = type(default[0]), getattr(given, name)
        if value is not default:
            setattr(given, name, [kind(part) for word in value for part in word.split(",")])
        if wrong := [one for one in getattr(given, name) if one not in (choices or {}).get(name, [one])]:
            parser.error(f"--{name}: {wrong[0]!r} is none of {', '.join((choices or {})[name])}")
    if getattr(given, "jobs", 1) < 1:
        parser.error(f"argument --jobs: must be at least 1, got {given.jobs}")
    return given


def write(path: Path, text: str) -> None:
    """Write a text, with its folder if it is not there, and show it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    io.save_text(path, text)
    print(text)


def saved_runs(folder: Path, runs: Mapping[str, tuple[Any, ...]], work: Callable[..., Any], jobs: int) -> list[Any]:
    """What ``work`` makes of the arguments of each run, by its name, kept in JSON files with which a study goes on.

    With several jobs, runs are in processes of one thread, whose sums are always in the same order. `FileError` if a
    kept run had other arguments; paths, which may be elsewhere now, are not compared.
    """
    missing = {name: given for name, given in runs.items() if not (folder / f"{name}.json").is_file()}
    io.make_directory(folder)
    if jobs == 1:
        for name, given in missing.items():
            _kept(folder / f"{name}.json", work, given)
    elif missing:
        os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the processes
        with worker_pool(jobs) as pool:
            for done in [pool.submit(_kept, folder / f"{name}.json", work, given) for name, given in missing.items()]:
                done.result()
    return [_made(folder / f"{name}.json", _compared(given)) for name, given in runs.items()]


def _kept(path: Path, work: Callable[..., Any], given: tuple[Any, ...]) -> None:
    with one_blas_thread():
        io.save_json(path, {"asked": _compared(given), "made": work(*given)})


def _compared(given: tuple[Any, ...]) -> str:
    return ", ".join(str(value) for value in given if not isinstance(value, Path))


def _made(path: Path, asked: str) -> Any:
    run = io.load_json(path, "a run")
    if run.get("asked") != asked:
        raise FileError(f"{path} was made with {run.get('asked')}, and {asked} is asked for; choose another --output")
    return run["made"]


def saved_rows(
    path: Path, cases: Iterable[dict[str, Any]], measure: Callable[..., dict[str, Any]]
) -> list[dict[str, Any]]:
    """All rows of the file, with one for each of the cases; empty texts stand for what was not measured.

    Args:
        path: the CSV file, which is written after each case.
        cases: arguments of ``measure`` by name, with which a row begins.
        measure: returns the other columns, numbers or texts; where it fails, ``reason`` in the row says why.

    Raises:
        FileError: the file is no such table.
    """
    rows = _read(io.make_directory(path.parent) / path.name)
    for case in cases:
        if any(case.items() <= row.items() for row in rows):
            continue
        with one_blas_thread():
            try:
                row = measure(**case)
                rows.append(case | row | {"reason": row.get("reason", "")})
            except LieEDNNError as error:
                rows.append(case | {"reason": str(error)})
        print(*rows[-1].values(), sep=", ", flush=True)
        with io.atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            names = dict.fromkeys(name for row in rows for name in row)
            writer = csv.DictWriter(file, names, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return rows


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file, quoting=csv.QUOTE_NONNUMERIC))
    except ValueError as error:
        raise FileError(f"{path} is no table of this script ({error}); choose another --output") from None
