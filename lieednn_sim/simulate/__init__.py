"""Simulation of planned motions in MuJoCo."""

from lieednn_sim.simulate.control import PositionServo
from lieednn_sim.simulate.rollout import Rollout, simulate

__all__ = ["PositionServo", "Rollout", "simulate"]
