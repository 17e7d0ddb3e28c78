"""Logs of simulations: raw data are copied at every step, at little cost, and evaluated for all instants at once."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import control_ranges
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.lie.se3 import rotations, same_signs
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.validation import as_floats, quoted
from lieednn_sim.values import Floats


@runtime_checkable
class ChannelSource(Protocol):
    """A source of channels besides those of every simulation: a controller, a disturbance, or a `Channel`."""

    @property
    def channel_units(self) -> Mapping[str, str]:
        """Units of the channels, by name; empty without channels."""

    def sample(self, data: mujoco.MjData) -> Floats:
        """A new array of the data of a step from which the channels are computed; called after each step."""

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """The channels in the order of their units; like the samples, with K steps along the first axis."""


@dataclass(frozen=True)
class Channel:
    """A quantity to log besides the usual ones, computed from MuJoCo's data after each step.

    What MuJoCo derives in a step (frames, velocities and centres of mass of bodies, sensors, forces) belongs to the
    instant t[k] at which the step begins, as row k of the log does; qpos and qvel already belong to t[k + 1].

    Attributes:
        name: name of the channel.
        unit: its unit, "1" for none.
        value: function of the data of the simulated model to a number or an array, of one shape at all steps.

    Raises:
        InputError: the name or the unit is empty; in a simulation, the function fails, or returns no finite numbers.
    """

    name: str
    unit: str
    value: Callable[[mujoco.MjData], ArrayLike]

    def __post_init__(self) -> None:
        if not (self.name and self.unit):
            raise InputError(f"a channel needs a name and a unit, got {quoted(self.name)} and {quoted(self.unit)}")

    @property
    def channel_units(self) -> Mapping[str, str]:
        """See `ChannelSource`."""
        return {self.name: self.unit}

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `ChannelSource`."""
        try:
            value = self.value(data)
        except Exception as error:
            raise InputError(f"channel {self.name!r} failed: {type(error).__name__}: {error}") from error
        # A copy: the value may be a view of the data.
        return as_floats(f"channel {self.name!r}", value, (), batched=True).copy()

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `ChannelSource`."""
        return (samples,)


class Log:
    """Steps a simulation from its present state, and keeps the instant before each step.

    The forces and link frames that MuJoCo computes in a step, and keeps until the next one, belong to its beginning.

    Args:
        simulation: the simulation; nothing else may step it meanwhile.
        sources: sources of channels besides the simulation's pushes.

    Raises:
        InputError: a source is no `ChannelSource`, or two channels have the same name.
    """

    def __init__(self, simulation: Simulation, *sources: ChannelSource) -> None:
        self._simulation, self._rows = simulation, 0
        arm, data = simulation.arm, simulation.data
        self._data, self._first = data, simulation.steps
        # A contiguous range of bodies is logged, since a slice is copied in one piece, unlike selected rows.
        low, high = int(arm.frames.bodies.min()), int(arm.frames.bodies.max()) + 1
        self._frames = replace(arm.frames, bodies=arm.frames.bodies - low)
        before = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl}
        after = {
            "actuators": data.qfrc_actuator,
            "constraints": data.qfrc_constraint,
            "positions": data.xpos[low:high],
            "rotations": data.xmat[low:high],
        }
        # Data are written to byte streams, which takes a fifth of the time of assigning rows of an array.
        self._log = {name: (io.BytesIO(), view) for name, view in {**before, **after}.items()}
        self._before = [(self._log[name][0].write, view) for name, view in before.items()]
        self._after = [(self._log[name][0].write, view) for name, view in after.items()]
        self._contacts: list[tuple[int, int, float]] = []
        self._groups = _groups_of(arm, simulation.model)
        for source in sources:
            if not isinstance(source, ChannelSource):
                raise InputError(f"a quantity to log must be a Channel, got {quoted(source)}")
        self._sources: list[tuple[ChannelSource, list[Floats]]] = [
            (source, []) for source in (*sources, simulation.pushes) if source.channel_units
        ]
        drivers = (source.own_controls for source in sources if isinstance(source, Controller))
        self._own_controls = next(drivers, lambda controls, *_: controls)
        names = [name for source, _ in self._sources for name in source.channel_units]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(f"every channel needs a name of its own, there are several of {', '.join(twice)}")

    def step(self) -> None:
        """Do one step within `QuietWarnings`; if it does not fail, keep the instant before it."""
        for write, view in self._before:
            write(view)
        self._simulation.advance_once()
        for write, view in self._after:
            write(view)
        if self._data.ncon:
            touching, largest = self._touching()
            if touching:
                self._contacts.append((self._rows, touching, largest))
        for source, samples in self._sources:
            samples.append(source.sample(self._data))
        self._rows += 1

    def rollout(self, q_ref: Floats, qd_ref: Floats, **conditions: Any) -> Rollout:
        """The steps so far, in the arm's coordinates.

        Args:
            q_ref: reference ``(M, n)`` of the joint coordinates at these steps, and possibly later ones [rad, m].
            qd_ref: its rates.
            conditions: further fields of the `Rollout`.

        Raises:
            InputError: a reference is malformed, or shorter than the steps.
        """
        arm, model, rows = self._simulation.arm, self._simulation.model, self._rows
        q_ref = as_floats("q_ref", q_ref, ("M", arm.n_joints))[:rows].copy()
        qd_ref = as_floats("qd_ref", qd_ref, ("M", arm.n_joints))[:rows].copy()
        log = {
            name: np.frombuffer(stream.getvalue(), count=rows * view.size).reshape(rows, *view.shape)
            for name, (stream, view) in self._log.items()
        }
        contacts, contact_force = np.zeros(rows, dtype=int), np.zeros(rows)
        for row, touching, force in self._contacts:
            contacts[row], contact_force[row] = touching, force
        basis, controls = arm.moving(log["qpos"]), np.clip(log["ctrl"], *control_ranges(model).T)
        places, turns = self._frames.poses(log["positions"], log["rotations"])
        q = arm.coordinates(log["qpos"])
        channels, units = self._channels()
        return Rollout(
            arm=arm,
            t=self._simulation.timestep * np.arange(self._first, self._first + rows, dtype=float),
            q=q,
            qd=arm.rates(q, log["qvel"]),
            q_ref=q_ref,
            qd_ref=qd_ref,
            ctrl=self._own_controls(controls, log["qpos"], log["qvel"]),
            force=np.vecmat(np.nan_to_num(log["actuators"]), basis),
            constraint_force=np.vecmat(np.nan_to_num(log["constraints"]), basis),
            link_position=places,
            link_quaternion=same_signs(rotations(turns).as_quat(scalar_first=True)),
            contacts=contacts,
            contact_force=contact_force,
            qpos=log["qpos"],
            channels=channels,
            channel_units=units,
            **conditions,
        )

    def _channels(self) -> tuple[dict[str, Floats], dict[str, str]]:
        """The channels by name, with the instants along the first axis, and their units by name."""
        values: dict[str, Floats] = {}
        units: dict[str, str] = {}
        for source, samples in self._sources:
            units |= source.channel_units
            shapes = list(dict.fromkeys(np.shape(sample) for sample in samples))
            if len(shapes) > 1:
                names = ", ".join(source.channel_units)
                raise InputError(f"samples of {names} must have one shape, got {shapes[0]} and {shapes[1]}")
            values |= zip(source.channel_units, source.channel_values(np.array(samples)), strict=True)
        return values, units

    def _touching(self) -> tuple[int, float]:
        """Number of contacts that count, and the largest normal force among them [N]; in a gap there is no force."""
        counted = self._data.contact.exclude == 0
        if self._groups is not None:
            groups = self._groups.take(self._data.contact.geom)
            if not any(groups.ravel().tolist()):  # for a few numbers a list takes a third of the time
                return 0, 0.0
            first, second = groups.T
            counted &= (first != second) & ((first > 0) | (second > 0))
        contacts = np.flatnonzero(counted).tolist()
        wrench, largest = np.zeros(6), 0.0
        for i in contacts:
            mujoco.mj_contactForce(self._simulation.model, self._data, i, wrench)
            largest = max(largest, float(wrench[0]))
        return len(contacts), largest


def _groups_of(arm: Arm, plant: mujoco.MjModel) -> NDArray[np.int_] | None:
    """For each geom of a plant ``(ngeom,)``, its group of geoms that a view moves as one; zero if it is not moved."""
    if arm.qpos_home is None:
        return None
    groups = moved_together(plant, arm.space.rate_addresses)
    if arm.grasp is not None:
        bodies = [*arm.grasp.bodies, arm.grasp.carrier]
        if plant.nbody > arm.model.nbody:
            bodies = [plant.body(arm.model.body(body).name).id for body in bodies]
        groups[bodies[:-1]] = groups[bodies[-1]]
    return np.append(groups[plant.geom_bodyid], 0)  # the last for flexes, whose geoms have the id -1
