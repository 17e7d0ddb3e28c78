"""The settings that the user of a live view can change."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from lieednn_sim.arm import Arm
from lieednn_sim.planning import default_planner
from lieednn_sim.policies.making import PLANNED
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.simulation import Disturbances, default_controller
from lieednn_sim.validation import as_choice, as_positive
from lieednn_sim.values import check_fields


@dataclass(frozen=True)
class Settings:
    """The settings of a `Session`.

    Attributes:
        policy: one of your own as FILE.py:FUNCTION, or a name of `POLICIES`.
        planner: a name of `PLANNERS`, for policies that follow a plan; by default the arm's `default_planner`.
        rho: rate of the clock of ``lieednn-shaped``, see `ShapedOptions`.
        filtered: whether the policy is behind the safety filter; None if it is among obstacles.
        controller: of `CONTROLLERS`; by default ``inverse-dynamics`` for servos, else ``feedback-linearisation``.
        payload: mass at the end effector that policy and controller do not know [kg].
        mass_scale: true masses relative to those that the controller knows.

    Raises:
        InputError: a name is unknown, or a number is out of range.
        LieEDNNError: the planner's library is not installed.
    """

    policy: str = "lieednn-shaped"
    planner: str | None = None
    rho: float = 1.0
    filtered: bool | None = None
    controller: str | None = None
    payload: float = 0.0
    mass_scale: float = 1.0

    def __post_init__(self) -> None:
        POLICIES.find(self.policy)
        if self.planner is not None:
            PLANNERS.require(self.planner)
        if self.controller is not None:
            CONTROLLERS.find(self.controller)
        check_fields(self, as_positive, "rho")
        self.disturbances  # noqa: B018 (checks the numbers)

    def changed(self, **values: Any) -> Settings:
        """The settings with other values of some fields; `InputError` as for new ones, or if there is no such field."""
        for name in values:
            as_choice("setting", name, [field.name for field in fields(self)])
        return replace(self, **values)

    def chosen(self, arm: Arm) -> Settings:
        """The settings, with fields that are None replaced by the defaults for an arm."""
        usual: Any = {"planner": default_planner(arm)[0], "controller": default_controller(arm, policy=True)}
        usual["filtered"] = arm.scene != "free"
        return replace(self, **{name: value for name, value in usual.items() if getattr(self, name) is None})

    @property
    def disturbances(self) -> Disturbances:
        """Payload and masses as disturbances of the simulation."""
        return Disturbances(payload=self.payload, mass_scale=self.mass_scale)

    @property
    def of_policy(self) -> tuple[object, ...]:
        """The values whose change needs another policy."""
        planner = self.planner if self.policy in PLANNED else ""
        return self.policy, planner, self.rho if self.policy == "lieednn-shaped" else 0.0, self.filtered

    @property
    def of_plant(self) -> tuple[object, ...]:
        """The values whose change needs another simulated model and controller."""
        return self.controller, self.payload, self.mass_scale
