"""Tables in Markdown."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from lieednn_sim.studies.rows import Column


def table_head(names: Sequence[str], columns: Sequence[Column] = ()) -> list[str]:
    """The first two lines of a table in Markdown: names, then the headings of columns."""
    cells = [*names, *(column.heading for column in columns)]
    return [table_line(cells), "|" + " --- |" * len(cells)]


def table_line(cells: Sequence[str]) -> str:
    """A line of a table in Markdown, whatever its cells hold."""
    return "| " + " | ".join(map(escaped, cells)) + " |"


def table(headings: Iterable[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a whole table in Markdown, after an empty one; of its cells, only a table's border is escaped."""
    lines = [[str(cell).replace("|", "\\|") for cell in cells] for cells in (headings, *rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return ["", *(f"| {' | '.join(cells)} |" for cells in lines)]


def escaped(text: str) -> str:
    """A text that shows in Markdown as it is, such as a name that the user gave: neither HTML nor a table's border."""
    return html.escape(text, quote=False).replace("|", "\\|")
