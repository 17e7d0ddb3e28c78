"""Simulation of planned and of online motions in MuJoCo."""

from lieednn_sim.simulation.controllers import CONTROLLERS, controllers, register_controller
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Disturbances, Push
from lieednn_sim.simulation.following import Following, follow
from lieednn_sim.simulation.log import Channel, Instant, Log
from lieednn_sim.simulation.many import Rollouts, simulate_many
from lieednn_sim.simulation.moving_obstacles import MovingObstacle
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.simulation.tracking import simulate
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "CONTROLLERS",
    "Channel",
    "Controller",
    "Disturbances",
    "Following",
    "Instant",
    "Log",
    "MovingObstacle",
    "Push",
    "Rollout",
    "Rollouts",
    "Simulation",
    "controllers",
    "follow",
    "register_controller",
    "simulate",
    "simulate_many",
]

typecheck_public(globals())
