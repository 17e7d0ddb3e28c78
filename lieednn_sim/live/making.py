"""What the workers of a session make: policies, and the path ahead of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.live.proof import Progress, network_policy, unfiltered
from lieednn_sim.live.settings import PLANNED, Settings
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.safety_filter import FilterOptions
from lieednn_sim.policies import MotionTracker, Policy, make_policy
from lieednn_sim.values import Floats

# Network time for which a path is foreseen, its tolerance, and the number of its points.
_HORIZON, _TOLERANCE, _POINTS = 12.0, 1e-4, 60


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
