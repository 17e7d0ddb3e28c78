"""Limits and clearance enforced while a network runs: a filter on joint velocities, and runs through it."""

from lieednn_sim.planning.filtering.proof import limits_proved
from lieednn_sim.planning.filtering.run import FilteredRun, run_filtered
from lieednn_sim.planning.filtering.safety import FilterOptions, FilterStep, SafetyFilter

__all__ = ["FilterOptions", "FilterStep", "FilteredRun", "SafetyFilter", "limits_proved", "run_filtered"]
