"""Shaping: certified networks whose transient follows a given curve, stored in the weights or in the start."""
