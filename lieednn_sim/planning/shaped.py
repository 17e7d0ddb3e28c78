"""A certified network shaped after the motion of a guide.

The guide is the best of a few quick motions (`guides`). It is encoded as an initial state of the arm's universal
network (`synthesis.CurveEncoder`); if its path is too long for a code, or the clock rate is below 1, a network of its
own is shaped (`synthesis.shape`). The motion follows the network's path with the guide's time law. It is proved that
the network ends at the target from every start; distance from the guide's path, limits and clearance are only checked.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.guides import GuideOptions, followed
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.path_constraints import check_path_constraint
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.planning.time_laws import law_of, retime
from lieednn_sim.synthesis import CurveEncoder, ShapingOptions, shape
from lieednn_sim.synthesis.shaping.encoder import STRENGTH
from lieednn_sim.values import Floats, frozen

# Strengths of universal networks; the second encodes curves that are fifty times as long or as sharply bent.
_STRENGTHS = (STRENGTH, 4000.0)
_PIECES = 250  # pieces of the guide's path, at whose ends the deviation is measured


@dataclass(frozen=True)
class ShapedOptions(NetworkOptions):
    """Options of the planner ``lieednn-shaped``.

    Attributes:
        deviation: largest deviation of the end effector's path from the guide's [m].
        rate: rho of the network's clock (`ShapingOptions`). With 1 the motion is encoded in the arm's universal network
            (`synthesis.CurveEncoder`), which is as fast as the arm; a motion too long or too sharply bent for that gets
            a network of its own. With less than 1, a network is shaped that returns to its path after a push.
        guides: largest number of seeds, from the problem's on, whose guides are tried until a network follows one.
        neurons: numbers of hidden neurons tried in turn for a network of its own, until it keeps 0.2 of the deviation.
        guide: how the guide's motion is found.
    """

    deviation: float = 5e-3
    rate: float = field(default=1.0, metadata={"range": (0.01, 1.0)})
    guides: int = 1
    neurons: tuple[int, ...] = field(default=(8, 16, 32, 64), metadata={"range": (2, 256)})
    guide: GuideOptions = field(default=GuideOptions())


@frozen
class ShapedDetails:
    """Further results of the planner ``lieednn-shaped``.

    Attributes:
        deviation: largest distance of the end effector's path from the guide's [m].
        fit_time: CPU time of the encoding or the shaping [s].
    """

    deviation: float
    fit_time: float


def shaped(problem: PlanningProblem, options: ShapedOptions) -> Plan:
    """A network shaped after the motion of the best guide.

    Raises:
        LieEDNNError: OMPL is needed but not installed.
        PlanError: no guide finds a motion, or no network follows it closely enough.
    """
    return followed(problem, options.guide, partial(followed_guide, problem, options), options.guides)


def followed_guide(problem: PlanningProblem, options: ShapedOptions, guide: Plan) -> Plan:
    """A network shaped after a guide's motion; raises `PlanError` as `shaped`."""
    given, arm, lasts = guide.motion, problem.arm, float(guide.motion.t[-1])
    # The guide's duration, which may be longer than the problem's.
    asked = problem if lasts == problem.duration else replace(problem, duration=lasts)
    if np.abs(given.xi - given.xi[0]).max() < 1e-14:
        network = without_weights(given.xi_target)
        path = NetworkPath.integrate(arm, network, problem.start)
        return Plan(in_time(timed_motion, asked, path), network, ShapedDetails(0.0, 0.0), guide=guide)
    tips = arm.tip_in_frames(given.q[given.ends(_PIECES)])
    units, start = lever_units(arm, given.q, tips), cpu_time()
    network, encoded = _network(arm, options, np.concatenate([given.xi[:-1:2], given.xi_target[None]]), units)
    fit_time = cpu_time() - start
    if encoded:
        path = NetworkPath.encoded(arm, network, given, units)
    else:
        path = NetworkPath.integrate(arm, network, problem.start, units)
    if fastest := options.guide.search.fastest:
        motion = path.timed(lasts, problem.timestep, law_of(given, units))
    else:
        motion = in_time(timed_motion, asked, path, law_of(given, units))
    deviation = _deviation(arm.tip_in_frames(motion.q[motion.ends(_PIECES)])[:, 0], tips[:, 0])
    if deviation > options.deviation:
        raise PlanError(
            f"the end effector would be {1e3 * deviation:.2g} mm off its path, {1e3 * options.deviation:.2g} mm allowed"
        )
    motion = retime(arm, motion) if fastest else motion
    check_path_constraint(arm, problem.path_constraint, motion)
    return Plan(motion, path.network, ShapedDetails(deviation, fit_time), guide=guide)


def _network(arm: Arm, options: ShapedOptions, curve: Floats, units: Floats) -> tuple[LieEDNN, bool]:
    """A network along a curve ``(K, N, 6)``, given the `lever_units`, and whether it is the universal one."""
    if options.rate == 1.0:
        # The encoder refuses curves that are too long or too sharply bent for a code.
        for strength in _STRENGTHS:
            with suppress(InputError):
                return CurveEncoder(arm.n_links, options.activation, strength).encode(curve, units), True
    shaping = ShapingOptions(options.rate, options.neurons, options.activation)
    # The deviation allowed is the end effector's, but this one is that of all links. Less than a fifth would take more
    # neurons, and up to 1.3 times the jerk at a rate of 0.1.
    return shape(curve, 0.2 * options.deviation, units=units, options=shaping).network, False


def lever_units(arm: Arm, q: Floats, tips: Floats | None = None) -> Floats:
    """Metres ``(N, 6)`` for one unit of each network coordinate along joint positions ``(K, n)``.

    For rotations they are the longest lever arm from the frame of rotation to the end effector (``tips`` of
    `Arm.tip_in_frames` may be given); for translations, the length scale.
    """
    tips = arm.tip_in_frames(q[:: max(1, len(q) // 50)]) if tips is None else tips
    lever = np.sqrt(np.einsum("knj,knj->kn", tips, tips).max(axis=0))
    units = np.empty((arm.n_links, 6))
    units[:, :3], units[:, 3:] = lever[:, None], arm.length_scale
    return units


def _deviation(path: Floats, line: Floats) -> float:
    """Largest distance [m] of a path ``(K, 3)`` from the segments of a polyline ``(L, 3)`` around the same time."""
    nearest = np.linspace(0, len(line) - 1, len(path)).round().astype(int)
    off = np.full(len(path), np.inf)
    for first in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(line) - 2)):
        step, away = line[first + 1] - line[first], path - line[first]
        fraction = np.einsum("ki,ki->k", away, step) / np.maximum(np.einsum("ki,ki->k", step, step), 1e-300)
        off = np.minimum(off, np.linalg.norm(away - np.clip(fraction, 0.0, 1.0)[:, None] * step, axis=1))
    return float(off.max())
