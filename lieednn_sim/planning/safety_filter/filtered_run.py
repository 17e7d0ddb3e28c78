"""A run of a network through the safety filter: the network gives the path, and the filter keeps the arm safe on it.

The network is autonomous and proved to arrive, so its path and pace are known beforehand (`NetworkPath`). The filter
changes the clock of the reference: the further the joints are behind, the slower the clock runs, so the reference stays
near the joints. The clock never stops, so the network arrives, and its equilibrium stays the attractor. Joints held
back by the filter move to the network's present state with bounded velocity.

During the run the network may be retargeted by its bias. Then its visible neurons take their state from the arm's
present configuration, and the hidden ones continue.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.budget import check_time
from lieednn_sim.errors import PlanError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion
from lieednn_sim.planning.network_path import NetworkPath, require_fit
from lieednn_sim.planning.safety_filter.barriers import FilterOptions
from lieednn_sim.planning.safety_filter.filter import SafetyFilter
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen

# Pull of the joints towards the network's state [1/s], and the fraction of the acceleration limits left for braking.
_TRACKING_GAIN = 8.0
_BRAKING_FRACTION = 0.5
# Lag of the joints at which the clock would stop [s, at full speed], and the least fraction of its pace.
_STOPPING_LAG = 0.15
_LEAST_PACE = 0.3
# The run has arrived when every joint is this close [rad, m] and this slow [rad/s, m/s].
_ARRIVAL_DISTANCE = 1e-4
_ARRIVAL_SPEED = 5e-3
# Distance at which an intermediate configuration counts as passed [s, at full speed]: a fraction of the distance to the
# next one, within these bounds.
_PASSING_DISTANCE, _LEAST_PASSING_DISTANCE, _PASSING_FRACTION = 0.02, 0.001, 0.2
# Least time between two configurations, as a fraction of the mean.
_LEAST_DURATION_FRACTION = 0.4
# After the network's arrival, the arm is blocked if its distance does not shrink by this fraction in this time [s].
_LEAST_PROGRESS = 0.02
_PROGRESS_TIME = 0.4


@frozen
class FilteredRun:
    """Outcome of a network's run through the filter.

    Attributes:
        success: whether the joints came to rest at the target.
        message: how the run ended, and what blocked it if it was blocked.
        blocked_by: position limits and pairs of geoms that hold the arm back, the strongest first; empty on success.
        t: ``(K,)`` times of the control steps [s].
        q: ``(K, n)`` joint positions [rad, m].
        qd: ``(K, n)`` joint velocities [rad/s, m/s], linear within a control step, where q is quadratic.
        clock: ``(K,)`` time of the reference that the network had reached [s].
        clearance: ``(K,)`` smallest distance [m] among the pairs that could come too close within the step, infinite if
            there are none; the last entry is the smallest distance of all pairs.
        filtered_fraction: fraction of the steps in which position limits or clearance changed the velocities.
        brakings: number of steps in which the filter could only brake.
        reference: the network's own motion, unfiltered; with intermediate configurations, its motions between them.
    """

    success: bool
    message: str
    blocked_by: tuple[str, ...]
    t: Floats
    q: Floats
    qd: Floats
    clock: Floats
    clearance: Floats
    filtered_fraction: float
    brakings: int
    reference: Motion

    def __repr__(self) -> str:
        steps = f"{len(self.t) - 1} control steps, {self.filtered_fraction:.0%} of them filtered"
        return f"<FilteredRun: {self.message}; {steps}, clearance at least {1e3 * self.clearance.min():.3g} mm>"


def run_filtered(
    arm: Arm,
    network: LieEDNN,
    start: ArrayLike,
    duration: float,
    *,
    via: ArrayLike = (),
    timestep: float = 0.01,
    max_time_scale: float = 3.0,
    options: FilterOptions | None = None,
) -> FilteredRun:
    """Run a network from rest at ``start`` ``(n,)`` to its equilibrium, with all limits and clearance enforced.

    Args:
        arm: the arm, with its obstacles.
        network: a network with as many visible neurons as the arm has links.
        start: joint position at rest.
        duration: duration of the motion if the filter changes nothing [s].
        via: intermediate joint positions ``(V, n)``: the network is retargeted to one after another, each time from the
            arm's configuration when it has come close to the previous one, and finally to its own equilibrium.
        timestep: control step [s].
        max_time_scale: number of durations after which the run ends, arrived or not.
        options: settings of the filter.

    Raises:
        InputError: a value is malformed, the start is out of the arm's reach, or something touches at start or end.
        PlanError: the network has no equilibrium that the arm can be at, or does not arrive there by itself.
    """
    factor, n = as_positive("max_time_scale", max_time_scale), arm.n_joints
    passed = as_floats("via", via, (), batched=True)
    passed = as_floats("via", passed if passed.size else passed.reshape(0, n), ("V", n))
    q, v = arm.check_position(start, "start"), np.zeros(n)
    require_fit(arm, network)
    equilibrium = network.equilibrium(network.start(arm.encode(q)))
    if not equilibrium.success:
        raise PlanError(f"the network cannot be used for a motion: {equilibrium.message}")
    target = arm.decode(network.visible(equilibrium.xi)).q
    outside = arm.limit_excess(target)
    if outside.max() > LIMIT_TOLERANCE:
        reason = arm.describe_excess(target, int(outside.argmax()))
        raise PlanError(f"the network ends out of the arm's limits: {reason}")
    filter_ = SafetyFilter(arm, timestep, options)
    filter_.allow(q, target)
    networks = [*(network.retarget(arm.encode(configuration)) for configuration in passed), network]
    speeds, brakes = filter_.velocity_limits, _BRAKING_FRACTION * filter_.acceleration_limits
    lengths = np.abs(np.diff([q, *passed, target], axis=0) / speeds).max(axis=1)
    durations = as_positive("duration", duration) * _duration_fractions(lengths)
    # If the next segment is short, the arm must not start far beside it.
    closeness = np.clip(_PASSING_FRACTION * lengths[1:], _LEAST_PASSING_DISTANCE, _PASSING_DISTANCE)
    h = filter_.timestep
    segments = [_Segment(arm, networks[0], q, float(durations[0]), h)]
    segment, clock = segments[0], 0.0
    positions, velocities, clocks, clearances = [q], [v], [clock], [np.inf]
    filtered = brakings = 0
    blocked_by: tuple[str, ...] = ()
    success, message = False, ""
    best, since = np.inf, 0.0
    for k in range(1, int(np.ceil(factor * duration / h)) + 1):
        check_time()
        error = segment.path(clock) - q
        rate = (
            float(np.clip(1.0 - np.abs(error / speeds).max() / _STOPPING_LAG, _LEAST_PACE, 1.0))
            if clock < segment.end
            else 0.0
        )
        clock = min(clock + rate * h, segment.end)
        # Velocities at the end of the step are wanted, so the reference is read there.
        error = segment.path(clock) - q - 0.5 * h * v
        wanted = _bounded(_towards(error, brakes) + rate * segment.path(clock, 1), speeds)
        step = filter_.step(q, v, wanted)
        q, v = q + 0.5 * h * (v + step.velocity), step.velocity
        filtered, brakings = filtered + step.active, brakings + step.braked
        positions.append(q)
        velocities.append(v)
        clocks.append(segment.begun + clock)
        clearances.append(step.clearance)
        away = np.abs(segment.path(segment.end) - q)
        if len(segments) < len(networks) and (away / speeds).max() < closeness[len(segments) - 1]:
            segment = segment.next(networks[len(segments)], q, float(durations[len(segments)]), clock)
            segments.append(segment)
            clock, best = 0.0, np.inf
            continue
        if clock < segment.end:
            continue
        distance = away.max()
        if distance < _ARRIVAL_DISTANCE and np.abs(v).max() < _ARRIVAL_SPEED:
            success, message = True, f"arrived after {k * h:.2f} s"
            break
        if distance < (1.0 - _LEAST_PROGRESS) * best:
            best, since = distance, k * h
        elif k * h - since > _PROGRESS_TIME:
            blocked_by = step.blocking
            by = " and ".join(blocked_by[:2]) or "the acceleration limits"
            where = "the target" if len(segments) == len(networks) else f"intermediate configuration {len(segments)}"
            message = f"blocked by {by} after {k * h:.2f} s, {distance:.2g} (largest joint difference) from {where}"
            break
    else:
        blocked_by = step.blocking
        message = f"not at the target after {factor:g} times the duration"
        message += f"; held back by {' and '.join(blocked_by[:2])}" if blocked_by else ""
    steps = len(positions) - 1
    return FilteredRun(
        success=success,
        message=message,
        blocked_by=blocked_by,
        t=h * np.arange(steps + 1, dtype=np.float64),
        q=np.array(positions),
        qd=np.array(velocities),
        clock=np.array(clocks),
        # Steps measure the clearance at their beginning.
        clearance=np.array([*clearances[1:], min(filter_.clearance.collisions.clearance(q), np.inf)]),
        filtered_fraction=filtered / steps,
        brakings=brakings,
        reference=_joined([segment.reference for segment in segments]),
    )


class _Segment:
    """A network's own motion from a configuration; `reference` is cut when the arm has passed its end."""

    def __init__(self, arm: Arm, network: LieEDNN, q: Floats, duration: float, h: float, begun: float = 0.0) -> None:
        self._drawn = NetworkPath.integrate(arm, network, q)
        self.reference = self._drawn.timed(max(duration, 2.0 * h), h)
        self.path = CubicHermiteSpline(self.reference.t, self.reference.q, self.reference.qd)
        self.end = float(self.reference.t[-1])
        self.begun, self._h = begun, h

    def next(self, network: LieEDNN, q: Floats, duration: float, clock: float) -> _Segment:
        """The next segment, from this clock time of the present one; hidden neurons continue from their state."""
        count = max(min(int(clock / self._h) + 1, len(self.reference.t)), 2)
        arrays = {name: value[:count] for name, value in vars(self.reference).items() if name != "xi_target"}
        self.reference = Motion(**arrays, xi_target=self.reference.xi_target)
        hidden = self._drawn.states(self.reference.tau[-1:])[0, network.n_visible :]
        network = network.with_start(hidden)
        return _Segment(self._drawn.arm, network, q, duration, self._h, self.begun + count * self._h)


def _joined(segments: list[Motion]) -> Motion:
    """Motions one after another, a time step apart."""
    if len(segments) == 1:
        return segments[0]
    tau, step = 0.0, segments[0].timestep
    arrays: dict[str, list[Floats]] = {name: [] for name in vars(segments[0]) if name not in ("t", "xi_target")}
    for segment in segments:
        for name, parts in arrays.items():
            parts.append(getattr(segment, name) + (tau if name == "tau" else 0.0))
        tau += segment.tau[-1]
    whole = {name: np.concatenate(parts) for name, parts in arrays.items()}
    return Motion(t=step * np.arange(len(whole["q"]), dtype=np.float64), xi_target=segments[-1].xi_target, **whole)


def _duration_fractions(lengths: Floats) -> Floats:
    """Fractions of the duration for the segments, in proportion to their lengths, but none of them very small."""
    fractions = np.maximum(lengths / max(lengths.sum(), 1e-12), _LEAST_DURATION_FRACTION / len(lengths))
    return np.asarray(fractions / fractions.sum())


def _towards(error: Floats, brakes: Floats) -> Floats:
    """Velocities along the error ``(n,)``, proportional to it, from which the joints can brake before they arrive."""
    size = np.abs(error)
    fraction = np.sqrt(2.0 * brakes / np.maximum(size, 1e-12)).min()
    return min(_TRACKING_GAIN, float(fraction)) * error


def _bounded(velocity: Floats, speeds: Floats) -> Floats:
    """The velocity, scaled down as a whole if a joint is too fast."""
    return velocity / max(1.0, float(np.abs(velocity / speeds).max()))
