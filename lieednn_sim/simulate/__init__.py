"""Simulation of planned and of online motions in MuJoCo."""

from lieednn_sim.simulate.controllers import CONTROLLERS
from lieednn_sim.simulate.disturbances import Disturbances, Push
from lieednn_sim.simulate.log import Instant
from lieednn_sim.simulate.online import Following, follow
from lieednn_sim.simulate.rollout import Rollout
from lieednn_sim.simulate.simulation import Simulation
from lieednn_sim.simulate.tracking import simulate

__all__ = [
    "CONTROLLERS",
    "Disturbances",
    "Following",
    "Instant",
    "Push",
    "Rollout",
    "Simulation",
    "follow",
    "simulate",
]
