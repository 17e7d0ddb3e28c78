"""Policies of a session: made by its workers, what is proved about them, and the path ahead of one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import NotCertifiedError
from lieednn_sim.live.settings import PLANNED, Settings
from lieednn_sim.network import BlockNetwork
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.policies import FilteredPolicy, FilterOptions, MotionTracker, NetworkPolicy, Policy, make_policy
from lieednn_sim.stability import Certificate
from lieednn_sim.stability.robustness import Decay
from lieednn_sim.values import Floats, frozen

# Network time for which a path is foreseen, its tolerance, and the number of its points.
_HORIZON, _TOLERANCE, _POINTS = 12.0, 1e-4, 60


def unfiltered(policy: Policy) -> Policy:
    """The policy itself, without a safety filter around it."""
    return policy.inner if isinstance(policy, FilteredPolicy) else policy


def network_policy(policy: Policy) -> NetworkPolicy | None:
    """The network policy in a policy, which may be behind a safety filter; None if there is none."""
    inner = unfiltered(policy)
    return inner if isinstance(inner, NetworkPolicy) else None


def certificate_of(policy: Policy) -> Certificate | None:
    """The certificate of the network of a policy, whatever class the policy has; None without one."""
    inner = unfiltered(policy)
    network = getattr(inner, "network", None) if inner.certified else None
    return network.certificate if isinstance(network, BlockNetwork) else None


@frozen
class Progress:
    """A network's way to its target.

    The bound begins again whenever the target moves, or the measured joints pull the state. Its time is the network's
    own: a policy that slows down is slower on the same orbit.

    Attributes:
        rate: proved rate of convergence at full speed [1/s].
        decay: the proved bound on the distance of the visible neurons; None if none was found.
        xi: ``(N, 6)`` present state.
        goal: ``(N, 6)`` state to arrive at.
        begun: value of `Decay.begin` when the target last moved.
        time: network time since then.
    """

    rate: float
    decay: Decay | None
    xi: Floats
    goal: Floats
    begun: Floats
    time: float = 0.0

    @classmethod
    def of(cls, policy: NetworkPolicy, target: Floats) -> Progress:
        """The beginning of the way of a policy to a joint target ``(n,)``."""
        network, certificate = policy.network, policy.network.certificate
        assert certificate is not None
        try:
            bounds = network.robustness(np.arange(len(network.weight)))
            decay: Decay | None = Decay(bounds, 6 * network.n_visible)
        except NotCertifiedError:
            decay = None
        rate = certificate.rate * policy.speed
        blank = cls(rate, decay, policy.xi, policy.xi, np.empty(0))
        return blank.towards(policy, target)

    def towards(self, policy: Policy, target: Floats) -> Progress:
        """The way begins again: the policy has another joint target ``(n,)``, or another state."""
        inner = network_policy(policy)
        assert inner is not None
        goal = inner.network.goal(inner.arm.encode(target))
        return self._begun(inner.xi, goal)

    def after(self, policy: Policy) -> Progress:
        """The way after one more control period."""
        inner = network_policy(policy)
        assert inner is not None
        if inner.pulled:
            return self._begun(inner.xi, self.goal)
        return replace(self, xi=inner.xi, time=self.time + inner.pace * inner.speed * inner.period)

    def _begun(self, xi: Floats, goal: Floats) -> Progress:
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
    """A policy and what belongs to it.

    Attributes:
        settings: the settings for which it was made.
        policy: the policy.
        motion: the planned motion that it follows or imitates; None if there is none.
        progress: what is proved about it; None for a policy without a network.
    """

    settings: Settings
    policy: Policy
    motion: Motion | None
    progress: Progress | None


def make_for(
    arm: Arm,
    settings: Settings,
    start: Floats,
    target: Floats,
    *,
    rate: float,
    seed: int,
    check: Callable[..., None],
) -> Made:
    """Make the policy of some settings; raises as `make_policy` and `plan`.

    Args:
        arm: an arm that nothing else uses.
        settings: the settings.
        start: ``(n,)`` joint position from which it starts.
        target: ``(n,)`` joint target.
        rate: control rate [Hz].
        seed: seed of random draws.
        check: called between the steps of the work; an exception of it ends the work.
    """
    motion = None
    if settings.policy in PLANNED:
        motion = plan(
            arm, target, planner=settings.planner, start=start, seed=seed, progress=lambda *_: check()
        ).motion  # fmt: skip
    options = ShapedOptions(rate=settings.rho) if settings.policy == "lieednn-shaped" else None
    safety = FilterOptions() if settings.filtered else None
    policy = make_policy(
        settings.policy, arm, target, rate=rate, start=start, motion=motion, safety=safety, options=options, seed=seed
    )
    check()
    inner = network_policy(policy)
    return Made(settings, policy, motion, None if inner is None else Progress.of(inner, target))


def foreseen(
    arm: Arm, policy: Policy, motion: Motion | None, progress: Progress | None, q: Floats, target: Floats
) -> Floats | None:
    """Positions of the end effector ``(P, 3)`` on a policy's way to its target, where that is known; else None.

    Of a network it is its own orbit from the present state, which limits and a slow arm only slow down.
    """
    if motion is not None and isinstance(unfiltered(policy), MotionTracker):
        rows = np.linspace(0, len(motion.q) - 1, _POINTS).astype(int)
        return arm.tip(motion.q[rows])
    inner = network_policy(policy)
    if progress is None or inner is None:
        return None
    network = inner.network.retarget(arm.encode(target))
    run = network.trajectory(
        progress.xi, _HORIZON, until=progress.goal, distance=1e-3, rtol=_TOLERANCE, atol=_TOLERANCE
    )
    decoded = arm.decode(network.visible(run(np.linspace(0.0, run.t[-1], _POINTS))), start=q).q
    return arm.tip(np.vstack([decoded, target]))
