"""Limits and clearance enforced while a network runs: a filter on joint velocities, and runs through it."""

from lieednn_sim.planning.safety_filter.barriers import Barrier, FilterOptions
from lieednn_sim.planning.safety_filter.filter import FilterStep, SafetyFilter
from lieednn_sim.planning.safety_filter.filtered_run import FilteredRun, run_filtered
from lieednn_sim.planning.safety_filter.limits import Limit
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "Barrier",
    "FilterOptions",
    "FilterStep",
    "FilteredRun",
    "Limit",
    "SafetyFilter",
    "run_filtered",
]

typecheck_public(globals())
