"""Draw the rooms of the package, which are its subpackages, from their imports: which room uses which.

    python scripts/house.py [PACKAGE] [--output results/house.svg]

The rooms stand on a staircase, in the order in which `tests/test_house.py` allows imports. To the right of a room are
the rooms below that it uses, above a room are those that use it. A circle has the number of modules of the user's room
that import from the other room. Colours suit light and dark pages.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

import lieednn_sim

PACKAGE = Path(lieednn_sim.__file__).parent
ROOMS = lieednn_sim._SUBPACKAGES
# The colour of each group of rooms, named by its last one: mathematics, robot, results, doors.
GROUPS = {"learning": "#3b6fb6", "simulation": "#1f8a70", "studies": "#b5651d", "cli": "#8e4a9e"}
WRONG, LINES = "#d62728", "#9aa3ad"


def imports(package: Path) -> tuple[Counter[str], Counter[tuple[str, str]]]:
    """Lines of each room, and modules of a room that import from another one."""
    lines, uses = Counter[str](), Counter[tuple[str, str]]()
    for path in package.rglob("*.py"):
        room, text = path.relative_to(package).parts[0], path.read_text(encoding="utf-8")
        if room in ROOMS:
            lines[room] += text.count("\n")
            nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
            names = {f"{node.module}.{alias.name}" for node in nodes for alias in node.names}
            others = {name.split(".")[1] for name in names if name.startswith("lieednn_sim.")}
            uses.update((room, other) for other in others if other in ROOMS and other != room)
    return lines, uses


def draw(package: Path, figure: Figure) -> None:
    """The rooms on their staircase, the highest one first; a use of a room above, which no test lets pass, is red."""
    lines, uses = imports(package)
    rooms = [room for room in reversed(ROOMS) if room in lines]
    ends = [ROOMS.index(last) for last in GROUPS]
    colours = {room: list(GROUPS.values())[sum(end < ROOMS.index(room) for end in ends)] for room in rooms}
    figure.set_size_inches(10.0, 7.2)
    figure.set_facecolor("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor="none")
    axes.set(xlim=(-2.75, len(rooms) - 0.4), ylim=(len(rooms) - 0.4, -0.6))
    axes.set_axis_off()
    for step, room in enumerate(rooms):
        used = [rooms.index(other) for user, other in uses if user == room]
        users = [rooms.index(user) for user, other in uses if other == room]
        axes.plot([step, max(used, default=step)], [step, step], color=colours[room], lw=1.0, alpha=0.5, zorder=1)
        axes.plot([step, step], [step, min(users, default=step)], color=LINES, lw=0.8, alpha=0.5, zorder=0)
        box = FancyBboxPatch((step - 2.5, step - 0.34), 2.85, 0.68, boxstyle="round,pad=0,rounding_size=0.16")
        box.set(facecolor=colours[room], edgecolor="none", zorder=3)
        axes.add_patch(box)
        axes.text(step - 2.37, step, room, color="white", va="center", weight="bold", fontsize=10.0, zorder=4)
        axes.text(step + 0.26, step, f"{lines[room]:,}", color="white", va="center", ha="right", fontsize=7.0, zorder=4)
    for (room, other), count in uses.items():
        place = rooms.index(other), rooms.index(room)
        colour = colours[room] if place[0] > place[1] else WRONG
        axes.scatter(*place, s=130.0 + 12.0 * count, color=colour, edgecolors="none", zorder=2)
        axes.text(*place, str(count), color="white", ha="center", va="center_baseline", fontsize=8.0, zorder=5)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, nargs="?", default=PACKAGE)
    parser.add_argument("--output", type=Path, default=Path("results/house.svg"))
    given = parser.parse_args(arguments)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    figure = Figure()
    draw(given.package, figure)
    figure.savefig(given.output, metadata={"Date": None} if given.output.suffix == ".svg" else None)
    print(given.output)


if __name__ == "__main__":
    main()
