"""Rendering of rollouts without a display: videos, pictures, and pages that play a motion in 3D in a browser."""
