"""Limits and clearance enforced while a policy runs: a filter on joint velocities."""

from lieednn_sim.planning.safety_filter.barriers import Barrier, FilterOptions
from lieednn_sim.planning.safety_filter.filter import FilterStep, SafetyFilter
from lieednn_sim.planning.safety_filter.limits import Limit
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "Barrier",
    "FilterOptions",
    "FilterStep",
    "Limit",
    "SafetyFilter",
]

typecheck_public(globals())
