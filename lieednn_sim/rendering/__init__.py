"""Headless rendering of rollouts."""
