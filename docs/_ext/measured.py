"""Measured results on pages: `include` of a file below results/reference, with the command and the date first.

The file's own title gives way to that of the page; a .csv file becomes a table. In cells, numbers stay together.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from pathlib import Path

from sphinx.application import Sphinx

REFERENCE = Path(__file__).parents[2] / "results" / "reference"


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("include-read", arrange)
    app.add_css_file("results.css")
    return {"parallel_read_safe": True}


def arrange(app: Sphinx, path: Path, _: str, content: list[str]) -> None:
    """Put what made the file first, and let links lead from the page; ``path`` is relative to docs/."""
    file = (Path(app.srcdir) / path).resolve()
    if not file.is_relative_to(REFERENCE):
        return
    text = content[0]
    if file.suffix == ".csv":
        head, *rows = csv.reader(io.StringIO(text))
        names = [name.replace("_", " ") for name in head]
        lines = [names, ["---"] * len(head), *([_short(cell) for cell in row] for row in rows)]
        text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    text = re.sub(r"\A# .*\n", "", text)
    text = re.sub(r"\nMade by `[^`]*`,.*\n*\Z", "\n", text)

    def from_docs(match: re.Match[str]) -> str:
        target = file.parent / match[1]
        # For MyST an absolute path begins at docs/.
        return f"](/{Path(os.path.relpath(target, app.srcdir)).as_posix()}" if target.is_file() else match[0]

    text = re.sub(r"\]\(([^)#:]+)", from_docs, text)
    text = re.sub(r"^\|.*\|$", lambda row: _together(row[0]), text, flags=re.MULTILINE)
    # An image with a width is a link to the whole picture.
    text = re.sub(r"^(!\[.*\))$", r'\1{.chart width="100%"}', text, flags=re.MULTILINE)
    content[0] = f"{_origin(file)}\n\n{text}"


def _origin(file: Path) -> str:
    """How and when the study made the file, from results/reference/made.json."""
    name = file.relative_to(REFERENCE).as_posix()
    studies = json.loads((REFERENCE / "made.json").read_text(encoding="utf-8"))["studies"]
    study = next(study for study in studies.values() if name in study["outputs"])
    versions = ", ".join(f"{package} {version}" for package, version in study["versions"].items())
    # The CPU time of a study that was interrupted is not known.
    spent = f"{study['wall_s']:.0f} s" if study["cpu_s"] is None else f"{study['cpu_s']:.0f} s of CPU time"
    return f"Made on {study['date']} by `{study['command']}`, in {spent} on {study['cores']} cores, with {versions}."


def _together(row: str) -> str:
    """A row whose "19 of 20", "84% to 100%" and "1 / 2 / 3 / 4" are on one line, or the latter in pairs on two."""
    row = re.sub(r"(?<=[\d%]) (of|to|/) (?=-?[\d.])", "\N{NO-BREAK SPACE}\\1\N{NO-BREAK SPACE}", row)
    four = r"(\S+\xa0/\xa0\S+\xa0/)\xa0(\S+\xa0/\xa0\S+)"
    return re.sub(four, r"\1 \2", row)


def _short(cell: str) -> str:
    try:
        return f"{float(cell):.4g}"
    except ValueError:
        return cell
