"""From a joint target to a certified network whose whole motion keeps the arm's limits."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, as_time_budget, check_time, time_limit
from lieednn_sim.errors import NotCertifiedError, PlanError, TooFastError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import (
    LIMIT_TOLERANCE,
    Motion,
    NetworkPath,
    check_motion,
    count_steps,
    least_duration,
    slowed_down,
)
from lieednn_sim.synthesis import synthesize
from lieednn_sim.validation import as_count, as_generator, as_positive

Floats = NDArray[np.float64]

# The stronger the bias, the less the weights have to do and the straighter the transient; the search tries all.
BIAS_MAGNITUDES = (0.125, 0.25, 0.5)

# Starts of `synthesize` for a candidate, and for the last one when there is none yet.
_QUICK_ATTEMPTS, _PATIENT_ATTEMPTS = 3, 16

# Where between two roughly integrated states contact is looked for, too.
_BETWEEN = (0.25, 0.5, 0.75)

# At most so many networks are tried in full, where the first ones are refused.
_TRIED = 8
# A motion below this share of the time that limits of velocity and acceleration allow at best is too fast, however it
# is made; sampled ones may seem a little faster than they are.
_HURRIED = 0.99

# A network that roughly integrated leaves the limits by more than this [rad, m] need not be tried in full.
_HOPELESS_EXCESS = 0.01


@dataclass(frozen=True)
class Plan:
    """A certified network and the motion it makes.

    Attributes:
        network: certified, with the target as its equilibrium.
        motion: keeps the limits and touches nothing, see `motion.check_motion`.
        target: ``(n,)`` joint target [rad, m].
        candidates: networks synthesised.
        within_limits: of these, networks whose transient keeps the position limits.
    """

    network: LieEDNN
    motion: Motion
    target: Floats
    candidates: int
    within_limits: int


@dataclass(frozen=True)
class _Candidate:
    """A network, its roughly integrated way from a start as postures ``(K, n)``, the largest excess and gap on it."""

    arm: Arm
    network: LieEDNN
    start: Floats
    way: Floats
    excess: float
    gap: float

    @functools.cached_property
    def touches(self) -> bool:
        """Whether the postures, or some straight in between, come too near to contact."""
        between = [start + share * (end - start) for start, end in pairwise(self.way) for share in _BETWEEN]
        for touching in self.arm.near_contacts_along(np.array([*self.way, *between])):
            check_time()
            if touching:
                return True
        return False

    @functools.cached_property
    def path(self) -> NetworkPath:
        """Where the network really goes, from which motions of any duration are made."""
        return NetworkPath.drawn(self.arm, self.network, self.start)


def plan(
    arm: Arm,
    target: ArrayLike,
    *,
    start: ArrayLike | None = None,
    duration: float = 4.0,
    timestep: float | None = None,
    bias: str = "sign-matched",
    bias_magnitude: float | None = None,
    candidates: int = 24,
    seed: int = 0,
    longest: float = 1.0,
    time_budget: float = DEFAULT_TIME_BUDGET,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """Draw certified networks for a joint target and keep the one with the smallest mechanism gap within the limits.

    Args:
        arm: the arm.
        target: joint target ``(n,)``.
        start: joint position at rest, the keyframe ``home`` by default.
        duration: of the motion [s].
        timestep: sampling period [s], the model's time step by default.
        bias: a rule of `synthesis.BIAS_RULES`.
        bias_magnitude: of the rule; by default the search alternates between `BIAS_MAGNITUDES`.
        candidates: networks to draw.
        seed: of the draws; the same seed gives the same plan.
        longest: the motion may take up to this many durations where the arm's limits need it.
        time_budget: CPU time that planning may take [s]; infinity for no limit.
        progress: called with (done, total) after every candidate.

    Raises:
        InputError: a value is malformed, or the target is out of the arm's reach.
        NotCertifiedError: no candidate could be certified.
        PlanError: every candidate breaks a limit; the message is of the best one.
        OutOfTimeError: the time budget is spent.
    """
    goal = arm.check_reachable(target, "target")
    origin = arm.keyframe("home") if start is None else arm.check_position(start, "start")
    total, factor = as_count("candidates", candidates), as_positive("longest", longest)
    step = float(arm.model.opt.timestep) if timestep is None else timestep
    count_steps(duration, step)
    magnitudes = BIAS_MAGNITUDES if bias_magnitude is None else (as_positive("bias_magnitude", bias_magnitude),)
    rng = as_generator("seed", seed)
    with time_limit(as_time_budget("time_budget", time_budget)):
        networks: list[LieEDNN] = []
        message = ""
        for index in range(total):
            magnitude = magnitudes[index % len(magnitudes)]
            # Patience only where everything else failed: easy candidates are many, hard ones cost seconds.
            attempts = _PATIENT_ATTEMPTS if index == total - 1 and not networks else _QUICK_ATTEMPTS
            result = synthesize(arm.encode(goal), bias=bias, bias_magnitude=magnitude, seed=rng, max_attempts=attempts)
            if result.network is None:
                message = result.message
            else:
                networks.append(result.network)
            if progress is not None:
                progress(index + 1, total)
        if not networks:
            raise NotCertifiedError(
                f"none of {total} candidates for the target could be certified; the last one: {message}"
            )
        found = _screen(arm, networks, origin)
        # Networks and their ways do not depend on the duration.
        chosen, motion = slowed_down(
            lambda seconds: _best(arm, found, total, origin, goal, seconds, step), duration, factor * duration
        )
    return Plan(chosen, motion, goal, total, sum(candidate.excess <= LIMIT_TOLERANCE for candidate in found))


def _best(
    arm: Arm, found: list[_Candidate], total: int, start: Floats, target: Floats, duration: float, timestep: float
) -> tuple[LieEDNN, Motion]:
    """The network with the smallest gap among those whose motion the arm can make; errors as of `plan`."""
    # Where no motion at all could be fast enough, one refusal tells as much as all of them.
    tries = _TRIED if duration > _HURRIED * least_duration(arm, start, target) else 1
    refusals: list[PlanError] = []
    for candidate in _promising(found):
        if refusals and (candidate.touches or candidate.excess > _HOPELESS_EXCESS):
            break
        try:
            motion = candidate.path.timed(duration, timestep)
            check_motion(arm, motion)
        except PlanError as error:
            refusals.append(error)
            if len(refusals) == tries:
                break
            continue
        return candidate.network, motion
    message = f"{refusals[0]} (best of {total} candidates)"
    if isinstance(refusals[0], TooFastError):
        raise TooFastError(message, refusals[0].duration)
    raise PlanError(f"{message}; try more candidates, another seed, a larger bias magnitude or the solved bias")


def _promising(found: list[_Candidate]) -> Iterator[_Candidate]:
    """Those whose way touches nothing first, of these those within the limits, the smallest gap first.

    Contact is looked for posture by posture, which costs more than all else, so only when a candidate's turn has come.
    """
    touching = []
    for candidate in sorted(found, key=lambda one: (max(one.excess, LIMIT_TOLERANCE), one.gap)):
        if candidate.touches:
            touching.append(candidate)
        else:
            yield candidate
    yield from touching


def rough_way(network: LieEDNN, start: Floats) -> Floats:
    """States ``(K, N, 6)`` of the network from ``start`` ``(N, 6)``, roughly integrated, to look at before planning."""
    return network.trajectory(start, 20.0 / network.gamma, rtol=1e-4, atol=1e-6).xi


def _screen(arm: Arm, networks: list[LieEDNN], start: Floats) -> list[_Candidate]:
    """Roughly integrated trajectories, decoded, with their largest excess over the position limits and largest gap."""
    state = arm.encode(start)
    runs = [rough_way(network, state) for network in networks]
    # All at once: a retraction without closed form costs nearly as much for one state as for a hundred.
    decoded = arm.decode(np.concatenate(runs))
    excess = arm.limit_excess(decoded.q).max(axis=-1)
    gap = decoded.gap_translation.max(axis=-1) + arm.length_scale * decoded.gap_rotation.max(axis=-1)
    firsts = np.cumsum([0, *(len(run) for run in runs[:-1])])
    worst = zip(networks, np.maximum.reduceat(excess, firsts), np.maximum.reduceat(gap, firsts), strict=True)
    ways = np.split(decoded.q, firsts[1:])
    return [
        _Candidate(arm, network, start, way, float(most), float(widest))
        for (network, most, widest), way in zip(worst, ways, strict=True)
    ]
