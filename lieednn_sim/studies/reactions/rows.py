"""Rows of the benchmark of disturbed policies, and what each policy is compared as."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from lieednn_sim.planning import ShapedOptions
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.studies.rows import TableRow, column, columns_of, outcome


class ComparedPolicy(NamedTuple):
    """A policy of the benchmark: a name of `POLICIES`, and whether it needs the safety filter among obstacles."""

    policy: str
    options: PlannerOptions | None = None
    filtered: bool = True


COMPARED: dict[str, ComparedPolicy] = {
    **{f"lieednn-shaped, rho {r:g}": ComparedPolicy("lieednn-shaped", ShapedOptions(rate=r)) for r in (1, 0.3, 0.1)},
    "lieednn-certified": ComparedPolicy("lieednn-certified"),
    "lieednn-replanning": ComparedPolicy("lieednn-replanning", filtered=False),
    "linear-attractor": ComparedPolicy("linear-attractor"),
    "dmp": ComparedPolicy("dmp"),
    "fabric": ComparedPolicy("fabric", filtered=False),
    "mppi": ComparedPolicy("mppi", filtered=False),
    "tracker": ComparedPolicy("tracker", filtered=False),
}


DISTURBANCES = ("none", "push", "payload", "target", "obstacle")


@dataclass(frozen=True, slots=True)
class Reaction(TableRow):
    """A row of the benchmark of disturbed policies: one rollout.

    Attributes:
        arm, scene: names; together with the next three, the key of the row.
        policy, disturbance: names of `COMPARED` and of `DISTURBANCES`.
        seed: seed of target, obstacles and disturbance.
        success: whether every link ends within 1 mm and 0.1 degrees of the target without contact.
        reason: why it does not; begins with "problem", "plan", "simulation", "contact", "arrival" or "error".
    """

    _key = ("arm", "scene", "policy", "disturbance", "seed")

    arm: str
    scene: str
    policy: str
    disturbance: str
    seed: int
    success: bool = outcome()
    reason: str = ""
    push_n: float | None = column("push [N]", "force that takes a joint a tenth of its range off that path")
    final_mm: float | None = column("final [mm]", "distance of the worst link from its target at the end")
    deviation: float | None = column("deviation [ranges]", "largest distance of a joint from the undisturbed path")
    back_s: float | None = column(
        "back after [s]", "time after the disturbance until it stays within a tenth of that; none where it does not"
    )
    back_fraction: float | None = column("of path left", "covered by then, as a fraction of the path that was left")
    effort: float | None = column("effort [s]", "integral of the mean squared actuator force in units of the limits")
    velocity_fraction: float | None = column("velocity / limit", "largest joint velocity in units of its limit")
    force_fraction: float | None = column(
        "force / limit", "largest actuator force in units of its limit in the weaker direction"
    )
    path_m: float | None = column("path [m]", "length of the end effector's path")
    settled_s: float | None = column("settled after [s]", "time from which it stays within 1 mm and 0.1 degrees")
    step_us: float | None = column("control step [us]", "median CPU time of a control step", timed=True)

    @property
    def posed(self) -> bool:
        """Whether there was a problem to solve; a pole may find no place in the arm's way."""
        return not self.reason.startswith("problem")


MEASURED = columns_of(Reaction)
