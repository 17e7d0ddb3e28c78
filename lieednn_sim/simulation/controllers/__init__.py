"""All controllers by name, including those of other packages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import Reference

# Arrays that a controller must not change, since they move the arm without its actuators.
_NOT_ITS_OWN = ("qpos", "qvel", "qfrc_applied", "xfrc_applied")

_Make = TypeVar("_Make", bound=Callable[[Arm, Reference], Controller])


def make_controller(name: str, arm: Arm, reference: Reference) -> Controller:
    """A controller of an arm that follows a reference; the actions of one of another package are watched.

    Raises:
        InputError: there is no controller of that name, it cannot drive the arm, or another package's is none.
    """
    entry = CONTROLLERS.find(name)
    controller = entry.load()(arm, reference)
    if not isinstance(controller, Controller):
        raise InputError(f"the controller {name!r} is no Controller, but {type(controller).__name__}")
    return controller if entry.own else _watched(name, controller)


def _watched(name: str, controller: Controller) -> Controller:
    """The controller, whose actions raise `SimulationError` if they move the arm without its actuators."""
    act = controller.act

    def watched(data: mujoco.MjData, step: int, noise: Noise) -> None:
        before = [getattr(data, array).copy() for array in _NOT_ITS_OWN]
        act(data, step, noise)
        for array, values in zip(_NOT_ITS_OWN, before, strict=True):
            if not np.array_equal(values, getattr(data, array)):
                raise SimulationError(f"the controller {name} changed {array}; it may set controls and mocap bodies")

    controller.act = watched  # type: ignore[method-assign]
    return controller


def register_controller(name: str) -> Callable[[_Make], _Make]:
    """Decorator that registers a `Controller` by name for `simulate`, `compare` and the command line.

    A controller is made from an arm and a reference; a function that returns one is also accepted. Its actions are
    watched at every step: a controller may set controls and mocap bodies, but neither the state nor forces.
    Worker processes and the command line find controllers that an installed package names in its entry points::

        [project.entry-points."lieednn_sim.controllers"]
        my-controller = "my_package.my_module:MyController"

    Args:
        name: lower-case letters, digits and hyphens.

    Raises:
        InputError: the name is malformed or taken, or the decorated object is not callable.
    """
    return CONTROLLERS.register(name)
