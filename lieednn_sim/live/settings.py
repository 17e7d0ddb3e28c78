"""What a live view lets its user choose."""

from __future__ import annotations

from dataclasses import dataclass

from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.simulation import Disturbances
from lieednn_sim.validation import as_positive
from lieednn_sim.values import check_fields

# Policies that follow or imitate a planned motion.
PLANNED = ("tracker", "dmp")


def ready_planners() -> tuple[str, ...]:
    """Names of the planners whose libraries are installed, for menus."""
    return tuple(name for name in PLANNERS if not PLANNERS[name].install)


@dataclass(frozen=True)
class Settings:
    """The settings of a `Session`.

    Attributes:
        policy: a name of `POLICIES`.
        planner: a name of `PLANNERS`, which plans the motions of the policies in `PLANNED`.
        rho: rate of the clock of ``lieednn-shaped``, see `ShapedOptions`.
        filtered: whether the policy is behind the safety filter.
        controller: a name of `CONTROLLERS`.
        payload: mass at the end effector that policy and controller do not know [kg].
        mass_scale: true masses relative to those that the controller knows.

    Raises:
        InputError: a name is unknown, or a number is out of range.
    """

    policy: str = "lieednn-shaped"
    planner: str = "minimum-jerk"
    rho: float = 1.0
    filtered: bool = False
    controller: str = "inverse-dynamics"
    payload: float = 0.0
    mass_scale: float = 1.0

    def __post_init__(self) -> None:
        POLICIES.find(self.policy)
        PLANNERS.find(self.planner)
        CONTROLLERS.find(self.controller)
        check_fields(self, as_positive, "rho")
        self.disturbances  # noqa: B018 (checks the numbers)

    @property
    def disturbances(self) -> Disturbances:
        """Payload and masses as disturbances of the simulation."""
        return Disturbances(payload=self.payload, mass_scale=self.mass_scale)

    @property
    def of_policy(self) -> tuple[object, ...]:
        """The values whose change needs another policy."""
        planner = self.planner if self.policy in PLANNED else ""
        return self.policy, planner, self.rho if self.policy == "lieednn-shaped" else 1.0, self.filtered

    @property
    def of_plant(self) -> tuple[object, ...]:
        """The values whose change needs another simulated model and controller."""
        return self.controller, self.payload, self.mass_scale
