"""Rows of a study that are measured once and kept in a CSV file, with which an interrupted study goes on."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import FileError, LieEDNNError


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
    rows = _read(path)
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
        with io.atomic_text(path) as file:
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
