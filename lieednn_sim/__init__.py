"""The front door: the names that most programs need, to plan, simulate, render and evaluate an arm's motion.

::

    import lieednn_sim as ls

    arm = ls.Arm.load("telescopic_pr")
    plan = ls.plan(arm, "extended")
    rollout = ls.simulate(arm, plan)

Each name is imported when it is first used. Everything else is in the subpackages: `lie`, `stability`, `network`,
`theory`, `synthesis`, `learning`, `arm`, `planning`, `policies`, `simulation`, `rendering`, `evaluation`,
`studies`, `environments`, `exports`, `live`, `cli`.
"""

from __future__ import annotations

from importlib import import_module

# As in `typing`, which takes milliseconds to import, in which Ctrl-C would end a command with a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
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

_NAMES = {
    "arm": ("Arm", "TaskSpaceRegion", "solve_ik"),
    "arm.targets": ("draw_target",),
    "budget": ("reporting", "time_limit"),
    "errors": ("LieEDNNError", "PlanError"),
    "evaluation": ("evaluate", "evaluate_following"),
    "evaluation.plots": ("plot",),
    "learning": ("train",),
    "live": ("view",),
    "network": ("LieEDNN",),
    "planning": ("Actuate", "Move", "Plan", "plan", "plan_learned", "plan_sequence", "register_planner"),
    "policies": ("Feedback", "LoopOptions", "NetworkPolicy", "Policy", "control_loop", "make_policy"),
    "rendering.page": ("render_page",),
    "rendering.still": ("render_still",),
    "rendering.video": ("render_video",),
    "simulation": ("Channel", "Disturbances", "Push", "Rollout", "follow", "simulate", "simulate_many"),
    "studies": ("compare",),
    "synthesis": ("CurveEncoder", "shape", "synthesize"),
}
_SUBPACKAGES = (
    *("lie", "stability", "network", "theory", "synthesis", "learning", "arm", "planning", "policies", "simulation"),
    *("rendering", "evaluation", "studies", "environments", "exports", "live", "cli"),
)
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("lieednn_sim")
    if name in _MODULE_OF:
        return getattr(import_module(f"lieednn_sim.{_MODULE_OF[name]}"), name)
    if name in _SUBPACKAGES:
        return import_module(f"lieednn_sim.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; names: {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBPACKAGES, "__version__"})
