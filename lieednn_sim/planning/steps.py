"""Steps of a sequence: moves of an arm, and controls of other actuators, such as a gripper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.forces import actuator_moments
from lieednn_sim.errors import InputError
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Duration
from lieednn_sim.planning.settling import SettlingOptions
from lieednn_sim.validation import Seed, as_choice, as_floats, as_positive, quoted
from lieednn_sim.values import set_fields

SETTLED = "settled"
# Joints count as settled if they are slower than this [rad/s, m/s] for so long [s].
_SLOW, _QUIET = 2e-3, 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Move:
    """A motion of the arm to a goal, planned by `plan`.

    Attributes:
        goal: any goal of `plan`, such as a pose of the tip or a keyframe; ``home`` is where the sequence begins.
        name: what the move is called, by default the goal if that is a name.
        holding: name of the free body that the tip carries, from its place at the beginning of the move.
        touching: names of bodies that the held one may touch, besides what it stands on at the beginning.
        planner, duration, seed, options, fastest, settle: as for `plan`; None for those of the sequence.
        clearance: distance that it keeps from contact [m]; None for the arm's.
        path_constraint: region in which the tip stays on the way; none if it may go anywhere.
    """

    goal: Any = field(kw_only=False)
    name: str = ""
    holding: str | None = None
    touching: Sequence[str] = ()
    planner: str | None = None
    duration: Duration | None = None
    seed: Seed | None = None
    clearance: float | None = None
    options: PlannerOptions | None = None
    fastest: bool | None = None
    settle: str | SettlingOptions | None = None
    path_constraint: TaskSpaceRegion | None = None

    def __post_init__(self) -> None:
        label = self.name or (self.goal if isinstance(self.goal, str) else "move")
        set_fields(self, name=label, touching=tuple(self.touching))


@dataclass(frozen=True)
class Actuate:
    """New controls of actuators that do not move the arm, while the arm rests.

    Attributes:
        controls: the controls by the names of the actuators; they stay the same in the following steps.
        seconds: how long the step takes; with ``until``, how long it may take at most [s].
        until: the event that ends the step: ``"settled"``, when the joints of these actuators rest, or the names of two
            bodies, when one of them, or what it carries, touches the other. Without it the step ends by time.
        name: what the step is called.

    Raises:
        InputError: a value is malformed.
    """

    controls: Mapping[str, float]
    seconds: float = 0.5
    until: str | tuple[str, str] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        given = self.controls.items()
        values = {name: float(as_floats(f"the control of {quoted(name)}", value, ())) for name, value in given}
        if isinstance(self.until, str):
            as_choice("event", self.until, (SETTLED,))
        label = self.name or ", ".join(f"{name} {value:g}" for name, value in values.items()) or "wait"
        set_fields(self, controls=values, seconds=as_positive("seconds", self.seconds), name=label)


class Gripping:
    """Sets the controls of a step, in an arm's model or a simulated one like it, and knows when the step is over.

    Attributes:
        late: why the step's event has not come in time; empty as long as it may come.

    Raises:
        InputError: there is no such actuator or body, it moves the arm, or a control is out of its range.
    """

    def __init__(self, arm: Arm, model: mujoco.MjModel, step: Actuate) -> None:
        self.step, self._model, dofs = step, model, arm.space.rate_addresses
        names = [model.actuator(k).name for k in range(model.nu)]
        moments = actuator_moments(model)
        self._controls = {names.index(as_choice("actuator", name, names)): v for name, v in step.controls.items()}
        for k, value in self._controls.items():
            low, high = model.actuator_ctrlrange[k]
            if moments[k, dofs].any():
                raise InputError(f"actuator {names[k]!r} moves the arm, which follows its plan; leave it out")
            if model.actuator_ctrllimited[k] and not low <= value <= high:
                raise InputError(f"the control of {names[k]!r} must be from {low:g} to {high:g}, got {value:g}")
        self._dofs = np.flatnonzero(moments[list(self._controls)].any(axis=0))
        if step.until == SETTLED and not len(self._dofs):
            raise InputError(f"step {step.name!r} waits until joints have settled, but its actuators move none")
        self._sides = [] if step.until in (None, SETTLED) else [self._carried(name) for name in step.until or ()]
        self.late = ""

    def begin(self, data: mujoco.MjData) -> None:
        """Set the controls."""
        data.ctrl[list(self._controls)] = list(self._controls.values())
        self._quiet = 0.0

    def over(self, data: mujoco.MjData, steps: int) -> bool:
        """Whether the step is over after a number of time steps, the last one just done; else it may be `late`."""
        timestep = self._model.opt.timestep
        ended = steps >= max(round(self.step.seconds / timestep), 1)
        if self.step.until is None:
            return ended
        if self.step.until == SETTLED:
            fastest = float(np.abs(data.qvel[self._dofs]).max())
            self._quiet = self._quiet + timestep if fastest < _SLOW else 0.0
            if self._quiet >= _QUIET:
                return True
            missing = f"its joints have not settled, the fastest moves at {fastest:.2g} rad/s or m/s"
        else:
            first, second = self._sides
            bodies = self._model.geom_bodyid[data.contact.geom]
            if ((first[bodies[:, 0]] & second[bodies[:, 1]]) | (second[bodies[:, 0]] & first[bodies[:, 1]])).any():
                return True
            missing = "{!r} and {!r} have not touched".format(*self.step.until)
        if ended:
            self.late = f"after {self.step.seconds:g} s {missing}; give it more seconds, or no event"
        return False

    def _carried(self, name: str) -> NDArray[np.bool_]:
        """A mask ``(nbody,)`` of a body and all bodies that it carries."""
        known = [self._model.body(k).name for k in range(self._model.nbody)]
        body = known.index(as_choice("body", name, filter(None, known)))
        return np.array([body in ancestry(self._model, part) for part in range(len(known))])
