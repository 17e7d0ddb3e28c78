"""Names for help texts, from modules that are slow to import; a test compares them with the registries."""

from __future__ import annotations

ARMS = ("telescopic_compound", "telescopic_pr", "telescopic_rrp")
SCENES = ("free", "window", "shelf", "poles")
CONTROLLERS = ("position-servo", "inverse-dynamics", "computed-torque", "mocap", "mocap-deadbeat")
POLICIES = (
    *("lieednn-shaped", "lieednn-certified", "lieednn-replanning", "linear-attractor", "dmp", "fabric", "mppi"),
    "tracker",
)
ALGORITHMS = ("literal", "repaired", "tracked", "riemannian", "stability-aware")
BIAS_RULES = ("uniform", "sign-matched", "solved")
FORMATS = ("csv", "ros2", "plannerarena", "lerobot", "rerun")
RIVALS = ("dmp", "promp", "lpv-ds", "linear-attractor")
