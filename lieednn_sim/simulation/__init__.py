"""Simulation in MuJoCo: an arm tracks a planned motion, or follows a policy, under chosen disturbances.

`simulate` tracks a motion or a sequence with a controller, `simulate_many` does that for many motions at once, and
`follow` runs a policy. Each returns the log of what happened.
"""

from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation.controllers import register_controller
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Disturbances, MovingObstacle, Push
from lieednn_sim.simulation.following import Following, follow
from lieednn_sim.simulation.log import Channel, Log
from lieednn_sim.simulation.many import Rollouts, simulate_many
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.simulation.tracking import default_controller, simulate
from lieednn_sim.simulation.tracking_bound import tracking_bound
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "CONTROLLERS",
    "Channel",
    "Controller",
    "Disturbances",
    "Following",
    "Log",
    "MovingObstacle",
    "Push",
    "Rollout",
    "Rollouts",
    "Simulation",
    "default_controller",
    "follow",
    "register_controller",
    "simulate",
    "simulate_many",
    "tracking_bound",
]

typecheck_public(globals())
