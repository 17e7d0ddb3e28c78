"""The planners by name, and where they live: the one place to register them.

It imports nothing slow, so that the command line lists planners without loading them; `planning.registry` does so.
"""

from __future__ import annotations

from typing import NamedTuple

# CPU time of a case of most planners, and that above which a planner is slow [s].
TYPICAL, SLOW = 0.6, 1.0


class Entry(NamedTuple):
    """What is known of a planner before it is loaded.

    Attributes:
        solve: place of its function within the package, ``module:name``; see `planning.registry.Planner`.
        options: name of its options' class in the same module; empty for a planner without options.
        help: what it does, in one line.
        extra: extra of this package that installs what it needs; empty if it needs nothing more.
        libraries: modules of that extra that it needs.
        cost: CPU time of a case of a comparison [s], planning and both default controllers, in the mean over the
            package's arms, free and behind the window. Declared, not measured, so that which cases there are depends
            on no machine.
        network: whether its plans have a certifiable network, which `lieednn-sim synthesize` stores.
        keeps: whether it can keep the end effector in a region on the way, the argument ``keep`` of `planning.plan`.
    """

    solve: str
    options: str
    help: str
    extra: str = ""
    libraries: tuple[str, ...] = ()
    cost: float = TYPICAL
    network: bool = False
    keeps: bool = False


_OMPL = ("rivals", ("ompl",))
PLANNERS = {
    "minimum-jerk": Entry("planning.baselines.interpolation:minimum_jerk", "", "straight in joint space"),
    "se3-geodesic": Entry("planning.baselines.interpolation:se3_geodesic", "", "compound joints on geodesics of SE(3)"),
    "dmp": Entry("planning.baselines.primitives:dmp", "DmpOptions", "a dynamic movement primitive"),
    "rrt-connect": Entry("planning.baselines.sampling:rrt_connect", "RrtConnectOptions", "OMPL's RRT-Connect", *_OMPL),
    "rrt-star": Entry("planning.baselines.sampling:rrt_star", "RrtStarOptions", "OMPL's RRT*", *_OMPL, cost=1.3),
    "informed-rrt-star": Entry(
        "planning.baselines.sampling:informed_rrt_star", "InformedRrtStarOptions", "OMPL's Informed RRT*", *_OMPL
    ),
    "bit-star": Entry("planning.baselines.sampling:bit_star", "BitStarOptions", "OMPL's BIT*", *_OMPL),
    "aorrtc": Entry("planning.baselines.sampling:aorrtc", "RrtStarOptions", "OMPL's AORRTC", *_OMPL),
    "mjpl": Entry(
        "planning.baselines.cbirrt:mjpl", "PathOptions", "the bidirectional RRT of mjpl", "cbirrt", ("mjpl",)
    ),
    "sscbirrt": Entry(
        "planning.baselines.cbirrt:sscbirrt",
        "PathOptions",
        "the bidirectional RRT of sscbirrt",
        "cbirrt",
        ("sscbirrt",),
    ),
    "trajectory-optimisation": Entry(
        "planning.baselines.optimisation:trajectory_optimisation",
        "OptimisationOptions",
        "a spline of least jerk",
        cost=1.6,
    ),
    "stomp": Entry("planning.baselines.stomp:stomp", "StompOptions", "stochastic trajectory optimisation"),
    "qshnn": Entry("planning.baselines.qshnn:qshnn", "QshnnOptions", "a quaternion Hopfield network"),
    "linear-attractor": Entry(
        "planning.network_planners:linear_attractor", "", "a network without weights", network=True
    ),
    "lieednn-certified": Entry(
        "planning.certified:certified", "CertifiedOptions", "a certified network for the target", network=True
    ),
    "lieednn-retargeted": Entry(
        "planning.network_planners:retargeted", "RetargetedOptions", "one network, certified once", network=True
    ),
    "lieednn-trained": Entry(
        "planning.network_planners:trained", "TrainedOptions", "a learned network", cost=2.7, network=True
    ),
    "lieednn-unprojected": Entry(
        "planning.network_planners:unprojected", "UnprojectedOptions", "the same without projections", network=True
    ),
    "lieednn-shaped": Entry(
        "planning.shaped:shaped", "ShapedOptions", "a network along another's motion", network=True, keeps=True
    ),
    "lieednn-filtered": Entry(
        "planning.filtered_planners:filtered",
        "FilteredOptions",
        "a network through the safety filter",
        cost=1.1,
        network=True,
    ),
    "lieednn-guided": Entry(
        "planning.filtered_planners:guided",
        "GuidedOptions",
        "the same along RRT-Connect's path",
        *_OMPL,
        cost=1.1,
        network=True,
    ),
}
