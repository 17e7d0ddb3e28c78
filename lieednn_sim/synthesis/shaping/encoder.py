"""A universal network: its weights are fixed and certified once, and its hidden neurons' start encodes any curve.

Each visible neuron has `CODE_PAIRS` pairs of opposite switches (`cascade`) and nothing else. From a code of zero it
goes straight to the target. `docs/mathematics/families.md` derives its path x(g), g = e^-t, from the input u(s), which
is odd in the code, and nearly linear while codes are small. So encoding is one linear least-squares problem, solved
beforehand for all curves: only a product of matrices remains.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, Activation, LieEDNN
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.network.stepping import UndrivenState
from lieednn_sim.synthesis.shaping.cascade import LARGEST_CODE, TAIL, assemble, pairs_of, switches
from lieednn_sim.synthesis.shaping.curve import as_units, clock_along, third_derivative
from lieednn_sim.validation import as_count, as_floats, as_positive
from lieednn_sim.values import Floats, frozen

CODE_PAIRS = 48  # pairs for each visible neuron
_MOST_VISIBLE = 16  # largest number of visible neurons: arrays of hidden ones grow with its square, to 0.2 GB
STRENGTH = 80.0  # D, by default; codes of the package's arms reach about a third of `LARGEST_CODE`
# Instants of the fit and of the path in closed form: so many even steps of g, then steps by this ratio, down to this g.
_STEPS, _RATIO, _LEAST_CLOCK = 360, 0.75, 5e-10
_STRIDE = 3  # every third instant is one of the fit
# Ripples shorter than 2 pi times this fraction of the clock count more than deviations.
_RIPPLE, _LEAST_RIPPLING = 0.02, 0.01
# A turn of the tangent by one radian takes as much of the clock as this fraction of the length; turns are smoothed over
# the second fraction, and computed on so many pieces.
_CLOCK_PER_TURN, _SMOOTHING, _PIECES = 0.2, 0.02, 256
_POWERS = np.array([1, 3, 5])  # powers of a code in its bump; the next one is below rounding


class CurveEncoder:
    """One certified network for every curve of an arm, which encodes a curve as its hidden neurons' initial state.

    This universal network depends on the arguments alone. It is made and certified once in a process, and shared by all
    encoders with equal arguments.

    Args:
        n_visible: number N of visible neurons, at most 16.
        activation: a name of `ACTIVATIONS`.
        strength: D; with a larger one, longer and more sharply bent curves have codes.

    Attributes:
        network: the certified `LieEDNN` with code zero and target zero: N visible neurons and M = 2 N `CODE_PAIRS`
            hidden ones, gamma = mu = 1, rate rho = 1.
    """

    def __init__(self, n_visible: int, activation: str = DEFAULT_ACTIVATION, strength: float = STRENGTH) -> None:
        count, name = as_count("n_visible", n_visible), as_activation(activation)
        if count > _MOST_VISIBLE:
            raise InputError(f"n_visible must be at most {_MOST_VISIBLE}, got {count}")
        size = as_positive("strength", strength)
        self.network, self._silent = _universal(count, name, ACTIVATIONS[name], size)
        self._basis = _basis(ACTIVATIONS[name], size)

    def encode(self, curve: ArrayLike, units: ArrayLike = 1.0) -> LieEDNN:
        """The universal network with the code and the target of a curve.

        Args:
            curve: samples ``(K, N, 6)`` from start to target; only their places matter, not their times.
            units: metres that a unit of each coordinate counts for in the curve's length; broadcasts to ``(N, 6)``.

        Raises:
            InputError: a shape does not fit, or the code exceeds `LARGEST_CODE`, beyond which bumps are not linear.
        """
        return self.with_code(self.code(curve, units), np.asarray(curve)[-1])

    def code(self, curve: ArrayLike, units: ArrayLike = 1.0) -> Floats:
        """The hidden start ``(M, 6)`` of a curve; see `encode`."""
        n = self.network.n_visible
        samples = as_floats("curve", curve, ("K", n, 6))
        if len(samples) < 2:
            raise InputError(f"a curve must have at least two samples, got {len(samples)}")
        with one_blas_thread():
            g = self._basis.fitted
            points = _at_clock(samples, as_units(units, n), 1.0 - g)
            missing = points - samples[-1] - g[:, None, None] * (samples[0] - samples[-1])
            code = self._basis.solution @ missing.reshape(len(g), -1)
        self._require_range(code)
        return self._started(code)

    def with_code(self, code: ArrayLike, target: ArrayLike) -> LieEDNN:
        """The universal network of a code ``(M, 6)``, to a target ``(N, 6)``; its certificate is not checked again."""
        return self.network.retarget(target).with_start(as_floats("code", code, self._silent.shape))

    @property
    def levels(self) -> Floats:
        """``(L,)`` values of e^-t at which `code_at` takes the visible states, falling from 1."""
        return self._basis.levels

    @cached_property
    def still(self) -> UndrivenState:
        """The network's state at rest at zero, from which others begin."""
        return UndrivenState(self.network, np.zeros((self.network.n_visible, 6)))

    def code_at(
        self, states: Floats, start: Floats, target: Floats, rate: Floats, bend: Floats, most: float = np.inf
    ) -> Floats:
        """The hidden start ``(M, 6)`` of a motion in the network's time; unchecked but for the code's range.

        Args:
            states: ``(L, N, 6)`` visible states at the `levels`.
            start: ``(N, 6)`` visible state at the beginning.
            target: ``(N, 6)`` visible equilibrium.
            rate: ``(N, 6)`` dx/dt at the beginning, which the network meets up to terms of third order in the code.
            bend: ``(N, 6)`` the derivative of dx/dt there, likewise.
            most: largest difference of the code's states from the given ones, in any coordinate, that is accepted.

        Raises:
            InputError: the code exceeds `LARGEST_CODE`, or its states are further off.
        """
        basis, offset = self._basis, start - target
        missing = (states - target - basis.levels[:, None, None] * offset).reshape(len(basis.levels), -1)
        code = basis.of_levels @ missing
        desired = np.array([(rate + offset).ravel(), (bend + rate).ravel()])  # x' = u - (x - x_d) and x'' = u' - x'
        code += basis.starting @ (desired - basis.start @ code)
        self._require_range(code)
        if most < np.inf and (off := float(np.abs(basis.at_levels @ code - missing).max())) > most:
            raise InputError(f"its states would be {off:.3g} off the motion, {most:.3g} at most are allowed")
        return self._started(code)

    def path(self, network: LieEDNN, start: ArrayLike) -> CubicHermiteSpline:
        """States ``(..., N, 6)`` of the visible neurons in closed form, as a function of w = 1 - e^-t.

        It ends where e^-t is 5e-10.

        Args:
            network: the universal network with any code and target.
            start: ``(N, 6)`` visible start.

        Raises:
            InputError: a shape does not fit, or the network is another one or has a code out of range.
        """
        n = self.network.n_visible
        if network.alpha is not self.network.alpha and not np.array_equal(network.alpha, self.network.alpha):
            raise InputError("the network must be one of this encoder, with a code")
        shift = (network.hidden_start - self._silent).reshape(n, 2, CODE_PAIRS, 6)
        code = shift.mean(axis=1).transpose(1, 0, 2).reshape(CODE_PAIRS, -1)
        self._require_range(code)
        basis, target = self._basis, network.bias[:n]
        bent, driven = basis.bent @ (code ** _POWERS[:, None, None]).reshape(-1, code.shape[1])
        offset = (as_floats("start", start, (n, 6)) - target).ravel()
        away = basis.g[:, None] * offset + bent
        # From x' = u - (x - x_d) in the network's time: dx/dg = ((x - x_d) - u) / g.
        slope = (driven - away) / basis.g[:, None]
        shape = (len(basis.g), n, 6)
        return CubicHermiteSpline(1.0 - basis.g, target + away.reshape(shape), slope.reshape(shape))

    def _started(self, code: Floats) -> Floats:
        """The hidden start ``(M, 6)`` of a code ``(pairs, 6N)``, which both neurons of a pair have."""
        shift = code.reshape(CODE_PAIRS, -1, 6).swapaxes(0, 1)
        return (self._silent.reshape(-1, 2, CODE_PAIRS, 6) + shift[:, None]).reshape(self._silent.shape)

    def _require_range(self, code: Floats) -> None:
        largest = float(np.abs(code).max(initial=0.0))
        if largest > LARGEST_CODE:
            raise InputError(
                f"the curve's code must stay below {LARGEST_CODE:g}, up to which bumps are linear in it, and would "
                f"reach {largest:.3g}: the curve is too long or too sharply bent for the universal network"
            )


@frozen
class _Basis:
    """Bumps of one visible neuron's pairs, and how curves become codes."""

    g: Floats  # (K,) instants of the closed form
    bent: Floats  # (2, K, 3 pairs) displacements and inputs u at the instants, for each of `_POWERS` of the code
    fitted: Floats  # (F,) g at the instants of the fit
    solution: Floats  # (pairs, F) from a displacement there to the code
    levels: Floats  # (L,) the values of g among these that suffice for a motion
    of_levels: Floats  # (pairs, L) from a displacement at these, cubic splines in between, to the code
    at_levels: Floats  # (L, pairs) displacements there of unit codes
    start: Floats  # (2, pairs) the input u and its derivative in time at the beginning, of unit codes
    starting: Floats  # (pairs, 2) codes of unit u and u' at the beginning that change the rest of the motion least


@lru_cache(maxsize=8)
def _universal(n: int, activation: str, function: Activation, strength: float) -> tuple[LieEDNN, Floats]:
    """The universal network of N visible neurons, and the hidden start of code zero."""
    network = assemble(pairs_of(n, CODE_PAIRS, strength), 1.0, np.zeros((n, 6)), activation)
    if not network.certified:
        raise NotCertifiedError(f"the closed-form certificate does not hold ({network.certificate})")
    return network, network.hidden_start


@lru_cache(maxsize=4)
def _basis(activation: Activation, strength: float) -> _Basis:
    phi = activation.phi
    a, c = switches(CODE_PAIRS)
    # An odd polynomial in d through phi(z + d) - phi(z - d) at as many d as it has terms.
    tried = LARGEST_CODE * np.arange(1.0, 1.0 + len(_POWERS)) / len(_POWERS)
    of_values = strength * np.linalg.inv(tried[:, None] ** _POWERS)

    def inputs(g: Floats) -> Floats:
        z = a + c * g[:, None]
        values = np.stack([phi(z + d) - phi(z - d) for d in tried])
        return np.tensordot(of_values, values, 1) * (g ** _POWERS[:, None])[..., None]

    first = np.linspace(1.0, 1.0 / _STEPS, _STEPS)
    # The first geometric steps must not be longer than the even ones.
    even = first[first > 1.0 / (_STEPS * (1.0 - _RATIO))]
    count = int(np.ceil(np.log(_LEAST_CLOCK / even[-1]) / np.log(_RATIO)))
    g = np.append(even, even[-1] * (_LEAST_CLOCK / even[-1]) ** (np.arange(1.0, count + 1.0) / count))
    node, weight = np.polynomial.legendre.leggauss(3)
    width = -np.diff(g)
    fine = g[1:, None] + 0.5 * width[:, None] * (node + 1.0)
    masses = 0.5 * width[:, None] * weight / fine**2
    pieces = (inputs(fine.ravel()).reshape(len(_POWERS), *fine.shape, -1) * masses[..., None]).sum(axis=2)
    shifts = np.concatenate([np.zeros((len(_POWERS), 1, CODE_PAIRS)), np.cumsum(pieces, axis=1)], axis=1)
    shifts *= g[:, None]
    looks = np.append(np.arange(0, len(even), _STRIDE), np.arange(len(even), len(g), _STRIDE))
    bumps = shifts[0, looks]
    # Near the end u = D delta s 2 phi'(a), and x - x_d = e^-t (A + B t) with B = 2 D phi'(a) delta.
    tail = 2.0 * TAIL * strength * activation.slope(a)
    used = int((g[looks] > _LEAST_RIPPLING).sum())
    ripples = np.pad(third_derivative(1.0 - g[looks[:used]]), ((0, 0), (0, len(looks) - used)))
    ridge = 1e-6  # weight of the squared codes D delta
    rows = np.concatenate([bumps, _RIPPLE**3 * (ripples @ bumps), tail[None], ridge**0.5 * strength * np.eye(len(a))])
    inverse = np.linalg.pinv(rows)
    count = len(looks)
    solution = inverse[:, :count] + inverse[:, count : count + len(ripples)] @ (_RIPPLE**3 * ripples)
    slope = activation.slope_at(a + c, phi(a + c))
    steeper = activation.bend(a + c)
    # The values and time derivatives of u = 2 D delta g phi'(a + c g) at g = 1, with g' = -g.
    start = 2.0 * strength * np.stack([slope, -(slope + c * steeper)])
    starting = inverse @ inverse.T @ start.T
    # Every second one of the even instants, and all later ones.
    levels = np.append(g[looks[:used:2]], g[looks[used:]])
    of_levels = solution @ CubicSpline(-levels, np.eye(len(levels)))(-g[looks])
    bent = np.stack([shifts, inputs(g)]).transpose(0, 2, 1, 3).reshape(2, len(g), -1)
    starting = starting @ np.linalg.inv(start @ starting)
    at_levels = np.concatenate([bumps[:used:2], bumps[used:]])
    return _Basis(g, bent, g[looks], solution, levels, of_levels, at_levels, start, starting)


def _at_clock(curve: Floats, units: Floats, w: Floats) -> Floats:
    """Points ``(F, N, 6)`` of a curve ``(K, N, 6)`` at fractions ``(F,)`` of the clock, slower where it turns."""
    steps = (np.diff(curve, axis=0) * units).reshape(len(curve) - 1, -1)
    passed = np.append(0.0, np.cumsum(np.sqrt(np.einsum("ki,ki->k", steps, steps))))
    if passed[-1] <= 0.0:
        return np.broadcast_to(curve[-1], (len(w), *curve.shape[1:]))

    def points(length: Floats) -> Floats:
        low = np.clip(np.searchsorted(passed, length, side="right") - 1, 0, len(passed) - 2)
        part = (length - passed[low]) / np.maximum(passed[low + 1] - passed[low], 1e-300)
        return np.asarray(curve[low] + np.clip(part, 0.0, 1.0)[:, None, None] * (curve[low + 1] - curve[low]))

    even = np.linspace(0.0, 1.0, _PIECES + 1) * passed[-1]
    spent = clock_along((points(even) * units).reshape(len(even), -1), _CLOCK_PER_TURN, _SMOOTHING)
    return points(np.interp(w, spent, even))
