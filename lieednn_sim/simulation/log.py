"""Logs of simulations: raw data are copied at little cost at every step, and evaluated for all instants at once."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.lie import rotations
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

    What MuJoCo derives in a step (frames, velocities and centres of mass of bodies, sensors, forces) is of the instant
    t[k] at which it begins, as row k of the log; qpos and qvel are already of t[k + 1].

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


class Instant(NamedTuple):
    """Data of one instant, or of K along a first axis; the forces are those of the step that begins there.

    Attributes:
        t: time [s].
        qpos: ``(nq,)`` MuJoCo's positions.
        qvel: ``(nv,)`` MuJoCo's velocities.
        ctrl: ``(nu,)`` actuator controls.
        actuator_force: ``(nv,)`` forces of actuators, including gravity compensation [N m, N].
        constraint_force: ``(nv,)`` forces of contacts, joint limits, couplings and welds [N m, N].
        link_position: ``(N, 3)`` link frames, world [m].
        link_quaternion: ``(N, 4)`` the same, (w, x, y, z).
        contacts: number of contacts.
        contact_force: largest normal force among them [N].
    """

    t: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    actuator_force: Floats
    constraint_force: Floats
    link_position: Floats
    link_quaternion: Floats
    contacts: NDArray[np.int_]
    contact_force: Floats


class Log:
    """Steps a simulation from its present state, and keeps the instant before each step.

    The forces and link frames that MuJoCo computes in a step belong to the instant at which it begins, and stay in its
    data until the next one.

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
        # A contiguous range of sites, since a slice is copied in one piece, unlike selected rows.
        low, high = int(arm.site_ids.min()), int(arm.site_ids.max()) + 1
        self._sites = arm.site_ids - low
        before = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl}
        after = {
            "actuators": data.qfrc_actuator,
            "compensation": data.qfrc_gravcomp,
            "constraints": data.qfrc_constraint,
            "positions": data.site_xpos[low:high],
            "rotations": data.site_xmat[low:high],
        }
        # Writing bytes to a stream takes a fifth of the time of assigning rows of an array.
        self._log = {name: (io.BytesIO(), view) for name, view in {**before, **after}.items()}
        self._before = [(self._log[name][0].write, view) for name, view in before.items()]
        self._after = [(self._log[name][0].write, view) for name, view in after.items()]
        self._contacts: list[tuple[int, int, float]] = []
        for source in sources:
            if not isinstance(source, ChannelSource):
                raise InputError(f"a quantity to log must be a Channel, got {quoted(source)}")
        self._sources: list[tuple[ChannelSource, list[Floats]]] = [
            (source, []) for source in (*sources, simulation.pushes) if source.channel_units
        ]
        names = [name for source, _ in self._sources for name in source.channel_units]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(f"every channel needs a name of its own, there are several of {', '.join(twice)}")

    def __len__(self) -> int:
        """Return the number of instants."""
        return self._rows

    def step(self) -> None:
        """Do one step within `QuietWarnings`; if it does not fail, keep the instant before it."""
        for write, view in self._before:
            write(view)
        self._simulation.advance_once()
        for write, view in self._after:
            write(view)
        if touching := self._data.ncon:
            self._contacts.append((self._rows, touching, self._largest_contact()))
        for source, samples in self._sources:
            samples.append(source.sample(self._data))
        self._rows += 1

    def instants(self) -> Instant:
        """All instants so far, along the first axis of every array."""
        rows, log = self._rows, {name: self._read(*pair) for name, pair in self._log.items()}
        # Gravity compensation that bypasses MuJoCo's actuators, which have to exert it, too.
        model = self._simulation.model
        bypassing = log["compensation"] * (model.jnt_actgravcomp[model.dof_jntid] == 0)
        matrices = log["rotations"][:, self._sites].reshape(rows, len(self._sites), 3, 3)
        contacts, contact_force = np.zeros(rows, dtype=int), np.zeros(rows)
        for row, touching, force in self._contacts:
            contacts[row], contact_force[row] = touching, force
        return Instant(
            t=self._simulation.timestep * np.arange(self._first, self._first + rows, dtype=float),
            qpos=log["qpos"].copy(),
            qvel=log["qvel"].copy(),
            ctrl=log["ctrl"].copy(),
            actuator_force=log["actuators"] + bypassing,
            constraint_force=log["constraints"].copy(),
            link_position=log["positions"][:, self._sites],
            link_quaternion=rotations(matrices).as_quat(scalar_first=True),
            contacts=contacts,
            contact_force=contact_force,
        )

    def channels(self) -> tuple[dict[str, Floats], dict[str, str]]:
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

    def _read(self, stream: io.BytesIO, view: Floats) -> Floats:
        return np.frombuffer(stream.getvalue(), count=self._rows * view.size).reshape(self._rows, *view.shape)

    def _largest_contact(self) -> float:
        wrench, largest = np.zeros(6), 0.0
        for i in range(self._data.ncon):
            mujoco.mj_contactForce(self._simulation.model, self._data, i, wrench)
            largest = max(largest, float(wrench[0]))
        return largest
