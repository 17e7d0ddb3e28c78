"""Tables of what is chosen by name: ``{registry} PLANNERS`` makes one from the rows of `lieednn_sim.registry`."""

from __future__ import annotations

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from lieednn_sim import registry


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("registry", RegistryTable)
    return {"parallel_read_safe": True}


class RegistryTable(SphinxDirective):
    """The rows of a registry: name, what it is, and the extra that it needs, if any needs one."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Called by Sphinx."""
        self.content = StringList(rows(self.arguments[0]), source="registry")
        return self.parse_content_to_nodes()


def rows(name: str) -> list[str]:
    """The lines of the table of a registry, by its name in `lieednn_sim.registry`, in Markdown."""
    kind = getattr(registry, name)
    cells = [[kind.kind, "what it is", "extra"], ["---"] * 3]
    for key, entry in kind.entries.items():
        cells.append([f"`{key}`", entry.help, f"`{registry.LIBRARIES[entry.library].extra}`" if entry.library else ""])
    width = 3 if any(entry.library for entry in kind.entries.values()) else 2
    return [f"| {' | '.join(line[:width])} |" for line in cells]
