"""From a curve, or several, to a certified network that follows it.

The network is a cascade: hidden neurons switch one after another as they come to rest, and steer the visible ones
(`cascade`). Its equilibrium and its certificate hold by construction for all parameters, so the fit is unconstrained;
it may miss the curve, and the result says by how much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.budget import check_time, cpu_time
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.synthesis.shaping.assembly import assemble
from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters, clockwork
from lieednn_sim.synthesis.shaping.curve import Curve
from lieednn_sim.synthesis.shaping.fit import Descent
from lieednn_sim.synthesis.shaping.placed_switches import fit_placed_switches
from lieednn_sim.synthesis.shaping.start import starting_point
from lieednn_sim.validation import Seed, as_count, as_floats, as_generator, as_positive, quoted
from lieednn_sim.values import Floats, frozen

# Fraction of the requested deviation at which the fit aims, since it sees only about seventy instants.
_GOAL_FRACTION = 0.7
# Refinement of the clock for placed switches, whose ripples are short.
_REFINEMENT = 2
# Samples at which deviations between the network's path and the curve are measured.
_SAMPLES = 1000
# States of the network's trajectory from which its path is tabulated.
_PATH_SAMPLES = 4000
# Network time, times rho, after which less than a micrometre of a path of a metre is left.
_NETWORK_TIME = 16.0
# Least weight of a deviation relative to the largest, however far demonstrations are apart.
_LEAST_WEIGHT = 0.1


@dataclass(frozen=True)
class ShapingOptions:
    """Options of `shape`.

    Attributes:
        rate: rho in (0, 1], the rate at which the hidden neurons' clock runs down. With 1 it is as fast as the
            visible neurons, which return to the target after a push. With less they return to the path after a push,
            1/rho times as fast as they move along it.
        neurons: numbers of hidden neurons besides the clock, tried in turn by a descent on all parameters.
        placed_neurons: larger numbers, tried where those do not suffice: switches are placed along the curve
            beforehand, which leaves a linear problem.
        iterations: largest number of iterations of a descent.
        activation: a name of `network.ACTIVATIONS`.

    Raises:
        InputError: a value is out of range.
    """

    rate: float = 1.0
    neurons: tuple[int, ...] = (2, 4, 8, 16)
    placed_neurons: tuple[int, ...] = (32, 48, 64)
    iterations: int = 80
    activation: str = DEFAULT_ACTIVATION

    def __post_init__(self) -> None:
        if not 0.01 <= as_positive("rate", self.rate) <= 1.0:
            raise InputError(f"rate must be from 0.01 to 1, got {self.rate:g}")
        if not self.neurons and not self.placed_neurons:
            raise InputError("neurons or placed_neurons must hold at least one number of hidden neurons")
        for name, least, most in (("neurons", 1, 64), ("placed_neurons", 2, 256)):
            for count in getattr(self, name):
                if as_count(name, count, least=least) > most:
                    raise InputError(f"{name} must be at most {most}, got {count}")
        as_count("iterations", self.iterations)
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
        rms: root mean square distance of the network's path from the curve, over its length [m].
        placed: whether the network's switches were placed along the curve beforehand.
        tries: number of network sizes tried.
        iterations: iterations of all descents together.
        cpu_time: CPU time of the search [s].
    """

    success: bool
    message: str
    network: LieEDNN
    parameters: Parameters = field(repr=False)
    deviation: float
    rms: float
    placed: bool
    tries: int
    iterations: int
    cpu_time: float

    def unwrap(self) -> LieEDNN:
        """The network, or `NotCertifiedError` with the reason when it deviates by more than requested."""
        if not self.success:
            raise NotCertifiedError(self.message)
        return self.network


def shape(
    curves: ArrayLike | Sequence[ArrayLike],
    deviation: float = 1e-3,
    *,
    units: ArrayLike = 1.0,
    spread: ArrayLike | None = None,
    options: ShapingOptions | None = None,
    seed: Seed = 0,
) -> Shaping:
    """Make a certified network whose visible neurons follow a curve from its first point to its last.

    Only the curve matters, not the times of its samples: a time law of `planning` decides the speed along it.

    Args:
        curves: samples ``(K, N, 6)`` of a curve, or a sequence of such arrays with demonstrations of one motion: the
            network follows their mean at equal fractions of their lengths, more closely where they agree.
        deviation: largest deviation requested [m]; neurons are added until it is met.
        units: metres that one unit of each coordinate counts for, of a shape that broadcasts to ``(N, 6)``: the lever
            arm of a rotation, the length scale of a translation.
        spread: ``(K,)`` distance of demonstrations from each sample of a single curve that is their mean [m]; where it
            is small, the network follows the curve more closely.
        options: options of the search.
        seed: seed of the starts; the same seed gives the same network.

    Returns:
        The outcome. Its network is certified even if it deviates by more than requested.

    Raises:
        InputError: a value is malformed, a curve does not move, or the curves have different numbers of neurons.
        OutOfTimeError: the time budget is spent.
    """
    begun = cpu_time()
    chosen = ShapingOptions() if options is None else options
    goal, rng = as_positive("deviation", deviation), as_generator("seed", seed)
    with one_blas_thread():
        curve = as_curve(curves, units, spread)
        clocks = partial(clockwork, float(chosen.rate), activation=ACTIVATIONS[chosen.activation])
        cascade = Cascade(clocks(1), curve.points[0], curve.points[-1])
        best: tuple[float, float, LieEDNN, Parameters] | None = None
        tries = best_try = iterations = 0

        def candidates() -> Iterator[Parameters]:
            nonlocal iterations
            for count in chosen.neurons:
                first = starting_point(cascade, curve, count, rng)
                fit = Descent(cascade, curve).run(first, chosen.iterations, _GOAL_FRACTION * goal)
                iterations += fit.iterations
                yield fit.parameters
            fine = Cascade(clocks(_REFINEMENT), curve.points[0], curve.points[-1])
            for count in chosen.placed_neurons:
                check_time()
                yield fit_placed_switches(fine, curve, count)

        for parameters in candidates():
            tries += 1
            made = *_measured(parameters, chosen, curve), parameters
            if best is None or made[0] < best[0]:
                best, best_try = made, tries
            if best[0] <= goal:
                break
    assert best is not None
    found, rms, network, parameters = best
    hidden = network.n_hidden - network.n_clock
    success = found <= goal
    message = (
        f"within {1e3 * found:.3g} mm of the curve with {hidden} hidden neurons"
        if success
        else f"{1e3 * found:.3g} mm off the curve, {1e3 * goal:.3g} mm were asked for: the best of {tries} tries, "
        f"with {hidden} hidden neurons; allow more by `placed_neurons` or `neurons`"
    )
    if not network.certified:
        raise NotCertifiedError(f"the closed-form certificate does not hold ({network.certificate}); curve too large")
    return Shaping(
        success,
        message,
        network,
        parameters,
        found,
        rms,
        best_try > len(chosen.neurons),
        tries,
        iterations,
        cpu_time() - begun,
    )


def as_curve(curves: ArrayLike | Sequence[ArrayLike], units: ArrayLike, spread: ArrayLike | None = None) -> Curve:
    """The curve through samples ``(K, N, 6)``, or the mean of several; raises as `shape`."""
    alone = isinstance(curves, np.ndarray) and curves.ndim == 3
    if not isinstance(curves, Sequence | np.ndarray) or (isinstance(curves, np.ndarray) and curves.ndim == 0):
        raise InputError(f"curves must be an array (K, N, 6) or a sequence of such arrays, got {quoted(curves)}")
    several: Sequence[Any] = [curves] if alone else curves  # type: ignore[assignment]
    if len(several) == 0:
        raise InputError("curves must hold at least one array (K, N, 6)")
    checked = [as_floats("curves", one, ("K", "N", 6)) for one in several]
    n = checked[0].shape[1]
    if n == 0 or any(one.shape[1] != n or len(one) < 2 for one in checked):
        raise InputError("curves must have at least two samples each, and all the same number N >= 1 of neurons")
    try:
        scale = as_floats("units", np.broadcast_to(as_floats("units", units, (), batched=True), (n, 6)), (n, 6)).copy()
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"units must be positive numbers of a shape that broadcasts to ({n}, 6): {error}") from None
    if not (scale > 0.0).all():
        raise InputError(f"units must be positive, the smallest is {scale.min():g}")
    if spread is not None:
        if len(checked) > 1:
            raise InputError("spread is for a single curve; for several it is computed from them")
        apart = as_floats("spread", spread, (len(checked[0]),))
        if apart.min() < 0.0:
            raise InputError(f"spread must not be negative, the smallest is {apart.min():g}")
        return Curve.through(checked[0], scale, _trust(apart))
    each = [Curve.through(one, scale) for one in checked]
    if len(each) == 1:
        return each[0]
    points = np.array([one.points for one in each])
    mean = points.mean(axis=0)
    return Curve.through(
        mean, scale, _trust(np.sqrt(np.mean(np.sum(((points - mean) * scale) ** 2, axis=(2, 3)), axis=0)))
    )


def _trust(spread: Floats) -> Floats:
    """Weights ``(K,)`` of deviations where demonstrations are ``spread`` ``(K,)`` [m] from their mean."""
    # A little is added, so that a sample where all demonstrations agree exactly does not take all the weight.
    spread = spread + _LEAST_WEIGHT * spread.mean() + 1e-12
    return np.maximum(spread.min() / spread, _LEAST_WEIGHT)


def _measured(parameters: Parameters, options: ShapingOptions, curve: Curve) -> tuple[float, float, LieEDNN]:
    """Deviation, its root mean square, and the network, by integrating the network."""
    network = assemble(parameters, options.rate, curve.points[-1], options.activation)
    trajectory = network.trajectory(network.start(curve.points[0]), _NETWORK_TIME / options.rate, rtol=1e-7, atol=1e-9)
    # Closer together at first, where it is fast.
    t = trajectory.t[-1] * np.linspace(0.0, 1.0, _PATH_SAMPLES) ** 3
    path = Curve.through(network.visible(trajectory(t)), curve.units)
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    off, back = (_distances(one.at(fractions)[0], other, fractions) for one, other in ((path, curve), (curve, path)))
    return float(max(off.max(), back.max())), float(np.sqrt(np.mean(off**2))), network


def _distances(points: Floats, curve: Curve, fractions: Floats) -> Floats:
    """Distances ``(K,)`` [m] of points ``(K, N, 6)`` from a curve near the given fractions of its length."""
    nearest, _ = curve.at(curve.feet(points, fractions))
    return np.asarray(np.linalg.norm(((points - nearest) * curve.units).reshape(len(points), -1), axis=1))
