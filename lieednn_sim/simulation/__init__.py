"""Simulation in MuJoCo: an arm tracks a planned motion, or follows a policy, under chosen disturbances.

`simulate` tracks a motion or a sequence with a controller, `simulate_many` does that for many motions at once, and
`follow` runs a policy. Each returns the log of what happened.
"""

from lieednn_sim.registry import CONTROLLERS as CONTROLLERS
from lieednn_sim.simulation.controllers import register_controller as register_controller
from lieednn_sim.simulation.controllers.base import Controller as Controller
from lieednn_sim.simulation.disturbances import Disturbances as Disturbances
from lieednn_sim.simulation.disturbances import MovingObstacle as MovingObstacle
from lieednn_sim.simulation.disturbances import Push as Push
from lieednn_sim.simulation.following import Following as Following
from lieednn_sim.simulation.following import follow as follow
from lieednn_sim.simulation.log import Channel as Channel
from lieednn_sim.simulation.log import Log as Log
from lieednn_sim.simulation.many import Rollouts as Rollouts
from lieednn_sim.simulation.many import simulate_many as simulate_many
from lieednn_sim.simulation.rollout import Rollout as Rollout
from lieednn_sim.simulation.simulation import Simulation as Simulation
from lieednn_sim.simulation.tracking import default_controller as default_controller
from lieednn_sim.simulation.tracking import simulate as simulate
from lieednn_sim.simulation.tracking_bound import tracking_bound as tracking_bound
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
