"""From a joint target to a certified network whose whole motion keeps the arm's limits."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import cycle, islice, pairwise

import numpy as np

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm
from lieednn_sim.budget import check_time
from lieednn_sim.errors import NotCertifiedError, PlanError, TooFastError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.side_by_side import states_side_by_side
from lieednn_sim.planning.baselines.joint_space import joint_scale
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion, least_duration
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.synthesis import BIAS_RULES, Synthesis, synthesize, synthesize_many
from lieednn_sim.validation import as_choice
from lieednn_sim.values import Floats

# The stronger the bias, the less the weights have to do and the straighter the transient; searches try all.
BIAS_MAGNITUDES = (0.125, 0.25, 0.5)
# In their place, unless others are asked for, where every link moves along one screw: straight ways first, and where
# the first is blocked one that is nearly as straight as minimum jerk's.
_STRAIGHT = (1.0, 4.0, 0.5, 0.25, 0.125)

# Candidates that are made at once. More at a time gain little, and neither progress nor an interrupt waits for long.
_AT_ONCE = 24

# Shares of the way from one roughly integrated state to the next at which contact is looked for, too: steps are long.
_BETWEEN = (0.25, 0.5, 0.75)

# Gaps up to this are rounding [m]: where links have six freedoms there is no other.
_NO_GAP = 1e-9

# A motion below this share of the time that limits of velocity and acceleration allow at best is too fast, however it
# is made; sampled ones may seem a little faster than they are.
_HURRIED = 0.99


@dataclass(frozen=True)
class CandidateOptions(PlannerOptions):
    """Of planners that make one network after another.

    Attributes:
        candidates: networks to make, at most.
        bias_magnitudes: of their bias, in turn [gamma/mu].
    """

    candidates: int = 24
    bias_magnitudes: tuple[float, ...] = BIAS_MAGNITUDES

    def magnitudes(self) -> Iterator[float]:
        """Of the bias of one network after another."""
        return islice(cycle(self.bias_magnitudes), self.candidates)


@dataclass(frozen=True)
class CertifiedOptions(CandidateOptions):
    """How the planner ``lieednn-certified`` searches, beside what `CandidateOptions` say.

    Attributes:
        bias: a rule of `synthesis.BIAS_RULES`.
        first: of the candidates, where every link moves along one screw: there a gap costs nothing, and what is drawn
            takes most of the time. The others are drawn where none of these can be used. Unless other magnitudes are
            asked for, 1 and 4 come before the usual ones, the strongest of which is first.
        attempts: starts of `synthesize` for a candidate.
        last_attempts: for the last one once more, when there is none at all.
        tried: networks that are tried in full at most, where the first ones are refused.
        hopeless_excess: a network that roughly integrated leaves the limits by more than this [rad, m] is not tried in
            full after another one was refused.

    Raises:
        InputError: a value is out of range.
    """

    bias: str = "sign-matched"
    first: int = 1
    attempts: int = 3
    last_attempts: int = 16
    tried: int = 8
    hopeless_excess: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        as_choice("bias rule", self.bias, BIAS_RULES)


@dataclass(frozen=True)
class _Candidate:
    """A network and, once it is asked for, its roughly integrated way from a start, see `_screened`."""

    arm: Arm
    network: LieEDNN
    start: Floats
    index: int
    screened: Callable[[], list[tuple[Floats, float, float]]]

    @property
    def way(self) -> Floats:
        """Postures ``(K, n)``."""
        return self.screened()[self.index][0]

    @property
    def excess(self) -> float:
        """The largest over the position limits [rad, m]."""
        return self.screened()[self.index][1]

    @property
    def gap(self) -> float:
        """The largest of the mechanism [m]."""
        return self.screened()[self.index][2]

    @property
    def length(self) -> float:
        """Of the way, joints in units of `joint_scale`."""
        steps = np.diff(self.way, axis=0) / joint_scale(self.arm)
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def rank(self) -> tuple[float, float, float]:
        """The less the better: what leaves the limits, then the gap, and where there is none, the length of the way."""
        return max(self.excess, LIMIT_TOLERANCE), max(self.gap, _NO_GAP), self.length

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


def certified(problem: PlanningProblem, options: CertifiedOptions) -> Plan:
    """Draw certified networks for the target and keep the one with the smallest mechanism gap within the limits.

    Where no network has a gap, as on arms whose links have six freedoms, the one with the shortest way is kept.

    Raises:
        NotCertifiedError: no candidate could be certified.
        PlanError: every candidate breaks a limit; the message is of the best one.
    """
    # Threads would wait for each other in products of so small matrices.
    with one_blas_thread():
        return _certified(problem, options)


def _certified(problem: PlanningProblem, options: CertifiedOptions) -> Plan:
    rng, total = np.random.default_rng(problem.seed), options.candidates
    xi = problem.arm.encode(problem.target)
    networks: list[LieEDNN] = []
    message = ""
    one_screw = all(joint.screw is not None for joint in problem.arm.joints.joints)
    few = min(options.first, total) if one_screw else total
    if one_screw and options.bias_magnitudes == BIAS_MAGNITUDES:
        options = replace(options, bias_magnitudes=_STRAIGHT)
    magnitudes = list(options.magnitudes())
    for begin, end in ((0, few), (few, total)):
        if begin == end:
            continue
        for first in range(begin, end, _AT_ONCE):
            drawn = _drawn(xi, magnitudes[first : min(first + _AT_ONCE, end)], options, rng)
            for number, result in enumerate(drawn, first + 1):
                if result.network is None:
                    message = result.message
                else:
                    networks.append(result.network)
                if problem.progress is not None:
                    problem.progress(number, total)
        if not networks and end == total:
            # Patience only where everything else failed: easy candidates are many, hard ones cost seconds.
            last = synthesize(
                xi, bias=options.bias, bias_magnitude=magnitudes[-1], seed=rng, max_attempts=options.last_attempts
            )
            message, networks = last.message, [last.network] if last.network else []
        if networks:
            try:
                return _plan(problem, options, networks, end)
            except PlanError:
                if end == total:
                    raise
    raise NotCertifiedError(f"none of {total} candidates for the target could be certified; the last one: {message}")


def _drawn(xi: Floats, magnitudes: list[float], options: CertifiedOptions, rng: np.random.Generator) -> list[Synthesis]:
    """Networks for the target ``xi``, one for each magnitude of the bias."""
    if len(magnitudes) == 1:
        return [
            synthesize(xi, bias=options.bias, bias_magnitude=magnitudes[0], seed=rng, max_attempts=options.attempts)
        ]
    return synthesize_many(
        np.broadcast_to(xi, (len(magnitudes), *xi.shape)),
        bias=options.bias,
        bias_magnitude=magnitudes,
        seed=rng,
        max_attempts=options.attempts,
    )


def _plan(problem: PlanningProblem, options: CertifiedOptions, networks: list[LieEDNN], drawn: int) -> Plan:
    """The plan of the best network; errors as of `certified`."""
    arm, start = problem.arm, problem.start
    screen = functools.cache(lambda: _screened(arm, networks, start))
    found = [_Candidate(arm, network, start, index, screen) for index, network in enumerate(networks)]
    # Networks and their ways do not depend on the duration.
    network, motion = in_time(_best, problem, options, found)
    # The motion has been checked.
    within = sum(candidate.network is network or candidate.excess <= LIMIT_TOLERANCE for candidate in found)
    return Plan(motion, network, drawn, within)


def _best(problem: PlanningProblem, options: CertifiedOptions, found: list[_Candidate]) -> tuple[LieEDNN, Motion]:
    """The first of the `_promising` networks whose motion the arm can make; errors as of `certified`."""
    arm = problem.arm
    # Where no motion at all could be fast enough, one refusal tells as much as all of them.
    hurried = problem.duration <= _HURRIED * least_duration(arm, problem.start, problem.target)
    refusals: list[PlanError] = []
    for candidate in _promising(found):
        if refusals and (candidate.touches or candidate.excess > options.hopeless_excess):
            break
        try:
            motion = timed_motion(problem, candidate.path)
        except PlanError as error:
            refusals.append(error)
            if hurried or len(refusals) == options.tried:
                break
            continue
        return candidate.network, motion
    message = f"{refusals[0]} (best of {options.candidates} candidates)"
    if isinstance(refusals[0], TooFastError):
        raise TooFastError(message, refusals[0].duration)
    raise PlanError(f"{message}; try more candidates, another seed, a larger bias magnitude or the solved bias")


def _promising(found: list[_Candidate]) -> Iterator[_Candidate]:
    """Those whose way touches nothing first, of these the best by `_Candidate.rank`.

    Contact is looked for posture by posture, which costs more than all else, so only when a candidate's turn has come.
    """
    if len(found) == 1:
        # Its turn comes whatever is seen on its way.
        yield found[0]
        return
    touching = []
    for candidate in sorted(found, key=lambda one: one.rank):
        if candidate.touches:
            touching.append(candidate)
        else:
            yield candidate
    yield from touching


def rough_ways(networks: list[LieEDNN], start: Floats) -> list[Floats]:
    """States ``(K, n, 6)`` from ``start`` ``(n, 6)`` of each network, roughly integrated, to look at first.

    The networks have no hidden neurons, and one decay rate.
    """
    return states_side_by_side(networks, start, 20.0 / networks[0].gamma, rtol=1e-4, atol=1e-6)


def _screened(arm: Arm, networks: list[LieEDNN], start: Floats) -> list[tuple[Floats, float, float]]:
    """Roughly integrated ways as postures, with their largest excess over the position limits and largest gap."""
    state = arm.encode(start)
    runs = rough_ways(networks, state)
    # All side by side, the shorter ones waiting at their ends: a retraction without closed form costs nearly as much
    # for one state as for a hundred.
    length = max(map(len, runs))
    side_by_side = np.stack([run[np.minimum(np.arange(length), len(run) - 1)] for run in runs], axis=1)
    decoded = arm.decode(side_by_side, start=start)
    excess = arm.limit_excess(decoded.q).max(axis=(0, -1))
    gap = (decoded.gap_translation.max(axis=-1) + arm.length_scale * decoded.gap_rotation.max(axis=-1)).max(axis=0)
    return [(decoded.q[: len(run), k], float(excess[k]), float(gap[k])) for k, run in enumerate(runs)]
