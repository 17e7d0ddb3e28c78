"""Small good values of the package's classes, by the names of the classes, for `fuzz_public`."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import lieednn_sim as ls
from lieednn_sim import (
    arm,
    learning,
    network,
    planning,
    policies,
    simulation,
    stability,
    studies,
    synthesis,
    theory,
)
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.environments import gymnasium, suite, tasks
from lieednn_sim.learning import demonstrations
from lieednn_sim.rendering.camera import Camera
from lieednn_sim.simulation.reference import Reference

# Calls change these: a new one is made for each.
CHANGING = {"Environment", "VectorEnvironment", "Reach", "Track", "ControlEnvironment", "Camera", "Table"}
CHANGING |= {"Simulation", "MjSpec", "Controller", "FilteredPolicy", "ChunkStep"}


@functools.cache
def thing(name: str) -> Any:
    """A value of a class by its name."""
    return MAKERS[name]()


def fresh(kind: type) -> Any:
    """A value of a class, new if calls change it; options are the usual ones. None if there is no maker of it."""
    name = kind.__name__
    if name.endswith("Options") and name not in MAKERS:
        return kind()
    return None if name not in MAKERS else MAKERS[name]() if name in CHANGING else thing(name)


def home() -> Any:
    return thing("Arm").keyframe("home")


def furnish(two_hinges: str) -> None:
    """Files in the working directory, which calls name."""
    Path("folder").mkdir(exist_ok=True)
    Path("file.txt").write_text("0 0\n1 1\n2 4\n")
    np.savez("file.npz", a=np.zeros(2))
    Path("two.xml").write_text(two_hinges)


def _demonstration() -> Any:
    s = np.linspace(0.0, 1.0, 9)
    return demonstrations.Demonstration.from_samples(np.stack([s, s * s], axis=1))


# A policy of each class.
POLICY_CLASSES = {"Fabric": "fabric", "MotionTracker": "tracker", "MovementPrimitive": "dmp", "PathIntegral": "mppi"}
POLICY_CLASSES |= {"Policy": "fabric", "JointPolicy": "fabric", "NetworkPolicy": "linear-attractor"}
POLICY_CLASSES |= {"ReplanningPolicy": "lieednn-replanning", "ChunkPolicy": "lieednn-chunks"}
CHANGING |= {*POLICY_CLASSES}


def _policy(kind: str, **how: Any) -> Any:
    arm, motion = thing("Arm"), thing("Motion")
    alone = kind in ("fabric", "linear-attractor", "mppi")
    return policies.make_policy(kind, arm, motion.q[-1] if alone else motion, start=motion.q[0], **how)


def _table() -> Any:
    table = studies.Comparison(common=thing("Settings")).open(tempfile.mkdtemp(dir="."))
    table.add([thing("Row")])
    return table


def _equivariant() -> Any:
    turns = np.tile(np.eye(3), (2, 2, 1, 1))
    return theory.EquivariantLieEDNN(0.1 * np.eye(2), turns, np.zeros((2, 2, 3)), np.zeros((2, 6)))


MAKERS: dict[str, Callable[[], Any]] = {
    "Arm": lambda: arm.Arm.load("telescopic_pr"),
    "MjSpec": lambda: thing("Arm").spec.copy(),
    "MjModel": lambda: thing("Arm").model,
    "MjData": lambda: mujoco.MjData(thing("Arm").model),
    "TaskSpaceRegion": lambda: arm.TaskSpaceRegion.line(np.zeros(3), np.ones(3)),
    "Collisions": lambda: Collisions(thing("Arm")),
    "RigidTransform": lambda: thing("Arm").link_poses(home()),
    "Rotation": lambda: thing("RigidTransform").rotation[0],
    "Synthesis": lambda: synthesis.synthesize(0.5 * thing("Arm").encode(home())),
    **dict.fromkeys(("LieEDNN", "ComponentwiseNetwork", "BlockNetwork"), lambda: thing("Synthesis").network),
    "Activation": lambda: network.ACTIVATIONS["arctan"],
    "Verdict": lambda: thing("LieEDNN").assess(),
    "Robustness": lambda: thing("LieEDNN").robustness(),
    "Decay": lambda: stability.Decay(thing("Robustness"), 6),
    "MatrixLieGroup": lambda: theory.group("SO(3)"),
    "GroupLieEDNN": lambda: theory.complex_network(0.1 * np.eye(2), np.ones(2)),
    "EquivariantLieEDNN": _equivariant,
    "ShapingOptions": lambda: synthesis.ShapingOptions(neurons=(2,)),
    "CurveEncoder": lambda: synthesis.CurveEncoder(2),
    "Demonstration": _demonstration,
    "Demonstrations": lambda: demonstrations.align([thing("Demonstration")] * 2, samples=9),
    "ShapedMotion": lambda: demonstrations.ShapedMotion.fit(thing("Demonstrations"), 0.1, thing("ShapingOptions")),
    "LearnedMotion": lambda: thing("ShapedMotion"),
    "TrainingOptions": lambda: learning.TrainingOptions.tracked(max_epochs=3),
    "RiemannianOptions": lambda: learning.RiemannianOptions(max_start_epochs=3, restarts=0),
    "TrainingResult": lambda: learning.train(0.1 * np.ones((1, 6)), thing("TrainingOptions")),
    "History": lambda: thing("TrainingResult").history,
    "Plan": lambda: ls.plan(thing("Arm"), 0.99 * home(), planner="minimum-jerk", duration=(0.5, 10.0)),
    "Motion": lambda: thing("Plan").motion,
    "Tube": lambda: planning.find_tube(thing("Arm"), ls.plan(thing("Arm"), home(), planner="linear-attractor")),
    "SafetyFilter": lambda: policies.SafetyFilter(thing("Arm"), 0.01),
    "Move": lambda: ls.Move([0.1], planner="minimum-jerk", duration=(0.5, 10.0)),
    "PlanSequence": lambda: ls.plan_sequence(
        arm.Arm.of(thing("MjModel"), thing("MjData"), ["turn"]), [thing("Move"), ls.Actuate({}, 0.1)]
    ),
    "Rollout": lambda: ls.simulate(thing("Arm"), thing("Plan"), hold=0.0),
    "Rollouts": lambda: ls.simulate_many(thing("Arm"), [thing("Plan")] * 2, hold=0.0, threads=1),
    "Channel": lambda: ls.Channel("centre of mass", "m", lambda data: data.subtree_com[0]),
    "Push": lambda: ls.Push("link 1", (1.0, 0.0, 0.0), 0.0, 0.1),
    "MovingObstacle": lambda: simulation.MovingObstacle("floor", (0.0, 1.0), ((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))),
    "Simulation": lambda: simulation.Simulation(thing("Arm")),
    "Log": lambda: simulation.Log(simulation.Simulation(thing("Arm"))),
    **{name: functools.partial(_policy, kind) for name, kind in POLICY_CLASSES.items()},
    "ChunkStep": lambda: policies.ChunkStep(_policy("lieednn-chunks"), 0.02),
    "FilteredPolicy": lambda: policies.FilteredPolicy(_policy("linear-attractor")),
    "Reference": lambda: Reference.of(thing("Arm"), thing("Motion").q, thing("Motion").qd),
    "Controller": lambda: simulation.CONTROLLERS["position-servo"].load()(thing("Arm"), thing("Reference")),
    "Evaluation": lambda: ls.evaluate(thing("Rollout")),
    "Settings": lambda: studies.Settings(duration=0.5, hold=0.0),
    "Comparison": lambda: studies.Comparison(
        ("minimum-jerk",), ("telescopic_pr",), ("free",), ("position-servo",), seeds=1
    ),
    "Study": lambda: thing("Comparison"),
    "Row": lambda: studies.run_case(
        studies.Case("telescopic_pr", "free", "minimum-jerk", 0), ["position-servo"], thing("Settings")
    )[0],
    "Table": _table,
    "Environment": lambda: gymnasium.Environment(time_limit=0.1),
    "VectorEnvironment": lambda: gymnasium.VectorEnvironment(2, threads=1, time_limit=0.1),
    "Reach": lambda: tasks.Reach(time_limit=0.1),
    "Track": lambda: tasks.Track(time_limit=0.1),
    "ControlEnvironment": lambda: suite.load(random=0, time_limit=0.1),
    "Camera": lambda: Camera(thing("Arm"), size=(64, 48)),
}
