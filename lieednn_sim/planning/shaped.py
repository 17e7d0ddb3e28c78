"""A certified network shaped after the motion of a teacher.

The teacher is the best of a few quick motions (`teachers`). It is encoded as a start of the arm's universal network
(`synthesis.CurveEncoder`); where that does not follow it closely enough, a network is shaped by `synthesis.shape`. The
motion follows the network's path by the teacher's time law. It is proved that the network ends at the target from every
start; its distance from the teacher's path, limits and clearance are only checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import KDTree

from lieednn_sim.arm import Arm
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.encoded_path import EncodedPath
from lieednn_sim.planning.kept import check_kept, outside
from lieednn_sim.planning.motion import Motion, rms_jerk
from lieednn_sim.planning.network_path import NetworkPath, checked_motion, timed_motion
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.planning.teachers import TeacherOptions, best_teacher
from lieednn_sim.planning.time_laws import law_of
from lieednn_sim.synthesis import CurveEncoder, ShapingOptions, shape
from lieednn_sim.values import Floats, frozen

_TEACHER = TeacherOptions()
# Every second sample of the teacher's motion is a sample of the curve.
_STRIDE = 2
# Samples of a network's motion at which it is compared with the teacher's.
_N_COMPARED = 400
# Configurations at which lever arms are measured.
_N_CONFIGURATIONS = 50


@dataclass(frozen=True)
class ShapedOptions(NetworkOptions):
    """Options of the planner ``lieednn-shaped``.

    Attributes:
        deviation: deviation of the end effector's path from the teacher's up to which a network is accepted at once
            [m].
        jerk: joint jerk, relative to the teacher's, up to which a network is accepted at once.
        largest_deviation: deviation up to which the best network is accepted if none is accepted at once [m].
        rate: rho of the hidden neurons' clock (`ShapingOptions`): with 1 the network is as fast as the arm; with less
            it returns to its path after a push.
        teachers: largest number of teachers' motions to try until a network follows one, each from the next seed;
            minimum jerk is tried once.
        encoded: whether to encode the motion in the universal network of the arm first (`synthesis.CurveEncoder`),
            whose rate is 1; with another rate a network is shaped at once.
        neurons: numbers of hidden neurons of networks to shape where the universal network does not suffice, tried in
            turn until the motion is near, smooth, and keeps limits and clearance.
        teacher: how the teacher's motion is found.

    Raises:
        InputError: a value is out of range.
    """

    deviation: float = 7e-4
    jerk: float = 1.03
    largest_deviation: float = 5e-3
    rate: float = field(default=1.0, metadata={"range": (0.01, 1.0)})
    teachers: int = 1
    encoded: bool = True
    neurons: tuple[int, ...] = field(default=(8, 16, 32, 64), metadata={"range": (2, 256)})
    teacher: TeacherOptions = _TEACHER


@frozen
class ShapedDetails:
    """Further results of the planner ``lieednn-shaped``.

    Attributes:
        deviation: largest distance of the end effector's path from the teacher's [m].
        fit_time: CPU time of the encoding and the shaping [s].
        encoded: whether the network is the universal one, with a code, and not a shaped one.
        encoding_time: CPU time of the encoding alone [s].
    """

    deviation: float
    fit_time: float
    encoded: bool = False
    encoding_time: float = 0.0


def shaped(problem: PlanningProblem, options: ShapedOptions) -> Plan:
    """A network shaped after the motion of the best teacher.

    Raises:
        LieEDNNError: OMPL is needed but not installed.
        PlanError: no teacher finds a motion, or no network follows it closely enough.
    """
    for attempt in range(options.teachers):
        teacher = best_teacher(replace(problem, seed=problem.seed + attempt), options.teacher)
        try:
            return _following(problem, options, teacher)
        except PlanError:
            # Minimum jerk does not depend on the seed.
            if attempt + 1 == options.teachers or teacher.planner == "minimum-jerk":
                raise
    raise AssertionError("options.teachers is at least one")


def _following(problem: PlanningProblem, options: ShapedOptions, teacher: Plan) -> Plan:
    """A network shaped after a teacher's motion."""
    guide, arm = teacher.motion, problem.arm
    units = lever_units(arm, guide.q)
    lasts = float(guide.t[-1])
    # The teacher's duration, which may be longer than the problem's.
    asked = replace(problem, duration=lasts, max_time_scale=max(1.0, problem.max_time_scale * problem.duration / lasts))
    if np.abs(guide.xi - guide.xi[0]).max() == 0.0:
        network = without_weights(guide.xi_target)
        path = NetworkPath.integrate(arm, network, problem.start)
        return Plan(in_time(timed_motion, asked, path), network, ShapedDetails(0.0, 0.0), teacher=teacher)
    law = law_of(guide, units)
    curve = np.concatenate([guide.xi[:-1:_STRIDE], guide.xi_target[None]])
    line, guide_jerk = arm.tip(guide.q[::_STRIDE]), rms_jerk(arm, guide)
    fit_time, encoding_time, refusal, left = 0.0, 0.0, "no number of neurons was allowed", list[_Fitted]()

    def planned(candidate: _Fitted) -> Plan | None:
        nonlocal refusal
        path, deviation = candidate.path, candidate.deviation

        def timely(problem: PlanningProblem) -> Motion:
            if problem.duration == lasts:
                return checked_motion(problem, candidate.motion)
            return timed_motion(problem, path, law)

        try:
            motion = in_time(timely, asked)
            check_kept(arm, problem.keep, motion)
        except PlanError as error:
            refusal = str(error)
            return None
        details = ShapedDetails(deviation, fit_time, isinstance(path, EncodedPath), encoding_time)
        return Plan(motion, path.network, details, teacher=teacher)

    def paths() -> Iterator[NetworkPath]:
        nonlocal fit_time, encoding_time, refusal
        if options.encoded and options.rate == 1.0:
            try:
                encoder = CurveEncoder(arm.n_links, options.activation)
                begun = cpu_time()
                encoded = encoder.encode(curve, units)
            except InputError as error:
                refusal = str(error)
            else:
                encoding_time = fit_time = cpu_time() - begun
                yield EncodedPath.follow(arm, encoder, encoded, guide, units)
        for count in options.neurons:
            shaping = ShapingOptions(options.rate, neurons=(), placed_neurons=(count,), activation=options.activation)
            result = shape(curve, options.deviation, units=units, options=shaping)
            fit_time += result.cpu_time
            yield NetworkPath.integrate(arm, result.network, problem.start, units)

    for path in paths():
        motion = path.timed(lasts, problem.timestep, law)
        some = motion.q[:: max(1, len(motion.q) // _N_COMPARED)]
        deviation, jerk = _deviation(arm.tip(some), line), rms_jerk(arm, motion) / guide_jerk
        badness = max(deviation / options.deviation, (jerk - 1.0) / (options.jerk - 1.0))
        if problem.keep is not None:
            badness = max(badness, outside(arm, problem.keep, some))
        candidate = _Fitted(badness, path, motion, deviation)
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
    """A network's path and motion; their badness, of which at most 1 is accepted at once, and deviation [m]."""

    badness: float
    path: NetworkPath
    motion: Motion
    deviation: float


def lever_units(arm: Arm, q: Floats) -> Floats:
    """Metres ``(N, 6)`` for one unit of each network coordinate along joint positions ``(K, n)``.

    For rotations, the longest lever arm from the frame of rotation to the end effector; for translations, the length
    scale.
    """
    some = q[:: max(1, len(q) // _N_CONFIGURATIONS)]
    lever = np.linalg.norm(arm.tip_in_frames(some), axis=-1).max(axis=0)
    units = np.empty((arm.n_links, 6))
    units[:, :3], units[:, 3:] = lever[:, None], arm.length_scale
    return units


def _deviation(path: Floats, line: Floats) -> float:
    """Largest distance of a path ``(K, 3)`` from a polyline ``(L, 3)`` [m], near its nearest vertices."""
    _, nearest = KDTree(line, compact_nodes=False, balanced_tree=False).query(path)
    off = np.full(len(path), np.inf)
    for first in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(line) - 2)):
        step, away = line[first + 1] - line[first], path - line[first]
        fraction = np.einsum("ki,ki->k", away, step) / np.maximum(np.einsum("ki,ki->k", step, step), 1e-300)
        off = np.minimum(off, np.linalg.norm(away - np.clip(fraction, 0.0, 1.0)[:, None] * step, axis=1))
    return float(off.max())
