"""From a joint target to a certified network whose whole motion keeps the arm's limits."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import cycle, islice, pairwise
from typing import Any

import numpy as np
from scipy.integrate import RK45

from lieednn_sim.arm import Arm
from lieednn_sim.budget import check_time, report
from lieednn_sim.errors import NotCertifiedError, PlanError, TooFastError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import integrate
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion, joint_scale, least_duration
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.registry import BIAS_RULES
from lieednn_sim.synthesis import Synthesis, synthesize, synthesize_many
from lieednn_sim.values import Floats, frozen

# Bias magnitudes that are tried in turn: with a stronger bias, weights do less and the transient is straighter.
BIAS_MAGNITUDES = (0.125, 0.25, 0.5)
_BATCH_SIZE = 24  # candidates made at once: larger batches gain little, and delay progress reports and interrupts


@dataclass(frozen=True)
class CandidateOptions(NetworkOptions):
    """Options of planners that make several networks until one can be used.

    Attributes:
        n_networks: largest number of networks to make.
        bias_magnitudes: magnitudes of their biases, used in turn [gamma/mu].
    """

    n_networks: int = 24
    bias_magnitudes: tuple[float, ...] = BIAS_MAGNITUDES

    def magnitudes(self) -> Iterator[float]:
        """The bias magnitude of one network after another."""
        return islice(cycle(self.bias_magnitudes), self.n_networks)


@dataclass(frozen=True)
class CertifiedOptions(CandidateOptions):
    """Options of the planner ``lieednn-certified``, besides those of `CandidateOptions`.

    Attributes:
        bias: a rule of `synthesis.BIAS_RULES`.
        n_first: number of networks to begin with; the others are made only if none of these can be used.
        attempts: number of starts of `synthesize` for a network.
        last_attempts: number of starts for a last network if no other could be certified.
    """

    # The straightest path first; where it is blocked, others bend more.
    bias_magnitudes: tuple[float, ...] = (4.0, *BIAS_MAGNITUDES)
    bias: str = "sign-matched"
    n_first: int = 1
    attempts: int = 3
    last_attempts: int = 16

    def __post_init__(self) -> None:
        super().__post_init__()
        BIAS_RULES.find(self.bias)


@frozen
class CertifiedDetails:
    """Further results of the planner ``lieednn-certified``.

    Attributes:
        n_networks: number of networks that were made.
        within_limits: number of these networks whose transient keeps the position limits.
    """

    n_networks: int
    within_limits: int


@dataclass(frozen=True)
class _Candidate:
    """A network and, if there are several, its roughly integrated path from a start (`_screened`)."""

    arm: Arm
    network: LieEDNN
    start: Floats
    q: Floats = field(default_factory=lambda: np.empty((0, 0)))  # along the path
    excess: float = 0.0  # the largest over the position limits [rad, m]
    gap: float = 0.0  # the largest mechanism gap [m]

    @property
    def rank(self) -> tuple[float, float, float]:
        """The sort key, smallest first: excess over the limits, then the gap, then the length of the path."""
        steps = np.diff(self.q, axis=0) / joint_scale(self.arm)
        # The gaps of links with six degrees of freedom are only rounding errors.
        return max(self.excess, LIMIT_TOLERANCE), max(self.gap, 1e-9), float(np.linalg.norm(steps, axis=1).sum())

    @functools.cached_property
    def touches(self) -> bool:
        """Whether the configurations, or some on straight lines between them, come too near to contact."""
        between = [start + s * (end - start) for start, end in pairwise(self.q) for s in (0.25, 0.5, 0.75)]
        for touching in self.arm.near_contacts_along(np.array([*self.q, *between])):
            check_time()
            if touching:
                return True
        return False

    @functools.cached_property
    def path(self) -> NetworkPath:
        """The network's exact path, from which motions of any duration are made."""
        return NetworkPath.integrate(self.arm, self.network, self.start)


def certified(problem: PlanningProblem, options: CertifiedOptions) -> Plan:
    """Draw certified networks for the target and keep the one with the smallest mechanism gap within the limits.

    If no network has a gap, as on arms whose links have six degrees of freedom, keep the one with the shortest path.

    Raises:
        NotCertifiedError: no candidate could be certified.
        PlanError: every candidate breaks a limit; the message is about the best one.
    """
    rng, total = np.random.default_rng(problem.seed), options.n_networks
    xi = problem.arm.encode(problem.target)
    magnitudes = list(options.magnitudes())
    # A plan is tried with a few networks first, and then with all of them.
    few = min(options.n_first, total)
    networks, drawn = list[LieEDNN](), 0
    while drawn < total:
        end = min(drawn + _BATCH_SIZE, few if drawn < few else total)
        results = _drawn(xi, magnitudes[drawn:end], options, rng)
        networks += [result.network for result in results if result.network is not None]
        for number in range(drawn + 1, end + 1):
            report(number, total)
        drawn = end
        if drawn == total and not networks:
            # Only as a last resort: hard candidates cost seconds, and mostly an easy one suffices.
            results = _drawn(xi, magnitudes[-1:], replace(options, attempts=options.last_attempts), rng)
            networks = [result.network for result in results if result.network is not None]
        if drawn in (few, total) and networks:
            try:
                return _plan(problem, networks, drawn)
            except PlanError as error:
                # The straightest network comes first; those that bend more are no faster.
                if drawn == total or isinstance(error, TooFastError):
                    raise
    raise NotCertifiedError(f"none of {total} candidates could be certified; the last one: {results[-1].message}")


def _drawn(xi: Floats, magnitudes: list[float], options: CertifiedOptions, rng: np.random.Generator) -> list[Synthesis]:
    """Networks for the target ``xi``, one per magnitude of the bias."""
    same: Any = {"bias": options.bias, "activation": options.activation, "max_attempts": options.attempts, "seed": rng}
    if len(magnitudes) == 1:
        return [synthesize(xi, bias_magnitude=magnitudes[0], **same)]
    return synthesize_many(np.broadcast_to(xi, (len(magnitudes), *xi.shape)), bias_magnitude=magnitudes, **same)


def _plan(problem: PlanningProblem, networks: list[LieEDNN], drawn: int) -> Plan:
    """The plan of the best network; raises as `certified`."""
    arm, start = problem.arm, problem.start
    result = _screened(arm, networks, start) if len(networks) > 1 else [_Candidate(arm, networks[0], start)]
    # Networks and their paths do not depend on the duration, so they are not made again.
    network, motion = in_time(_best, problem, result)
    # The chosen network counts in any case, since its motion has been checked.
    within = sum(candidate.network is network or candidate.excess <= LIMIT_TOLERANCE for candidate in result)
    return Plan(motion, network, CertifiedDetails(drawn, within))


def _best(problem: PlanningProblem, result: list[_Candidate]) -> tuple[LieEDNN, Motion]:
    """The first of the `_promising` networks with a feasible motion; raises as `certified`."""
    # If no motion can be fast enough, one refusal suffices. Sampled motions may seem 1 % faster.
    hurried = problem.duration <= 0.99 * least_duration(problem.arm, problem.start, problem.target)
    refusals = list[tuple[str, float | None]]()
    for candidate in _promising(result):
        # After a refusal, networks whose rough path exceeds the limits by more than this [rad, m] are not tried.
        if refusals and (candidate.touches or candidate.excess > 0.01):
            break
        try:
            return candidate.network, timed_motion(problem, candidate.path)
        except PlanError as error:
            refusals.append((str(error), getattr(error, "duration", None)))
            # At most 8 exact motions are made and checked.
            if hurried or len(refusals) == 8:
                break
    reason, duration = refusals[0]
    message = f"{reason} (best of {len(result)} candidates)"
    if duration is not None:
        raise TooFastError(message, duration)
    raise PlanError(f"{message}; try the planner lieednn-shaped, which goes around, or another seed")


def _promising(result: list[_Candidate]) -> Iterator[_Candidate]:
    """Candidates by `_Candidate.rank`, those whose path is free of contact first.

    Contact is checked only when a candidate's turn comes, since that costs more than everything else.
    """
    if len(result) == 1:
        yield result[0]
        return
    touching = []
    for candidate in sorted(result, key=lambda item: item.rank):
        if candidate.touches:
            touching.append(candidate)
        else:
            yield candidate
    yield from touching


def _screened(arm: Arm, networks: list[LieEDNN], start: Floats) -> list[_Candidate]:
    """The networks, without hidden neurons and with one decay rate, with their roughly integrated paths."""
    # All at once: a retraction without closed form costs nearly as much for one state as for a hundred.
    decoded = arm.decode(_side_by_side(networks, arm.encode(start)), start=start)
    excess = arm.limit_excess(decoded.q).max(axis=(0, -1))
    gap = (decoded.gap_translation.max(axis=-1) + arm.length_scale * decoded.gap_rotation.max(axis=-1)).max(axis=0)
    return [
        _Candidate(arm, network, start, decoded.q[:, k], float(excess[k]), float(gap[k]))
        for k, network in enumerate(networks)
    ]


def _side_by_side(networks: list[LieEDNN], start: Floats) -> Floats:
    """States ``(K, B, N, 6)`` of the networks from one start ``(N, 6)``, as one system."""
    first, weight = networks[0], np.array([network.mu * network.weight for network in networks])
    bias = np.array([network.mu * network.bias.ravel() for network in networks])

    def rate(_: float, x: Floats) -> Floats:
        state = x.reshape(bias.shape)
        return ((weight @ first.phi(state)[..., None])[..., 0] + bias - first.gamma * state).ravel()

    begin = np.tile(start.ravel(), len(networks))
    _, states, _ = integrate(RK45(rate, 0.0, begin, 20.0 / first.gamma, rtol=1e-4, atol=1e-6), None)
    return states.reshape(-1, len(networks), *start.shape)
