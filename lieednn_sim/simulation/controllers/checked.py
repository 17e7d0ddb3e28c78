"""Checks of controllers from other packages."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import LieEDNNError, SimulationError
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.values import Floats

# Arrays that a controller must not change, since they move the arm without its actuators.
_NOT_ITS_OWN = ("qpos", "qvel", "qfrc_applied", "xfrc_applied")


class CheckedController(Controller):
    """A controller from another package; its exceptions, and forbidden actions, become a `SimulationError`.

    Args:
        name: name of the controller.
        make: function that makes the controller.
        arm: arm to drive.
        reference: reference to follow.

    Raises:
        SimulationError: ``make`` fails, or returns no controller.
    """

    def __init__(self, name: str, make: Callable[[Arm, Reference], Controller], arm: Arm, reference: Reference) -> None:
        self._name = name
        with self._told():
            self._own = make(arm, reference)
        if not isinstance(self._own, Controller):
            raise SimulationError(f"the controller {name} is no Controller, but {type(self._own).__name__}")
        self.adds_bodies, self.channel_units = self._own.adds_bodies, self._own.channel_units

    def add_bodies(self, spec: Any) -> None:
        """See `Controller`."""
        with self._told():
            self._own.add_bodies(spec)

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        with self._told():
            self._own.equip(plant)

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """See `Controller`."""
        before = [getattr(data, name).copy() for name in _NOT_ITS_OWN]
        with self._told():
            self._own.act(data, step, noise)
        for name, values in zip(_NOT_ITS_OWN, before, strict=True):
            if not np.array_equal(values, getattr(data, name)):
                raise SimulationError(
                    f"the controller {self._name} changed {name}; it may set controls and mocap bodies"
                )
        if not np.isfinite(data.ctrl).all():
            raise SimulationError(f"the controller {self._name} set controls that are not finite at {data.time:g} s")

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `Controller`."""
        with self._told():
            return self._own.sample(data)

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `Controller`."""
        with self._told():
            return self._own.channel_values(samples)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except LieEDNNError:
            raise
        except Exception as error:
            raise SimulationError(f"the controller {self._name} failed: {type(error).__name__}: {error}") from error
