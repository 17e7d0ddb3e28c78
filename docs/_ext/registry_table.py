"""Tables that say what the code says.

``{registry} PLANNERS`` makes one from the rows of `lieednn_sim.registry`, ``{columns}`` from the columns of the
comparison, and ``{disturbances}`` from the docstring of `Disturbances`, with the options of the command ``simulate``.
"""

from __future__ import annotations

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from lieednn_sim import registry
from lieednn_sim.cli.signatures import descriptions, find, parameters
from lieednn_sim.entries import LIBRARIES
from lieednn_sim.studies.comparison.rows import COLUMNS


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("registry", RegistryTable)
    app.add_directive("columns", ColumnsTable)
    app.add_directive("disturbances", DisturbancesTable)
    return {"parallel_read_safe": True}


class _Table(SphinxDirective):
    """A table of the cells that `cells` gives, the headings first."""

    def run(self) -> list[nodes.Node]:
        """Called by Sphinx."""
        head, *rows = self.cells()
        lines = [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]
        self.content = StringList(lines, source=self.name)
        return self.parse_content_to_nodes()

    def cells(self) -> list[list[str]]:
        """Text of each cell, in Markdown."""
        raise NotImplementedError


class RegistryTable(_Table):
    """The rows of a registry: name, what it is, and the extra that it needs, if any needs one."""

    required_arguments = 1

    def cells(self) -> list[list[str]]:
        """See `_Table`."""
        kind = getattr(registry, self.arguments[0])
        cells = [[kind.kind, "what it is", "extra"]]
        for key, entry in kind.entries.items():
            extra = f"`{LIBRARIES[entry.library].extra}`" if entry.library else ""
            cells.append([f"`{key}`", entry.help, extra])
        width = 3 if any(entry.library for entry in kind.entries.values()) else 2
        return [line[:width] for line in cells]


class ColumnsTable(_Table):
    """The measured columns of a comparison: name, heading with the unit, and meaning."""

    def cells(self) -> list[list[str]]:
        """See `_Table`."""
        return [["column", "heading", "meaning"], *([f"`{c.name}`", c.heading, c.meaning] for c in COLUMNS)]


class DisturbancesTable(_Table):
    """The fields of `Disturbances`: name, meaning, and the option on the command line, if there is one."""

    def cells(self) -> list[list[str]]:
        """See `_Table`."""
        source = find("lieednn_sim.simulation.disturbances", "Disturbances")
        command = find("lieednn_sim.cli.arguments", "Simulating")
        group = next(each.group for each in parameters(command) if each.name == "disturbances")
        options = {each.name: f"`--{each.option}`" for each in group} | {"pushes": "`--push`"}
        texts = descriptions(source.docstring).items()
        rows = ([f"`{name}`", text, options.get(name, "")] for name, text in texts)
        return [["`Disturbances(...)`", "what it is", "option"], *rows]
