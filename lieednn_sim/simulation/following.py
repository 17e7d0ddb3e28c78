"""Following a moving target in real time: the network's bias moves with the target.

The certificate of a network does not depend on its bias, so the bias b(x) = (gamma/mu) x - W phi(x) makes any target x
the global attractor, at any moment. With the network's rate c [1/s], the state follows

    xi' = c (-gamma (xi - x) + mu W (phi(xi) - phi(x))) + x'_ff,

which is c times the field of the network retargeted to x. A state near a target that moves with velocity v in the
network's coordinates lags by (-c J)^-1 v, with the Jacobian J of the field at the target; the feedforward x'_ff = v, a
stronger bias, removes the lag. The decoded joints are the reference of a controller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.planning.motion import count_steps
from lieednn_sim.planning.network_path import require_fit
from lieednn_sim.simulation.closed_loop import closed_loop
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.feedback import Feedback, FeedbackFollower
from lieednn_sim.simulation.reference import steps_of_rate
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.validation import as_positive
from lieednn_sim.values import Floats, frozen

# A target faster than the joints' limits has jumped; for joints without limits, one faster than this [rad/s, m/s].
_FASTEST = 10.0
# Largest |c J| h for which RK4 is accurate, far inside its region of stability.
_LARGEST_STEP = 1.0


@frozen
class Following:
    """A rollout behind a moving target.

    Attributes:
        rollout: its reference is the network's decoded state, and `motion_end` its end.
        target: ``(K, n)`` the target at the rollout's times.
        xi: ``(K, N, 6)`` states of all neurons; with feedback ``(L, N, 6)``, at the beginnings of the L control
            periods.
        period: simulation steps between two samples of the target.
        jumps: times at which the follower took the target to have jumped [s].
        slowed: share of the control periods in which the velocity limits slowed the network down.
        limit_excess: largest excess of the decoded joints over their position limits, at which the reference stops
            [rad, m]; not positive if they kept the limits.
        gap_translation: largest mechanism gap [m].
        gap_rotation: the same as an angle [rad].
    """

    rollout: Rollout
    target: Floats
    xi: Floats
    period: int
    jumps: tuple[float, ...]
    slowed: float
    limit_excess: float
    gap_translation: float
    gap_rotation: float

    def __repr__(self) -> str:
        return (
            f"<Following: {self.rollout!r}, {len(self.jumps)} jumps of the target, mechanism gap up to "
            f"{1e3 * self.gap_translation:.3g} mm>"
        )


class Follower:
    """A certified network that follows a target; its state is only set at the start.

    Args:
        arm: encodes targets and decodes states.
        network: certified, with as many visible neurons as the arm has links.
        start: joint coordinates ``(n,)``.
        steps: simulation steps in a control period.
        speed: the network's rate c [1/s].
        feedforward: whether to add the target's velocity, by the difference of its last two samples.

    Attributes:
        xi: ``(N, 6)`` state of all neurons.
        jumped: whether the last target was faster than the joints' limits.
        share: share of its speed at which the network ran in the last period, below 1 if joints would be too fast.

    Raises:
        InputError: network and arm differ in size, the network is not certified, or the speed is too high for the time
            step.
    """

    def __init__(
        self, arm: Arm, network: LieEDNN, start: ArrayLike, *, steps: int, speed: float, feedforward: bool
    ) -> None:
        require_fit(arm, network, certified=True)
        self._arm, self._network, self._steps = arm, network, steps
        self._speed, self._feedforward = as_positive("speed", speed), feedforward
        self._timestep = arm.timestep
        stiffness = network.gamma + network.mu * float(np.linalg.norm(network.weight, 2))
        if self._speed * stiffness * self._timestep > _LARGEST_STEP:
            raise InputError(
                f"speed must be at most {_LARGEST_STEP / (stiffness * self._timestep):.3g} per second for this network "
                f"and steps of {self._timestep:g} s, got {speed:g}"
            )
        self._fastest = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, _FASTEST)
        self._last: tuple[Floats, Floats] | None = None
        self.xi = network.start(arm.encode(arm.check_position(start, "start")))
        self.jumped, self.share = False, 1.0
        self.limit_excess, self.gap_translation, self.gap_rotation = -np.inf, 0.0, 0.0

    def advance(self, target: Floats) -> tuple[Floats, Floats, Floats]:
        """Follow a new target ``(n,)`` for a control period.

        Returns:
            Joint coordinates and rates ``(m, n)`` and states ``(m, N, 6)`` after each of the period's m steps.
        """
        goal, velocity = self._network.goal(self._arm.encode(target)), np.zeros_like(self.xi)
        self.jumped = False
        if self._last is not None:
            period = self._steps * self._timestep
            self.jumped = bool((np.abs(target - self._last[0]) > self._fastest * period).any())
            if self._feedforward and not self.jumped:
                velocity = (goal - self._last[1]) / period
        self._last = target, goal
        self.share = 1.0
        for _ in range(8):
            states, rates = self._integrate(goal, velocity)
            decoded = self._arm.decode(self._network.visible(states), self._network.visible(rates))
            excess = float((np.abs(decoded.qd) / self._arm.velocity_limits).max())
            if excess <= 1.0:
                break
            self.share /= 1.001 * excess
        self.xi = states[-1]
        self.gap_translation = max(self.gap_translation, float(decoded.gap_translation.max()))
        self.gap_rotation = max(self.gap_rotation, float(decoded.gap_rotation.max()))
        outside = self._arm.limit_excess(decoded.q)
        self.limit_excess = max(self.limit_excess, float(outside.max()))
        q = np.clip(self._arm.within_angles(decoded.q), *self._arm.position_limits.T)
        qd = np.where(outside > 0.0, 0.0, decoded.qd)
        return q, qd, states

    def _integrate(self, goal: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """States and their rates ``(m, N, 6)`` after each step of a period, by RK4."""
        network, h = self._network, self._timestep
        shape, weight = goal.shape, network.mu * network.weight
        scale = self.share * self._speed

        def field(x: Floats, step: float) -> Floats:
            aim = goal + step * h * velocity
            drive = (weight @ (network.phi(x) - network.phi(aim)).ravel()).reshape(shape)
            return scale * (drive - network.gamma * (x - aim)) + self.share * velocity

        x, states, rates = self.xi, np.empty((self._steps, *shape)), np.empty((self._steps, *shape))
        for i in range(self._steps):
            x = runge_kutta_step(field, x, h, i)
            states[i], rates[i] = x, field(x, i + 1)
        return states, rates


def follow(
    arm: Arm,
    network: LieEDNN,
    target: Callable[[float], ArrayLike] | ArrayLike,
    duration: float,
    *,
    start: ArrayLike | None = None,
    controller: str = "inverse-dynamics",
    control_rate: float = 100.0,
    speed: float = 5.0,
    feedforward: bool = True,
    feedback: Feedback | None = None,
    disturbances: Disturbances | None = None,
) -> Following:
    """Let the simulated arm follow a moving target that is known only up to the present.

    At every control period the network's bias is set from the target's last sample, and the network runs for the
    period; the joints that decode its states, at every simulation step, are the controller's reference. Joints are
    never faster than their limits: the network is slowed down instead. Nothing is ever reset. A run is a function of
    its arguments alone.

    Args:
        arm: the arm.
        network: certified, with as many visible neurons as the arm has links; its own bias does not matter.
        target: joint coordinates ``(n,)`` at a time [s], called once for each simulation step in order, but only seen
            by the follower at the control periods; or samples ``(M, n)``, one a simulation step, the last of which
            stays.
        duration: [s].
        start: joint coordinates at rest, the keyframe ``home`` by default.
        controller: a name of `CONTROLLERS`.
        control_rate: rate at which the target is sampled [Hz]; it must divide the rate of the simulation, and a period
            must not be longer than the duration.
        speed: the network's rate [1/s]: its own time in one second.
        feedforward: whether the follower adds the target's velocity, by which it follows without lag.
        feedback: the network hears the measured joints, and its time waits for them (`feedback`); by default it runs
            ahead of the arm and is never disturbed. The rollout's channels then say at which share of its speed it
            ran, ``pace``, and how far the arm was from where the network was, ``behind``, as a share of its range.
        disturbances: what the controller does not know of.

    Raises:
        InputError: a value is malformed, the network has no proof, or the target leaves the position limits.
        SimulationError: as `simulate`.
    """
    period = steps_of_rate("control_rate", control_rate, arm.timestep)
    if period > (total := count_steps(duration, arm.timestep)):
        raise InputError(
            f"control_rate must be at least {1.0 / (total * arm.timestep):g} Hz for a duration of {duration:g} s, "
            f"got {control_rate:g} Hz"
        )
    origin = arm.keyframe("home") if start is None else arm.check_position(start, "start")
    settings: dict[str, Any] = {"steps": period, "speed": speed, "feedforward": feedforward}
    follower: Follower | FeedbackFollower
    if feedback is None:
        follower = Follower(arm, network, origin, **settings)
    else:
        follower = FeedbackFollower(arm, network, origin, feedback=feedback, **settings)
    states, jumps, slowed = [follower.xi[None]], [], 0

    def lead(sample: Floats, simulation: Simulation) -> tuple[Floats, Floats]:
        nonlocal slowed
        if isinstance(follower, FeedbackFollower):
            q, qd, xi = follower.advance(sample, simulation.measured()[0])
        else:
            q, qd, xi = follower.advance(sample)
        states.append(xi)
        slowed += follower.share < 1.0
        if follower.jumped:
            jumps.append(simulation.time)
        return q, qd

    rollout, targets = closed_loop(
        arm,
        lead,
        target,
        duration,
        start=origin,
        period=period,
        controller=controller,
        disturbances=disturbances,
        sources=(follower,) if isinstance(follower, FeedbackFollower) else (),
    )
    return Following(
        rollout=rollout,
        target=targets,
        xi=np.concatenate(states)[: len(targets)],
        period=period,
        jumps=tuple(jumps),
        slowed=slowed / len(states[1:]),
        limit_excess=follower.limit_excess,
        gap_translation=follower.gap_translation,
        gap_rotation=follower.gap_rotation,
    )
