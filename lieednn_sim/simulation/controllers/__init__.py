"""All controllers by name, including those of other packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.registration import Registry
from lieednn_sim.simulation.controllers.base import ComputedTorque, Controller, InverseDynamicsServo, PositionServo
from lieednn_sim.simulation.controllers.checked import CheckedController
from lieednn_sim.simulation.controllers.mocap import DeadbeatWelds, MocapWelds
from lieednn_sim.simulation.reference import Reference

_Make = TypeVar("_Make", bound=Callable[[Arm, Reference], Controller])

#: Controllers by name, including those added by `register_controller`: functions or classes that take an arm and a
#: `Reference`.
CONTROLLERS: dict[str, Callable[[Arm, Reference], Controller]] = {
    "position-servo": PositionServo,
    "inverse-dynamics": InverseDynamicsServo,
    "computed-torque": ComputedTorque,
    "mocap": MocapWelds,
    "mocap-deadbeat": DeadbeatWelds,
}


def _controller(name: str, make: Callable[[Arm, Reference], Controller]) -> Callable[[Arm, Reference], Controller]:
    if not callable(make):
        raise InputError(f"controller {name!r} must be a Controller, or a function that makes one, got {make!r}")
    return lambda arm, reference: CheckedController(name, make, arm, reference)


REGISTRY = Registry("controller", CONTROLLERS, _controller)


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
    return REGISTRY.register(name)


def controllers() -> Mapping[str, Callable[[Arm, Reference], Controller]]:
    """All controllers by name: `CONTROLLERS`, and those of the entry points of installed packages.

    An entry point that cannot be loaded is left out, with a warning that names its package.
    """
    return REGISTRY.all()
