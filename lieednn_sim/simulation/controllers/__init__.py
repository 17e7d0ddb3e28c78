"""All controllers by name, including those of other packages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.reference import Reference

_Make = TypeVar("_Make", bound=Callable[[Arm, Reference], Controller])


def make_controller(name: str, arm: Arm, reference: Reference) -> Controller:
    """A controller by name; `InputError` if there is none, it cannot drive the arm, or another package's is none."""
    try:
        controller = CONTROLLERS.find(name).load()(arm, reference)
    except TypeError as error:
        raise InputError(f"the controller {name!r} is not made of an arm and a reference: {error}") from error
    if not isinstance(controller, Controller):
        raise InputError(f"the controller {name!r} is no Controller, but {type(controller).__name__}")
    return controller


def register_controller(name: str) -> Callable[[_Make], _Make]:
    """Decorator that registers a `Controller` by name for `simulate`, `compare` and the command line.

    A controller is made from an arm and a reference; a function that returns one is also accepted. Its actions may set
    controls and mocap bodies; if they set the state or forces, the arm moves without its actuators. Worker processes
    and the command line find controllers that a package declares as entry points ``lieednn_sim.controllers``.

    Args:
        name: lower-case letters, digits and hyphens.

    Raises:
        InputError: the name is malformed or taken, or the decorated object is not callable.
    """
    return CONTROLLERS.register(name)
