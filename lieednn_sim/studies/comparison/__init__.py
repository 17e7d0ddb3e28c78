"""The comparison of planners."""
