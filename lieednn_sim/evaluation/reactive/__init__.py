"""Planners that react, disturbed in the closed loop: their own benchmark."""
