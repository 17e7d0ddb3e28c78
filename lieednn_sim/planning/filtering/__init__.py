"""Limits and clearance enforced while a network runs: a filter on joint velocities, and runs through it."""

from lieednn_sim.planning.filtering.barriers import Barrier, FilterOptions
from lieednn_sim.planning.filtering.limits import Limit
from lieednn_sim.planning.filtering.run import FilteredRun, run_filtered
from lieednn_sim.planning.filtering.safety import FilterStep, SafetyFilter
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
