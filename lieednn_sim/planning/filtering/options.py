"""Settings of the safety filter."""

from __future__ import annotations

from dataclasses import dataclass

from lieednn_sim.planning.options import PlannerOptions


@dataclass(frozen=True)
class FilterOptions(PlannerOptions):
    """Settings of the filter.

    Attributes:
        margin: distance kept from the surroundings [m].
        own_margin: distance that parts of the arm keep from each other [m].
        approach: largest c, geoms approach each other by at most this share of their distance each second [1/s].
        cutoff: pairs further apart are not looked at [m].
        smoothing: s, weight of the change of velocity.

    Raises:
        InputError: a value is not positive.
    """

    margin: float = 0.01
    own_margin: float = 0.002
    approach: float = 5.0
    cutoff: float = 0.4
    smoothing: float = 0.05
