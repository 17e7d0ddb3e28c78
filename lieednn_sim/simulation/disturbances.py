"""Disturbances unknown to the controller: pushes, a payload, other masses, sensor noise, moving obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_floats, as_nonnegative, as_positive, as_seed
from lieednn_sim.values import Floats, check_fields, set_fields

# Descriptions of values of `Disturbances` that are not the defaults: of the arm itself, and of its sensors.
_OF_ARM = {"mass_scale": "masses times {:g}", "payload": "payload {:g} kg"}
_OF_SENSORS = {"position_noise": "position noise {:g}", "velocity_noise": "velocity noise {:g}"}


@dataclass(frozen=True)
class Push:
    """A disturbance: a constant force on a body for a limited time.

    Attributes:
        body: name of a body of the scene or of a link ("link 1", ..., "end effector").
        force: ``(3,)`` force at the body's centre of mass, world frame [N].
        start: time since the start of the rollout [s].
        duration: the force acts in simulation steps at times t with start <= t < start + duration [s], both rounded to
            the nearest step; a push in whose time no step begins is refused.
    """

    body: str
    force: tuple[float, float, float]
    start: float
    duration: float

    def __post_init__(self) -> None:
        set_fields(self, force=tuple(as_floats("force", self.force, (3,)).tolist()))
        check_fields(self, as_nonnegative, "start")
        check_fields(self, as_positive, "duration")

    @property
    def end(self) -> float:
        """Time at which the force ends [s]."""
        return self.start + self.duration

    def body_id(self, arm: Arm, model: mujoco.MjModel) -> int:
        """The pushed body in a model of the arm; `InputError` lists the names."""
        if self.body in arm.link_names:
            return int(arm.frames.bodies[arm.link_names.index(self.body)])
        names = filter(None, (model.body(i).name for i in range(1, model.nbody)))
        return int(model.body(as_choice("body to push", self.body, (*arm.link_names, *names))).id)


@dataclass(frozen=True)
class MovingObstacle:
    """An obstacle that moves along straight lines between given places, at constant speed on each of them.

    It rests before the first time and after the last one. It is a body without joints that is put to its new place in
    each step: contacts act where it is, but know nothing of its velocity, so it drags nothing along by friction.

    Attributes:
        body: name of a body of the scene without joints.
        times: ``(K,)`` increasing times since the start of the rollout [s].
        positions: ``(K, 3)`` positions of the body at these times, in the frame of its parent [m].

    Raises:
        InputError: the times do not increase, or a value is malformed.
    """

    body: str
    times: tuple[float, ...]
    positions: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        times = as_floats("times", self.times, ("K",))
        positions = as_floats("positions", self.positions, (len(times), 3))
        if not len(times) or (np.diff(times) <= 0.0).any():
            raise InputError(f"times must hold at least one time, and increase, got {self.times}")
        set_fields(self, times=tuple(times.tolist()), positions=tuple(map(tuple, positions.tolist())))

    def at(self, time: float) -> Floats:
        """Position of the body ``(3,)`` at a time [s]; `InputError` if that is no finite number."""
        now = float(as_floats("time", time, ()))
        return np.array([np.interp(now, self.times, column) for column in zip(*self.positions, strict=True)])


@dataclass(frozen=True)
class Disturbances:
    """Disturbances of a simulation that the controller does not know of; none by default.

    Attributes:
        pushes: forces on bodies.
        payload: mass at the frame of the end effector [kg], unknown to controller and gravity compensation.
        mass_scale: masses and inertias of the simulated arm, relative to those of controller and gravity compensation.
        position_noise: standard deviation of the white noise on each measured joint position, at every step [rad, m].
        velocity_noise: standard deviation of the same for each measured joint velocity [rad/s, m/s].
        seed: seed of the noise.
        obstacles: obstacles that move; `follow` passes their positions to the policy.
    """

    pushes: tuple[Push, ...] = ()
    payload: float = 0.0
    mass_scale: float = 1.0
    position_noise: float = 0.0
    velocity_noise: float = 0.0
    seed: int = 0
    obstacles: tuple[MovingObstacle, ...] = ()

    def __post_init__(self) -> None:
        set_fields(self, pushes=tuple(sorted(self.pushes, key=lambda push: push.start)))
        check_fields(self, as_positive, "mass_scale")
        check_fields(self, as_nonnegative, "payload", "position_noise", "velocity_noise")
        check_fields(self, as_seed, "seed")

    @property
    def conditions(self) -> list[str]:
        """How the arm and its sensors differ from what the controller knows, in words; empty if they do not."""
        return _said(self, _OF_ARM | _OF_SENSORS)

    @property
    def unknown_loads(self) -> list[str]:
        """What loads the arm without the controller's knowledge, in words; loads can hold a joint off its target."""
        return [*_said(self, _OF_ARM), *(["pushes"] if self.pushes else [])]

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Disturbances:
        """The inverse of `dataclasses.asdict`; raises InputError for malformed values."""
        try:
            pushes = tuple(Push(**push) for push in value["pushes"])
            obstacles = tuple(MovingObstacle(**each) for each in value.get("obstacles", ()))
            return cls(**{**value, "pushes": pushes, "obstacles": obstacles})
        except (KeyError, TypeError) as error:
            raise InputError(f"these are no disturbances: {type(error).__name__}: {error}") from None


def before(end: float, timestep: float, disturbances: Disturbances | None) -> Disturbances:
    """The given disturbances, or none; `InputError` for a push that begins at or after the ``end`` of a run [s]."""
    given = Disturbances() if disturbances is None else disturbances
    if late := late_push(end, timestep, given):
        raise InputError(late)
    return given


def late_push(end: float, timestep: float, disturbances: Disturbances) -> str:
    """The message about a push that begins at or after the ``end`` of a run [s]; empty without one."""
    # No step begins at the end; times are rounded to the nearest step.
    push = next((push for push in disturbances.pushes if push.start >= end - 0.5 * timestep), None)
    at = push and f"the push on {push.body!r} at {push.start:g} s"
    return f"{at} would begin when the run is over, at {end:g} s" if at else ""


def _said(disturbances: Disturbances, words: Mapping[str, str]) -> list[str]:
    given = {name: getattr(disturbances, name) for name in words}
    return [words[name].format(value) for name, value in given.items() if value != getattr(Disturbances, name)]


class Pushes:
    """Forces of pushes on a plant; logs ``push_force`` ``(K, B, 3)`` on each of the B pushed bodies, world frame."""

    def __init__(self, arm: Arm, model: mujoco.MjModel, pushes: tuple[Push, ...]) -> None:
        self._pushes = [(push, push.body_id(arm, model)) for push in pushes]
        self._bodies = list(dict.fromkeys(body for _, body in self._pushes))
        self._timestep, self._shape = float(model.opt.timestep), (model.nbody, 6)
        for push in pushes:
            # A push between two steps would never act.
            nearby = np.round(push.start / self._timestep) + np.arange(-1, 2)
            if not self._acts(push, self._timestep * nearby).any():
                raise InputError(
                    f"the push on {push.body!r} at {push.start:g} s takes {push.duration:g} s, in which no step of the"
                    f" simulation begins; make it at least one time step of {self._timestep:g} s"
                )
        self.channel_units: Mapping[str, str] = {"push_force": "N"} if pushes else {}

    def forces(self, steps: range) -> Floats:
        """Forces and torques ``(m, B, 6)`` on all B bodies of the plant in some steps."""
        applied, now = np.zeros((len(steps), *self._shape)), self._timestep * np.array(steps)
        for push, body in self._pushes:
            applied[self._acts(push, now), body, :3] += push.force
        return applied

    def _acts(self, push: Push, now: Floats) -> NDArray[np.bool_]:
        """Whether a push acts in the steps that begin at given times."""
        # Compared halfway between steps, so that rounding of the times does not matter.
        half = 0.5 * self._timestep
        return (push.start - half < now) & (now < push.end - half)

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `log.ChannelSource`."""
        return data.xfrc_applied[self._bodies, :3]

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `log.ChannelSource`."""
        return (samples,)


class Noise(NamedTuple):
    """Errors of one measurement, in MuJoCo's tangent space."""

    position: Floats  #: ``(nv,)`` errors of positions [rad, m]
    velocity: Floats  #: ``(nv,)`` errors of velocities [rad/s, m/s]
    present: bool = True  #: whether there are any; otherwise all are zero


class Sensors:
    """Draws the measurement errors of the arm's joints, if any (`noisy`), the same ones after every `reset`."""

    def __init__(self, arm: Arm, disturbances: Disturbances) -> None:
        self._seed = disturbances.seed
        # Deviations are zero for joints that are no part of the arm.
        measured = (tangent_basis(arm.space) != 0.0).any(axis=1)
        self._deviations = np.outer([disturbances.position_noise, disturbances.velocity_noise], measured)
        self.noisy = bool(self._deviations.any())
        # Adding negative zeros changes no bit.
        self._none = Noise(-np.zeros(len(measured)), -np.zeros(len(measured)), present=False)
        self.reset()

    def reset(self) -> None:
        """Start the sequence again."""
        self._sequence = self._draws()

    def draw(self) -> Noise:
        """Errors of the next measurement."""
        return next(self._sequence) if self.noisy else self._none

    def first(self, count: int) -> Noise:
        """Errors ``(m, nv)`` of the first measurements after a reset; does not advance the sequence."""
        errors = self._errors(np.random.default_rng(self._seed), count) if self.noisy else self._deviations[None]
        return Noise(errors[:, 0], errors[:, 1], present=self.noisy)

    def _errors(self, rng: np.random.Generator, count: int) -> Floats:
        return self._deviations * rng.standard_normal((count, *self._deviations.shape))

    def _draws(self) -> Iterator[Noise]:
        rng = np.random.default_rng(self._seed)
        while True:
            # Two arrays of rows: unpacking rows that are pairs would take five times as long as everything else.
            yield from map(Noise, *np.moveaxis(self._errors(rng, 256), 1, 0))
