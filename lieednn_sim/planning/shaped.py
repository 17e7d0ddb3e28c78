"""The LieEDNN that follows a good motion: a teacher finds the path, a certified cascade of neurons is shaped after it.

The teacher is minimum jerk where that touches nothing, else trajectory optimisation from there, else trajectory
optimisation from what RRT-Connect finds, else that itself. Its path is fitted by `synthesis.shape`, and the network's
motion runs through it by the teacher's own law of time. What is proved is where the network ends, for every start; how
near it comes to the path is measured, as is all else that a motion keeps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.spatial import KDTree

from lieednn_sim.arm import Arm
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.baselines import interpolation, optimisation, sampling
from lieednn_sim.planning.baselines.optimisation import OptimisationOptions
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.laws import law_of
from lieednn_sim.planning.motion import Motion, rms_jerk
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.synthesis import ShapingOptions, shape
from lieednn_sim.values import Floats, frozen

# From one guess: where it fails a path of RRT-Connect is a better one than any that is drawn.
# It keeps a little from the joints' limits, which a network that is a little off it would break.
_OPTIMISATION = OptimisationOptions(guesses=1, evaluations=12, inset=0.01)
_RRT = RrtConnectOptions()
# Every second sample of the teacher's motion is a sample of the curve.
_STRIDE = 2
# Samples of a network's motion at which it is compared with the teacher's.
_COMPARED = 400
# Postures at which lever arms are looked at.
_POSTURES = 50


@dataclass(frozen=True)
class ShapedOptions(PlannerOptions):
    """Options of the planner ``lieednn-shaped``.

    Attributes:
        deviation: of the end effector's path from the teacher's, with which a network is taken at once [m].
        jerk: of the joints, over the teacher's, with which a network is taken at once.
        largest_deviation: with which a network is taken when none is as near, the best one first [m].
        rate: rho of the hidden neurons' clock, see `ShapingOptions`: with 1 the network is as fast as the arm, with
            less it returns to its path after a push.
        teachers: motions that are asked for at most, until a network follows one: of RRT-Connect other paths, each
            drawn with the next seed.
        neurons: numbers of hidden ones, tried one after another until the motion is near, smooth, and keeps limits and
            clearance.
        optimised: whether teachers optimise, which takes long among many things; without, RRT-Connect's motion is
            followed as it is where minimum jerk touches something.
        optimisation: of the teacher that is asked where minimum jerk touches something, and of RRT-Connect's paths.
        search: of RRT-Connect, which is asked where that fails.

    Raises:
        InputError: a value is out of range.
    """

    deviation: float = 7e-4
    jerk: float = 1.03
    largest_deviation: float = 5e-3
    rate: float = field(default=1.0, metadata={"range": (0.01, 1.0)})
    teachers: int = 1
    neurons: tuple[int, ...] = field(default=(8, 16, 32, 64), metadata={"range": (2, 256)})
    optimised: bool = True
    optimisation: OptimisationOptions = _OPTIMISATION
    search: RrtConnectOptions = _RRT


def shaped(problem: PlanningProblem, options: ShapedOptions) -> Plan:
    """A network shaped after the first teacher's motion that can be made.

    Raises:
        LieEDNNError: OMPL is needed, and not installed.
        PlanError: no teacher finds a motion, or no network follows it closely enough.
    """
    for attempt in range(options.teachers):
        teacher = _teacher(replace(problem, seed=problem.seed + attempt), options)
        try:
            return _following(problem, options, teacher)
        except PlanError:
            # The others are the same with any seed.
            if attempt + 1 == options.teachers or not teacher.planner.startswith("rrt-connect"):
                raise
    raise AssertionError("options.teachers is at least one")


def _following(problem: PlanningProblem, options: ShapedOptions, teacher: Plan) -> Plan:
    """A network shaped after a teacher's motion."""
    guide, arm = teacher.motion, problem.arm
    units = lever_units(arm, guide.q)
    lasts = float(guide.t[-1])
    # As long as the teacher's, which may have asked for more time already.
    asked = replace(problem, duration=lasts, longest=max(1.0, problem.longest * problem.duration / lasts))
    if np.abs(guide.xi - guide.xi[0]).max() == 0.0:
        network = without_weights(guide.xi_target)
        path = NetworkPath.drawn(arm, network, problem.start)
        return Plan(in_time(timed_motion, asked, path), network, teacher=teacher, deviation=0.0)
    law = law_of(guide, units)
    curve = np.concatenate([guide.xi[:-1:_STRIDE], guide.xi_target[None]])
    line, guide_jerk = _effector(arm, guide), rms_jerk(arm, guide)
    fit_time, refusal, left = 0.0, "no number of neurons was allowed", list[_Fitted]()

    def planned(candidate: _Fitted) -> Plan | None:
        nonlocal refusal
        path, deviation = candidate.path, candidate.deviation
        try:
            motion = in_time(timed_motion, asked, path, law)
        except PlanError as error:
            refusal = str(error)
            return None
        return Plan(motion, path.network, teacher=teacher, deviation=deviation, fit_time=fit_time)

    for count in options.neurons:
        shaping = ShapingOptions(options.rate, neurons=(), placed=(count,))
        result = shape(curve, options.deviation, units=units, options=shaping)
        fit_time += result.seconds
        path = NetworkPath.drawn(arm, result.network, problem.start, units)
        motion = path.timed(lasts, lasts / _COMPARED, law)
        deviation, jerk = _deviation(_effector(arm, motion), line), rms_jerk(arm, motion) / guide_jerk
        candidate = _Fitted(max(deviation / options.deviation, (jerk - 1.0) / (options.jerk - 1.0)), path, deviation)
        if candidate.badness <= 1.0:
            if made := planned(candidate):
                return made
        elif deviation <= options.largest_deviation:
            left.append(candidate)
        else:
            refusal = f"the end effector would be {1e3 * deviation:.2g} mm off the teacher's path"
    for candidate in sorted(left, key=lambda one: one.badness):
        if made := planned(candidate):
            return made
    raise PlanError(f"no network follows the motion of {teacher.planner} closely enough: {refusal}")


@frozen
class _Fitted:
    """A network's path along the teacher's: how bad it is in units of what is allowed, and how far it is off [m]."""

    badness: float
    path: NetworkPath
    deviation: float


def _teacher(problem: PlanningProblem, options: ShapedOptions) -> Plan:
    """The motion of the first planner that finds one, by that planner's name."""
    optimised = partial(in_time, optimisation.trajectory_optimisation, problem, options.optimisation)
    refusals = []

    def asked(name: str, solve: Callable[[], Motion]) -> Plan | None:
        try:
            begun = cpu_time()
            return Plan(solve(), target=problem.target, planner=name, cpu_time=cpu_time() - begun)
        except PlanError as error:
            refusals.append(f"{name}: {error}")
            return None

    found = asked("minimum-jerk", lambda: in_time(interpolation.minimum_jerk, problem))
    if found is None and options.optimised:
        found = asked("trajectory-optimisation", optimised)
    if found is None and (path := asked("rrt-connect", lambda: sampling.rrt_connect(problem, options.search))):
        found = (options.optimised and asked("rrt-connect, optimised", lambda: optimised(path.motion))) or path
    if found is None:
        raise PlanError(f"no teacher finds a motion; {'; '.join(refusals)}")
    return found


def lever_units(arm: Arm, q: Floats) -> Floats:
    """Metres ``(N, 6)`` for one unit of each network coordinate along postures ``(K, n)``.

    For a rotation that is the longest lever arm, from the frame that it turns about to the end effector; for a
    translation the length scale.
    """
    postures = q[:: max(1, len(q) // _POSTURES)]
    frames = arm.link_poses(postures).as_matrix()[..., :3, 3]
    before = np.concatenate([np.broadcast_to(arm.base.as_matrix()[:3, 3], frames[:, :1].shape), frames[:, :-1]], axis=1)
    lever = np.linalg.norm(frames[:, -1:] - before, axis=-1).max(axis=0)
    units = np.empty((arm.n_links, 6))
    units[:, :3], units[:, 3:] = lever[:, None], arm.length_scale
    return units


def _effector(arm: Arm, motion: Motion) -> Floats:
    """Positions ``(K, 3)`` of the end effector [m]."""
    return np.asarray(arm.link_poses(motion.q).as_matrix()[:, -1, :3, 3])


def _deviation(path: Floats, line: Floats) -> float:
    """Largest distance of a path ``(K, 3)`` from a line ``(L, 3)`` [m], to the nearest of its samples' pieces."""
    _, nearest = KDTree(line).query(path)
    off = np.full(len(path), np.inf)
    for first in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(line) - 2)):
        step, away = line[first + 1] - line[first], path - line[first]
        share = np.einsum("ki,ki->k", away, step) / np.maximum(np.einsum("ki,ki->k", step, step), 1e-300)
        off = np.minimum(off, np.linalg.norm(away - np.clip(share, 0.0, 1.0)[:, None] * step, axis=1))
    return float(off.max())
