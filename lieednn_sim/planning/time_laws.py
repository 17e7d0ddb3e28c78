"""Time laws: how fast a motion follows its path, and the fastest one within the arm's limits.

TOPP-RA (Pham and Pham, IEEE Transactions on Robotics 34(3), 2018; the library toppra) finds the fastest time law within
limits of velocity and acceleration. That law switches between full acceleration and braking without a bound on jerk,
and keeps the limits only approximately within its pieces, which are shorter where the path bends. So `retime` smooths
it, by an average over a window of a 500th of its duration, and stretches it until it keeps the limits. Where actuators
would be too weak for it, it is found anew within limits of force, linear in s'' and s'^2, and averaged over a longer
window. Where the result is slow, as with limits of jerk, longer windows are tried, and the shortest motion is taken. A
network's motion keeps its path, since its field is only multiplied by a positive number at every instant; so what is
proven about the path still holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # whose ndimage is loaded when it is used
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BSpline, CubicHermiteSpline, CubicSpline, PchipInterpolator, make_interp_spline

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, PlanError, TooFastError
from lieednn_sim.planning.motion import Motion, check_motion, count_steps, joint_scale, rates_and_limits, travelled
from lieednn_sim.planning.statics import check_forces, least_stretch, path_forces
from lieednn_sim.registry import optional_module
from lieednn_sim.values import Floats

# Maps fractions ``(K,)`` of the duration to fractions of a path's length and their slopes, both ``(K,)``.
Law = Callable[[Floats], tuple[Floats, Floats]]

# Acceleration across a path above which a turn is sharp, in units of the path's length over the squared duration. Along
# the path minimum jerk needs at most 5.8; five of six certified motions of the package's arms stay below.
_SHARP_TURN = 10.0
# Half width of the maximum filter and of the average by which a motion slows down around a sharp turn, as a fraction of
# the duration; it begins to slow down two half widths before the turn.
_EASING_WIDTH = 0.1
# Half width of the average over recorded times, as a fraction of their duration.
_RECORDED_WIDTH = 0.05
_PIECES = 1000  # of the path, of equal length
_GRID = 400  # pieces with one acceleration of the law on each
_INSTANTS = 2000  # at which laws are sampled
_LOOKS = 251  # at which forces are looked at


def minimum_jerk_law(s: Floats) -> tuple[Floats, Floats]:
    """The minimum-jerk law on [0, 1] and its slope, at s (Flash and Hogan, J. Neuroscience 5(7), 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2


def law_of(motion: Motion, units: Floats) -> Law:
    """The law by which a motion follows its path; lengths are those of its states in ``units`` ``(N, 6)``."""
    known = motion.ends(250)
    length = travelled(motion.xi[known] * units)
    return _clipped(make_interp_spline(motion.t[known] / motion.t[-1], length / length[-1], min(5, len(known) - 1)))


def law_of_times(t: Floats, fraction: Floats) -> Law:
    """The monotonic law from rest to rest through given fractions ``(K,)`` of the length at times ``(K,)``."""
    s = t / t[-1]
    slope = PchipInterpolator(s, fraction).derivative()(s)
    return _clipped(CubicHermiteSpline(s, fraction, np.where((s > 0.0) & (s < 1.0), slope, 0.0)))


def recorded_law(t: Floats, fraction: Floats) -> Law:
    """`law_of_times` of a recording, which is noisy and may begin or end in motion, and is averaged over time."""
    width = _RECORDED_WIDTH * (t[-1] - t[0])
    begin, end = np.interp([t[0] + width, t[-1] - width], t, fraction)
    sudden = np.array([begin, 1.0 - end]) > 0.5 * _RECORDED_WIDTH
    # The arm rests before and after the recording; where it begins or ends suddenly, time is added there.
    width *= 1.0 + sudden.any()
    early, late = width * sudden
    s = np.linspace(t[0] - early, t[-1] + late, 401)
    half = round(width / (s[1] - s[0]))
    window = 1.0 + np.cos(np.linspace(-np.pi, np.pi, 2 * half + 3)[1:-1])
    smooth = scipy.ndimage.convolve1d(np.interp(s, t, fraction), window / window.sum(), mode="nearest")
    smooth = (smooth - smooth[0]) / (smooth[-1] - smooth[0])
    # At the other ends the average still moves a little: the law goes to and from rest there in one piece.
    first, last = np.where(sudden, 1, half)
    kept = np.concatenate([[0], np.arange(first, len(s) - last), [len(s) - 1]])
    return law_of_times((s - s[0])[kept], smooth[kept])


def eased_law(motion: Motion, units: Floats) -> Law | None:
    """A law that slows down where a motion by `minimum_jerk_law` turns sharply; None without sharp turns.

    If a law ignores the curvature kappa, the acceleration across the path, v^2 kappa, is unbounded. This law stretches
    time around every instant at which it exceeds a bound, by the square root of their ratio. The path's length is
    measured with joints in ``units`` ``(n,)``.
    """
    count, duration = len(motion.t), motion.t[-1]
    velocity = motion.qd / units
    acceleration = np.gradient(velocity, motion.timestep, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    length = float(np.trapezoid(speed, motion.t))
    if length <= 0.0:
        return None
    tangent = velocity / np.maximum(speed, 1e-300)[:, None]
    along = np.einsum("kj,kj->k", acceleration, tangent)
    # At rest the path has no direction.
    across = np.where(speed > 0.0, np.linalg.norm(acceleration - along[:, None] * tangent, axis=1), 0.0)
    sharpness = across * duration**2 / (_SHARP_TURN * length)
    if sharpness.max() <= 1.0:
        return None
    # A Hann window; scipy.signal has it, but takes as long to import as everything else in a planning process.
    window = 1.0 + np.cos(np.linspace(-np.pi, np.pi, 2 * max(1, round(_EASING_WIDTH * count)) + 1))
    slower = scipy.ndimage.maximum_filter1d(np.sqrt(np.maximum(sharpness, 1.0)), len(window), mode="nearest")
    slower = scipy.ndimage.convolve1d(slower, window / window.sum(), mode="nearest")
    s = motion.t / duration
    return law_of_times(cumulative_trapezoid(slower, s, initial=0.0), minimum_jerk_law(s)[0])


def _clipped(law: CubicHermiteSpline | BSpline) -> Law:
    rate = law.derivative()
    return lambda x: (np.clip(law(x), 0.0, 1.0), np.maximum(rate(x), 0.0))


def retime(arm: Arm, motion: Motion) -> Motion:
    """Retime a motion: follow its path as fast as velocity, acceleration, jerk and force limits allow.

    Args:
        arm: the motion's arm, in its scene.
        motion: a motion from rest to rest, at any pace.

    Returns:
        The motion; its duration is the least one found, rounded up to a time step, or a few thousandths more. A motion
        that stays in place, up to rounding, is returned unchanged.

    Raises:
        InputError: a joint that moves has no limit of acceleration.
        PlanError: the path breaks a limit of position, or touches something.
        LieEDNNError: toppra is not installed; the message names the extra.
    """
    if np.ptp(motion.q, axis=0).max() <= 1e-8:
        return motion
    if (free := np.flatnonzero((np.ptp(motion.q, axis=0) > 0.0) & np.isinf(arm.acceleration_limits))).size:
        raise InputError(
            f"joint {arm.joint_names[free[0]]!r} has no limit of acceleration, so that the fastest motion has no end; "
            "name one: Arm.load(..., limits={...}), or the custom numeric acceleration_limit"
        )
    path = TimedCurve(arm, motion)
    law = path.fastest()
    duration = max(float(law.x[-1]), 2.0 * arm.timestep)
    count_steps(duration, arm.timestep)
    return path.kept(lambda _: law, duration)


class TimedCurve:
    """A motion's path ``q`` over its length, in units of the joints' limits, and its ``own`` law of time."""

    def __init__(self, arm: Arm, motion: Motion) -> None:
        if motion.q.shape[1] != arm.n_joints:
            raise InputError(f"the motion has {motion.q.shape[1]} joints, arm {arm.name!r} has {arm.n_joints}")
        length = travelled(motion.q / joint_scale(arm))
        fraction = length / length[-1]
        # Samples are dense where the motion is slow; if too dense, they would make the second derivative noisy.
        kept = np.unique(np.searchsorted(fraction, np.linspace(0.0, 1.0, _PIECES + 1)))
        self._arm, self._motion, self._kept, self._fraction = arm, motion, kept, fraction[kept]
        self._every, self._places = np.unique(fraction, return_index=True)
        self.q = CubicSpline(self._fraction, motion.q[kept])
        speed = np.linalg.norm(motion.qd[kept] / joint_scale(arm), axis=1)
        self.own = CubicHermiteSpline(motion.t[kept], self._fraction, speed / length[-1])
        self._forces: CubicSpline | None = None
        # Half of the pieces have equal length, the others a density that grows with the curvature's root.
        even = np.linspace(0.0, 1.0, _PIECES + 1)
        bend = np.sqrt(np.linalg.norm(self.q(even, 2) / arm.acceleration_limits, axis=1))
        density = even + cumulative_trapezoid(bend / max(bend.mean(), 1e-300), even, initial=0.0)
        self._grid = np.interp(np.linspace(0.0, density[-1], _GRID + 1), density, even)

    def fastest(self) -> CubicHermiteSpline:
        """The law with the shortest duration, from time to the fraction of the path's length."""
        law, window = self._switching(), 0.002
        near = self._stretched(_averaged(law, window * law.x[-1]))
        t = np.linspace(0.0, near.x[-1], _LOOKS)
        if check_forces(self._arm, t, self.q(near(t)), self.q(near(t), 1) * near(t, 1)[:, None]) is not None:
            some = self._grid[::2]
            self._forces = CubicSpline(some, path_forces(self._arm, self.q, some), axis=1)
            near = self._stretched(near)
            with suppress(PlanError):
                # Switches between forces are steeper.
                law, window = self._switching(near), 0.007
        first, *more = law.x[-1] * np.geomspace(window, 1.0, 20)
        laws = [near, self._stretched(self.own), self._stretched(_averaged(law, first))]
        if min(each.x[-1] for each in laws) > 1.008 * law.x[-1] + first:  # otherwise longer windows gain little
            for each in more:
                laws.append(self._stretched(_averaged(law, each)))
                if laws[-1].x[-1] > 1.05 * min(tried.x[-1] for tried in laws[2:]):  # longer windows are slower still
                    break
        return min(laws, key=lambda item: float(item.x[-1]))

    @cached_property
    def _rate_limited(self) -> tuple[float, Any, list[Any]]:
        """A unit of time [s], and toppra's path and limits of velocity and acceleration in this unit."""
        constraint = optional_module("toppra.constraint")
        # The solver needs numbers near one, even for a motion of a micrometre. So the unit of time is about the
        # motion's duration, and that of each joint the way that its acceleration limit allows in this time.
        q, velocity, acceleration = self._motion.q[self._kept], self._arm.velocity_limits, self._arm.acceleration_limits
        unit = float(np.sqrt((np.ptp(q, axis=0) / acceleration).max()))
        size = np.where(np.isfinite(acceleration), acceleration, 1.0) * unit**2
        # It also needs bounds in place of missing limits, and fails at times if they are 100. Nothing that stays within
        # a unit is faster than sqrt(2), since it must brake: bounds of 10 exclude nothing.
        limits = [np.minimum(bound, 10)[:, None] * [-1.0, 1.0] for bound in (velocity * unit / size, 0.0 * size + 1.0)]
        constraints = [constraint.JointVelocityConstraint(limits[0]), constraint.JointAccelerationConstraint(limits[1])]
        return unit, optional_module("toppra").SplineInterpolator(self._fraction, (q - q[0]) / size), constraints

    def _switching(self, near: CubicHermiteSpline | None = None) -> CubicHermiteSpline:
        """The fastest law within the limits of velocity and acceleration and, given a law ``near`` it, of force."""
        unit, path, limits = self._rate_limited
        limits = limits if near is None else [*limits, self._force_constraint(near, unit)]
        topp = optional_module("toppra.algorithm").TOPPRA
        solver = topp(limits, path, gridpoints=self._grid, solver_wrapper="seidel")
        _, rate, _ = solver.compute_parameterization(0.0, 0.0)
        if rate is None or not np.isfinite(rate).all():
            raise PlanError("toppra finds no time law for this path; it turns too sharply")
        # The acceleration is constant on each piece.
        t = unit * np.append(0.0, np.cumsum(2.0 * np.diff(self._grid) / (rate[1:] + rate[:-1])))
        return CubicHermiteSpline(t, self._grid, rate / unit)

    def _force_constraint(self, near: CubicHermiteSpline, unit: float) -> Any:
        """Limits of force for toppra, with time in a unit [s].

        Dampers need a force d s', but toppra's constraints are linear in s'^2, not in s'. So d s' is replaced by its
        tangent as a function of s'^2 at the rate r of the law ``near``: d (s'^2 / r + r) / 2, which is never less.
        """
        assert self._forces is not None
        drawn, bent, damped, still = self._forces(self._grid)
        rate = np.interp(self._grid, near(near.x), near(near.x, 1))
        rate = np.maximum(rate, 0.05 * rate.max())[:, None]
        half, count = 0.5 * np.maximum(damped, 0.0), still.shape[1]
        rows = drawn / unit**2, (bent + half / rate) / unit**2, still + half * rate, np.eye(count), np.ones(count)
        linear = optional_module("toppra.constraint.linear_constraint")
        # The limits hold at both ends of a piece.
        both = linear.canlinear_colloc_to_interpolate(*rows, None, None, self._grid, identical=True)
        result = linear.LinearConstraint()
        result.identical, result.dof = True, len(self._arm.velocity_limits)
        result.compute_constraint_params = lambda *_: both
        return result

    def _stretched(self, law: CubicHermiteSpline) -> CubicHermiteSpline:
        """The law, stretched or compressed to the least duration in which it keeps all limits."""
        t = np.linspace(0.0, law.x[-1], max(_INSTANTS, round(law.x[-1] / self._arm.timestep)) + 1)
        qd = self.q(law(t), 1) * law(t, 1)[:, None]
        rates = rates_and_limits(self._arm, qd, t[1])
        factor = max(float((np.abs(values) / limits).max()) ** power for values, limits, power in rates)
        if self._forces is not None:
            drawn, bent, damped, still = self._forces(law(t[:-1]))
            speed = law(t, 1)[:, None]
            rest = drawn * np.diff(speed, axis=0) / t[1] + bent * speed[:-1] ** 2
            factor = max(factor, float(least_stretch(still, damped * speed[:-1], rest, 1.0).max()))
        return CubicHermiteSpline(law.x * factor, law(law.x), law(law.x, 1) / factor)

    def kept(
        self,
        law_of: Callable[[float], CubicHermiteSpline],
        duration: float,
        longest: float = math.inf,
        growth: tuple[float, float] = (1.002, math.inf),
        check: Callable[[Motion], None] = lambda _: None,
    ) -> Motion:
        """The motion by the law for a duration [s], or for the next longer one with which it keeps all limits.

        The duration grows by factors between the two of ``growth``, up to ``longest``. A `TooFastError` that ``check``
        raises for a motion within the limits lengthens it, too.
        """
        for _ in range(20):
            result = self.motion(law_of(duration), math.ceil(round(duration / self._arm.timestep, 6)))
            try:
                check_motion(self._arm, result)
                check(result)
                return result
            except TooFastError as error:
                # Rates sampled at the model's time step may slightly exceed the law's, which does not know the forces.
                needed = min(error.duration, growth[1] * duration)
                if needed > longest:
                    raise
                duration = min(max(needed, growth[0] * duration), longest)
        raise PlanError("no time law keeps the limits on this path; it turns too sharply for the model's time step")

    def motion(self, law: CubicHermiteSpline, steps: int) -> Motion:
        """The motion by a law, in a given number of time steps."""
        old, kept, arm = self._motion, self._kept, self._arm
        t = arm.timestep * np.arange(steps + 1, dtype=np.float64)
        pace = law.x[-1] / t[-1]
        fraction = np.clip(law(t * pace), 0.0, 1.0)
        q, qd = self.q(fraction), self.q(fraction, 1) * (law(t * pace, 1) * pace)[:, None]
        xi = CubicSpline(self._fraction, old.xi[kept])(fraction)
        q[[0, -1]], qd[[0, -1]], xi[[0, -1]] = old.q[[0, -1]], 0.0, old.xi[[0, -1]]
        # A network's state follows exp(-tau), which changes evenly along the path, while tau does not near its end.
        left = PchipInterpolator(self._every, np.exp(-old.tau[self._places]))(fraction)
        tau = 0.0 - np.log(np.clip(left, *np.exp(-old.tau[[-1, 0]])))
        both = old.gap_translation, old.gap_rotation
        gaps = (make_interp_spline(self._fraction, gap[kept], k=1)(fraction) for gap in both)
        return Motion(t, tau, xi, old.xi_target, q, qd, *gaps)


def _averaged(law: CubicHermiteSpline, window: float) -> CubicHermiteSpline:
    """A law averaged over a window of time: steps of its acceleration become ramps, and it lasts a window longer."""
    duration = float(law.x[-1])
    t = np.linspace(0.0, duration + window, _INSTANTS + 1)
    rate = (law(np.minimum(t, duration)) - law(np.maximum(t - window, 0.0))) / window
    fraction = cumulative_trapezoid(rate, dx=t[1], initial=0.0)
    return CubicHermiteSpline(t, fraction / fraction[-1], rate / fraction[-1])
