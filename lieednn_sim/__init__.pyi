"""The names of the front door, and the modules that they are in; `__init__.py` imports each when it is first used."""

from typing import Any

from lieednn_sim.arm import Arm as Arm
from lieednn_sim.arm import TaskSpaceRegion as TaskSpaceRegion
from lieednn_sim.arm import solve_ik as solve_ik
from lieednn_sim.arm.targets import draw_target as draw_target
from lieednn_sim.budget import reporting as reporting
from lieednn_sim.budget import time_limit as time_limit
from lieednn_sim.errors import LieEDNNError as LieEDNNError
from lieednn_sim.errors import PlanError as PlanError
from lieednn_sim.evaluation import evaluate as evaluate
from lieednn_sim.evaluation import evaluate_following as evaluate_following
from lieednn_sim.evaluation.plots import plot as plot
from lieednn_sim.learning import train as train
from lieednn_sim.live import view as view
from lieednn_sim.network import LieEDNN as LieEDNN
from lieednn_sim.planning import Actuate as Actuate
from lieednn_sim.planning import Move as Move
from lieednn_sim.planning import Plan as Plan
from lieednn_sim.planning import plan as plan
from lieednn_sim.planning import plan_learned as plan_learned
from lieednn_sim.planning import plan_sequence as plan_sequence
from lieednn_sim.planning import register_planner as register_planner
from lieednn_sim.policies import Feedback as Feedback
from lieednn_sim.policies import LoopOptions as LoopOptions
from lieednn_sim.policies import NetworkPolicy as NetworkPolicy
from lieednn_sim.policies import Policy as Policy
from lieednn_sim.policies import control_loop as control_loop
from lieednn_sim.policies import make_policy as make_policy
from lieednn_sim.rendering.page import render_page as render_page
from lieednn_sim.rendering.still import render_still as render_still
from lieednn_sim.rendering.video import render_video as render_video
from lieednn_sim.simulation import Channel as Channel
from lieednn_sim.simulation import Disturbances as Disturbances
from lieednn_sim.simulation import Push as Push
from lieednn_sim.simulation import Rollout as Rollout
from lieednn_sim.simulation import follow as follow
from lieednn_sim.simulation import simulate as simulate
from lieednn_sim.simulation import simulate_many as simulate_many
from lieednn_sim.studies import compare as compare
from lieednn_sim.synthesis import CurveEncoder as CurveEncoder
from lieednn_sim.synthesis import shape as shape
from lieednn_sim.synthesis import synthesize as synthesize

__version__: str

def __getattr__(name: str) -> Any: ...
