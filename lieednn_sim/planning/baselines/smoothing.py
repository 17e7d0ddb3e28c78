"""Path smoothing: from a polyline in joint space to a motion along a B-spline, timed by minimum jerk.

The control points of a clamped quintic B-spline are spaced evenly along the polyline. Each point of the curve lies in
the convex hull of six neighbouring ones: within the joint limits, which are convex, and on the polyline itself except
near its corners. With more control points the curve is closer to the corners. It is followed more slowly where it
bends, so accelerations stay bounded; they are continuous, since the curvature has a continuous derivative. If even the
closest curve touches something, the polyline itself is followed, with a stop at every corner.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from operator import itemgetter

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BSpline, CubicHermiteSpline

from lieednn_sim.errors import PlanError, TooFastError
from lieednn_sim.planning.baselines.search_space import bisecting
from lieednn_sim.planning.joint_space import SPLINE_DEGREE, clamped_knots, joint_motion
from lieednn_sim.planning.motion import Motion, joint_scale
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.planning.time_laws import minimum_jerk_law, retime
from lieednn_sim.values import Floats

Blocked = dict[int | None, str]
Paths = Callable[[int], Floats | None]


@dataclass(frozen=True)
class SmoothingOptions(PlannerOptions):
    """Options for how a path of straight edges is smoothed.

    Attributes:
        control_points: numbers of control points to try, from the smoothest curve to the closest, each up to 10 000.
        bend: curvature above which a curve is followed more slowly, in units of its inverse length.
        fastest: follow the smoothest curve that is free of contact as fast as the arm's limits allow, whatever the
            duration (`retime`). Otherwise the whole motion gets the time that its sharpest corner needs, and
            `plan(fastest=True)` only speeds up the curve chosen that way.
    """

    control_points: tuple[int, ...] = field(
        default=(6, 8, 11, 15, 20, 28, 40, 56, 80, 112, 160, 224), metadata={"range": (1, 10_000)}
    )
    bend: float = 8.0
    fastest: bool = False


def motion_along(problem: PlanningProblem, corners: Floats, options: SmoothingOptions, blocked: Blocked) -> Motion:
    """The smoothest motion along a polyline ``(M, n)`` from start to target that keeps limits and clearance.

    Numbers of control points whose curves are blocked at any duration are added to ``blocked``, with the reasons; pass
    it on to calls with other durations, which then skip these curves. `PlanError` if not even the polyline itself can
    be followed in the problem's duration.
    """
    late, refusal = list[tuple[float, str]](), ""
    fastest = options.fastest and len(_measured(corners / joint_scale(problem.arm))[1]) > 0
    for count in (*options.control_points, None):
        if count in blocked:
            refusal = blocked[count]
            continue
        try:
            if fastest and count is not None:
                return retime(problem.arm, slow_motion(problem, corners, count, options.bend))
            curve = stopping(problem, corners) if count is None else smoothed(problem, corners, count, options.bend)
            motion = joint_motion(problem, *curve)
            if fastest:
                # At its corners the retimed motion leaves the polyline, perhaps by more than its clearance.
                with suppress(PlanError):
                    motion = retime(problem.arm, motion)
            return motion
        except TooFastError as error:
            late.append((error.duration, str(error)))
        except PlanError as error:
            refusal = blocked[count] = str(error)
    # A motion that only needs more time takes precedence over blocked ones; of several, the one that needs the least.
    if late:
        duration, message = min(late, key=itemgetter(0))
        raise TooFastError(message, duration)
    raise PlanError(refusal)


def motion_along_first(
    problem: PlanningProblem, path: Paths, attempts: int, options: SmoothingOptions, name: str
) -> Motion:
    """The motion along the first path that can be followed, in the time that it needs; ``name`` is the planner's.

    ``path`` maps the number of an attempt to corners ``(M, n)``, or to None if it fails. Paths do not depend on the
    duration; ``path`` should cache them, since they are asked for again when the motion needs more time. `PlanError` if
    there is no path, or none can be followed.
    """
    blocked = {attempt: Blocked() for attempt in range(attempts)}

    def motion(asked: PlanningProblem) -> Motion:
        refusals = [PlanError(f"{name} found no path free of contact; try another seed or target")]
        for attempt, curves in blocked.items():
            corners = path(attempt)
            if corners is None:
                break
            try:
                return motion_along(asked, corners, options, curves)
            except PlanError as error:
                refusals = [error.with_traceback(None)]  # as in `plan`
                if isinstance(error, TooFastError) and error.duration <= asked.longest:
                    break
        raise refusals.pop()

    return in_time(motion, problem)


def slow_motion(problem: PlanningProblem, corners: Floats, count: int, bend: float) -> Motion:
    """A motion of 2000 steps along a curve of `smoothed`, to be timed; `PlanError` if it touches at one of 512 places.

    Nothing else is checked.
    """
    arm, scale = problem.arm, joint_scale(problem.arm)
    points, lengths = _measured(corners / scale)
    if len(lengths) and any(arm.near_contacts_along(scale * _spline(points, lengths, count)(bisecting(512)))):
        raise PlanError("the curve touches something")
    slow = replace(problem, duration=2000 * arm.timestep)
    return joint_motion(slow, *smoothed(slow, corners, count, bend), checked=False)


def smoothed(problem: PlanningProblem, corners: Floats, count: int, bend: float) -> tuple[Floats, Floats, Floats]:
    """Positions, velocities, both ``(K, n)``, and progress ``(K,)`` along a B-spline of about ``count`` points."""
    t, scale = problem.times(), joint_scale(problem.arm)
    scaled, lengths = _measured(corners / scale)
    if not len(lengths):
        return _resting(problem)
    curve = _spline(scaled, lengths, count)
    # With so many nodes of the arc length its inverse is accurate to about 1e-12.
    u = np.linspace(0.0, 1.0, 4097)
    speed = _weighted(curve(u, nu=1), curve(u, nu=2), bend)
    length = cumulative_simpson(speed, x=u, initial=0.0)
    inverse = CubicHermiteSpline(length, u, 1.0 / speed)
    progress, rate = minimum_jerk_law(t / t[-1])
    along = length[-1] * progress
    u_t = np.clip(inverse(along), 0.0, 1.0)
    u_rate = inverse(along, nu=1) * length[-1] * rate / t[-1]
    return scale * curve(u_t), scale * curve(u_t, nu=1) * u_rate[:, None], progress


def _weighted(tangent: Floats, second: Floats, bend: float) -> Floats:
    """Length of the tangents ``(K, n)`` times (1 + (kappa / kappa_0)^2)^(1/4), kappa the curvature, ``(K,)``.

    At a speed v of this measure the acceleration across the curve is at most v^2 kappa_0.
    """
    speed = np.linalg.norm(tangent, axis=1)
    # A path that doubles back on itself comes to rest where it turns.
    speed = np.maximum(speed, 1e-6 * speed.max())
    along = (second * tangent).sum(axis=1)[:, None] * tangent / speed[:, None] ** 2
    curvature = np.linalg.norm(second - along, axis=1) / speed**2
    limit = bend / speed.mean()
    return speed * (1.0 + (curvature / limit) ** 2) ** 0.25


def stopping(problem: PlanningProblem, corners: Floats) -> tuple[Floats, Floats, Floats]:
    """As `smoothed`, along the polyline itself: minimum jerk on each edge, in time proportional to its length."""
    t, scale = problem.times(), joint_scale(problem.arm)
    scaled, lengths = _measured(corners / scale)
    if not len(lengths):
        return _resting(problem)
    ends = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
    # Rounding errors must not put the last sample on an edge beyond the last.
    edge = np.clip(np.searchsorted(ends, t / t[-1], side="right") - 1, 0, len(lengths) - 1)
    fraction = ends[edge + 1] - ends[edge]
    sigma, rate = minimum_jerk_law(np.clip((t / t[-1] - ends[edge]) / fraction, 0.0, 1.0))
    change = (scaled[edge + 1] - scaled[edge]) * scale
    q = scale * scaled[edge] + sigma[:, None] * change
    return q, (rate / (fraction * t[-1]))[:, None] * change, ends[edge] + fraction * sigma


def _measured(points: Floats) -> tuple[Floats, Floats]:
    """Points without repetitions, and the lengths of the edges between them."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = lengths > 1e-9
    # The last point stays; the one before it goes where both are the same.
    return np.concatenate([points[:-1][kept], points[-1:]]), lengths[kept]


def _spline(points: Floats, lengths: Floats, count: int) -> BSpline:
    """The spline whose control points are at all corners and evenly in between, about ``count`` and at least six."""
    pieces = np.maximum(1, np.ceil(lengths / (lengths.sum() / count)).astype(int))
    pieces[0] += max(0, SPLINE_DEGREE - pieces.sum())
    laid = [
        first + np.arange(k)[:, None] / k * (second - first)
        for first, second, k in zip(points[:-1], points[1:], pieces, strict=True)
    ]
    control = np.concatenate([*laid, points[-1:]])
    return BSpline(clamped_knots(len(control)), control, SPLINE_DEGREE)


def _resting(problem: PlanningProblem) -> tuple[Floats, Floats, Floats]:
    t = problem.times()
    q = np.broadcast_to(problem.start, (len(t), len(problem.start)))
    return q, np.zeros_like(q), minimum_jerk_law(t / t[-1])[0]
