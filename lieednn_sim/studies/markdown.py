"""Tables in Markdown."""

from __future__ import annotations

import html
from collections.abc import Iterable


def table(headings: Iterable[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a table in Markdown, after an empty one; of its cells, only a table's border is escaped."""
    lines = [[str(cell).replace("|", "\\|") for cell in cells] for cells in (headings, *rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return ["", *(f"| {' | '.join(cells)} |" for cells in lines)]


def escaped(text: str) -> str:
    """A text without HTML that shows in Markdown as it is, such as a name that the user gave."""
    return html.escape(text, quote=False)
