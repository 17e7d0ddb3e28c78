"""The controllers by name."""

from __future__ import annotations

from collections.abc import Callable

from lieednn_sim.arm import Arm
from lieednn_sim.simulation.controllers.base import ComputedTorque, Controller, InverseDynamicsServo, PositionServo
from lieednn_sim.simulation.controllers.mocap import DeadbeatWelds, MocapWelds
from lieednn_sim.simulation.reference import Reference

CONTROLLERS: dict[str, Callable[[Arm, Reference], Controller]] = {
    "position-servo": PositionServo,
    "inverse-dynamics": InverseDynamicsServo,
    "computed-torque": ComputedTorque,
    "mocap": MocapWelds,
    "mocap-deadbeat": DeadbeatWelds,
}
