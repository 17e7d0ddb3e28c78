"""Style of a page: colours and marks of planners, the same in all figures and tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from lieednn_sim.evaluation.figure_layout import COLOURS
from lieednn_sim.registry import PLANNERS

# The package's colours, and a grey.
_COLOURS = (*COLOURS, "#8C8C8C")
# Marks and their shapes in the page's styles; each repetition of the colours has another one.
_MARKS = (("o", "round"), ("D", "diamond"), ("s", "square"), ("^", "triangle"))


@dataclass(frozen=True)
class Mark:
    """Colour of a planner, its Matplotlib marker, and the name of that shape in the page's styles."""

    colour: str
    marker: str
    shape: str


def marks(names: Iterable[str]) -> dict[str, Mark]:
    """A mark for each planner, which does not depend on the other names."""
    known = list(PLANNERS)
    order = known + sorted(set(names) - set(known))
    made = {}
    for index, name in enumerate(order):
        marker, shape = _MARKS[index // len(_COLOURS) % len(_MARKS)]
        made[name] = Mark(_COLOURS[index % len(_COLOURS)], marker, shape)
    return made
