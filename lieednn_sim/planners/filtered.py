"""The LieEDNN with limits and clearance enforced while it runs, for scenes with obstacles.

Certified networks are drawn for the target; those whose own motion stays clearest of obstacles run through the filter
first. Where the filter blocks them, which sees no further than the next step, a search finds intermediate postures, and
the network is retargeted on the way: its bias makes it arrive at one after the other and then at the target, with the
same weights and the same certificate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import InputError, NotCertifiedError, PlanError
from lieednn_sim.filtering import FilteredRun, FilterOptions, run_filtered
from lieednn_sim.motion import Motion, check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.planners.problem import PlanningProblem
from lieednn_sim.planners.waypoints import find_waypoints
from lieednn_sim.planning import BIAS_MAGNITUDES
from lieednn_sim.synthesis import synthesize

Floats = NDArray[np.float64]

# A motion takes at most this many of the problem's durations.
LONGEST = 3.0

_CANDIDATES, _TRIED = 12, 1
_ATTEMPTS = 3
# Samples of a motion that are looked at before the filter runs.
_LOOKS = 40
# Searches for intermediate postures.
_SEARCHES = 3
# A control step is the whole number of the model's steps next to this [s].
_CONTROL_STEP = 0.01
# The last difference to the target is closed in this time [s].
_CLOSING = 0.1
# Geoms that the filter lets approach by a share of their distance do not touch within a step from here [m].
_NEAR, _OWN_NEAR = 0.03, 0.003


@dataclass(frozen=True)
class _Candidate:
    network: LieEDNN
    unsafe: float


def filtered(problem: PlanningProblem) -> tuple[LieEDNN, Motion]:
    """The first motion that arrives; it may take up to `LONGEST` times the problem's duration.

    Raises:
        NotCertifiedError: no network could be certified.
        PlanError: no run arrived; the message says what blocked the most promising one.
    """
    collisions = Collisions(problem.arm)
    refusals: list[str] = []
    drawn: list[_Candidate] = []
    for candidate in _candidates(problem, collisions):
        drawn.append(candidate)
        if candidate.unsafe == 0.0:
            motion = _attempt(problem, collisions, candidate.network, [problem.target], refusals)
            if motion is not None:
                return candidate.network, motion
    if not drawn:
        raise NotCertifiedError(f"none of {_CANDIDATES} candidates for the target could be certified and followed")
    drawn.sort(key=lambda candidate: candidate.unsafe)
    for candidate in drawn[:_TRIED]:
        motion = _attempt(problem, collisions, candidate.network, [problem.target], refusals)
        if motion is not None:
            return candidate.network, motion
    rng = np.random.default_rng([problem.seed, 1])
    for candidate in drawn[:_SEARCHES]:
        postures = find_waypoints(collisions, problem.start, problem.target, seed=rng)
        if not postures:
            continue
        motion = _attempt(problem, collisions, candidate.network, [*postures, problem.target], refusals)
        if motion is not None:
            return candidate.network, motion
    raise PlanError(f"no run through the filter arrived; the most promising: {refusals[0]}")


def _candidates(problem: PlanningProblem, collisions: Collisions) -> Iterator[_Candidate]:
    """Certified networks for the target, with how their own motion fares among the obstacles."""
    arm, rng = problem.arm, np.random.default_rng(problem.seed)
    xi, margins = arm.encode(problem.target), FilterOptions()
    for index in range(_CANDIDATES):
        magnitude = BIAS_MAGNITUDES[index % len(BIAS_MAGNITUDES)]
        network = synthesize(
            xi, bias="sign-matched", bias_magnitude=magnitude, seed=rng, max_attempts=_ATTEMPTS
        ).network
        if network is None:
            continue
        try:
            motion = make_motion(arm, network, problem.start, problem.duration, problem.duration / _LOOKS)
        except PlanError:
            continue
        kept = [
            arm.limit_excess(q).max() <= 0.0 and collisions.free(q, margins.margin, own=margins.own_margin)
            for q in motion.q[1:-1]
        ]
        yield _Candidate(network, 1.0 - float(np.mean(kept)))


def _attempt(
    problem: PlanningProblem, collisions: Collisions, network: LieEDNN, goals: list[Floats], refusals: list[str]
) -> Motion | None:
    """The motion through the filter by way of the goals, or None and the reason."""
    arm, at = problem.arm, problem.start
    ratio = max(round(_CONTROL_STEP / problem.timestep), 1)
    lengths = np.array([np.ptp(np.stack(pair), axis=0) for pair in zip([at, *goals[:-1]], goals, strict=True)])
    shares = (lengths / (arm.position_limits[:, 1] - arm.position_limits[:, 0])).max(axis=1)
    shares = np.maximum(shares / max(shares.sum(), 1e-12), 0.2)
    legs = []
    try:
        for goal, share in zip(goals, shares / shares.sum(), strict=True):
            run = run_filtered(
                arm,
                network if goal is problem.target else network.retarget(arm.encode(goal)),
                at,
                problem.duration * float(share),
                timestep=ratio * problem.timestep,
                longest=LONGEST,
            )
            if not run.success:
                refusals.append(run.message)
                return None
            legs.append(_sampled(run, goal, ratio, problem.timestep))
            at = goal
        motion = _joined(legs, arm.encode(problem.target))
        check_motion(arm, motion)
        _check_clearance(arm, collisions, motion, ratio)
    except (PlanError, InputError) as error:
        refusals.append(str(error))
        return None
    return motion


def _sampled(run: FilteredRun, goal: Floats, ratio: int, step: float) -> Motion:
    """A run at the model's time step, and the rest of the way to where its network ends."""
    h = ratio * step
    fraction = (np.arange(ratio) / ratio)[:, None]
    change = np.diff(run.qd, axis=0)[:, None]
    # Between control steps the acceleration is constant.
    qd = (run.qd[:-1, None] + fraction * change).reshape(-1, run.q.shape[1])
    q = (run.q[:-1, None] + h * fraction * run.qd[:-1, None] + 0.5 * h * fraction**2 * change).reshape(qd.shape)
    closing_q, closing_qd = _closing(run.q[-1], run.qd[-1], goal, step)
    q, qd = np.concatenate([q, closing_q]), np.concatenate([qd, closing_qd])
    t = step * np.arange(len(q), dtype=np.float64)
    reference = run.reference
    clock = np.interp(t, run.t, run.clock)

    def along(values: Floats) -> Floats:
        position = np.clip(np.searchsorted(reference.t, clock, side="right") - 1, 0, len(reference.t) - 2)
        share = ((clock - reference.t[position]) / np.diff(reference.t)[position]).reshape(
            -1, *(1,) * (values.ndim - 1)
        )
        return np.asarray((1.0 - share) * values[position] + share * values[position + 1])

    names = ("tau", "xi", "gap_translation", "gap_rotation")
    tau, xi, *gaps = (along(getattr(reference, name)) for name in names)
    return Motion(t, tau, xi, reference.xi_target, q, qd, *gaps)


def _closing(q: Floats, qd: Floats, goal: Floats, step: float) -> tuple[Floats, Floats]:
    """From nearly at rest near the goal to rest at the goal, by the quintic whose accelerations vanish at both ends."""
    count = max(round(_CLOSING / step), 2)
    s = (np.arange(count + 1) / count)[:, None]
    length = count * step
    ease, slope = s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2
    # Position and slope of the quintic with unit slope at s = 0 and zeros else.
    start, start_slope = s * (1.0 - s) ** 3 * (1.0 + 3.0 * s), (1.0 - s) ** 2 * (1.0 + 2.0 * s - 15.0 * s**2)
    way = goal - q
    positions = q + ease * way + length * start * qd
    rates = slope * way / length + start_slope * qd
    positions[-1], rates[-1] = goal, 0.0
    return positions, rates


def _joined(legs: list[Motion], xi_target: Floats) -> Motion:
    """Legs one after another, each from where the one before came to rest."""
    arrays: dict[str, list[Floats]] = {name: [] for name in vars(legs[0]) if name != "xi_target"}
    t, tau = 0.0, 0.0
    for number, leg in enumerate(legs):
        for name, parts in arrays.items():
            values = getattr(leg, name) + (t if name == "t" else tau if name == "tau" else 0.0)
            # The first sample of a leg is the last of the one before.
            parts.append(values[min(number, 1) :])
        t, tau = t + leg.t[-1], tau + leg.tau[-1]
    return Motion(xi_target=xi_target, **{name: np.concatenate(parts) for name, parts in arrays.items()})


def _check_clearance(arm: Arm, collisions: Collisions, motion: Motion, ratio: int) -> None:
    """Raise `PlanError` where any sample of the motion touches something."""
    for first in range(0, len(motion.t), ratio):
        if collisions.free(motion.q[first], _NEAR, own=_OWN_NEAR):
            continue
        for k in range(max(first - ratio, 0), min(first + ratio, len(motion.t))):
            distance, pair = collisions.nearest(motion.q[k]) if not collisions.free(motion.q[k]) else (np.inf, (0, 0))
            if distance <= 0.0:
                names = collisions.names(pair)
                raise PlanError(f"{names[0]!r} would touch {names[1]!r} at t = {motion.t[k]:.2f} s")
