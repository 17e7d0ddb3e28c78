"""The closed loop: a simulated arm behind a policy, which sees the arm and a target that may move."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import count_steps, steps_of_rate
from lieednn_sim.policies import Policy
from lieednn_sim.policies.base import has_jumped
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.log import ChannelSource, Log
from lieednn_sim.simulation.reference import Reference, interpolator
from lieednn_sim.simulation.rollout import Rollout, as_rollout
from lieednn_sim.simulation.tracking import make_controlled
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen


@frozen
class Following:
    """A rollout of an arm that follows a policy.

    Attributes:
        rollout: the rollout. Its reference is the policy's, cubic between control periods; `motion_end` is its end, and
            its channels include the policy's.
        target: ``(K, n)`` the target at the rollout's times.
        states: ``(L, ...)`` the policy's states at the beginnings of the L control periods; ``(L, N, 6)`` of a network.
        period: simulation steps in a control period.
        step_time: ``(L,)`` CPU time of each step of the policy [s]; only this differs between two equal runs.
    """

    rollout: Rollout
    target: Floats
    states: Floats
    period: int
    step_time: Floats = field(repr=False, compare=False)

    @property
    def jumps(self) -> tuple[float, ...]:
        """Times at which the policy saw that the target had jumped, faster than the joints' limits [s]."""
        seen = self.target[:: self.period]
        t, arm = self.rollout.t[:: self.period], self.rollout.arm
        velocity = np.diff(seen, axis=0) / (self.period * self.rollout.timestep)
        return tuple(t[1:][has_jumped(arm, velocity)].tolist())

    def __repr__(self) -> str:
        return f"<Following: {self.rollout!r}, {len(self.jumps)} jumps of the target>"


def follow(
    policy: Policy,
    target: Callable[[float], ArrayLike] | ArrayLike | str,
    duration: float,
    *,
    start: ArrayLike | str = "home",
    controller: str = "inverse-dynamics",
    disturbances: Disturbances | None = None,
    log: Sequence[ChannelSource] = (),
) -> Following:
    """Let the simulated arm follow a policy, which sees the measured joints and the present target.

    In every control period the policy gets both and returns the reference for the end of the period. The controller
    gets a cubic polynomial between these references at every simulation step. The run is a function of its arguments
    alone.

    Args:
        policy: runs the arm; its rate must divide the rate of the simulation. It is reset at the start.
        target: joint coordinates ``(n,)``, or a keyframe's name; or a function of the time [s], called once for each
            simulation step in order, but only seen by the policy at the control periods; or samples ``(M, n)``, one a
            simulation step, the last of which stays.
        duration: [s], at least a control period.
        start: joint coordinates ``(n,)`` at rest, or a keyframe's name.
        controller: a name of `CONTROLLERS`.
        disturbances: disturbances unknown to policy and controller.
        log: further quantities to log, as for `simulate`.

    Raises:
        InputError: a value is malformed, the target leaves the position limits, or two channels have one name.
        SimulationError: as `simulate`.
    """
    arm = policy.arm
    period, total = steps_of_rate("the policy's rate", policy.rate, arm.timestep), count_steps(duration, arm.timestep)
    if period > total:
        raise InputError(
            f"the policy's rate must be at least {1.0 / (total * arm.timestep):g} Hz for a duration of {duration:g} s, "
            f"got {policy.rate:g} Hz"
        )
    origin = arm.check_position(start, "start")
    policy.reset(origin)
    changes = Disturbances() if disturbances is None else disturbances
    reference, between = Reference(arm, total + 1), interpolator(policy.period, period)
    reference.extend(origin[None], np.zeros((1, arm.n_joints)))
    driver, simulation = make_controlled(arm, controller, reference, changes)
    simulation.reset(origin)
    sample = _sampler(arm, target, arm.timestep)
    record, targets = Log(simulation, driver, _Channels(policy), *log), list[Floats]()
    states, spent = list[Floats](), list[float]()
    with QuietWarnings():
        for k in range(total + 1):
            targets.append(sample(k))
            if k % period == 0:
                states.append(policy.state)
                if changes.obstacles:
                    simulation.moved.apply(simulation.time)
                    policy.see(simulation.moved.places())
                measured, before = simulation.measured()[0], (policy.q, policy.qd)
                begun = time.thread_time()
                after = policy.step(measured, targets[-1])
                spent.append(time.thread_time() - begun)
                reference.extend(*between(*before, *after))
            driver.act(simulation.data, k, simulation.noise)
            record.step()
    end = total * arm.timestep
    rollout = as_rollout(
        arm,
        record,
        reference.q,
        reference.qd,
        target=targets[-1],
        motion_end=end,
        controller=controller,
        disturbances=changes,
    )
    return Following(rollout, np.array(targets), np.array(states), period, np.array(spent))


class _Channels:
    """The channels of a policy, as those of a controller."""

    def __init__(self, policy: Policy) -> None:
        self._policy, self.channel_units = policy, policy.channel_units

    def sample(self, _: mujoco.MjData) -> Floats:
        """See `log.ChannelSource`."""
        return self._policy.channels()

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `log.ChannelSource`."""
        return tuple(samples.T)


def _sampler(
    arm: Arm, target: Callable[[float], ArrayLike] | ArrayLike | str, timestep: float
) -> Callable[[int], Floats]:
    """The target ``(n,)`` at a simulation step, checked against the position limits."""
    if callable(target):
        return lambda k: arm.check_position(target(k * timestep), f"the target at t = {k * timestep:.3f} s")
    given = arm.configuration(target) if isinstance(target, str) else target
    samples = np.atleast_2d(as_floats("target", given, (arm.n_joints,), batched=True))
    if samples.ndim > 2 or not len(samples):
        raise InputError(
            f"target must be ({arm.n_joints},) or (M, {arm.n_joints}) with M at least 1, got {samples.shape}"
        )
    return lambda k: arm.check_position(samples[min(k, len(samples) - 1)], f"the target at t = {k * timestep:.3f} s")
