"""The jobs: each trains, makes or checks something and returns arrays and scalars, from its parameters alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from lieednn_sim import learning, stability, theory
from lieednn_sim.learning import ALGORITHMS, History, train
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import synthesize
from paper.checks import CHECKS
from paper.plan import BIAS, TOLERANCE

Arrays = dict[str, np.ndarray]
Scalars = dict[str, Any]
Outcome = tuple[Arrays, Scalars]

# Of a stored history: bins whose width grows with the epoch, and the first epochs one by one.
N_BINS = 160
N_FIRST = 400
# Random starts are uniform in (-START, START); NEAR is how near to the target they must come.
START, N_STARTS, NEAR = 2.0, 100, 1e-3
TIMES = np.linspace(0.0, 40.0, 161)


def target(seed: int) -> np.ndarray:
    """The paper's random target, ``(4, 6)``: every coordinate uniform in (-0.8, 0.8)."""
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (4, 6))


def trained(algorithm: str, changes: dict[str, Any], seed: int) -> Outcome:
    """Projective learning in one of its variants."""
    return _training(ALGORITHMS[algorithm].load()(**changes), seed)


def riemannian(seed: int, **options: Any) -> Outcome:
    """Learning on the manifold itself."""
    return _training(learning.RiemannianOptions(**options), seed)


def synthesis(seed: int) -> Outcome:
    """A certified network for the target, without training."""
    result, seconds = _timed(lambda: synthesize(target(seed), seed=seed))
    scalars = {"success": result.success, "reason": result.message, "seconds": seconds}
    return _described(result.network, None, seed, scalars)


def retargeted(seed: int) -> Outcome:
    """The certified network of the first target, whose bias then leads it to another target."""
    network, goal = synthesize(target(0), seed=0).unwrap(), target(seed)
    # The first call also fills the network's caches.
    network.retarget(goal)
    moved, seconds = _timed(lambda: network.retarget(goal))
    success = float(np.abs(moved.equilibrium().xi - goal).max()) < TOLERANCE
    return _described(moved, None, seed, {"success": success, "reason": "retargeted", "seconds": seconds})


KINDS: dict[str, Callable[..., Outcome]] = {
    "train": trained,
    "riemannian": riemannian,
    "synthesis": synthesis,
    "retarget": retargeted,
    "check": lambda name, samples: ({}, CHECKS[name](samples)),
}


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """The result of a call and its CPU time, which does not depend on other load of the machine."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def _training(options: Any, seed: int) -> Outcome:
    result, seconds = _timed(lambda: train(target(seed), options, bias=BIAS, seed=seed))
    history = result.history
    rises = float(np.mean(np.diff(history.error) > 0.0)) if len(history) > 1 else 0.0
    scalars = {
        "success": result.success,
        "reason": str(result.reason),
        "seconds": seconds,
        "epochs": result.epochs,
        "starts": result.starts,
        "error": result.error,
        "structure_error": result.structure_error,
        "accuracy": float(history.accuracy[-1]),
        "rises": rises,
    }
    # On SE(3), where there is a network at all.
    network = result.network if isinstance(result.network, LieEDNN) else None
    arrays, scalars = _described(network, result.weight, seed, scalars)
    return {**arrays, **thinned(history)}, scalars


def thinned(history: History) -> Arrays:
    """A history in at most `N_BINS` rows: median and range of the error, last accuracy and equilibrium of each."""
    last = int(history.epoch[-1])
    edges = np.unique(np.round(np.geomspace(1.0, last + 2.0, N_BINS)).astype(int)) - 1
    first = np.unique(np.searchsorted(history.epoch, edges))
    first = first[first < len(history)]
    pieces = np.split(history.error, first[1:])
    ends = np.append(first[1:], len(history)) - 1
    return {
        "epoch": history.epoch[first].astype(np.int64),
        "error_median": np.array([np.median(piece) for piece in pieces]),
        "error_low": np.array([piece.min() for piece in pieces]),
        "error_high": np.array([piece.max() for piece in pieces]),
        "accuracy": history.accuracy[ends],
        "equilibrium": history.equilibrium[ends].astype(np.float32),
        "first_error": history.error[:N_FIRST],
    }


def _described(network: LieEDNN | None, weight: np.ndarray | None, seed: int, scalars: Scalars) -> Outcome:
    """Properties of a network at its target; the ablation has weights but no network, a failure may have neither."""
    if network is not None:
        weight = network.weight
    if weight is None:
        return {}, scalars
    goal = target(seed)
    bias = np.full(goal.shape, BIAS) if network is None else network.bias
    scalars |= {
        "one_norm": float(np.linalg.norm(weight, 1)),
        "infinity_norm": float(np.linalg.norm(weight, np.inf)),
        "smallest_one_norm": stability.smallest_one_norm(np.tanh(goal), goal - bias),
    }
    core = weight
    if network is not None:
        core = network.rotational_weight
        size = np.linalg.norm(network.translation, axis=-1)
        scalars |= {"median_translation": float(np.median(size)), "largest_translation": float(size.max())}
    certificate = None if network is None else network.certificate
    if certificate is None:
        certificate = stability.find_certificate(core, gamma=1.0, mu=1.0)
    scalars |= {"certified": certificate.valid, "lambda_max": certificate.lambda_max}
    arrays = {"weight": weight, "bias": bias}
    if scalars["success"]:
        scalars |= _dynamics(weight, bias.ravel(), goal.ravel(), seed)
    return arrays, scalars


def _dynamics(weight: np.ndarray, bias: np.ndarray, goal: np.ndarray, seed: int) -> Scalars:
    """The network run from zero and from random starts: whether it reaches the target, and how it moves."""
    jacobian = weight * (1.0 - np.tanh(goal) ** 2) - np.eye(len(goal))
    abscissa = float(np.linalg.eigvals(jacobian).real.max())
    states = trajectory(weight, bias, np.zeros_like(goal), TIMES)
    slope = states_slope(weight, bias, states)
    # xi'' = J(xi) xi'.
    bend = (slope * (1.0 - np.tanh(states) ** 2)) @ weight.T - slope
    radius = float(np.abs(states).max())
    bounds = theory.smoothness_bounds(weight, bias, radius, gamma=1.0, mu=1.0)
    starts = np.random.default_rng([seed, 1]).uniform(-START, START, (N_STARTS, len(goal)))
    # Long enough for the slowest mode near the target, unless that is very slow.
    duration = float(np.clip(15.0 / max(-abscissa, 1e-9), 60.0, 1000.0))
    ends = trajectory(weight, bias, starts, np.array([duration]), rtol=1e-5)[0]
    final = np.abs(ends - goal).max(axis=-1)
    return {
        "abscissa": abscissa,
        "from_zero": float(np.abs(trajectory(weight, bias, 0.0 * goal, np.array([duration]))[0] - goal).max()),
        "reached": float(np.mean(final < NEAR)),
        "radius": radius,
        "acceleration": float(np.abs(bend).max()),
        "curvature": float(theory.curvature(slope, bend).max()),
        "acceleration_bound": bounds.acceleration,
        # The paper's closing bound whether or not ||W||_inf < gamma/mu: 2 gamma (gamma R + gamma + mu b_max).
        "closing": 2.0 * (radius + 1.0 + float(np.abs(bias).max())),
        "closing_applies": bounds.closing is not None,
    }


def states_slope(weight: np.ndarray, bias: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Vector field with gamma = mu = 1 at states ``(..., n)``; also for weights that are no network of the package."""
    return np.tanh(states) @ weight.T + bias - states


def trajectory(
    weight: np.ndarray, bias: np.ndarray, start: np.ndarray, times: np.ndarray, *, rtol: float = 1e-8
) -> np.ndarray:
    """States ``(K, ..., n)`` at ``times`` ``(K,)`` from starts ``(..., n)``, all integrated at once."""
    shape = np.shape(start)

    def field(_: float, flat: np.ndarray) -> np.ndarray:
        return states_slope(weight, bias, flat.reshape(shape)).ravel()

    solution = solve_ivp(field, (0.0, times[-1]), np.ravel(start), t_eval=times, rtol=rtol, atol=1e-2 * rtol)
    return solution.y.T.reshape(len(times), *shape)
