"""Time laws that leave little swinging and bending on a given path: input shapers, and laws of least residual energy.

Shapers convolve a motion's time law with impulses: ZV and ZVD of Singer and Seering (J. Dyn. Sys., Meas., Control
112(1), 1990), EI of Singhose, Seering and Singer (J. Mech. Des. 116(2), 1994). They cancel a mode that is constant and
driven linearly; on a curved path a part of the oscillation is left. The law of least energy accounts for the change of
the modes along the path (`swing_model`). It is a cubic B-spline s'(t), found by the Gauss-Newton method as a sequence
of quadratic programs within the limits of the joints. The path stays as planned, so what is proved about it still
holds; the limits are checked anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial

import daqp
import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, CubicSpline

from lieednn_sim.arm import Arm, Mode, with_load
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import InputError
from lieednn_sim.planning.load_clearance import check_load
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.swing_model import SwingModel, longest_step
from lieednn_sim.planning.time_laws import TimedCurve
from lieednn_sim.values import Floats

METHODS = ("least-energy", "zv", "zvd", "ei")

_SAMPLES = 2000  # of a law
_INSTANTS = 501  # of the path
_LOOKS = 240  # instants at which a law's limits are kept
_MARGIN = 0.995  # of the limits, between these instants
_GROWTH = 1.05, 1.2  # of the duration of a law that breaks limits, at least and at most
_SMOOTH = 1e-7  # weight of the law's mean squared jerk, in units of the duration, relative to fractions of energy


@dataclass(frozen=True)
class SettlingOptions(PlannerOptions):
    """How `plan` lets a motion end with its load at rest.

    Attributes:
        method: a name of `METHODS`.
        loads: further masses of what hangs, as fractions of the model's, for which ``least-energy`` settles, too.
        lengths: the same for the lengths at which it hangs.
        modes: number of the slowest modes for which a shaper is made.
    """

    method: str = field(default=METHODS[0], metadata={"choices": METHODS})
    loads: tuple[float, ...] = (0.8, 1.2)
    lengths: tuple[float, ...] = (0.83, 1.17)
    modes: int = 1


def settled(arm: Arm, motion: Motion, options: SettlingOptions, longest: float = math.inf, more: float = 0.0) -> Motion:
    """A motion along the path of another one, by a time law that leaves less swinging and bending.

    It keeps the duration if the arm's limits allow that and the swinging load keeps the arm's clearance
    (`load_clearance`); otherwise it takes as much longer as they need.

    Args:
        arm: the motion's arm, in its scene.
        motion: a motion from rest to rest.
        options: the method, and for which loads.
        longest: the longest duration that it may take [s].
        more: number of periods of the slowest oscillation by which it takes longer at least.

    Raises:
        InputError: the arm has no passive joints that oscillate.
        NoSolutionError: the passive joints have no position of rest.
        PlanError: the motion breaks a limit, see `check_motion`, or the load would come too near to something;
            `TooFastError` if it would take longer.
    """
    passive = PassiveJoints(arm)
    modes = passive.modes(motion.q[-1])
    if not modes:
        raise InputError(f"arm {arm.name!r} has nothing that swings or bends: all joints of its model are driven")
    if np.ptp(motion.q, axis=0).max() <= 1e-8:  # it stays in place, up to rounding
        return motion
    curve, duration = TimedCurve(arm, motion), float(motion.t[-1]) + more / modes[0].frequency
    others, least = list[Arm](), options.method == METHODS[0]
    if least and passive.bodies.any():
        loads = [(mass, 1.0) for mass in options.loads] + [(1.0, length) for length in options.lengths]
        others = [with_load(arm, *load) for load in loads]
    law = _LeastEnergy(arm, curve, others, modes).law if least else partial(delayed, curve.own, *shaper(options, modes))
    return curve.kept(law, duration, longest, _GROWTH, partial(check_load, arm))


def shaper(options: SettlingOptions, modes: tuple[Mode, ...]) -> tuple[Floats, Floats]:
    """Delays [s] and weights ``(k,)`` of a shaper's impulses, for the slowest of the modes.

    EI leaves 5 % of its mode, for a wider range of frequencies; its undamped impulses decay with the mode's damping.
    """
    v = 0.05
    undamped = {"zv": [1.0, 1.0], "zvd": [1.0, 2.0, 1.0], "ei": [1.0 + v, 2.0 - 2.0 * v, 1.0 + v]}[options.method]
    delays, shares = np.zeros(1), np.ones(1)
    for mode in modes[: options.modes]:
        root = math.sqrt(1.0 - mode.damping**2)
        count = np.arange(len(undamped))
        decayed = undamped * np.exp(-mode.damping * math.pi / root) ** count
        delays = np.add.outer(delays, count * 0.5 / (mode.frequency * root)).ravel()
        shares = np.multiply.outer(shares, decayed / decayed.sum()).ravel()
    return delays, shares


def delayed(law: CubicHermiteSpline, delays: Floats, shares: Floats, duration: float) -> CubicHermiteSpline:
    """A law convolved with impulses, and compressed before so that the result takes a duration [s].

    If less than a quarter of the duration would be left for the law itself, it gets that, and the result is longer.
    """
    own = max(duration - delays.max(), 0.25 * duration)
    t = np.linspace(0.0, own + delays.max(), _SAMPLES)
    pace = law.x[-1] / own
    times = np.clip((t[:, None] - delays) * pace, 0.0, law.x[-1])
    return CubicHermiteSpline(t, law(times) @ shares, pace * law(times, 1) @ shares)


class _LeastEnergy:
    """The laws of least energy left on a path, for an arm's load and others."""

    def __init__(self, arm: Arm, curve: TimedCurve, others: list[Arm], modes: tuple[Mode, ...]) -> None:
        self._modes = modes
        self._limits = np.concatenate([arm.velocity_limits, arm.acceleration_limits])[:, None, None]
        # The path's own spline has denser knots, where its third derivative jumps if a planner left corners.
        self._t, s = np.linspace(0.0, 1.0, _SAMPLES), np.linspace(0.0, 1.0, _INSTANTS)
        self._own, self._path = curve.own(self._t * curve.own.x[-1]), CubicSpline(s, curve.q(s))
        self._model = SwingModel([arm, *others], self._path)

    def law(self, duration: float) -> CubicHermiteSpline:
        """The law for a duration [s]."""
        # Three coefficients per period of the slowest mode, within bounds.
        count = int(np.clip(3.0 * duration * self._modes[0].frequency + 10.0, 16, 60))
        knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
        # s' over fractions of the duration, from rest to rest without a step of the acceleration.
        spline = BSpline(knots, np.eye(count)[:, 2:-2], 3)
        parts = spline.antiderivative(), spline, spline.derivative()
        steps = math.ceil(duration / (2.0 * longest_step(self._modes)))
        # Instants in the middle of the model's steps, and those at which limits are kept.
        middle, tau = (np.arange(steps) + 0.5) / steps, np.linspace(0.0, 1.0, _LOOKS)
        basis, looks = ([part(at) / duration**k for k, part in enumerate(parts)] for at in (middle, tau))
        fitted, *_ = np.linalg.lstsq(parts[0](self._t), self._own, rcond=None)
        now = fitted / (looks[0][-1] @ fitted)
        rough = math.sqrt(_SMOOTH / _LOOKS) * spline.derivative(2)(tau)
        best, unit = (math.inf, now), 0.0
        for _ in range(4):
            changes = [np.column_stack([part @ now, part]) for part in basis]
            lefts, each = self._model.left(duration / steps, changes, corrected=True)
            # All other loads together count as much as the arm's own.
            lefts[1:], each[1:] = (part[1:] / math.sqrt(max(len(lefts) - 1, 1)) for part in (lefts, each))
            left, slopes = lefts.ravel(), each.reshape(lefts.size, -1)
            size = float(np.linalg.norm(left))
            best, unit = min(best, (size, now), key=lambda pair: pair[0]), unit or max(size, 1e-9)
            rest = np.append((left - slopes @ now) / unit, np.zeros(len(rough)))
            now = self._within_limits(now, np.vstack([slopes / unit, rough]), rest, looks)
        s, rate = (part(self._t) @ best[1] for part in parts[:2])
        return CubicHermiteSpline(duration * self._t, s, rate / duration)

    def _within_limits(self, now: Floats, slopes: Floats, rest: Floats, looks: list[Floats]) -> Floats:
        """The coefficients c that minimise ``|slopes c + rest|^2`` within the joints' limits, linearised at ``now``."""
        s, rate, bend = (part @ now for part in looks)
        path, r, u = [self._path(s, k).T[:, :, None] for k in range(4)], rate[:, None], bend[:, None]
        values = path[1] * r, path[2] * r**2 + path[1] * u
        over_s = path[2] * r * looks[0], (path[3] * r**2 + path[2] * u) * looks[0]
        over_rates = path[1] * looks[1], 2.0 * path[2] * r * looks[1] + path[1] * looks[2]
        # Velocities and accelerations in units of their limits; zero where there is no limit.
        value, change, more = (np.concatenate(pair) / self._limits for pair in (values, over_s, over_rates))
        change = (change + more).reshape(-1, len(now))
        known = value.ravel() - change @ now
        # Constraints: s ends at 1, s' is not negative, and the limits are kept.
        rows = np.vstack([looks[0][-1:], looks[1], change])
        lower = np.concatenate([[1.0], np.zeros(_LOOKS), -_MARGIN - known])
        upper = np.concatenate([[1.0], np.full(_LOOKS, 1e6), _MARGIN - known])
        # DAQP marks soft constraints by 8, and equalities by 5. If limits cannot be kept, the motion will take longer.
        sense = np.full(len(rows), 8, dtype=np.int32)
        sense[0] = 5
        return np.asarray(daqp.solve(slopes.T @ slopes, slopes.T @ rest, rows, upper, lower, sense, rho_soft=1e-6)[0])
