"""Names to choose from, for help texts without slow imports; a test compares them with the registries."""

from __future__ import annotations

ARMS = ("telescopic_compound", "telescopic_pr", "telescopic_rrp")
SCENES = ("free", "window", "shelf", "poles")
PLANNERS = (
    "minimum-jerk",
    "se3-geodesic",
    "dmp",
    "rrt-connect",
    "rrt-star",
    "informed-rrt-star",
    "bit-star",
    "aorrtc",
    "mjpl",
    "sscbirrt",
    "trajectory-optimisation",
    "stomp",
    "qshnn",
    "linear-attractor",
    "lieednn-certified",
    "lieednn-retargeted",
    "lieednn-trained",
    "lieednn-unprojected",
    "lieednn-shaped",
    "lieednn-filtered",
    "lieednn-guided",
)
SLOW_PLANNERS = ("lieednn-trained", "trajectory-optimisation", "rrt-star", "lieednn-filtered", "lieednn-guided")
CONTROLLERS = ("position-servo", "inverse-dynamics", "computed-torque", "mocap", "mocap-deadbeat")
ALGORITHMS = ("literal", "repaired", "tracked", "riemannian", "stability-aware")
BIAS_RULES = ("uniform", "sign-matched", "solved")
RIVALS = ("dmp", "promp", "lpv-ds", "linear-attractor")
