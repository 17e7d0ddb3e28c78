"""The closed loop of a policy and a simulated arm: the policy sees the arm, and a target that may move."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import field
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import QuietWarnings
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import count_steps, steps_of_rate
from lieednn_sim.policies import Policy
from lieednn_sim.simulation.disturbances import Disturbances, before
from lieednn_sim.simulation.log import ChannelSource, Log
from lieednn_sim.simulation.reference import Reference, interpolator
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.tracking import default_controller, make_controlled
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

_KEPT_PERIODS = 1000  # number of periods for which an endless run keeps the reference


@frozen
class Following:
    """A rollout of an arm that follows a policy.

    Attributes:
        rollout: the rollout, with the policy's channels and reference, cubic between control periods.
        target: ``(K, n)`` the target at the rollout's times.
        states: ``(L, ...)`` the policy's states at the beginnings of the L control periods; ``(L, N, 6)`` of a network.
        period: simulation steps in a control period.
        step_time: ``(L,)`` CPU time of each step of the policy [s]; only this differs between two equal runs.

    Raises:
        InputError: the target does not match the rollout's times and joints.
    """

    rollout: Rollout
    target: Floats
    states: Floats
    period: int
    step_time: Floats = field(repr=False, compare=False)

    def __post_init__(self) -> None:
        as_floats("target", self.target, self.rollout.q.shape)

    @property
    def jumps(self) -> tuple[float, ...]:
        """Times [s] at which the policy saw that the target had jumped, that is moved faster than the joints can."""
        seen = self.target[:: self.period]
        speed = np.abs(np.diff(seen, axis=0)) / (self.period * self.rollout.timestep)
        jumped = (speed > self.rollout.arm.jump_speeds).any(axis=1)
        return tuple(self.rollout.t[:: self.period][1:][jumped].tolist())


def follow(
    policy: Policy,
    target: Callable[[float], ArrayLike] | ArrayLike | str,
    duration: float,
    *,
    start: ArrayLike | str = "home",
    controller: str | None = None,
    disturbances: Disturbances | None = None,
    log: Sequence[ChannelSource] = (),
) -> Following:
    """Simulate an arm that follows a policy, which sees the measured joints and the present target.

    In every control period the policy gets both, and returns the reference for the end of the period. At every
    simulation step the controller gets a cubic interpolation of these. The run is a function of its arguments alone.

    Args:
        policy: runs the arm; its rate must divide the rate of the simulation. It is reset at the start.
        target: joint coordinates ``(n,)``, or a keyframe's name; or a function of the time [s], called once for each
            simulation step in order, but only seen by the policy at the control periods; or samples ``(M, n)``, one a
            simulation step, the last of which stays.
        duration: [s], at least a control period.
        start: joint coordinates ``(n,)`` at rest, or a keyframe's name.
        controller: of `CONTROLLERS`; by default ``inverse-dynamics`` for servos, else ``feedback-linearisation``.
        disturbances: disturbances unknown to policy and controller.
        log: further quantities to log, as for `simulate`.

    Raises:
        InputError: a value is malformed, the target leaves the position limits, or two channels have one name.
        SimulationError: as `simulate`.
    """
    arm, total = policy.arm, count_steps(duration, policy.arm.timestep)
    changes = before(total * arm.timestep, arm.timestep, disturbances)
    loop = ClosedLoop(policy, controller, changes, rows=total + 1)
    period, simulation, name = loop.period, loop.simulation, loop.controller
    if period > total:
        raise InputError(
            f"the policy's rate must be at least {1.0 / (total * arm.timestep):g} Hz for a duration of {duration:g} s, "
            f"got {policy.rate:g} Hz"
        )
    origin = arm.check_start(start)
    policy.reset(origin)
    loop.begin(origin)
    sample = _sampler(arm, target)
    # A `ChannelSource` for the channels of the policy.
    told: Any = SimpleNamespace(channel_units=policy.channel_units)
    told.sample, told.channel_values = lambda _: policy.channels(), lambda samples: tuple(samples.T)
    record, targets = Log(simulation, loop.driver, told, *log), list[Floats]()
    states, spent = list[Floats](), list[float]()
    with QuietWarnings():
        for k in range(total + 1):
            targets.append(sample(k))
            if k % period == 0:
                states.append(policy.state)
                spent.append(loop.decide(targets[-1]))
            loop.act()
            record.step()
    end = total * arm.timestep
    rollout = record.rollout(
        loop.reference.q, loop.reference.qd, target=targets[-1], motion_end=end, controller=name, disturbances=changes
    )
    return Following(rollout, np.array(targets), np.array(states), period, np.array(spent))


class ClosedLoop:
    """A policy that runs a simulated arm, and is asked once in every control period.

        policy.reset(q)
        loop.begin(q)
        loop.advance(target)    # one control period; or `decide`, and for each of its steps `act` and the step itself

    Args:
        policy: its rate must divide the simulation's; between periods, another one of this arm and rate may replace it.
        controller, disturbances: as for `follow`.
        rows: number of simulation steps of the whole run; by default it has no end, and old references are forgotten.

    Attributes:
        period: simulation steps in a control period.
        controller, driver, reference: the controller's name, itself, and its reference.

    Raises:
        InputError: the rates do not fit, or the controller is unknown or cannot drive the arm.
    """

    def __init__(self, policy: Policy, controller: str | None, disturbances: Disturbances, rows: int = 0) -> None:
        arm = policy.arm
        self.controller = default_controller(arm, policy=True) if controller is None else controller
        self.policy, self.period = policy, steps_of_rate("the policy's rate", policy.rate, arm.timestep)
        self.reference = Reference(arm, rows or _KEPT_PERIODS * self.period)
        self.driver, self.simulation = make_controlled(arm, self.controller, self.reference, disturbances)
        self._between, self._forgotten = interpolator(policy.period, self.period), 0
        self._endless = not rows

    def begin(self, q: ArrayLike, qd: ArrayLike | None = None) -> None:
        """Put the arm at joint coordinates ``(n,)`` with rates, by default zero; its reference is the policy's."""
        self.reference.forget(self.reference.known)
        self.reference.extend(self.policy.q[None], self.policy.qd[None])
        self.simulation.reset(q, qd)
        self._forgotten = 0

    def decide(self, target: Floats) -> float:
        """Ask the policy for the reference of this period, towards a target ``(n,)``; returns its CPU time [s]."""
        reference, row = self.reference, self.simulation.steps - self._forgotten
        if self._endless and reference.known + self.period > len(reference.q):
            # Velocities also need the row before the present one.
            reference.forget(row - 1)
            self._forgotten += row - 1
        if self.simulation.disturbances.obstacles:
            self.policy.see(self.simulation.move_obstacles())
        measured, before = self.simulation.measured()[0], (self.policy.q, self.policy.qd)
        start = time.thread_time()
        after = self.policy.step(measured, target)
        spent = time.thread_time() - start
        reference.extend(*self._between(*before, *after))
        return spent

    def act(self) -> None:
        """Let the controller set the controls of the next simulation step."""
        self.driver.act(self.simulation.data, self.simulation.steps - self._forgotten, self.simulation.noise)

    def advance(self, target: Floats) -> None:
        """Do one control period towards a target ``(n,)``; raises as `Simulation.advance`."""
        with QuietWarnings():
            self.decide(target)
            for _ in range(self.period):
                self.act()
                self.simulation.advance_once()


def _sampler(arm: Arm, target: Callable[[float], ArrayLike] | ArrayLike | str) -> Callable[[int], Floats]:
    """The target ``(n,)`` at a simulation step, checked against the position limits."""
    timestep = arm.timestep
    if callable(target):
        return lambda k: arm.check_position(target(k * timestep), f"the target at t = {k * timestep:.3f} s")
    given = arm.configuration(target) if isinstance(target, str) else target
    samples = np.atleast_2d(as_floats("target", given, (arm.n_joints,), batched=True))
    if samples.ndim > 2 or not len(samples):
        raise InputError(
            f"target must be ({arm.n_joints},) or (M, {arm.n_joints}) with M at least 1, got {samples.shape}"
        )
    return lambda k: arm.check_position(samples[min(k, len(samples) - 1)], f"the target at t = {k * timestep:.3f} s")
