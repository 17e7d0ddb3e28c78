"""Style of a page: colours and marks of planners, the same in all figures and tables, and number formats."""

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


def in_order(names: Iterable[str]) -> list[str]:
    """Planners in the order of the registry, unknown ones last."""
    found, known = set(names), list(PLANNERS)
    return [name for name in known if name in found] + sorted(found - set(known))


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, *, rounding: float = 0.0) -> str:
    """Three digits, with a power of ten for very small or large values; "< ..." for values below ``rounding``."""
    if 0.0 < abs(value) < rounding:
        return f"< {number(rounding)}"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    else:
        mantissa, _, exponent = f"{value:.1e}".partition("e")
        factor = "" if mantissa == "1.0" else f"{mantissa}·"
        text = f"{factor}10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return text.replace("-", "\N{MINUS SIGN}")
