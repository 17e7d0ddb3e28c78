"""Certified synthesis: a LieEDNN with a given equilibrium and a proof of global stability.

A fast search runs for many targets at once, then a patient one for each that it failed for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.budget import cpu_time, one_blas_thread
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.network.base import as_rates
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.stability import Certificate
from lieednn_sim.synthesis.bias import bias_for, equation_columns, impossibility
from lieednn_sim.synthesis.problem import Problem, contracted, random_starts
from lieednn_sim.synthesis.search import QUATERNION_BOUNDS, feasible_points, polish, smallest_eigenvalue_point
from lieednn_sim.validation import Seed, as_count, as_floats, as_generator, as_positive
from lieednn_sim.values import Floats, frozen

#: Largest entry of the vector field at the target, in units of gamma, with which the target counts as the equilibrium;
#: the solution is usually exact to 1e-13.
RESIDUAL_TOLERANCE = 1e-9
_LARGEST_TRANSLATION = 20.0  # largest |t_ij| allowed
_LARGEST_NORM = 1e3  # largest norm of W_R that is searched for, in units of gamma/mu
_LARGEST_STACK = 2**23  # largest number of derivatives of entries of the symmetric matrices in a stack: 64 MB


@frozen
class Synthesis:
    """Result of `synthesize`, or one of the results of `synthesize_many`.

    Attributes:
        impossible: whether it is proved that no weights can be certified with this target and bias.
        message: the outcome, with the reason for a failure.
        network: the certified network, or None. An uncertified network is never returned.
        residual: largest entry of the vector field at the target.
        largest_translation: largest |t_ij| of the weights.
        attempts: number of starts tried.
        cpu_time: CPU time since the beginning of the call [s].
    """

    impossible: bool
    message: str
    network: LieEDNN | None
    residual: float
    largest_translation: float
    attempts: int
    cpu_time: float

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
    activation: str = DEFAULT_ACTIVATION,
    seed: Seed = 0,
    max_attempts: int = 16,
) -> Synthesis:
    """Make a network whose only equilibrium is ``xi``, with a proof that it is globally attractive.

    xi is an equilibrium exactly when W phi(xi) = (gamma/mu) xi - b. The 3N rotational equations are solved for
    (alpha, R) under the eigenvalue bound of `stability`, the 3N translational ones then almost always for t alone. If
    that fails, the outcome's `message` says whether no such network exists or none was found. No |t_ij| exceeds 20.

    Args:
        xi: ``(N, 6)`` target, twists (omega, v).
        bias: a name of `BIAS_RULES` or an array ``(N, 6)``.
        bias_magnitude: strength of the uniform rule; least strength of the sign-matched one, in units of gamma/mu.
        gamma, mu: decay rate and scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        seed: seed of the random starts; the same seed gives the same network.
        max_attempts: number of starts to try.
    """
    target = as_floats("xi", xi, ("N", 6))
    offset = bias if isinstance(bias, str) else as_floats("bias", bias, target.shape)[None]
    magnitudes = [as_positive("bias_magnitude", bias_magnitude)]
    rng = as_generator("seed", seed)
    return _attempt_all(target[None], offset, magnitudes, [rng], gamma, mu, activation, max_attempts)[0]


def synthesize_many(
    xi: ArrayLike,
    *,
    bias: str | ArrayLike = "uniform",
    bias_magnitude: ArrayLike = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    seed: Seed = 0,
    max_attempts: int = 16,
) -> list[Synthesis]:
    """Make a network for each of many targets, as `synthesize` makes one, in a fraction of the time; in their order.

    The fast searches run for all targets at once, in stacked arrays; the targets left are then searched one by one. The
    k-th network is, to the last bit, the one that ``synthesize`` makes with the k-th generator spawned from ``seed``,
    whatever the other targets are.

    Args:
        xi: ``(B, N, 6)`` targets; equal ones give several networks with one equilibrium.
        bias: a name of `BIAS_RULES` or an array ``(B, N, 6)``.
        bias_magnitude: as in `synthesize`, one number or one for each target ``(B,)``.
        seed: seed from which a generator for each target's starts is spawned.
        gamma, mu, activation, max_attempts: as in `synthesize`, for each target.
    """
    targets = as_floats("xi", xi, ("B", "N", 6))
    count = len(targets)
    offset = bias if isinstance(bias, str) else as_floats("bias", bias, targets.shape)
    given = as_floats("bias_magnitude", bias_magnitude, (), batched=True)
    given = np.broadcast_to(as_floats("bias_magnitude", given, (count,) if given.ndim else ()), (count,))
    magnitudes = [as_positive("bias_magnitude", float(item)) for item in given]
    starts = as_generator("seed", seed).spawn(count)
    return _attempt_all(targets, offset, magnitudes, starts, gamma, mu, activation, max_attempts)


@dataclass(eq=False)
class _Task:
    """One network to be made, and the progress so far."""

    target: Floats  # (N, 6)
    state: Floats  # phi(target)
    offset: Floats  # the bias
    rng: np.random.Generator
    rates: dict[str, Any]  # gamma, mu and the activation
    begun: float  # time of the start, by `cpu_time`
    attempts: int = 0
    outcome: Synthesis | None = None

    def __post_init__(self) -> None:
        # What W phi(target) must be, in units of gamma/mu: W' = W mu/gamma has bound 1.
        self.ratio = self.rates["gamma"] / self.rates["mu"]
        self.required = self.target - self.offset / self.ratio
        # Column sets that W_R has to meet, tried in turn: those that suit the target, and then, if the translations t
        # may meet the others, the rotational ones alone.
        self.choices = [equation_columns(self.target)]
        if len(self.choices[0]) > 1 and self.state[:, :3].any():
            self.choices.append(self.choices[0][:1])

    @property
    def columns(self) -> list[slice]:
        """The columns that W_R has to meet at the next attempt."""
        return self.choices[self.attempts % len(self.choices)]

    def end(self, message: str, network: LieEDNN | None = None, *, impossible: bool = False) -> Synthesis:
        """Set the outcome, and return it."""
        residual, largest = np.inf, np.inf
        if network is not None:
            residual = float(np.abs(network.vector_field(self.target)).max())
            largest = float(np.linalg.norm(network.translation, axis=-1).max())
        self.outcome = Synthesis(
            impossible, message, network, residual, largest, self.attempts, cpu_time() - self.begun
        )
        return self.outcome

    def offer(self, network: LieEDNN) -> None:
        """End with this network if it is certified, has the target as equilibrium, and t is not too large."""
        if network.certified:
            result = self.end("certified", network)
            exact = result.residual < RESIDUAL_TOLERANCE * self.rates["gamma"]
            if not (exact and result.largest_translation < _LARGEST_TRANSLATION):
                self.outcome = None

    def refuse(self) -> None:
        """End if no weights can reach the target, or only larger ones than those searched for."""
        reason = impossibility(self.state, self.required)
        if reason is not None:
            self.end(f"not certified: {reason}", impossible=True)
            return
        # The least 2-norm of any matrix that maps the rotational part of phi(target) to what it must be.
        size, needed = (float(np.linalg.norm(part[:, :3])) for part in (self.state, self.required))
        norm = needed / size if size > 0.0 else 0.0
        if norm > _LARGEST_NORM:
            self.end(
                f"not certified: target and bias need weights of norm {norm:.2g} gamma/mu or more, and the largest "
                f"searched for is {_LARGEST_NORM:g}; use another bias or retarget a certified network"
            )


def _attempt_all(
    targets: Floats,
    bias: str | Floats,
    magnitudes: Sequence[float],
    generators: Sequence[np.random.Generator],
    gamma: float,
    mu: float,
    activation: str,
    max_attempts: int,
) -> list[Synthesis]:
    """The outcomes of `synthesize` for targets ``(B, N, 6)``; the bias is a rule or an array ``(B, N, 6)``."""
    if targets.shape[1] == 0:
        raise InputError("xi must have shape (..., N, 6) with N >= 1, got N = 0")
    rates = {**as_rates(gamma, mu), "activation": as_activation(activation)}
    # The bound means minutes of searching: if thousands of starts find nothing, more don't either.
    as_count("max_attempts", max_attempts, most=10_000)
    start, solved = cpu_time(), isinstance(bias, str) and bias == "solved"
    tasks = []
    for k, (target, state) in enumerate(zip(targets, ACTIVATIONS[activation].phi(targets), strict=True)):
        offset = bias_for(bias, target, state, gamma / mu, magnitudes[k]) if isinstance(bias, str) else bias[k]
        tasks.append(_Task(target, state, offset, generators[k], rates, start))
        if not solved:
            tasks[k].refuse()
    at_once = max(1, _LARGEST_STACK // ((3 * targets.shape[1]) ** 4 // 4))
    fast_attempts = 4  # starts of the fast search before the patient one takes over
    with one_blas_thread():
        for attempt in range(max_attempts):
            left = [task for task in tasks if task.outcome is None]
            if solved or attempt < fast_attempts:
                # All problems in a stack have the same number of equations, which an attempt changes.
                stacks = [[task for task in left if len(task.columns) == columns] for columns in (1, 2)]
                for stack in stacks:
                    for first in range(0, len(stack), at_once):
                        _fast_attempt(stack[first : first + at_once], solved)
            else:
                for task in left:
                    _patient_attempt(task)
    matched = isinstance(bias, str) and bias == "sign-matched"
    other = "a larger bias magnitude" if matched else "the sign-matched bias"
    advice = f"which does not prove that there are none; try another seed, {other}, or retarget a certified network"
    lacking = "not certified: no feasible weights found from"
    return [task.outcome or task.end(f"{lacking} {task.attempts} starts, {advice}") for task in tasks]


def _start(stack: Sequence[_Task]) -> tuple[Problem, Floats]:
    state, required = (np.array([getattr(task, name) for task in stack]) for name in ("state", "required"))
    return random_starts(state, required, stack[0].columns, [task.rng for task in stack])


def _fast_attempt(stack: Sequence[_Task], solved: bool) -> None:
    problem, start = _start(stack)
    for task in stack:
        task.attempts += 1
    if solved:
        # Any weights will do, since the bias that makes the target their equilibrium is computed afterwards.
        still = np.zeros((*problem.signs.shape, 3))
        for task, network in zip(stack, _networks(stack, problem, contracted(problem, start), still), strict=True):
            task.offer(network.retarget(task.target))
        return
    unknowns, feasible = feasible_points(problem, start, aim=0.85, accept=0.97)
    result = np.flatnonzero(feasible)
    _offer_polished([stack[k] for k in result.tolist()], problem.of(result), unknowns[result])


def _patient_attempt(task: _Task) -> None:
    """Search from another start by the patient method, which may take seconds."""
    # Each choice of columns is tried with one bound after another.
    bound = QUATERNION_BOUNDS[task.attempts // len(task.choices) % len(QUATERNION_BOUNDS)]
    problem, start = _start([task])
    task.attempts += 1
    unknowns = smallest_eigenvalue_point(problem.of(0), start[0], accept=0.9999, quaternion_bound=bound)
    if unknowns is not None:
        _offer_polished([task], problem, unknowns[None])


def _offer_polished(stack: Sequence[_Task], problem: Problem, unknowns: Floats) -> None:
    """Offer each task its network, polished with smaller and smaller quaternion weights until it is accepted."""
    # The less the quaternions move, the less the certificate suffers, but the larger are the translations.
    for weight in (0.05, 0.01, 0.001):
        if not stack:
            return
        state, required = (np.array([getattr(task, name) for task in stack]) for name in ("state", "required"))
        polished, translation = polish(problem, unknowns, state, required, quaternion_weight=weight)
        for task, network in zip(stack, _networks(stack, problem, polished, translation), strict=True):
            task.offer(network)
        left = np.flatnonzero([task.outcome is None for task in stack])
        stack, problem, unknowns = [stack[k] for k in left.tolist()], problem.of(left), unknowns[left]


def _networks(stack: Sequence[_Task], problem: Problem, unknowns: Floats, translation: Floats) -> list[LieEDNN]:
    """The network of each task's problem with its unknowns and translations."""
    blocks, _ = problem.blocks(unknowns)
    size = np.cbrt(np.abs(np.linalg.det(blocks)))
    safe = np.where(size > 0.0, size, 1.0)
    rotation = problem.signs[..., None, None] * blocks / safe[..., None, None]
    rotation[size == 0.0] = np.eye(3)
    diagonal = np.exp(2.0 * unknowns[:, problem.n_quaternion :])
    result = []
    for k, task in enumerate(stack):
        parts = task.ratio * problem.signs[k] * size[k], rotation[k], translation[k], task.offset
        result.append(LieEDNN(*parts, **task.rates, lyapunov_diagonal=diagonal[k]))
    return result
