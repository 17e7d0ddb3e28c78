"""Joint trajectories in continuous time: LieEDNN plans as fast as the limits allow, and smooth random ones."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.errors import NoSolutionError, NotCertifiedError, PlanError
from lieednn_sim.planning import CertifiedOptions, Plan, plan
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.validation import Seed, as_floats, as_positive
from lieednn_sim.values import Floats

# Duration with which plans are made before they are sped up [s]; minimum jerk gives the same path in any duration.
_PLANNING_DURATION = 10.0
# Number of sines of a random trajectory, and of attempts to draw one.
_SINES, _ATTEMPTS = 3, 40


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """A joint trajectory that begins at t = 0; before and after it, the joints rest.

    Attributes:
        spline: positions ``(n,)`` [rad, m] over time [s].
        certificate: the proof of stability of the network that it comes from, in words; empty without one.
    """

    spline: CubicHermiteSpline
    certificate: str = ""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.spline.x[-1])

    def position(self, time: ArrayLike) -> Floats:
        """Joint positions at times ``(...)``, shape ``(..., n)``."""
        times = as_floats("time", time, (), batched=True)
        return np.asarray(self.spline(np.clip(times, 0.0, self.duration)))

    def velocity(self, time: ArrayLike) -> Floats:
        """Joint velocities at times ``(...)``, shape ``(..., n)``."""
        times = as_floats("time", time, (), batched=True)
        inside = (times >= 0.0) & (times < self.duration)
        return np.where(inside[..., None], self.spline(np.clip(times, 0.0, self.duration), 1), 0.0)


def planned(arm: Arm, target: ArrayLike | str, *, planner: str | None = None, seed: Seed = 0) -> JointTrajectory:
    """A planned motion from the keyframe ``home``, as fast as 90 % of the velocity and acceleration limits allow.

    Args:
        arm: the arm.
        target: joint target ``(n,)``, or a keyframe's name.
        planner: a name of `planning.PLANNERS`; by default a certified LieEDNN, of which two networks are drawn at
            first; if their motions break limits, four times as many are drawn, and then sixteen times as many.
        seed: seed of the draws.

    Raises:
        InputError: an unknown planner, or the target is out of the arm's reach.
        NotCertifiedError: no network could be certified.
        PlanError: every motion breaks a limit.
    """
    if planner is None:
        result = _patient_plan(arm, target, seed)
    else:
        result = plan(arm, target, planner=planner, duration=_PLANNING_DURATION, seed=seed)
    motion, certificate = result.motion, "" if result.network is None else str(result.network.certificate)
    # The rest of the limits is left to the servos. Nothing moves if it is already there.
    pace = _pace(arm, motion.t, motion.qd, 0.9) or 1.0
    return JointTrajectory(CubicHermiteSpline(motion.t * pace, motion.q, motion.qd / pace), certificate)


def _patient_plan(arm: Arm, target: ArrayLike | str, seed: Seed) -> Plan:
    # Few networks suffice for most targets, and each takes time.
    for count in (2, 8):
        with contextlib.suppress(PlanError, NotCertifiedError):
            return _certified_plan(arm, target, seed, count)
    return _certified_plan(arm, target, seed, 32)


def _certified_plan(arm: Arm, target: ArrayLike | str, seed: Seed, count: int) -> Plan:
    options = CertifiedOptions(n_networks=count)
    return plan(arm, target, duration=_PLANNING_DURATION, max_time_scale=1.0, seed=seed, options=options)


def band_limited(arm: Arm, rng: np.random.Generator, duration: float) -> JointTrajectory:
    """A random trajectory that starts at rest at ``home`` and keeps the limits free of contact.

    q(t) = home + r(t) (m + h u(t) - home), elementwise, where u is a sum of sines of 0.1 to 0.5 Hz with random
    weights, frequencies and phases, |u| <= 1; m - h and m + h are random positions within the limits; r rises from 0
    to 1 by the minimum-jerk law. If it exceeds half the velocity or acceleration limits, it is slowed down as a whole.

    Raises:
        NoSolutionError: every attempt touches something.
    """
    total = as_positive("duration", duration)
    # A fraction of the joint ranges, which is reduced after a contact.
    home, spread = arm.keyframe("home"), 0.8
    for _ in range(_ATTEMPTS):
        trajectory = _draw(arm, rng, home, total, spread)
        checked = trajectory.position(np.linspace(0.0, total, int(np.ceil(10.0 * total)) + 1))
        if not any(arm.contacts(q) for q in checked):
            return trajectory
        spread *= 0.85
    raise NoSolutionError(f"no random trajectory of arm {arm.name!r} is free of contact; use another scene or seed")


def _draw(arm: Arm, rng: np.random.Generator, home: Floats, total: float, spread: float) -> JointTrajectory:
    n = len(home)
    low, high = arm.position_limits.T.copy()
    for ball in arm.space.balls:
        # Limits of the cube inscribed in the ball.
        low[ball], high[ball] = low[ball] / np.sqrt(3.0), high[ball] / np.sqrt(3.0)
    # Closer to home as the spread shrinks; convex combinations stay within the limits.
    ends = np.sort(home + spread * (rng.uniform(low, high, (2, n)) - home), axis=0)
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    weights = rng.dirichlet(np.ones(_SINES), n)
    omega = 2.0 * np.pi * rng.uniform(0.1, 0.5, (n, _SINES))
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, _SINES))
    # Long enough even if it is not slowed down.
    t = np.linspace(0.0, total, int(np.ceil(total / 0.02)) + 1)
    angle = omega * t[:, None, None] + phase
    wave = middle + half * (weights * np.sin(angle)).sum(axis=-1) - home
    wave_rate = half * (weights * omega * np.cos(angle)).sum(axis=-1)
    onset = min(1.5, total)
    rise, slope = (values[:, None] for values in minimum_jerk_law(np.minimum(t / onset, 1.0)))
    q, qd = home + rise * wave, slope / onset * wave + rise * wave_rate
    slowdown = max(1.0, _pace(arm, t, qd, 0.5))
    return JointTrajectory(CubicHermiteSpline(t * slowdown, q, qd / slowdown))


def _pace(arm: Arm, t: Floats, qd: Floats, fraction: float) -> float:
    """Factor of time with which the fastest joint reaches a fraction of its limits; 0 if nothing moves."""
    velocity = (np.abs(qd) / arm.velocity_limits).max()
    acceleration = (np.abs(np.gradient(qd, t, axis=0)) / arm.acceleration_limits).max()
    return float(max(velocity / fraction, np.sqrt(acceleration / fraction)))
