"""From a curve, or several, to a certified network that follows it.

The network is a cascade: hidden neurons switch one after another on their own way to rest, and steer the visible ones
(`cascade`). Its equilibrium and its certificate hold by construction for all values of the parameters, so the fit has
no constraint; what it may miss is the curve, and the result says by how much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.budget import check_time, cpu_time
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis.shaping.assembly import assemble
from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters, clockwork
from lieednn_sim.synthesis.shaping.curve import Curve
from lieednn_sim.synthesis.shaping.fit import Descent
from lieednn_sim.synthesis.shaping.placed import placed
from lieednn_sim.synthesis.shaping.start import starting_point
from lieednn_sim.validation import as_count, as_floats, as_generator, as_positive, quoted
from lieednn_sim.values import frozen

Floats = NDArray[np.float64]

# The fit looks at some seventy instants and aims at this share of the deviation asked for, since there are others.
_AIM = 0.7
# Placed switches are many, and their ripples short: so many times as many instants.
_REFINEMENT = 2
# Samples of the network's way between which and the curve deviations are measured.
_SAMPLES = 1000
# States of the way from which they are taken.
_WAY_SAMPLES = 4000
# Network time after which what is left of the way is below a micrometre of a metre's, over rho.
_SPAN = 16.0
# Of several curves: no weight is less than this share of the largest, however far they are apart.
_LEAST_WEIGHT = 0.1


@dataclass(frozen=True)
class ShapingOptions:
    """How `shape` searches.

    Attributes:
        rate: rho in (0, 1], at which the hidden neurons' clock runs down: 1 goes on with the visible neurons, which
            after a push return to the target; with less they return to the path 1/rho times as fast as they move on.
        neurons: numbers of hidden neurons beside the clock, tried one after another by a descent on all parameters.
        placed: larger numbers, tried where those do not suffice: switches are placed along the curve beforehand, and
            what is left is a linear problem.
        iterations: of the descent, at most, from each start.

    Raises:
        InputError: a value is out of range.
    """

    rate: float = 1.0
    neurons: tuple[int, ...] = (2, 4, 8, 16)
    placed: tuple[int, ...] = (32, 48, 64)
    iterations: int = 80

    def __post_init__(self) -> None:
        if not 0.01 <= as_positive("rate", self.rate) <= 1.0:
            raise InputError(f"rate must be from 0.01 to 1, got {self.rate:g}")
        if not self.neurons and not self.placed:
            raise InputError("neurons or placed must hold at least one number of hidden neurons")
        for name, least, most in (("neurons", 1, 64), ("placed", 2, 256)):
            for count in getattr(self, name):
                if as_count(name, count, least=least) > most:
                    raise InputError(f"{name} must be at most {most}, got {count}")
        as_count("iterations", self.iterations)


@frozen
class Shaping:
    """Result of `shape`.

    Attributes:
        success: whether the deviation asked for was met.
        message: how it ended.
        network: the best network found; certified in any case.
        deviation: largest distance of network's way and curve, either from the other, in the metric [m].
        rms: root mean square of the distances of the network's way from the curve, even over its length [m].
        placed: whether the network's switches are placed ones.
        tries: numbers of neurons tried.
        iterations: of the descents, together.
        seconds: CPU time.
    """

    success: bool
    message: str
    network: LieEDNN
    deviation: float
    rms: float
    placed: bool
    tries: int
    iterations: int
    seconds: float

    def unwrap(self) -> LieEDNN:
        """The network, or `NotCertifiedError`, with the reason, when it deviates by more than was asked for."""
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
    seed: int | np.random.Generator = 0,
) -> Shaping:
    """Make a certified network whose visible neurons, started on a curve's first point, follow it to its last.

    Only the curve counts, not the times of its samples: how fast it is run through is for a law of time (`planning`).

    Args:
        curves: samples ``(K, N, 6)`` of a curve, or a sequence of such arrays, several demonstrations of one motion:
            the network follows their mean at equal shares of their lengths, more closely where they agree.
        deviation: asked for [m]; neurons are added until it is met.
        units: ``(N, 6)``, or of a shape that broadcasts to it, metres that count for one unit of each coordinate: the
            lever arm of a rotation, the length scale of a translation.
        spread: ``(K,)`` of one curve that is a mean already: how far demonstrations are from it at each sample [m]; it
            is followed more closely where that is little.
        options: of the search.
        seed: of the starts; the same seed gives the same network.

    Returns:
        The outcome. Its network is certified also where it deviates by more.

    Raises:
        InputError: a value is malformed, a curve does not move, or demonstrations differ in their numbers of neurons.
        OutOfTimeError: the time budget is spent.
    """
    begun = cpu_time()
    chosen = ShapingOptions() if options is None else options
    goal, rng = as_positive("deviation", deviation), as_generator("seed", seed)
    with one_blas_thread():
        curve = as_curve(curves, units, spread)
        cascade = Cascade(clockwork(float(chosen.rate)), curve.points[0], curve.points[-1])
        best: tuple[float, float, LieEDNN] | None = None
        tries = best_try = iterations = 0

        def candidates() -> Iterator[Parameters]:
            nonlocal iterations
            for count in chosen.neurons:
                first = starting_point(cascade, curve, count, rng)
                fit = Descent(cascade, curve).run(first, chosen.iterations, _AIM * goal)
                iterations += fit.iterations
                yield fit.parameters
            fine = Cascade(clockwork(float(chosen.rate), _REFINEMENT), curve.points[0], curve.points[-1])
            for count in chosen.placed:
                check_time()
                yield placed(fine, curve, count)

        for parameters in candidates():
            tries += 1
            made = _measured(parameters, chosen.rate, curve)
            if best is None or made[0] < best[0]:
                best, best_try = made, tries
            if best[0] <= goal:
                break
    assert best is not None
    found, rms, network = best
    hidden = network.n_hidden - network.n_clock
    success = found <= goal
    message = (
        f"within {1e3 * found:.3g} mm of the curve with {hidden} hidden neurons"
        if success
        else f"{1e3 * found:.3g} mm off the curve, {1e3 * goal:.3g} mm were asked for: the best of {tries} tries, "
        f"with {hidden} hidden neurons; allow more, as `placed` or as `neurons`"
    )
    if not network.certified:
        raise NotCertifiedError(f"the closed-form certificate does not hold ({network.certificate}); curve too large")
    return Shaping(
        success, message, network, found, rms, best_try > len(chosen.neurons), tries, iterations, cpu_time() - begun
    )


def as_curve(curves: ArrayLike | Sequence[ArrayLike], units: ArrayLike, spread: ArrayLike | None = None) -> Curve:
    """The curve through samples ``(K, N, 6)``, or the mean of several; errors as of `shape`."""
    alone = isinstance(curves, np.ndarray) and curves.ndim == 3
    if not alone and not isinstance(curves, Sequence | np.ndarray):
        raise InputError(f"curves must be an array (K, N, 6) or a sequence of such arrays, got {quoted(curves)}")
    several: Sequence[Any] = [curves] if alone else curves  # type: ignore[assignment]
    if len(several) == 0:
        raise InputError("curves must hold at least one array (K, N, 6)")
    checked = [as_floats("curves", one, ("K", "N", 6)) for one in several]
    n = checked[0].shape[1]
    if n == 0 or any(one.shape[1] != n or len(one) < 2 for one in checked):
        raise InputError("curves must have at least two samples each, and all the same number N >= 1 of neurons")
    try:
        scale = as_floats("units", np.broadcast_to(np.asarray(units), (n, 6)), (n, 6)).copy()
    except ValueError as error:
        raise InputError(f"units must be positive numbers of a shape that broadcasts to ({n}, 6): {error}") from None
    if not (scale > 0.0).all():
        raise InputError(f"units must be positive, the smallest is {scale.min():g}")
    if spread is not None:
        if len(checked) > 1:
            raise InputError("spread is of one curve; of several it is measured")
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
    """How much deviations count ``(K,)`` where demonstrations are ``spread`` ``(K,)`` [m] from their mean."""
    # Where all agree to the last digit a little spread is added, or nothing else would count.
    spread = spread + _LEAST_WEIGHT * spread.mean() + 1e-12
    return np.maximum(spread.min() / spread, _LEAST_WEIGHT)


def _measured(parameters: Parameters, rate: float, curve: Curve) -> tuple[float, float, LieEDNN]:
    """Deviation, its root mean square, and the network, whose way is integrated."""
    network = assemble(parameters, rate, curve.points[-1])
    way = network.trajectory(network.start(curve.points[0]), _SPAN / rate, rtol=1e-7, atol=1e-9)
    # Closer together at first, where it is fast.
    drawn = Curve.through(network.visible(way(way.t[-1] * np.linspace(0.0, 1.0, _WAY_SAMPLES) ** 3)), curve.units)
    shares = np.linspace(0.0, 1.0, _SAMPLES)
    off, back = (_distances(one.at(shares)[0], other, shares) for one, other in ((drawn, curve), (curve, drawn)))
    return float(max(off.max(), back.max())), float(np.sqrt(np.mean(off**2))), network


def _distances(points: Floats, curve: Curve, shares: Floats) -> Floats:
    """Distances ``(K,)`` [m] of points ``(K, N, 6)`` from a curve near the given shares of its length."""
    nearest, _ = curve.at(curve.feet(points, shares))
    return np.asarray(np.linalg.norm(((points - nearest) * curve.units).reshape(len(points), -1), axis=1))
