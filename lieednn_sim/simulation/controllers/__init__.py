"""All controllers by name, including those of other packages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from lieednn_sim.arm import Arm
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.controllers.checked import CheckedController
from lieednn_sim.simulation.reference import Reference

_Make = TypeVar("_Make", bound=Callable[[Arm, Reference], Controller])


def make_controller(name: str, arm: Arm, reference: Reference) -> Controller:
    """A controller of an arm that follows a reference; one of another package is checked at every step.

    Raises:
        InputError: there is no controller of that name, or it cannot drive the arm.
        SimulationError: one of another package fails.
    """
    entry = CONTROLLERS.find(name)
    made: Controller = (
        entry.load()(arm, reference) if entry.own else CheckedController(name, entry.place, arm, reference)
    )
    return made


def register_controller(name: str) -> Callable[[_Make], _Make]:
    """Decorator that registers a `Controller` by name for `simulate`, `compare` and the command line.

    A controller is made from an arm and a reference; a function that returns one is also accepted. The actions are
    checked at every step: a controller may set finite controls and mocap bodies, but neither the state nor forces.
    Worker processes and the command line find controllers that an installed package names in its entry points::

        [project.entry-points."lieednn_sim.controllers"]
        my-controller = "my_package.my_module:MyController"

    Args:
        name: lower-case letters, digits and hyphens.

    Raises:
        InputError: the name is malformed or taken, or the decorated object is not callable.
    """
    return CONTROLLERS.register(name)
