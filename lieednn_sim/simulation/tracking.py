"""A planned motion followed by the simulated arm, with a controller chosen by name."""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.budget import report
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning import Move, Plan, PlanSequence
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.planning.motion import Motion, steps_of_rate
from lieednn_sim.planning.steps import Actuate, Gripping
from lieednn_sim.simulation.actuators import has_servos
from lieednn_sim.simulation.controllers import make_controller
from lieednn_sim.simulation.controllers.base import Controller, Inputs
from lieednn_sim.simulation.disturbances import Disturbances, before, late_push
from lieednn_sim.simulation.log import Channel, ChannelSource, Log
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.simulation.rollout import SLIP, Rollout
from lieednn_sim.simulation.simulation import Simulation, make_plant
from lieednn_sim.validation import as_nonnegative, as_positive
from lieednn_sim.values import Floats


def make_controlled(
    arm: Arm, controller: str, reference: Reference, disturbances: Disturbances
) -> tuple[Controller, Simulation]:
    """A controller by name, and the simulation of the plant that it drives, without visual geoms."""
    bare = arm.without_visuals
    # A controller does not know where obstacles move, and must not push against where they began.
    known = {each.body: (0.0, 0.0, -1e4) for each in disturbances.obstacles}
    own = replace(bare, spec=None).with_moved_bodies(known) if known else bare
    driver = make_controller(controller, own, reference)
    changed = disturbances.obstacles or (disturbances.payload, disturbances.mass_scale) != (0.0, 1.0)
    changed = changed or driver.changes_plant or driver.add_bodies is not None
    plant = make_plant(bare, disturbances, driver.add_bodies) if changed else bare.model
    driver.equip(plant)
    return driver, Simulation(arm, plant, disturbances=disturbances)


def as_hold(value: float) -> float:
    """Return the time after a motion [s] when it can be simulated, or raise `InputError`."""
    # A longer time is an error of units, and would take gigabytes.
    return as_nonnegative("hold", value, 1000.0)


def as_loaded(arm: Arm, *motions: Plan | Motion | PlanSequence) -> Arm:
    """The arm with the payload of plans, unless it has one of its own; `InputError` if they have several."""
    payloads = {each.arm.payload for each in motions if not isinstance(each, Motion) and each.arm is not None}
    if len(payloads) > 1:
        raise InputError("the plans are for several payloads; simulate those for each by themselves")
    return arm.with_payload(sum(payloads)) if arm.payload == 0.0 else arm


def as_motion(arm: Arm, motion: Plan | Motion) -> Motion:
    """Return a motion, or that of a plan, when the arm can follow it, or raise `InputError`."""
    motion = motion.motion if isinstance(motion, Plan) else motion
    if motion.q.shape[1] != arm.n_joints:
        raise InputError(f"the motion has {motion.q.shape[1]} coordinates, arm {arm.name!r} has {arm.n_joints}")
    step = arm.timestep
    if not np.isclose(motion.timestep, step, rtol=1e-9):
        raise InputError(f"the motion is sampled every {motion.timestep:g} s, the model steps every {step:g} s")
    return motion


def at_rest_after(motion: Motion, rows: int) -> tuple[Floats, Floats]:
    """Joint coordinates and rates ``(rows, n)`` of a motion and of the rest at its end."""
    extra = ((0, rows - len(motion.q)), (0, 0))
    return np.pad(motion.q, extra, "edge"), np.pad(motion.qd, extra)


def default_controller(arm: Arm, *, policy: bool = False) -> str:
    """Name of the controller that `simulate` takes by default, or, with a ``policy``, `follow` and the live view.

    It is ``position-servo`` for arms that are made for it, whose weight is compensated; ``inverse-dynamics`` for these
    with a payload or policy, and for imported arms that servos drive; otherwise ``feedback-linearisation``.
    """
    if arm.qpos_home is None and arm.payload == 0.0 and not policy:
        return "position-servo"
    return "inverse-dynamics" if arm.state is None and has_servos(arm) else "feedback-linearisation"


def simulate(
    arm: Arm,
    motion: Plan | Motion | PlanSequence,
    *,
    target: ArrayLike | None = None,
    controller: str | None = None,
    hold: float = 1.0,
    reference_rate: float | None = None,
    disturbances: Disturbances | None = None,
    log: Sequence[ChannelSource] = (),
    stop_outside: bool = False,
) -> Rollout:
    """Simulate an arm whose controller tracks a motion and then holds its end.

    The simulation starts at rest at the motion's first position, and is a function of its arguments alone: two runs
    are bit-identical. For a view, the user's model is simulated from the state that the view was made from: other
    actuators keep their controls of that state, and what is not part of the arm moves by physics.

    Args:
        arm: the arm; its model is not changed. Without a payload, it gets that of the plan, which the controller knows.
        motion: a plan, or a motion sampled at the model's time step; or, for a view, a sequence, whose control steps
            end by time or by events, which may come sooner or later than planned.
        target: ``(n,)`` joint position to reach; by default the plan's, or the motion's end.
        controller: a name of `CONTROLLERS`, or ``file.py:class`` of one's own; by default that of `default_controller`.
        hold: time after the end of the motion [s].
        reference_rate: rate of the samples of the motion that the controller sees, held in between [Hz]; a divisor of
            the simulation's rate. By default it sees every step.
        disturbances: disturbances unknown to the controller.
        log: further quantities to log, each a `Channel`; the rollout has them in ``channels``.
        stop_outside: whether the run ends, by `SimulationError`, when it leaves the proof of the motion's clearance.

    Raises:
        InputError: the motion does not fit the model; two channels have one name; a push begins when the run is over;
            or ``stop_outside`` is asked for, but the motion has no proof, is a sequence, or obstacles move.
        SimulationError: MuJoCo warns, a state is not finite, an event of a sequence does not come in time, or the run
            left its proof; the error has the run up to there.

    Warns:
        UserWarning: events of a sequence came so soon that a push was still to begin when the run was over.
    """
    arm, sequence = as_loaded(arm, motion), motion if isinstance(motion, PlanSequence) else None
    if target is None and isinstance(motion, Plan):
        target = motion.target
    rate = None if reference_rate is None else as_positive("reference_rate", reference_rate)
    rest = round(as_hold(hold) / arm.timestep)
    if isinstance(motion, PlanSequence):
        if motion.qpos.shape[1] != arm.model.nq or motion.arm.joint_names != arm.joint_names:
            raise InputError(
                f"the sequence is of another model or of other joints: it has {motion.qpos.shape[1]} positions and "
                f"moves {', '.join(motion.arm.joint_names)}"
            )
        q = arm.coordinates(motion.qpos)  # the last row also serves for the rest after it
        qd = arm.rates(q, motion.qvel)
    else:
        motion = as_motion(arm, motion)
        q, qd = at_rest_after(motion, len(motion.t) + rest)
    held = 1 if rate is None else steps_of_rate("reference_rate", rate, arm.timestep)
    reference = Reference.of(arm, q, qd, hold=held)
    total, end = len(motion.t) + rest, float(motion.t[-1])
    steps = [] if sequence is None else [part.step for part in sequence.parts]
    # Events may come later than planned, at most by all of their time.
    late = sum(step.seconds for step in steps if isinstance(step, Actuate) and step.until)
    changes = before((total - 1) * arm.timestep + late, arm.timestep, disturbances)
    name = default_controller(arm) if controller is None else controller
    meta: dict[str, Any] = {"controller": name, "reference_rate": rate, "disturbances": changes}
    meta["motion"] = motion if isinstance(motion, Motion) else None
    if target is not None:
        meta["target"] = arm.check_position(target, "target")
    driver, simulation = make_controlled(arm, name, reference, changes)
    simulation.reset(reference.q[0])
    drive = _drive(driver, simulation, None if sequence else total)
    monitor = None
    if stop_outside:
        if not isinstance(motion, Motion) or changes.obstacles:
            raise InputError("stop_outside needs a single motion, in a scene at rest: else no clearance is proved")
        monitor = ClearanceMonitor.of(arm, motion)
    play = None if sequence is None else _Play(sequence, simulation, rest)
    holds = any(isinstance(step, Move) and step.holding for step in steps)
    record = Log(simulation, driver, *log, *([Channel(SLIP, "m", play.slip)] if holds and play else []))
    shown, seen, rows = time.monotonic(), list[int](), range(total) if play is None else play.rows()
    try:
        with QuietWarnings():
            for k in rows:
                drive(k)
                left = "" if monitor is None else monitor.left(k, simulation.q, simulation.data.qpos)
                record.step()
                seen.append(k)
                if left:
                    raise SimulationError(left)
                if time.monotonic() - shown > 0.1 or len(seen) == total:
                    shown = time.monotonic()
                    report(min(len(seen), total), total)
    except SimulationError as error:
        if len(seen) > 1:
            ended = {"motion_end": len(seen) * arm.timestep, **({} if play is None else {"steps": tuple(play.begun)})}
            # Logged values may leave their range before the state does; then there is no rollout.
            with contextlib.suppress(InputError):
                error.rollout = record.rollout(reference.q[seen], reference.qd[seen], **ended, **meta)
        raise
    if play is not None:
        end, meta["steps"] = play.end, tuple(play.begun)
        if said := late_push((len(seen) - 1) * arm.timestep, arm.timestep, changes):
            warnings.warn(said, stacklevel=3)  # past the wrapper that checks arguments
    return record.rollout(reference.q[seen], reference.qd[seen], motion_end=end, **meta)


class _Play:
    """The steps of a sequence in a simulation: ``begun`` has the time [s] and name of each; all are over at ``end``."""

    def __init__(self, sequence: PlanSequence, simulation: Simulation, rest: int) -> None:
        self._sequence, self._simulation, self._rest = sequence, simulation, rest
        self.begun: list[tuple[float, str]] = []
        self.end = float(sequence.t[-1])
        self._held: str | None = None
        self._place: Floats | None = None

    def slip(self, data: mujoco.MjData) -> float:
        """Displacement of the held body in the hand since the beginning of the move [m]; 0 without one."""
        if not self._held:
            return 0.0
        hand = int(self._sequence.arm.frames.bodies[-1])
        place = (data.body(self._held).xpos - data.xpos[hand]) @ data.xmat[hand].reshape(3, 3)
        self._place = place if self._place is None else self._place
        return float(np.linalg.norm(place - self._place))

    def rows(self) -> Iterator[int]:
        """The row of the sequence to track in each step; the caller does the step before it asks for the next row."""
        sequence, simulation = self._sequence, self._simulation
        for number, part in enumerate(sequence.parts):
            self.begun.append((simulation.time, part.step.name))
            self._held, self._place = getattr(part.step, "holding", None), None
            if isinstance(part.step, Move):
                yield from range(part.first, part.last)
                continue
            gripping, done = Gripping(sequence.arm, simulation.model, part.step), 0
            gripping.begin(simulation.data)
            over = False
            while not over:
                # The arm rests, so that the rows of the step are all the same.
                yield min(part.first + done, part.last - 1)
                done += 1
                over = gripping.over(simulation.data, done)
                if gripping.late:
                    raise SimulationError(
                        f"step {number + 1}, {part.step.name!r}, begun at {self.begun[-1][0]:.2f} s: its event does "
                        f"not come: {gripping.late}"
                    )
        self.end = simulation.time
        yield from repeat(len(sequence.t) - 1, self._rest + 1)


def _drive(driver: Controller, simulation: Simulation, total: int | None) -> Callable[[int], None]:
    """A function that sets the controls of a step after a reset; they are computed beforehand if they can be."""
    model, data = simulation.model, simulation.data
    inputs = None if total is None else driver.inputs(range(total), simulation.sensors.first(total))
    if inputs is None:
        return lambda k: driver.act(data, k, simulation.noise)
    kind, rows = joined(inputs)
    return lambda k: mujoco.mj_setState(model, data, rows[k], kind)


def joined(inputs: Inputs) -> tuple[int, Floats]:
    """Arguments of `mj_setState` for inputs of m steps: the parts of the state, and a row ``(m, size)`` per step."""
    kinds = sorted(inputs, key=int)
    return sum(map(int, kinds)), np.concatenate([inputs[kind].reshape(len(inputs[kind]), -1) for kind in kinds], axis=1)
