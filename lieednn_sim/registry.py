"""Everything that is chosen by name: one row for each planner, policy, controller, arm, scene, format and model.

A row (`entries.Entry`) says where a thing is, what it does in one line, which class its options have, and which
optional library it needs. Help texts, menus and the tables of the documentation come from the rows; nothing is imported
for them, and this module imports nothing slow.
"""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any

from lieednn_sim.entries import LIBRARIES, Entry, FormatEntry, PlannerEntry, Registry, install_command
from lieednn_sim.errors import LieEDNNError

SLOW = 1.0  # CPU time of a case above which a planner is slow [s]


def purpose(library: str) -> str:
    """What an optional library is for."""
    users = []
    for registry in (PLANNERS, FORMATS):
        names = [name for name, entry in registry.entries.items() if entry.library == library]
        users += [f"{registry.kind}{'s' * (len(names) > 1)} {', '.join(names)}"] * bool(names)
    return ", ".join(filter(None, (*users, LIBRARIES[library].purpose)))


def optional_module(name: str) -> Any:
    """Import a module of an optional library; `LieEDNNError`, which names the extra, if that is impossible."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        library = name.partition(".")[0]
        why = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be imported, since {error}"
        raise LieEDNNError(f"{library} {why} (for {purpose(library)}): {install_command(library)}") from None


_PLANNERS = {
    "minimum-jerk": PlannerEntry("baselines.interpolation:minimum_jerk", "straight in joint space"),
    "se3-geodesic": PlannerEntry("baselines.interpolation:se3_geodesic", "compound joints on SE(3) geodesics"),
    "dmp": PlannerEntry("baselines.interpolation:dmp", "a dynamic movement primitive"),
    "rrt-connect": PlannerEntry("baselines.sampling:rrt_connect", "OMPL's RRT-Connect", "RrtConnectOptions", "ompl"),
    "rrt-star": PlannerEntry("baselines.sampling:rrt_star", "OMPL's RRT*", "RrtStarOptions", "ompl", cost=1.3),
    "informed-rrt-star": PlannerEntry(
        "baselines.sampling:informed_rrt_star", "OMPL's Informed RRT*", "InformedRrtStarOptions", "ompl"
    ),
    "bit-star": PlannerEntry("baselines.sampling:bit_star", "OMPL's BIT*", "BitStarOptions", "ompl"),
    "aorrtc": PlannerEntry("baselines.sampling:aorrtc", "OMPL's AORRTC", "RrtStarOptions", "ompl"),
    "mjpl": PlannerEntry("baselines.cbirrt:mjpl", "the bidirectional RRT of mjpl", "PathOptions", "mjpl"),
    "sscbirrt": PlannerEntry(
        "baselines.cbirrt:sscbirrt", "the bidirectional RRT of sscbirrt", "PathOptions", "sscbirrt"
    ),
    "trajectory-optimisation": PlannerEntry(
        "baselines.optimisation:trajectory_optimisation", "a spline of least jerk", "OptimisationOptions", cost=1.6
    ),
    "stomp": PlannerEntry("baselines.stomp:stomp", "stochastic trajectory optimisation", "StompOptions"),
    "qshnn": PlannerEntry(
        "baselines.qshnn:qshnn", "the quaternion Hopfield network that the paper starts from", "QshnnOptions"
    ),
    "linear-attractor": PlannerEntry("network_planners:linear_attractor", "a network without weights", network=True),
    "lieednn-certified": PlannerEntry(
        "certified:certified", "a certified network for the target", "CertifiedOptions", network=True
    ),
    "lieednn-retargeted": PlannerEntry(
        "network_planners:retargeted",
        "one certified network for all targets, retargeted by its bias",
        "RetargetedOptions",
        network=True,
    ),
    "lieednn-trained": PlannerEntry(
        "network_planners:trained", "a learned network", "TrainedOptions", cost=2.7, network=True
    ),
    "lieednn-shaped": PlannerEntry(
        "shaped:shaped",
        "a certified network along the motion of a guide, around obstacles",
        "ShapedOptions",
        network=True,
        path_constraints=True,
    ),
}
#: All planners by name; a comparison's table is in this order.
PLANNERS = Registry(
    "planner",
    _PLANNERS,
    "planning.",
    make=partial(PlannerEntry, path_constraints=True),
    wanted="a function of a PlanningProblem",
)

_POLICIES = {
    "lieednn-shaped": Entry("network_policy:shaped", "a certified network along the path of a guide", "ShapedOptions"),
    "lieednn-certified": Entry(
        "network_policy:certified", "a certified network, made in milliseconds", "CertifiedPolicyOptions"
    ),
    "lieednn-replanning": Entry(
        "replanning:ReplanningPolicy.of",
        "a certified network that replans for new targets and around moving obstacles",
        "ReplanningOptions",
    ),
    "lieednn-chunks": Entry(
        "chunks:ChunkPolicy.of",
        "a certified network that follows action chunks of learned policies within the limits",
        "ChunkOptions",
    ),
    "linear-attractor": Entry("network_policy:linear", "the network without weights: straight in se(3)"),
    "dmp": Entry("planned:primitive", "a movement primitive that imitates a motion", "PrimitiveOptions"),
    "fabric": Entry("fabric:fabric", "an attractor with repulsive obstacles", "FabricOptions"),
    "mppi": Entry(
        "path_integral:path_integral",
        "model-predictive path integral control, with a model of its own",
        "PathIntegralOptions",
    ),
    "tracker": Entry("planned:tracker", "plays a planned motion, without feedback"),
}
#: All policies by name: functions of a `PolicyTask`, and of their options if there are any, that make a `Policy`. After
#: a reset a policy repeats itself to the bit, and it can be copied and pickled at any time. Its message is "moves", or
#: "has ended" at the end of a motion; any other message says what keeps the policy from moving on.
POLICIES = Registry("policy", _POLICIES, "policies.", make=Entry, wanted="a function of a PolicyTask")

_CONTROLLERS = {
    "position-servo": Entry("base:PositionServo", "sends positions and velocities to the arm's position servos"),
    "inverse-dynamics": Entry(
        "base:InverseDynamicsServo", "adds the forces that the motion needs according to the model"
    ),
    "computed-torque": Entry(
        "base:ComputedTorque", "feedback from the measured state through the model, instead of servos"
    ),
    "feedback-linearisation": Entry(
        "linearisation:feedback_linearisation",
        "computed torques by the actuators that a model has; the default for views of models",
    ),
    "mocap": Entry(
        "mocap:MocapWelds", "moves the link frames by mocap bodies welded to them; no actuators, hence no noise"
    ),
    "mocap-deadbeat": Entry(
        "mocap:DeadbeatWelds", "mocap with welds that close the error in one step; needs a reference at every time step"
    ),
}
#: All controllers by name: functions or classes that take an arm and a `Reference`.
CONTROLLERS = Registry(
    "controller",
    _CONTROLLERS,
    "simulation.controllers.",
    make=Entry,
    wanted="a Controller, or a function that makes one",
)

_ARMS = {
    "telescopic_compound": Entry(help="four compound joints of six degrees of freedom each"),
    "telescopic_crane": Entry(help="a truck crane whose boom a cylinder lifts, with a hook that swings"),
    "telescopic_pr": Entry(help="four sliding and turning links"),
    "telescopic_rrp": Entry(help="three links that turn twice and slide"),
}
#: The arms of the package; each is a folder of that name with a scene.xml in ``assets/mjcf``.
ARMS = Registry("arm", _ARMS, further="or the path of an MJCF or URDF file")
#: The arms that studies take by default, which are similar.
DEFAULT_ARMS = ("telescopic_compound", "telescopic_pr", "telescopic_rrp")

_SCENES = {
    "free": Entry(help="no obstacles"),
    "window": Entry("window", "a wall with an opening"),
    "shelf": Entry("shelf", "a shelf of two columns and two rows"),
    "poles": Entry("poles", "a field of vertical poles"),
}
#: Obstacles around an arm, functions of `arm.scenes`. The index of a name is part of the seed of its obstacles.
SCENES = Registry("scene", _SCENES, "arm.scenes:")

_FORMATS = {
    "csv": FormatEntry(
        "formats:write_csv", "a table of time, joints and end effector, for a spreadsheet, MATLAB, R or pandas"
    ),
    "ros2": FormatEntry(
        "ros2:write",
        "a JointTrajectory as YAML, and a bag in MCAP, for a robot's controller or a replay in ROS 2",
        library="rosbags",
    ),
    "plannerarena": FormatEntry(
        "planner_arena:write",
        "OMPL's benchmark logs of a comparison, for tools such as Planner Arena",
        of_comparison=True,
    ),
    "lerobot": FormatEntry(
        "lerobot:write",
        "a data set of one episode for each run, to train policies by imitation with LeRobot",
        library="pyarrow",
    ),
    "rerun": FormatEntry(
        "rerun_recording:write",
        "a recording of the moving arm and of curves over time, for Rerun's viewer",
        library="rerun",
    ),
}
#: File formats of other tools.
FORMATS = Registry(
    "format", _FORMATS, "exports.", further="and of a network ONNX and C, by plan.network.to_onnx and to_c"
)

_ALGORITHMS = {
    "literal": Entry("TrainingOptions.literal", "as printed in the paper"),
    "repaired": Entry("TrainingOptions", "its equations, repaired"),
    "tracked": Entry("TrainingOptions.tracked", "the same, with the equilibrium tracked"),
    "riemannian": Entry("RiemannianOptions", "on the manifold of scaled adjoints"),
    "stability-aware": Entry("RiemannianOptions.stability_aware", "the same, certified all along"),
}
#: Algorithms that learn a network for a target: functions of their options' values, which make these options.
ALGORITHMS = Registry("algorithm", _ALGORITHMS, "learning.options:")

_BIAS_RULES = {
    "uniform": Entry(help="every entry the same, as in the paper"),
    "sign-matched": Entry(help="with the sign of the target"),
    "solved": Entry(help="what makes the target the equilibrium of weights drawn without regard to it"),
}
#: Rules that choose a network's bias, see `synthesis.bias_for`.
BIAS_RULES = Registry("bias rule", _BIAS_RULES)

_RIVALS = {
    "dmp": Entry("primitives:DynamicPrimitive.fit", "a dynamic movement primitive"),
    "promp": Entry("primitives:ProbabilisticPrimitive.fit", "a probabilistic movement primitive"),
    "lpv-ds": Entry("models:StableMixture.fit", "a stable mixture of linear ones"),
    "linear-attractor": Entry("models:LinearAttractor.fit", "the same rate everywhere"),
}
#: Models of demonstrations with which a shaped network is compared: functions of demonstrations and of the number of
#: parameters to have.
RIVALS = Registry("rival", _RIVALS, "learning.demonstrations.")
