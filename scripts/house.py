"""Draw the rooms of the package from its imports: lines of code, and which room uses which.

    python scripts/house.py [PACKAGE] [--output results/house.svg]

Rooms stand above those that they use, as `tests/test_house.py` orders them; an arc is as wide as the number of modules
that import from the other room.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

import lieednn_sim

ROOMS = (
    *("lie", "stability", "network", "theory", "synthesis", "learning", "arm", "planning", "policies", "simulation"),
    *("rendering", "evaluation", "studies", "environments", "cli"),
)


def imports(package: Path) -> tuple[Counter[str], Counter[tuple[str, str]]]:
    """Lines of each room, and modules of a room that import from another one."""
    lines, uses = Counter[str](), Counter[tuple[str, str]]()
    for path in package.rglob("*.py"):
        room, text = path.relative_to(package).parts[0], path.read_text(encoding="utf-8")
        if room in ROOMS:
            lines[room] += text.count("\n")
            names = {node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)}
            others = {name.split(".")[1] for name in names if name and name.startswith("lieednn_sim.")}
            uses.update((room, other) for other in others if other in ROOMS and other != room)
    return lines, uses


def draw(package: Path) -> Figure:
    """The rooms as boxes, from the ground up, and their uses of each other as arcs."""
    lines, uses = imports(package)
    rooms = [room for room in ROOMS if room in lines]
    figure = Figure(figsize=(8.0, 0.55 * len(rooms) + 0.6), layout="constrained")
    axes = figure.subplots()
    for (room, other), count in uses.items():
        low, high = rooms.index(other), rooms.index(room)
        side = 1 if high - low > 1 else -1
        ends = (0.9 * side, high), (0.9 * side, low)
        arc = FancyArrowPatch(*ends, connectionstyle=f"arc3,rad={-0.5 * side}", arrowstyle="-|>", mutation_scale=9.0)
        arc.set(lw=0.4 + 0.12 * count, color="tab:blue" if high > low else "tab:red", alpha=0.6)
        axes.add_patch(arc)
    for level, room in enumerate(rooms):
        axes.text(0.0, level, f"{room}  {lines[room]:,}", ha="center", va="center", bbox={"fc": "white", "pad": 4.0})
    axes.set(xlim=(-4.0, 6.0), ylim=(-0.7, len(rooms) - 0.3), title=f"{sum(lines.values()):,} lines in rooms")
    axes.set_axis_off()
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, nargs="?", default=Path(lieednn_sim.__file__).parent)
    parser.add_argument("--output", type=Path, default=Path("results/house.svg"))
    given = parser.parse_args(arguments)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    draw(given.package).savefig(given.output, metadata={"Date": None} if given.output.suffix == ".svg" else None)
    print(given.output)


if __name__ == "__main__":
    main()
