"""The closed loop of a live view, whose policy, plant and pushes may change while it runs; without threads or requests.

Workers of the session call the functions here to make its policies, and to find their proofs and the path ahead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import NotCertifiedError
from lieednn_sim.live.settings import Settings
from lieednn_sim.network import BlockNetwork
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.policies import FilteredPolicy, MotionTracker, NetworkPolicy, Policy, make_policy
from lieednn_sim.policies.making import PLANNED
from lieednn_sim.simulation.disturbances import Push
from lieednn_sim.simulation.following import ClosedLoop
from lieednn_sim.stability import Certificate
from lieednn_sim.stability.robustness import Decay
from lieednn_sim.values import Floats, frozen


def _unfiltered(policy: Policy) -> Policy:
    return policy.inner if isinstance(policy, FilteredPolicy) else policy


def network_policy(policy: Policy) -> NetworkPolicy | None:
    """The policy if it is a network policy, without its safety filter; None for others."""
    inner = _unfiltered(policy)
    return inner if isinstance(inner, NetworkPolicy) else None


def certificate_of(policy: Policy) -> Certificate | None:
    """The certificate of a policy's network, for any class of policies; None if there is none."""
    inner = _unfiltered(policy)
    network = getattr(inner, "network", None) if inner.certified else None
    return network.certificate if isinstance(network, BlockNetwork) else None


@frozen
class Progress:
    """A network's progress towards its target.

    The bound begins again whenever the target moves, or the measured joints pull the state. The time is the network's
    own: a policy that slows down moves more slowly on the same orbit.
    """

    policy: NetworkPolicy  # the policy of the network
    rate: float  # proved rate of convergence at full speed [1/s]
    decay: Decay | None  # the proved bound on the distance of the visible neurons; None if none was found
    xi: Floats  # (N, 6) present state
    goal: Floats  # (N, 6) state to arrive at
    begun: Floats  # value of `Decay.begin` when the target last moved
    time: float = 0.0  # network time since then

    @classmethod
    def of(cls, policy: NetworkPolicy) -> Progress:
        """The progress of a policy that has no target yet; see `towards`."""
        network, certificate = policy.network, policy.network.certificate
        assert certificate is not None
        try:
            bounds = network.robustness(np.arange(len(network.weight)))
            decay: Decay | None = Decay(bounds, 6 * network.n_visible)
        except NotCertifiedError:
            decay = None
        return cls(policy, certificate.rate * policy.speed, decay, policy.xi, policy.xi, np.empty(0))

    def towards(self, target: Floats) -> Progress:
        """The progress begun anew, towards another joint target ``(n,)`` or from another state."""
        return self._begun(self.policy.network.goal(self.policy.arm.encode(target)))

    def after(self) -> Progress:
        """The progress after one more control period."""
        policy = self.policy
        if policy.pulled:
            return self._begun(self.goal)
        return replace(self, xi=policy.xi, time=self.time + policy.pace * policy.speed * policy.period)

    def _begun(self, goal: Floats) -> Progress:
        xi = self.policy.xi
        start = np.empty(0) if self.decay is None else self.decay.begin((xi - goal).ravel())
        return replace(self, xi=xi, goal=goal, begun=start, time=0.0)

    @property
    def distance(self) -> float:
        """Distance of the visible neurons from the target [rad, m / unit]."""
        visible = self.goal.shape[0] if self.decay is None else self.decay.watched // 6
        return float(np.linalg.norm((self.xi - self.goal)[:visible]))

    @property
    def bound(self) -> float:
        """The proved bound on `distance`; infinite if none was found."""
        return np.inf if self.decay is None else self.decay.bound(self.begun, self.time)


class Made(NamedTuple):
    """A policy, its settings, its motion, and what is proved about it."""

    settings: Settings  # settings for which the policy was made
    policy: Policy
    motion: Motion | None  # the planned motion that it follows or imitates
    progress: Progress | None  # what is proved about it; None for a policy without a network


def make_for(arm: Arm, settings: Settings, start: Floats, target: Floats, *, rate: float, seed: int) -> Made:
    """Make the policy of some settings; raises as `make_policy` and `plan`. No other thread may use the arm."""
    motion = None
    if settings.policy in PLANNED:
        motion = plan(arm, target, planner=settings.planner, start=start, seed=seed).motion
    options = ShapedOptions(rate=settings.rho) if settings.policy == "lieednn-shaped" else None
    goal = target if motion is None else motion
    policy = make_policy(settings.policy, arm, goal, rate=rate, start=start, options=options, seed=seed)
    if settings.filtered:
        policy = FilteredPolicy(policy)
        policy.reset(start)
    inner = network_policy(policy)
    return Made(settings, policy, motion, None if inner is None else Progress.of(inner))


def foreseen(
    arm: Arm, policy: Policy, motion: Motion | None, progress: Progress | None, q: Floats, target: Floats
) -> tuple[Floats, Floats, Floats] | None:
    """Samples t, q and qd of a policy's way to its target, like those of a motion; None if the way is not known.

    For a network it is its orbit from the present state, which limits and a slow arm only slow down; t counts points.
    """
    if motion is not None and isinstance(_unfiltered(policy), MotionTracker):
        return motion.t, motion.q, motion.qd
    if progress is None:
        return None
    network = progress.policy.network.retarget(arm.encode(target))
    # For 12 of the network's own time, in 120 points.
    run = network.trajectory(progress.xi, 12.0, until=progress.goal, distance=1e-3, rtol=1e-4, atol=1e-4)
    decoded = arm.decode(network.visible(run(np.linspace(0.0, run.t[-1], 120))), start=q).q
    points = np.vstack([decoded, target])
    return np.arange(len(points), dtype=float), points, np.gradient(points, axis=0)


class Tick(NamedTuple):
    """The state after a control period, with arrays that nobody changes."""

    time: float  # since the last reset [s]
    q: Floats  # (n,) joint coordinates [rad, m]
    q_ref: Floats  # (n,) their reference
    target: Floats  # (n,) joint target
    force: Floats  # (3,) force of the last one of the acting pushes and pulls [N], world
    pushed: Floats  # (3,) the point where it acts, world [m]
    policy: str  # name of the policy in use; empty while the arm only stops
    message: str  # what the policy does, in words
    progress: Progress | None  # what is proved about the way to the target; None for a policy without a network


class Engine:
    """A simulated arm driven by a policy, both of which may be exchanged between control periods.

    Start and first target ``(n,)`` are unchecked. `InputError` if the controller cannot drive the arm.
    """

    policy: Policy

    def __init__(self, arm: Arm, settings: Settings, start: Floats, target: Floats, rate: float) -> None:
        self._arm, self._start, self._first, self._rate = arm, start, target, rate
        self.equipped = settings  # settings for which controller and plant were made
        self.begin()
        self._loop = ClosedLoop(self.policy, settings.controller, settings.disturbances)
        self._loop.begin(start)

    def begin(self) -> None:
        """Forget everything but the plant, and stay at the start until there is a policy."""
        self._periods, self._force = 0, (np.zeros(3), np.zeros(3))
        # Pushes with the periods in which they end.
        self._pushes: list[tuple[Push, int]] = []
        # A push that acts until it is removed, with the point where it acts, or None for the centre of mass.
        self.pull: tuple[Push, Floats | None] | None = None
        self.motion: Motion | None = None  # the motion that the policy follows or imitates
        self.progress: Progress | None = None  # progress of a policy with a network
        self._name, self.target = "", self._first
        self.policy = MotionTracker.stopping(self._arm, self._start, np.zeros_like(self._start), self._rate)

    def restart(self) -> None:
        """As `begin`, with the arm back at the start."""
        self.begin()
        self._loop.policy = self.policy
        self._loop.begin(self._start)

    def retarget(self, q: Floats) -> None:
        """Move the target to joint coordinates ``(n,)``."""
        self.target = q
        if self.progress is not None:
            self.progress = self.progress.towards(q)

    def push(self, push: Push) -> None:
        """Begin a push now; its own start does not count."""
        self._pushes.append((push, self._periods + max(1, round(push.duration * self._rate))))

    def stop(self) -> Floats:
        """Let the reference stop at the limits of acceleration; returns where it comes to rest ``(n,)``."""
        if not self.policy.qd.any():
            return self.policy.q
        stopping = MotionTracker.stopping(self._arm, self.policy.q, self.policy.qd, self._rate)
        self._go_on_with(stopping)
        return stopping.end

    def put_in(self, result: Made) -> None:
        """Let another policy take over from the present reference; after `InputError` the present one continues."""
        self._go_on_with(result.policy)
        self._name, self.motion = result.settings.policy, result.motion
        if result.progress is not None:
            self.progress = result.progress.towards(self.target)

    def equip(self, plant: ClosedLoop, settings: Settings) -> None:
        """Let another plant and controller take over from the present state of the arm."""
        before, self._loop, self.equipped = self._loop.simulation, plant, settings
        plant.policy = self.policy
        plant.begin(before.q, before.qd)

    def advance(self) -> Tick:
        """Do a control period; after a `SimulationError`, `restart` begins again."""
        self._apply_forces()
        self._loop.advance(self.target)
        self._periods += 1
        if self.progress is not None:
            self.progress = self.progress.after()
        return self.look()

    def look(self) -> Tick:
        """The present state."""
        policy, time = self.policy, self._periods * self.policy.period
        loop = self._loop.simulation.q, policy.q, self.target
        return Tick(time, *loop, *self._force, self._name, policy.message, self.progress)

    def _go_on_with(self, policy: Policy) -> None:
        q, qd = self.policy.q, self.policy.qd
        policy.reset(q)
        policy.qd = qd
        self.policy = self._loop.policy = policy
        self.progress, self.motion, self._name = None, None, ""

    def _apply_forces(self) -> None:
        data, model = self._loop.simulation.data, self._loop.simulation.model
        self._pushes = [push for push in self._pushes if push[1] > self._periods]
        acting: list[tuple[Push, Floats | None]] = [(push, None) for push, _ in self._pushes]
        acting += [self.pull] if self.pull else []
        data.xfrc_applied[:], self._force = 0.0, (np.zeros(3), np.zeros(3))
        for push, point in acting:
            body = push.body_id(self._arm, model)
            force, centre = np.array(push.force), data.xipos[body].copy()
            where = centre if point is None else point
            data.xfrc_applied[body] += (*force, *np.cross(where - centre, force))
            self._force = force, where
