"""From a curve to a certified network that follows it.

The network is a cascade: hidden neurons switch one after another as they come to rest, and steer the visible ones
(`cascade`). Its equilibrium and its certificate hold by construction for all parameters, so the fit is unconstrained;
it may miss the curve, and the result says by how much. `docs/mathematics/shaped.md` explains the fit: switches are
placed along the curve first, each of them a turn or a shift, so that linear least squares remain.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy  # whose ndimage is loaded when it is used
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from lieednn_sim.budget import check_time, cpu_time, one_blas_thread
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters, assemble, clockwork, turns_to
from lieednn_sim.synthesis.shaping.curve import Curve, as_units, clock_along, third_derivative
from lieednn_sim.validation import as_count, as_floats, as_positive
from lieednn_sim.values import Floats, frozen

_SAMPLES = 1000  # samples at which deviations between the network's path and the curve are measured
# Pieces over which curvature is computed, and the fraction of the length over which it is smoothed.
_PIECES, _SMOOTHING = 512, 0.01
# Bound on slopes: the steepest switch spans a sixtieth of the path, twice the resolution of `cascade`.
LARGEST_SLOPE = 60.0
_LEAST_DENSITY = 0.1  # switches' density: root of the curve's second derivative + this + this fraction of its mean
_RIPPLE = 0.03  # ripples shorter than 2 pi times this fraction of the clock count more than deviations
# Number of instants at which ripples are penalised, nearly even down to where g is this small.
_INSTANTS, _LEAST_CLOCK = 120, 0.01
_RIDGE = 1e-9  # weight of the squared readouts


@dataclass(frozen=True)
class ShapingOptions:
    """Options of `shape`.

    Attributes:
        rate: rho in (0, 1], the rate at which the hidden neurons' clock runs down. With 1 it is as fast as the visible
            neurons, which go to the target after a push. With less, they return to the path after a push, 1/rho times
            as fast as they move along it.
        neurons: numbers of hidden neurons besides the clock, tried in turn.
        activation: a name of `network.ACTIVATIONS`.
    """

    rate: float = 1.0
    neurons: tuple[int, ...] = (8, 16, 32, 48, 64)
    activation: str = DEFAULT_ACTIVATION

    def __post_init__(self) -> None:
        if not 0.01 <= as_positive("rate", self.rate) <= 1.0:
            raise InputError(f"rate must be from 0.01 to 1, got {self.rate:g}")
        if not self.neurons:
            raise InputError("neurons must hold at least one number of hidden neurons")
        for count in self.neurons:
            if as_count("neurons", count, least=2) > 256:
                raise InputError(f"neurons must be at most 256, got {count}")
        as_activation(self.activation)


@frozen
class Shaping:
    """Result of `shape`.

    Attributes:
        success: whether the requested deviation was met.
        message: the outcome in words.
        network: the best network found; always certified.
        parameters: parameters of its cascade.
        deviation: largest distance of a point of the network's path from the curve, or of the curve from the path [m].
        options: the options of the search, with the number of neurons that was chosen.
        cpu_time: CPU time of the search [s].
    """

    success: bool
    message: str
    network: LieEDNN
    parameters: Parameters = field(repr=False)
    deviation: float
    options: ShapingOptions
    cpu_time: float

    def unwrap(self) -> LieEDNN:
        """The network, or `NotCertifiedError` with the reason when it deviates by more than requested."""
        if not self.success:
            raise NotCertifiedError(self.message)
        return self.network


def shape(
    curve: ArrayLike, deviation: float = 1e-3, *, units: ArrayLike = 1.0, options: ShapingOptions | None = None
) -> Shaping:
    """Make a certified network whose visible neurons follow a curve from its first point to its last.

    Only the curve matters, not the times of its samples: a time law of `planning` decides the speed along it.

    Args:
        curve: samples ``(K, N, 6)``.
        deviation: largest deviation requested [m]; neurons are added until it is met.
        units: metres that one unit of each coordinate counts for, of a shape that broadcasts to ``(N, 6)``: the lever
            arm of a rotation, the length scale of a translation.
        options: options of the search.

    Returns:
        The outcome. Its network is certified even if it deviates by more than requested.

    Raises:
        InputError: a value is malformed, or the curve does not move.
        OutOfTimeError: the time budget is spent.
    """
    start, goal = cpu_time(), as_positive("deviation", deviation)
    chosen = ShapingOptions() if options is None else options
    with one_blas_thread():
        samples = as_floats("curve", curve, ("K", "N", 6))
        n = samples.shape[1]
        if n == 0 or len(samples) < 2:
            raise InputError(f"curve must have at least two samples of at least one neuron, got shape {samples.shape}")
        path = Curve.through(samples, as_units(units, n))
        clock = clockwork(float(chosen.rate), ACTIVATIONS[chosen.activation])
        cascade = Cascade(clock, path.points[0], path.points[-1])
        best: tuple[float, LieEDNN, Parameters] | None = None
        for count in chosen.neurons:
            check_time()
            parameters = fit_switches(cascade, path, count)
            result = *_measured(parameters, chosen, path), parameters
            if best is None or result[0] < best[0]:
                best = result
            if best[0] <= goal:
                break
    assert best is not None
    nearest, network, parameters = best
    if not network.certified:
        raise NotCertifiedError(f"the closed-form certificate does not hold ({network.certificate}); curve too large")
    hidden = network.n_hidden - network.n_clock
    message = (
        f"within {1e3 * nearest:.3g} mm of the curve with {hidden} hidden neurons"
        if nearest <= goal
        else f"{1e3 * nearest:.3g} mm off the curve with {hidden} hidden neurons, {1e3 * goal:.3g} mm were asked for; "
        "ask for a larger deviation, or allow more neurons"
    )
    chosen = replace(chosen, neurons=(hidden,))
    return Shaping(nearest <= goal, message, network, parameters, nearest, chosen, cpu_time() - start)


def _measured(parameters: Parameters, options: ShapingOptions, curve: Curve) -> tuple[float, LieEDNN]:
    """Deviation, and the network, by integrating it."""
    network = assemble(parameters, options.rate, curve.points[-1], options.activation)
    network_time = 16.0  # network time, times rho, after which less than a micrometre of a path of a metre is left
    trajectory = network.trajectory(network.start(curve.points[0]), network_time / options.rate, rtol=1e-7, atol=1e-9)
    t = trajectory.t[-1] * np.linspace(0.0, 1.0, 4000) ** 3  # denser at first, where the motion is fast
    path = Curve.through(network.visible(trajectory(t)), curve.units)
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    off, back = (_distances(item.at(fractions)[0], other, fractions) for item, other in ((path, curve), (curve, path)))
    return float(max(off.max(), back.max())), network


def _distances(points: Floats, curve: Curve, fractions: Floats) -> Floats:
    """Distances ``(K,)`` [m] of points ``(K, N, 6)`` from a curve near the given fractions of its length."""
    nearest, _ = curve.at(curve.feet(points, fractions))
    return np.asarray(np.linalg.norm(((points - nearest) * curve.units).reshape(len(points), -1), axis=1))


def fit_switches(cascade: Cascade, curve: Curve, n_switches: int) -> Parameters:
    """Parameters of the cascade with ``n_switches`` switches placed along the curve whose path is nearest to it."""
    n, m, clock = curve.points.shape[1], n_switches, cascade.clock
    pace, w = _pace(curve), 1.0 - clock.g
    goal, _ = curve.at(pace(w))
    # The last row is the tail, which should vanish.
    missing = np.concatenate([goal - cascade.free[:-1], np.zeros((1, n, 6))])
    # Nearly even instants, so that close ones dominate no difference.
    looks = np.unique(np.abs(w[:, None] - np.linspace(0.0, 1.0 - _LEAST_CLOCK, _INSTANTS)).argmin(axis=0))
    ripples = third_derivative(w[looks])
    a, c, read = np.zeros((m, 6)), np.zeros((m, 6)), np.zeros((n, m, 3))
    # Equal numbers of turns and shifts if the curve has both.
    halves = [half for half in (slice(0, 3), slice(3, 6)) if np.ptp(curve.points[..., half], axis=0).max() > 0.0]
    for half, chosen in zip(halves, np.array_split(np.arange(m), len(halves)), strict=True):
        place, slope = _switches(curve, pace, half, len(chosen))
        lead = half.start
        c[chosen, lead], a[chosen, lead] = slope, -slope * (1.0 - place)
        outputs = cascade.switched(a[chosen, lead], c[chosen, lead])
        target = missing[..., half].reshape(len(missing), -1)
        left, right = (np.concatenate([side, _RIPPLE**3 * (ripples @ side[looks])]) for side in (outputs, target))
        ridge = np.sqrt(_RIDGE) * np.eye(len(chosen))
        readouts = np.linalg.lstsq(
            np.concatenate([left, ridge]), np.concatenate([right, np.zeros((len(chosen), 3 * n))]), rcond=None
        )[0]
        read[:, chosen] = readouts.reshape(-1, n, 3).transpose(1, 0, 2)
    return Parameters(a, c, np.linalg.norm(read, axis=-1), turns_to(read))


def _pace(curve: Curve) -> CubicSpline:
    """Fraction of the curve's length as a function of the fraction of the clock: slower where the curve turns."""
    s = np.linspace(0.0, 1.0, _PIECES + 1)
    points = (curve.at(s)[0] * curve.units).reshape(len(s), -1)
    # Turns make room for switches in a sharp corner, where a motion is slow anyway.
    return CubicSpline(clock_along(points, per_turn=0.03, smoothing=_SMOOTHING), s)


def _switches(curve: Curve, pace: CubicSpline, half: slice, count: int) -> tuple[Floats, Floats]:
    """Positions of the switches, as fractions ``(count,)`` of the clock, and their slopes."""
    w = np.linspace(0.0, 1.0, _PIECES // 4 + 1)
    points = (curve.at(pace(w))[0] * curve.units)[:, :, half].reshape(len(w), -1) / curve.length
    second = np.linalg.norm(np.diff(points, n=2, axis=0), axis=1) / w[1] ** 2
    density = np.sqrt(scipy.ndimage.gaussian_filter1d(np.pad(second, 1, mode="edge"), 3.0, mode="nearest"))
    density += _LEAST_DENSITY * density.mean() + _LEAST_DENSITY
    mass = np.append(0.0, np.cumsum(0.5 * (density[1:] + density[:-1])))
    edges = np.interp(np.linspace(0.0, mass[-1], 2 * count + 1), mass, w)
    # Slopes follow the density of switches, and are at least 1: without overlap the path would ripple.
    return edges[1::2], np.clip(1.0 / (edges[2::2] - edges[:-2:2]), 1.0, LARGEST_SLOPE)
