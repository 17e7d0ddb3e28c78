"""Shaping: certified networks whose transient follows a given curve, stored in their weights or initial state."""
