"""Simulation of planned motions in MuJoCo."""

from lieednn_sim.simulate.rollout import CONTROLLERS, Rollout, simulate

__all__ = ["CONTROLLERS", "Rollout", "simulate"]
