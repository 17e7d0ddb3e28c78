"""Test the bounds on pushes, moving targets and time steps on 1000 seeded networks: do they hold, and how tightly?

    python scripts/robustness.py [--cases 1000] [--jobs 1] [--output results/robustness.md]

Writes a Markdown table (ten minutes on one core). Exits with status 1 if a bound is broken.
"""

from __future__ import annotations

import itertools
import sys
from collections import defaultdict
from dataclasses import replace
from functools import partial

import numpy as np
from common import options, spread, write
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from lieednn_sim.budget import one_blas_thread
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.stability import Robustness
from lieednn_sim.studies.study import worker_pool
from lieednn_sim.synthesis import synthesize

DURATION = 60.0


def synthesized(rng: np.random.Generator) -> LieEDNN:
    """A certified network for a random target of one to four neurons, as the paper draws them."""
    while True:
        n = int(rng.integers(1, 5))
        bias = "uniform" if n > 1 and rng.uniform() < 0.5 else "sign-matched"
        made = synthesize(rng.uniform(-0.8, 0.8, (n, 6)), bias=bias, seed=rng)
        if made.network is not None:
            return made.network


def scaled(rng: np.random.Generator) -> LieEDNN:
    """As `synthesized`, with smaller strengths, so that the network is well inside its certificate."""
    network = synthesized(rng)
    return replace(network, alpha=rng.uniform(0.2, 0.95) * network.alpha).certify()


def cascade(rng: np.random.Generator) -> LieEDNN:
    """Hidden neurons that drive visible ones, in half of the cases driven by a clock; without weights backwards."""
    visible, hidden, clock = int(rng.integers(1, 5)), int(rng.integers(2, 6)), int(rng.integers(0, 2))
    n = visible + hidden + clock
    alpha = np.zeros((n, n))
    rotation = Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3)
    alpha[:visible, visible : visible + hidden] = rng.normal(size=(visible, hidden))
    if clock:
        alpha[visible:-1, -1] = rng.uniform(2.0, 30.0, hidden)
        alpha[-1, -1], rotation[-1, -1] = 1.0 - rng.uniform(0.1, 0.9), np.eye(3)
    translation = rng.normal(size=(n, n, 3))
    translation[-1, -1] = 0.0
    return LieEDNN(
        alpha, rotation, translation, np.zeros((n, 6)), hidden_start=rng.uniform(-5.0, 5.0, (n - visible, 6))
    ).certify()


KINDS = {"synthesized": synthesized, "scaled": scaled, "cascade": cascade}


def field(network: LieEDNN, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Slopes at states ``(..., n)`` where the bias has the equilibrium at the origin."""
    drive = (network.phi(x) - network.phi(origin)) @ network.weight.T
    return network.mu * drive - network.gamma * (x - origin)


def run(network: LieEDNN, starts: np.ndarray, times: np.ndarray, velocity: np.ndarray | None = None) -> np.ndarray:
    """States ``(K, S, n)`` from starts ``(S, n)``; with a velocity, the bias moves the equilibrium."""
    shift = np.zeros(starts.shape[1]) if velocity is None else velocity
    target = network.goal(np.zeros((network.n_visible, 6))).ravel()

    def flow(t: float, x: np.ndarray) -> np.ndarray:
        return field(network, x.reshape(starts.shape), target + t * shift).ravel()

    found = solve_ivp(flow, (0.0, times[-1]), starts.ravel(), "DOP853", times, rtol=1e-9, atol=1e-11)
    return found.y.T.reshape(len(times), *starts.shape)


def unstable_step(jacobian: np.ndarray, method: str) -> float:
    """Step beyond which the method is unstable at the linearised equilibrium, an upper bound of provable steps."""
    values = np.linalg.eigvals(jacobian)

    def growth(h: float) -> float:
        z = h * values
        factor = 1.0 + z if method == "Euler" else 1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0
        return float(np.abs(factor).max()) - 1.0

    high = 1e-3
    while growth(high) < 0.0:
        high *= 1.1
    return float(brentq(growth, high / 1.1, high))


def measure(network: LieEDNN, rng: np.random.Generator) -> dict[str, float]:
    """Ratio of measurement to bound for each bound that is available; above 1 it is broken."""
    bounds = network.robustness()
    m, n = 6 * network.n_visible, 6 * network.n_neurons
    origin = network.goal(np.zeros((network.n_visible, 6))).ravel()
    push, one, velocity = np.zeros(n), np.zeros(n), np.zeros(n)
    push[:m] = rng.normal(size=m)
    push *= 10.0 ** rng.uniform(-2.0, 0.5) / np.linalg.norm(push)
    k = int(rng.integers(m))
    one[k] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-2.0, 0.5)
    velocity[:m] = rng.normal(size=m)
    velocity *= 10.0 ** rng.uniform(-3.0, -1.0) / np.linalg.norm(velocity)
    elsewhere = origin + rng.normal(size=n)
    elsewhere[m:] = network.hidden_start.ravel()
    times = np.linspace(0.0, DURATION / network.gamma, 600)
    x = run(network, np.array([origin + push, origin + one, elsewhere, elsewhere + push]), times)
    away = np.linalg.norm(x[:, 0, :m] - origin[:m], axis=1) / np.linalg.norm(push)
    apart = np.linalg.norm(x[:, 3, :m] - x[:, 2, :m], axis=1) / np.linalg.norm(push)
    lag = np.linalg.norm(
        (run(network, origin[None], times, velocity)[:, 0] - origin - times[:, None] * velocity), axis=1
    )
    alone = tuple(guarantee for guarantee in bounds.guarantees if not guarantee.contracting)
    ratios = {
        "push gain": away.max() / bounds.push_gain(),
        "push gain, one coordinate": np.abs(x[:, 1, k] - origin[k]).max() / abs(one[k]) / bounds.push_gain([k], [k]),
        "time to a tenth": times[np.flatnonzero(away > 0.1)[-1]] / bounds.settling_time(0.1),
        "lag": lag.max() / np.linalg.norm(velocity) / bounds.lag(),
    }
    if alone:
        ratios["push gain, certificate alone"] = away.max() / replace(bounds, guarantees=alone).push_gain()
    if bounds.contracting is not None:
        ratios["push gain, between two motions"] = apart.max() / bounds.contracting.push_gain()
    reached = np.ix_(bounds.reached, bounds.reached)
    jacobian = network.jacobian(origin.reshape(-1, 6))[reached]
    for method in ("Euler", "RK4"):
        # The proved step over the unstable one: a lower over an upper bound of the largest stable step.
        h = bounds.largest_step(method)
        ratios[f"{method} step"] = h / unstable_step(jacobian, method)
        if not closer(network, bounds, origin, h, method, rng):
            ratios[f"{method} step"] = np.inf
    return {name: float(value) for name, value in ratios.items()}


def closer(
    network: LieEDNN, bounds: Robustness, origin: np.ndarray, h: float, method: str, rng: np.random.Generator
) -> bool:
    """Whether 100 steps of size h from random pushes keep the guarantee's bounds on the distance, in its norm."""
    guarantee = max(bounds.guarantees, key=lambda g: float(getattr(g, f"{method.lower()}_step")))
    x = np.repeat(origin[None], 8, axis=0)
    m = 6 * network.n_visible
    x[:, :m] += rng.normal(size=(8, m)) * 10.0 ** rng.uniform(-2.0, 1.0, (8, 1))

    def distances(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm((x - origin)[:, bounds.reached] @ guarantee.factor.T, axis=1)

    first, flow = distances(x), partial(field, network, origin=origin)
    last = first
    for _ in range(100):
        x = runge_kutta_step(flow, x, h) if method == "RK4" else x + h * flow(x)
        now = distances(x)
        if guarantee.contracting and (now > last * (1.0 + 1e-9) + 1e-12).any():
            return False
        last = now
    # Without contraction, the function U bounds the distance by the overshoot.
    return bool((last <= guarantee.overshoot * first * (1.0 + 1e-9)).all())


def case(seed: int) -> tuple[str, dict[str, float]]:
    """Kind and ratios of a seeded network."""
    kind, rng = list(KINDS)[seed % len(KINDS)], np.random.default_rng(seed)
    with one_blas_thread():
        return kind, measure(KINDS[kind](rng), rng)


def report(cases: int, jobs: int) -> tuple[list[str], int]:
    """The table, and the number of broken bounds."""
    ratios: dict[tuple[str, str], list[float]] = defaultdict(list)
    with worker_pool(jobs) as pool:
        for kind, found in pool.map(case, range(cases), chunksize=5):
            for name, ratio in found.items():
                ratios[name, kind].append(ratio)
    rows, broken = [], 0
    for name, kind in itertools.product(dict.fromkeys(name for name, _ in ratios), KINDS):
        if values := ratios[name, kind]:
            beyond = sum(value > 1.0 + 1e-6 for value in values)
            rows.append([name, kind, len(values), beyond, *spread(values, 0.5, 0.95, 1.0)])
            broken += beyond
    lines = [
        "# Bounds on pushes, moving targets and time steps",
        "",
        f"`python scripts/robustness.py --cases {cases}` draws random certified networks with seeds 0 to {cases - 1}. "
        "They are in turn synthesized (one to four neurons), scaled (the same with weaker connections), and cascades "
        "with hidden neurons, half of which have a clock. Pushes (0.01 to 3), target velocities (0.001 to 0.1) and "
        "starts have random directions in the coordinates of the visible neurons. The table has ratios of measured "
        "values to their bounds. For time steps it has the proved step, divided by the step at which the linearisation "
        f"at the equilibrium turns unstable. A ratio above 1 breaks the bound: {broken} of "
        f"{sum(map(len, ratios.values()))} do.",
        *markdown_table(["bound", "network", "cases", "broken", "median", "95 %", "largest"], rows),
    ]
    return lines, broken


def main(arguments: list[str] | None = None) -> int:
    """Measure and write the table."""
    given = options(arguments, __doc__, "results/robustness.md", cases=1000, jobs=1)
    lines, broken = report(given.cases, given.jobs)
    write(given.output, lines)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
