"""From a network to a joint trajectory that starts and ends at rest and takes a stated duration.

The network runs in its own time tau: its field starts with a step in velocity and arrives exponentially, never in
finite time. A robot does neither. So the path q(tau) that the network draws is kept, and run through by a minimum-jerk
law in its length l: l(t) = L sigma(t / T) with sigma = 10 s^3 - 15 s^4 + 6 s^5. The length measures joint velocities in
units of their limits, and the pace of the approach: where the joints turn back their velocity passes through
zero, and length alone would make them do so at once. The path is cut where the network is within `RESIDUAL` of its
equilibrium.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from lieednn_sim import storage
from lieednn_sim.arm import PLANNED_CLEARANCE, Arm
from lieednn_sim.budget import check_time
from lieednn_sim.errors import FileError, InputError, PlanError, TooFastError
from lieednn_sim.network import BlockNetwork, ComponentwiseNetwork
from lieednn_sim.network.dynamics import Trajectory
from lieednn_sim.validation import as_floats, as_positive, as_times
from lieednn_sim.values import Floats, frozen

# Share of a path's length and its slope, both ``(K,)``, at shares ``(K,)`` of the duration.
Law = Callable[[Floats], tuple[Floats, Floats]]

# Distance to the equilibrium at which the network's path is cut [network coordinates: rad, length_scale m].
RESIDUAL = 1e-8
# Positions may exceed a limit by this much [rad, m]: a target on a limit is reached up to the residual.
LIMIT_TOLERANCE = 1e-6
# A step between two samples that the velocities do not explain by this much is a jump [rad, m].
_JUMP = 0.02
# At a simulation step of 2 ms this is 200 s: more takes minutes to plan, and a table of results nobody needs.
_MAX_STEPS = 100_000
# Of the speed along a path, for each step of the integrator: between them the speed is interpolated with less order.
_SAMPLES_PER_STEP = 8


@frozen
class Motion:
    """A joint trajectory planned by a network, sampled at constant time steps.

    Attributes:
        t: ``(K,)`` [s].
        tau: ``(K,)`` the network's own time; of a planner without a network, its progress from 0 to 1.
        xi: ``(K, N, 6)`` states of the network's visible neurons, one for each link.
        xi_target: ``(N, 6)`` where these are at its equilibrium.
        q: ``(K, n)`` joint positions [rad, m].
        qd: ``(K, n)`` joint velocities [rad/s, m/s].
        gap_translation: ``(K, N)`` distance of the decoded poses from the joints' own set [m].
        gap_rotation: ``(K, N)`` the same as an angle [rad].
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
        k = len(as_times("t", self.t))
        n = len(as_floats("xi_target", self.xi_target, ("N", 6)))
        joints = as_floats("q", self.q, (k, "n")).shape[1]
        shapes: dict[str, tuple[int, ...]] = {
            "t": (k,),
            "tau": (k,),
            "xi": (k, n, 6),
            "xi_target": (n, 6),
            "q": (k, joints),
            "qd": (k, joints),
            "gap_translation": (k, n),
            "gap_rotation": (k, n),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, as_floats(name, getattr(self, name), shape))

    def __repr__(self) -> str:
        return (
            f"<Motion: {len(self.t)} samples in {self.t[-1]:g} s, {self.q.shape[1]} joints, {self.xi.shape[1]} links, "
            f"mechanism gap up to {1e3 * self.gap_translation.max():.3g} mm>"
        )

    @property
    def residual(self) -> float:
        """Largest coordinate of xi - xi_target left at the end."""
        return float(np.abs(self.xi[-1] - self.xi_target).max())

    @property
    def timestep(self) -> float:
        """Sampling period [s]."""
        return float(self.t[1] - self.t[0])

    def save(self, path: str | os.PathLike[str], made_from: Mapping[str, str] | None = None) -> None:
        """Write to an ``.npz`` file, atomically; ``made_from`` as for `storage.save_arrays`."""
        storage.save_arrays(path, "motion", vars(self), {}, made_from)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Motion:
        """Read a file of `save`; `FileError` when it is none."""
        arrays, _ = storage.load_arrays(path, "motion")
        names = tuple(cls.__dataclass_fields__)
        try:
            return cls(**dict(zip(names, storage.take(arrays, path, *names), strict=True)))
        except InputError as error:
            raise FileError(f"{path} is not a valid motion: {error}") from None


def minimum_jerk_law(s: Floats) -> tuple[Floats, Floats]:
    """Position and slope in s of the minimum-jerk law on [0, 1] (Flash and Hogan, J. Neuroscience 5(7), 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2


def law_of(motion: Motion, units: Floats) -> Law:
    """The law by which a motion runs through its path, whose length is that of its states in ``units`` ``(N, 6)``."""
    steps = np.linalg.norm(np.diff(motion.xi, axis=0) * units, axis=(-2, -1))
    length = np.append(0.0, np.cumsum(steps))
    s, share = motion.t / motion.t[-1], length / length[-1]
    slope = np.gradient(share, s, edge_order=2)
    slope[[0, -1]] = 0.0
    way = CubicHermiteSpline(s, share, np.maximum(slope, 0.0))
    rate = way.derivative()
    return lambda x: (np.clip(way(x), 0.0, 1.0), np.maximum(rate(x), 0.0))


@dataclass(frozen=True, eq=False)
class NetworkPath:
    """The path that a network draws for an arm, in the network's own time; `timed` makes motions of it.

    Attributes:
        arm: decodes states to joint positions.
        network: with as many visible neurons as the arm has links.
        origin: ``(N, 6)`` state of all neurons at the start.
        target: ``(N, 6)`` the network's equilibrium.
        way: the states from there to here and the speed along them, over tau; None where both are the same. The speed
            is that of the joints in units of their limits, with the pace of the approach, or the network's own.
    """

    arm: Arm
    network: ComponentwiseNetwork
    origin: Floats
    target: Floats
    way: tuple[Trajectory, PchipInterpolator] | None

    @classmethod
    def drawn(
        cls, arm: Arm, network: ComponentwiseNetwork, start: ArrayLike, units: Floats | None = None
    ) -> NetworkPath:
        """The path from joint position ``start`` ``(n,)``; errors as of `make_motion`.

        With ``units`` ``(N, 6)`` of the visible neurons' coordinates lengths are measured in these, as by `law_of`.
        """
        require_fit(arm, network)
        origin = network.start(arm.encode(arm.check_position(start, "start")))
        equilibrium = network.equilibrium(origin)
        if not equilibrium.success:
            raise PlanError(f"the network cannot be used for a motion: {equilibrium.message}")
        target = equilibrium.xi
        if np.abs(origin - target).max() <= RESIDUAL:
            return cls(arm, network, origin, target, None)
        # Far from the equilibrium the pace is gamma's, close to it the slowest eigenvalue's.
        pace = max(-equilibrium.spectral_abscissa, 1e-3 * network.gamma)
        longest = 100.0 / network.gamma + 40.0 / pace
        # The integrator's error, a share of the states, may keep it from a target with large entries: then a finer one.
        for rtol, atol in ((1e-8, 1e-10), (1e-10, 1e-10)):
            trajectory = network.trajectory(origin, longest, until=target, distance=RESIDUAL, rtol=rtol, atol=atol)
            arrived = np.abs(network.visible(trajectory.xi[-1] - target)).max() <= 2.0 * RESIDUAL
            if arrived:
                break
        if not arrived:
            raise PlanError(
                "the network does not arrive at its equilibrium from this start, or too slowly (spectral abscissa "
                f"{equilibrium.spectral_abscissa:.2g}); use another network"
            )
        fraction = np.arange(_SAMPLES_PER_STEP) / _SAMPLES_PER_STEP
        grid = (trajectory.t[:-1, None] + np.diff(trajectory.t)[:, None] * fraction).ravel()
        grid = np.append(grid, trajectory.t[-1])
        states = trajectory(grid)
        field = network.visible(network.vector_field(states))
        if units is None:
            weights = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, 1.0)
            rates = np.linalg.norm(arm.decode(network.visible(states), field).qd / weights, axis=-1)
            rates = np.hypot(rates, pace * np.linalg.norm(network.visible(states - target), axis=(-2, -1)))
        else:
            rates = np.linalg.norm(field * units, axis=(-2, -1))
        # Shape-preserving, so that the speed stays positive between its samples.
        speed = PchipInterpolator(grid, rates)
        return cls(arm, network, origin, target, (trajectory, speed))

    def state(self, tau: ArrayLike) -> Floats:
        """States ``(..., N, 6)`` of all neurons at the network's own times ``(...)``."""
        if self.way is None:
            return np.broadcast_to(self.origin, (*np.shape(tau), *self.origin.shape))
        return self.way[0](tau)

    def timed(self, duration: float, timestep: float, law: Law = minimum_jerk_law) -> Motion:
        """The motion along the path in ``duration``, sampled every ``timestep`` [s]; see `make_motion`.

        The law says which share of the path's length is behind it at which share of the duration.
        """
        steps = count_steps(duration, timestep)
        t = as_floats("t", timestep * np.arange(steps + 1), (steps + 1,))
        if self.way is None:
            tau, tau_rate = np.zeros_like(t), np.zeros_like(t)
        else:
            _, speed = self.way
            length = speed.antiderivative()
            total = float(length(speed.x[-1]))
            progress, progress_rate = law(t / t[-1])
            tau = _invert(length, speed, speed.x, total * progress)
            tau_rate = total * progress_rate / (t[-1] * np.maximum(speed(tau), 1e-300))
        states = self.state(tau)
        xi, rates = self.network.visible(states), self.network.visible(self.network.vector_field(states))
        decoded = self.arm.decode(xi, rates)
        qd = decoded.qd * tau_rate[:, None]
        qd[[0, -1]] = 0.0
        target = self.network.visible(self.target)
        return Motion(t, tau, xi, target, decoded.q, qd, decoded.gap_translation, decoded.gap_rotation)


def require_fit(arm: Arm, network: BlockNetwork) -> None:
    """Raise `InputError` unless the network has one visible neuron for each link of the arm."""
    if network.n_visible != arm.n_links:
        raise InputError(
            f"the network has {network.n_visible} visible neurons, arm {arm.name!r} has {arm.n_links} links"
        )


def make_motion(arm: Arm, network: ComponentwiseNetwork, start: ArrayLike, duration: float, timestep: float) -> Motion:
    """Decode the network's trajectory from joint position ``start`` ``(n,)`` and time it to ``duration`` [s].

    Args:
        arm: decodes states to joint positions.
        network: with as many visible neurons as the arm has links.
        start: joint position at rest.
        duration: of the motion [s], rounded to a whole number of time steps.
        timestep: sampling period [s], the simulation's step.

    Raises:
        InputError: start out of limits, or network and arm differ in size.
        PlanError: the network has no equilibrium or does not arrive there.
    """
    count_steps(duration, timestep)
    return NetworkPath.drawn(arm, network, start).timed(duration, timestep)


def count_steps(duration: float, timestep: float) -> int:
    """Number of time steps in ``duration`` [s], or `InputError` when there are less than 2 or too many to hold."""
    ratio = as_positive("duration", duration) / as_positive("timestep", timestep)
    if not 1.5 <= ratio <= _MAX_STEPS:
        raise InputError(
            f"duration must be between 2 and {_MAX_STEPS} time steps of {timestep:g} s, got {duration:g} s"
        )
    return round(ratio)


def least_duration(arm: Arm, start: Floats, target: Floats) -> float:
    """Time [s] from rest at ``start`` to rest at ``target``, both ``(n,)``, at the limits of velocity and acceleration.

    Every joint accelerates, cruises at its limit v where the way d >= v^2 / a, and brakes: d / v + v / a, else
    2 sqrt(d / a). No motion within the limits is faster.
    """
    way, v, a = np.abs(target - start), arm.velocity_limits, arm.acceleration_limits
    # Without a limit of velocity nothing cruises; without one of acceleration nothing takes time to start.
    peak = np.minimum(v, np.sqrt(way * np.minimum(a, 1e300)))
    return float((way / np.maximum(peak, 1e-300) + peak / a).max())


def _invert(length: PchipInterpolator, speed: PchipInterpolator, grid: Floats, wanted: Floats) -> Floats:
    """Tau with length(tau) = wanted, by bisection-safeguarded Newton steps on all samples at once."""
    known = length(grid)
    index = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(grid) - 2)
    low, high = grid[index].copy(), grid[index + 1].copy()
    tau = 0.5 * (low + high)
    for _ in range(60):
        error = length(tau) - wanted
        low, high = np.where(error < 0.0, tau, low), np.where(error >= 0.0, tau, high)
        newton = tau - error / np.maximum(speed(tau), 1e-300)
        trial = np.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
        if np.abs(trial - tau).max() <= 1e-14 * grid[-1]:
            break
        tau = trial
    tau[0], tau[-1] = grid[0], grid[-1]
    return tau


def check_motion(arm: Arm, motion: Motion) -> None:
    """Check position, velocity and acceleration limits and `PLANNED_CLEARANCE` at every sample of a motion.

    A motion whose nearest posture jumps from one sample to the next is refused: where two postures are equally near to
    the network's state the joints cannot follow, and neither branch is better.

    Raises:
        TooFastError: only velocity or acceleration is too high; it knows the duration that keeps them.
        PlanError: names the joint or bodies, the value and the bound.
    """
    outside = arm.limit_excess(motion.q)
    k, joint = map(int, np.unravel_index(outside.argmax(), outside.shape))
    if outside[k, joint] > LIMIT_TOLERANCE:
        raise PlanError(f"at t = {motion.t[k]:.2f} s {arm.describe_excess(motion.q[k], joint)}")
    _check_continuity(arm, motion)
    acceleration = np.diff(motion.qd, axis=0) / motion.timestep
    too_fast: list[tuple[float, str]] = []
    # A duration T scales velocities by 1 / T and accelerations by 1 / T^2.
    for what, values, limits, power, suffix in (
        ("move", motion.qd, arm.velocity_limits, 1.0, "/s"),
        ("accelerate", acceleration, arm.acceleration_limits, 0.5, "/s^2"),
    ):
        ratio = np.abs(values) / limits
        k, joint = map(int, np.unravel_index(ratio.argmax(), ratio.shape))
        if ratio[k, joint] > 1.0 + LIMIT_TOLERANCE:
            unit = arm.unit(joint) + suffix
            reason = (
                f"joint {arm.joint_names[joint]!r} would {what} at {abs(values[k, joint]):.3g} {unit} at "
                f"t = {motion.t[k]:.2f} s, its limit is {limits[joint]:.3g} {unit}"
            )
            too_fast.append((motion.t[-1] * ratio[k, joint] ** power, reason))
    if too_fast:
        enough, reason = max(too_fast)
        raise TooFastError(f"{reason}; a duration of at least {enough:.2f} s keeps it", float(enough))
    for k, touching in enumerate(arm.near_contacts_along(motion.q)):
        check_time()
        if touching:
            raise PlanError(
                f"{touching[0][0]!r} would come within {1e3 * PLANNED_CLEARANCE:g} mm of {touching[0][1]!r} at "
                f"t = {motion.t[k]:.2f} s"
            )


def _check_continuity(arm: Arm, motion: Motion) -> None:
    """Refuse a step that the velocities at its ends cannot explain twice over."""
    step = np.abs(np.diff(motion.q, axis=0))
    speed = np.maximum(np.abs(motion.qd[1:]), np.abs(motion.qd[:-1]))
    unexplained = step - 2.0 * motion.timestep * speed
    k, joint = map(int, np.unravel_index(unexplained.argmax(), unexplained.shape))
    if unexplained[k, joint] > _JUMP:
        raise PlanError(
            f"joint {arm.joint_names[joint]!r} would jump by {step[k, joint]:.3g} {arm.unit(joint)} at "
            f"t = {motion.t[k + 1]:.2f} s, where the nearest posture changes abruptly"
        )
