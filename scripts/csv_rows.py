"""Rows of a script's table on disk, so that interrupted runs can be continued."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lieednn_sim import io


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a file of `write_rows`; none if there is no file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def write_rows(path: Path, fields: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write all rows below a header of their fields, atomically."""
    with io.atomic_text(path) as stream:
        writer = csv.DictWriter(stream, fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
