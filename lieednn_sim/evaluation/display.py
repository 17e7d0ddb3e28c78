"""Tables for the terminal and in Markdown."""

from __future__ import annotations

import html
from collections.abc import Iterable

from rich import box
from rich.console import Console, RenderableType
from rich.table import Table


def table(title: str, *columns: str) -> Table:
    """An empty table; the first column is for names, the others for numbers."""
    result = Table(title=title, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, column in enumerate(columns):
        result.add_column(column, justify="left" if index == 0 else "right", no_wrap=index == 0)
    return result


def as_text(shown: RenderableType) -> str:
    """What the terminal shows, without colours."""
    # In a notebook rich would display an empty output, too.
    plain = Console(color_system=None, markup=False, emoji=False, highlight=False, soft_wrap=True, force_jupyter=False)
    with plain.capture() as capture:
        plain.print(shown)
    return capture.get().rstrip("\n")


def markdown_table(headings: Iterable[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a table in Markdown, after an empty one; in its cells, only the table's border is escaped."""
    lines = [[str(cell).replace("|", "\\|") for cell in cells] for cells in (headings, *rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return ["", *(f"| {' | '.join(cells)} |" for cells in lines)]


def escaped(text: str) -> str:
    """A text without HTML that shows in Markdown as it is, such as a name that the user gave."""
    return html.escape(text, quote=False)
