"""Joint trajectories that start and end at rest and take a given duration, and their checks."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError, PlanError, TooFastError
from lieednn_sim.planning.clearance import Cubics, check_clearance
from lieednn_sim.planning.statics import check_forces
from lieednn_sim.validation import as_floats, as_positive, as_times
from lieednn_sim.values import Floats, StrPath, check_fields, frozen, rounded

LIMIT_TOLERANCE = 1e-6  # how far positions may exceed a limit [rad, m]: a target on it is reached up to the residual
JUMP = 0.02  # largest part of a step between samples that the velocities do not explain [rad, m]
_MAX_STEPS = 100_000  # 200 s at a simulation step of 2 ms; longer motions would take minutes to plan


@frozen
class Motion:
    """A planned joint trajectory, sampled at constant time steps, with the network's states along it.

    Attributes:
        t: ``(K,)`` times [s].
        tau: ``(K,)`` the network's own time; for a planner without a network, the progress from 0 to 1.
        xi: ``(K, N, 6)`` states of the network's visible neurons, one for each link.
        xi_target: ``(N, 6)`` their states at the equilibrium.
        q: ``(K, n)`` joint positions [rad, m].
        qd: ``(K, n)`` joint velocities [rad/s, m/s].
        gap_translation: ``(K, N)`` mechanism gap: the distance of the poses from those that the joints can take [m].
        gap_rotation: ``(K, N)`` the mechanism gap in rotation [rad].
    """

    t: Floats
    tau: Floats
    xi: Floats
    xi_target: Floats
    q: Floats
    qd: Floats
    gap_translation: Floats
    gap_rotation: Floats

    def __post_init__(self) -> None:
        check_fields(self, as_times, "t")
        k, steps = len(self.t), np.diff(self.t)
        if np.ptp(steps) > 1e-3 * steps[0]:
            raise InputError(f"t must rise by one time step, but rises by {steps.min():g} to {steps.max():g} s")
        check_fields(self, as_floats, "xi_target", shape=("N", 6))
        check_fields(self, as_floats, "q", shape=(k, "n"))
        n, joints = len(self.xi_target), self.q.shape[1]
        check_fields(self, as_floats, "tau", shape=(k,))
        check_fields(self, as_floats, "xi", shape=(k, n, 6))
        check_fields(self, as_floats, "qd", shape=(k, joints))
        check_fields(self, as_floats, "gap_translation", "gap_rotation", shape=(k, n))

    def __repr__(self) -> str:
        return (
            f"<Motion: {len(self.t)} samples in {self.t[-1]:g} s, {self.q.shape[1]} joints, {self.xi.shape[1]} links, "
            f"mechanism gap up to {rounded(1e3 * self.gap_translation.max())} mm>"
        )

    @property
    def residual(self) -> float:
        """Largest coordinate of xi - xi_target left at the end."""
        return float(np.abs(self.xi[-1] - self.xi_target).max())

    @property
    def timestep(self) -> float:
        """Sampling period [s]."""
        return float(self.t[1] - self.t[0])

    def ends(self, pieces: int) -> NDArray[np.int_]:
        """Indices of the samples at the ends of ``pieces`` even pieces, or of all samples; see `interpolation`."""
        return interpolation(len(self.t), pieces)[0]

    def save(self, path: StrPath) -> None:
        """Write to an ``.npz`` file, atomically."""
        io.save_arrays(path, "motion", vars(self), {})

    @classmethod
    def load(cls, path: StrPath) -> Motion:
        """Read a file that `save` wrote; raise `FileError` if it is not one."""
        arrays, _ = io.load_arrays(path, "motion")
        names = tuple(cls.__dataclass_fields__)
        try:
            return cls(**dict(zip(names, io.take(arrays, path, *names), strict=True)))
        except InputError as error:
            raise FileError(f"{path} is not a valid motion: {error}") from None


def count_steps(duration: float, timestep: float) -> int:
    """Number of time steps in ``duration`` [s]; raise `InputError` if there are fewer than 2, or too many."""
    ratio = as_positive("duration", duration) / as_positive("timestep", timestep)
    if not 1.5 <= ratio <= _MAX_STEPS:
        raise InputError(f"duration must be 2 to {_MAX_STEPS} time steps of {timestep:g} s, got {duration:g} s")
    return round(ratio)


def steps_of_rate(what: str, rate: float, timestep: float) -> int:
    """Number of simulation steps in one period of a control rate [Hz]; `InputError` unless it is a whole number.

    A rate may be rounded to six digits, as messages print it.
    """
    ratio = 1.0 / (as_positive(what, rate) * timestep)
    if ratio < 0.5 or abs(ratio - round(ratio)) > 5e-6 * ratio:
        raise InputError(
            f"{what} must divide the simulation's {1.0 / timestep:.6g} Hz, got {rate:g} Hz; "
            f"for example {1.0 / (timestep * max(1, round(ratio))):.6g} Hz"
        )
    return round(ratio)


def usual_rate(timestep: float) -> float:
    """100 Hz, or the nearest control rate that divides the simulation's."""
    return 1.0 / (timestep * max(1, round(0.01 / timestep)))


def least_duration(arm: Arm, start: Floats, target: Floats) -> float:
    """Least time [s] from rest at ``start`` to rest at ``target``, both ``(n,)``, under the limits of all rates.

    With limits a of acceleration and j of jerk, a joint needs v / a + a / j to reach a speed v >= a^2 / j, and
    2 sqrt(v / j) for a lower one. Each joint reaches the highest speed from which it can brake in time, at most its
    limit, cruises, and brakes: a distance d takes d / v plus the time to reach v. Nothing within the limits is faster.
    """
    distance, v, a = np.abs(target - start), arm.velocity_limits, arm.acceleration_limits
    # Missing limits are infinite, which the formulas cannot use; large finite ones have the same effect.
    a, j = np.minimum(a, 1e60), np.minimum(arm.jerk_limits, 1e300)
    ramped = a * (a / j)
    # The peak speed of a motion that consists of the two ramps alone.
    long, short = 0.5 * (np.sqrt(ramped**2 + 4.0 * a * distance) - ramped), np.cbrt(0.25 * distance**2 * j)
    peak = np.minimum(v, np.where(distance * j >= 2.0 * a * ramped, long, short))
    ramp = np.where(peak >= ramped, peak / a + a / j, 2.0 * np.sqrt(peak / j))
    return float((distance / np.maximum(peak, 1e-300) + ramp).max())


@lru_cache(maxsize=8)
def interpolation(count: int, pieces: int) -> tuple[NDArray[np.int_], csr_array]:
    """Indices of the ends of even pieces of ``count`` samples, and the matrix that interpolates all samples from these.

    It holds Lagrange's polynomials through the six ends next to each sample, and takes a fifth of the time of a spline.
    """
    known = np.unique(np.linspace(0, count - 1, min(count, pieces + 1)).round().astype(int))
    at, size = np.arange(count), min(6, len(known))
    near = np.clip(np.searchsorted(known, at) - 3, 0, len(known) - size)[:, None] + np.arange(size)
    nodes, own = known[near], np.eye(size, dtype=bool)
    parts = (at[:, None, None] - nodes[:, None]) / np.where(own, 1, nodes[:, :, None] - nodes[:, None])
    weights = np.where(own, 1.0, parts).prod(axis=2)
    return known, csr_array((weights.ravel(), near.ravel(), size * np.arange(count + 1)), shape=(count, len(known)))


def joint_scale(arm: Arm) -> Floats:
    """Units ``(n,)`` of the joints for path lengths: the velocity limit times 1 s, or the range where it is missing."""
    return np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges)


def travelled(points: Floats) -> Floats:
    """Length ``(M,)`` of a path through points ``(M, ...)`` up to each of them."""
    steps = np.diff(points, axis=0).reshape(len(points) - 1, -1)
    return np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))


def check_motion(arm: Arm, motion: Motion) -> None:
    """Check a motion as `check_joints` does; it may begin too near to something if it leaves it (`Arm.leaving`)."""
    check_joints(arm.leaving(motion.q[0])[0], motion.t, motion.q, motion.qd)


def rates_and_limits(arm: Arm, qd: Floats, timestep: float) -> tuple[tuple[Floats, Floats, float], ...]:
    """Velocities, accelerations and jerks from rates ``(K, n)``, each with its limits ``(n,)`` and a power.

    They scale as 1 / T, 1 / T^2 and 1 / T^3 with the duration T. So if one exceeds its limit by a factor r, a duration
    of T times r to this power keeps the limit.
    """
    acceleration = np.diff(qd, axis=0) / timestep
    jerk = np.diff(acceleration, axis=0) / timestep
    return (
        (qd, arm.velocity_limits, 1.0),
        (acceleration, arm.acceleration_limits, 1.0 / 2.0),
        (jerk, arm.jerk_limits, 1.0 / 3.0),
    )


def check_joints(arm: Arm, t: Floats, q: Floats, qd: Floats) -> None:
    """Check the limits of a motion as `check_limits` does, its forces (`statics.check_forces`), and its clearance.

    Raises what these and `clearance.check_clearance` raise; `TooFastError` also if only forces are beyond a limit.
    """
    cubics = Cubics(t[1] - t[0], q, qd)
    check_limits(arm, t, q, qd, cubics)
    if (short := check_forces(arm, t, q, qd)) is not None:
        raise _too_fast(*short)
    check_clearance(arm, t, q, qd, cubics)
    if arm.leaves is not None:
        _check_leaving(arm, t, q)


def check_limits(arm: Arm, t: Floats, q: Floats, qd: Floats, cubics: Cubics | None = None) -> None:
    """Check limits of position, velocity, acceleration and jerk along a motion.

    Positions and velocities are checked at all instants, by the extrema of the cubics between samples (a ball joint's
    angle 64 times in each step in which it may be too large; `Arm.stops` at samples and at extrema of coordinates), but
    accelerations as the mean over each step. Where a time law switches within a step, the cubic's own acceleration
    exceeds this mean by up to a third.

    A motion that jumps from one sample to the next is refused: where two configurations are equally near to the
    network's state, the nearest one changes abruptly, and the joints cannot follow.

    Args:
        arm, t, q, qd, cubics: as for `clearance.check_clearance`.

    Raises:
        TooFastError: only velocity, acceleration or jerk is too high; the error has the duration that keeps the limits.
        PlanError: another check fails; the message names the joint or bodies, the value and the bound.
    """
    timestep = t[1] - t[0]
    _check_positions(arm, t, q)
    # Jumps come before rates, since no longer duration mends them.
    step, unexplained = unexplained_steps(t, q, qd)
    unexplained -= np.minimum(JUMP, timestep * arm.velocity_limits)
    k, joint = map(int, np.unravel_index(unexplained.argmax(), unexplained.shape))
    if unexplained[k, joint] > 0.0:
        raise PlanError(
            f"joint {arm.joint_names[joint]!r} would jump by {step[k, joint]:.3g} {arm.unit(joint)} at "
            f"t = {t[k + 1]:.2f} s, where the nearest configuration changes abruptly"
        )
    cubics = Cubics(timestep, q, qd) if cubics is None else cubics
    turns, balls = cubics.turns(), arm.space.balls
    if len(balls):
        # The cubic of a step is in the convex hull of its ends and of two points between them (Bezier).
        inner = np.array([q[:-1] + timestep / 3.0 * qd[:-1], q[1:] - timestep / 3.0 * qd[1:]])
        near = (arm.space.angles(inner) > arm.position_limits[balls[:, 0], 1]).any(axis=(0, 2))
        turns = np.append(turns, np.flatnonzero(near)[:, None] + np.linspace(0.0, 1.0, 65)[1:-1])
    if len(turns):
        _check_positions(arm, timestep * turns, cubics.at(turns)[0])
    too_fast: list[tuple[float, str]] = []
    words = (("move", "/s"), ("accelerate", "/s^2"), ("jerk", "/s^3"), ("move", "/s"))
    rates = (*rates_and_limits(arm, qd, timestep), (cubics.fastest() / timestep, arm.velocity_limits, 1.0))
    for (what, suffix), (values, limits, power) in zip(words, rates, strict=True):
        ratio = np.abs(values) / limits
        k, joint = map(int, np.unravel_index(ratio.argmax(), ratio.shape))
        if ratio[k, joint] > 1.0 + LIMIT_TOLERANCE:
            unit = arm.unit(joint) + suffix
            reason = (
                f"joint {arm.joint_names[joint]!r} would {what} at {abs(values[k, joint]):.3g} {unit} at "
                f"t = {t[k]:.2f} s, its limit is {limits[joint]:.3g} {unit}"
            )
            too_fast.append((t[-1] * ratio[k, joint] ** power, reason))
    if too_fast:
        raise _too_fast(*max(too_fast))


def unexplained_steps(t: Floats, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    """Steps ``(K - 1, n)`` between samples, and their excess over twice what the rates at their ends explain.

    Where the excess is large, a step leads to another of two configurations that are equally near to a network's state.
    """
    step, speed = np.abs(np.diff(q, axis=0)), np.maximum(np.abs(qd[1:]), np.abs(qd[:-1]))
    return step, step - 2.0 * np.diff(t)[:, None] * speed


def _too_fast(enough: float, reason: str) -> TooFastError:
    return TooFastError(f"{reason}; a duration of at least {enough:.2f} s keeps it", float(enough))


def _check_positions(arm: Arm, t: Floats, q: Floats) -> None:
    """Raise `PlanError` where joints ``(K, n)`` are beyond a limit at times ``(K,)``."""
    outside = arm.limit_excess(q)
    k, joint = map(int, np.unravel_index(outside.argmax(), outside.shape))
    if outside[k, joint] > LIMIT_TOLERANCE:
        raise PlanError(f"at t = {t[k]:.2f} s {arm.describe_excess(q[k], joint)}")


def _check_leaving(arm: Arm, t: Floats, q: Floats) -> None:
    """Raise `PlanError` where a motion comes nearer again to what it leaves (`Arm.leaving`)."""
    rounding = 1e-5  # of MuJoCo's distances between meshes [m]
    furthest = np.asarray(-np.inf)
    for time, distances in zip(t, arm.left_along(q), strict=True):
        if (distances < furthest - rounding).any():
            raise PlanError(f"at t = {time:.2f} s the arm would come nearer again to what it is near at the start")
        furthest = np.maximum(furthest, distances)
