"""Certified synthesis: a LieEDNN with a given equilibrium and a proof of global stability."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.stability import Certificate
from lieednn_sim.synthesis.bias import bias_for, equation_columns, impossibility
from lieednn_sim.synthesis.problem import Point, Problem
from lieednn_sim.synthesis.search import QUATERNION_BOUNDS, feasible_point, polish, smallest_eigenvalue_point
from lieednn_sim.validation import as_choice, as_count, as_floats, as_generator, as_positive
from lieednn_sim.values import Floats, frozen

RESIDUAL_TOLERANCE = 1e-9
# No weights are looked for beyond this norm of W_R, in units of gamma/mu.
_LARGEST_NORM = 1e3
# Starts of the fast search before the patient one takes over.
_FAST_ATTEMPTS = 4
# The less the quaternions move, the better the certificate survives, and the larger the translations become.
_POLISH_WEIGHTS = (0.05, 0.01, 0.001)


@frozen
class Synthesis:
    """Result of `synthesize`.

    Attributes:
        impossible: whether it is proved that no weights can be certified with this target and bias.
        message: how it ended; where it failed, why.
        network: the certified network, or None. An uncertified network is never returned.
        residual: largest entry of the vector field at the target.
        largest_translation: largest |t_ij| of the weights.
        attempts: starts tried.
        iterations: iterations of the searches over all starts.
        seconds: wall time.
    """

    impossible: bool
    message: str
    network: LieEDNN | None
    residual: float
    largest_translation: float
    attempts: int
    iterations: int
    seconds: float

    @property
    def success(self) -> bool:
        """Whether there is a certified network with the target as its equilibrium."""
        return self.network is not None

    @property
    def certificate(self) -> Certificate | None:
        """The verified certificate of the network."""
        return self.network.certificate if self.network is not None else None

    def unwrap(self) -> LieEDNN:
        """The network, or `NotCertifiedError` with the reason."""
        if self.network is None:
            raise NotCertifiedError(self.message)
        return self.network


def synthesize(
    xi: ArrayLike,
    *,
    bias: str | ArrayLike = "uniform",
    bias_magnitude: float = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = "tanh",
    seed: int | np.random.Generator = 0,
    max_translation: float = 20.0,
    max_attempts: int = 16,
) -> Synthesis:
    """Make a network whose one equilibrium is ``xi``, globally attractive by proof.

    xi is an equilibrium exactly when W phi(xi) = (gamma/mu) xi - b. The 3N rotational equations are met in (alpha, R)
    under the eigenvalue bound of `stability`, the 3N translational ones then almost always through t alone.

    Args:
        xi: ``(N, 6)`` target, twists (omega, v).
        bias: a name of `BIAS_RULES` or an array ``(N, 6)``.
        bias_magnitude: strength of the uniform rule; least strength of the sign-matched one, in units of gamma/mu.
        gamma: decay rate.
        mu: scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        seed: of the random starts; the same seed gives the same network.
        max_translation: largest |t_ij| allowed.
        max_attempts: starts to try before giving up.

    Returns:
        The outcome. It failed where `network` is None: then `message` says whether no such network exists, or none was
        found in ``max_attempts`` starts.

    Raises:
        InputError: a value has the wrong shape or range.
    """
    begun = time.perf_counter()
    target = as_floats("xi", xi, ("N", 6))
    if len(target) == 0:
        raise InputError("xi must have shape (N, 6) with N >= 1, got (0, 6)")
    as_choice("activation", activation, ACTIVATIONS)
    ratio = as_positive("gamma", gamma) / as_positive("mu", mu)
    as_positive("max_translation", max_translation)
    rng = as_generator("seed", seed)
    state = ACTIVATIONS[activation][0](target)
    rule = bias if isinstance(bias, str) else None
    solved = rule == "solved"
    if rule is not None:
        offset = bias_for(rule, target, state, ratio, as_positive("bias_magnitude", bias_magnitude))
    else:
        offset = as_floats("bias", bias, target.shape)
    # All in units of gamma/mu: W' = W mu/gamma has bound 1.
    required = target - offset / ratio
    attempts, iterations = 0, 0

    def outcome(message: str, network: LieEDNN | None = None, *, impossible: bool = False) -> Synthesis:
        residual, largest = np.inf, np.inf
        if network is not None:
            residual = float(np.abs(network.vector_field(target)).max())
            largest = float(np.linalg.norm(network.translation, axis=-1).max())
        elapsed = time.perf_counter() - begun
        return Synthesis(impossible, message, network, residual, largest, attempts, iterations, elapsed)

    def networks(problem: Problem, point: Point) -> Iterator[LieEDNN]:
        """Networks to check: the weights at hand with a solved bias, or polished ever more gently."""
        if solved:
            still = np.zeros((*problem.signs.shape, 3))
            yield _assemble(problem, point, still, offset, gamma, mu, activation).retarget(target)
            return
        for weight in _POLISH_WEIGHTS:
            polished, translation = polish(problem, point, state, required, quaternion_weight=weight)
            yield _assemble(problem, polished, translation, offset, gamma, mu, activation)

    if not solved:
        reason = impossibility(state, required)
        if reason is not None:
            return outcome(f"not certified: {reason}", impossible=True)
        norm = _least_norm(state[:, :3], required[:, :3])
        if norm > _LARGEST_NORM:
            return outcome(
                f"not certified: target and bias ask for weights of norm {norm:.2g} gamma/mu or more, beyond the "
                f"{_LARGEST_NORM:g} that are looked for; use another bias or retarget a certified network"
            )
    # What the weights serve in turn: what suits the target, and the rotations alone where the translations t may do.
    choices = [equation_columns(target)]
    if len(choices[0]) > 1 and state[:, :3].any():
        choices.append(choices[0][:1])
    with one_blas_thread():
        for attempt in range(as_count("max_attempts", max_attempts)):
            attempts += 1
            problem, start = _start(state, required, choices[attempt % len(choices)], rng)
            point: Point | None
            if solved:
                point, count = _contract(problem, start), 0
            elif attempt < _FAST_ATTEMPTS:
                point, count = feasible_point(problem, start, aim=0.85, accept=0.97)
            else:
                # A bound of its own for each kind of columns in turn.
                bound = QUATERNION_BOUNDS[attempt // len(choices) % len(QUATERNION_BOUNDS)]
                point, count = smallest_eigenvalue_point(problem, start, accept=0.9999, quaternion_bound=bound)
            iterations += count
            if point is None:
                continue
            for network in networks(problem, point):
                candidate = outcome("certified", network)
                if (
                    network.certified
                    and candidate.residual < RESIDUAL_TOLERANCE * gamma
                    and candidate.largest_translation < max_translation
                ):
                    return candidate
    other = "a larger bias magnitude" if rule == "sign-matched" else "the sign-matched bias"
    return outcome(
        f"not certified: no feasible weights found from {attempts} starts, which is no proof that there are none; "
        f"try another seed, {other}, or retarget a certified network"
    )


def _start(state: Floats, required: Floats, columns: list[slice], rng: np.random.Generator) -> tuple[Problem, Floats]:
    """A random problem (signs of the blocks) and a random start with a log S for which a solution can exist."""
    n = len(state)
    inputs = np.stack([state[:, part] for part in columns], axis=-1)
    outputs = np.stack([required[:, part] for part in columns], axis=-1)
    problem = Problem(inputs, outputs, np.where(rng.random((n, n)) < 0.5, 1.0, -1.0))
    quaternion = rng.normal(size=(n, n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.sqrt(0.3 / np.sqrt(n) * np.abs(rng.normal(size=(n, n, 1))))
    return problem, np.concatenate([quaternion.ravel(), _log_scale(inputs, outputs)])


def _least_norm(inputs: Floats, outputs: Floats) -> float:
    """Least 2-norm of any matrix that maps the inputs to the outputs."""
    length = float(np.linalg.norm(inputs))
    return float(np.linalg.norm(outputs)) / length if length > 0.0 else 0.0


def _log_scale(inputs: Floats, outputs: Floats) -> Floats:
    """The least spread of log S with sum_i s_i^2 u_i (c_i - u_i) < 0, without which no weights can be certified."""
    work = (inputs * (outputs - 0.9 * inputs)).sum(axis=-1).ravel()
    helpful = np.where(work < 0.0, 1.0, -1.0)
    for spread in np.arange(0.0, 3.0, 0.1):
        power = np.exp(spread * helpful)
        if power @ work <= -0.1 * power @ np.abs(work):
            break
    return 0.5 * spread * helpful


def _contract(problem: Problem, start: Floats) -> Point:
    """Random weights shrunk until lambda_max is at most 0.5, for a bias that is solved afterwards."""
    unknowns = start.copy()
    unknowns[problem.n_quaternion :] = 0.0
    largest = problem.evaluate(unknowns).values[-1]
    if largest > 0.5:
        unknowns[: problem.n_quaternion] *= np.sqrt(0.5 / largest)
    return problem.evaluate(unknowns)


def _assemble(
    problem: Problem, point: Point, translation: Floats, bias: Floats, gamma: float, mu: float, activation: str
) -> LieEDNN:
    size = np.cbrt(np.abs(np.linalg.det(point.blocks)))
    safe = np.where(size > 0.0, size, 1.0)
    rotation = problem.signs[:, :, None, None] * point.blocks / safe[:, :, None, None]
    rotation[size == 0.0] = np.eye(3)
    return LieEDNN(
        alpha=gamma / mu * problem.signs * size,
        rotation=rotation,
        translation=translation,
        bias=bias,
        gamma=gamma,
        mu=mu,
        activation=activation,
        lyapunov_diagonal=np.exp(2.0 * point.unknowns[problem.n_quaternion :]),
    )
