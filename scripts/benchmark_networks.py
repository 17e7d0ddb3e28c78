"""Rows of the benchmark on networks: learning, retargeting, evaluation, control steps, and starts of the package."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from functools import partial
from typing import Any

import numpy as np
from benchmark_timing import Row, seconds, time_ratios
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.learning import TrainingOptions, train
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import Plan, plan
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.policies import POLICIES, NetworkPolicy, make_policy
from lieednn_sim.simulation import follow, simulate
from lieednn_sim.synthesis import synthesize


def epoch_costs(targets: list[np.ndarray], epochs: int) -> dict[str, list[float]]:
    """Microseconds per epoch of each learning algorithm, for each target."""
    algorithms = {
        "literal Algorithm 1": TrainingOptions.literal(max_epochs=max(epochs // 10, 1)),
        "repaired Algorithm 1": TrainingOptions.repaired(max_epochs=epochs),
        "repaired, no projection": TrainingOptions.repaired(max_epochs=epochs, projection="none"),
        "tracked": TrainingOptions.tracked(),
    }
    costs: dict[str, list[float]] = {name: [] for name in algorithms}
    for seed, xi in enumerate(targets):
        for name, options in algorithms.items():
            result = train(xi, options, seed=seed)
            costs[name].append(1e6 * result.cpu_time / result.epochs)
    return costs


def learning_rows(targets: list[np.ndarray], epochs: dict[str, list[float]]) -> list[Row]:
    """Epochs of Algorithm 1 in each other and in linear solves, and learning and retargeting in syntheses."""
    literal, repaired = np.array(epochs["literal Algorithm 1"]), np.array(epochs["repaired Algorithm 1"])
    matrix, right = np.random.default_rng(0).normal(size=(24, 24)), np.ones(24)
    learned, retargeted = [], []
    solve = np.median([1e3 * seconds(partial(_repeat, 1000, np.linalg.solve, matrix, right)) for _ in repaired])
    for seed, xi in enumerate(targets):
        synthesis = synthesize(xi, seed=seed)
        learned.append(train(xi, TrainingOptions.tracked(), seed=seed).cpu_time / synthesis.cpu_time)
        retargeting = seconds(partial(_repeat, 200, synthesis.unwrap().retarget, 0.5 * xi)) / 200
        retargeted.append(synthesis.cpu_time / retargeting)
    return [
        Row("epoch of the literal Algorithm 1, in epochs of the repaired", (literal / repaired).tolist(), ">= 50"),
        Row(
            "epoch of the repaired Algorithm 1, in LU solves of its size by NumPy", (repaired / solve).tolist(), "<= 5"
        ),
        Row("tracked learning of a network, in certified syntheses", learned),
        Row("certified synthesis of a network, in retargetings", retargeted),
    ]


def _repeat(times: int, what: Any, *arguments: Any) -> None:
    for _ in range(times):
        what(*arguments)


def control_step_rows(arm: Arm) -> list[Row]:
    """Time of a control step of `follow` with feedback and 12 neurons, and in evaluations of the vector field.

    Over a run with its simulation, which empties the processor's caches between steps.
    """
    target, home = draw_target(arm, 0), arm.keyframe("home")
    network = plan(arm, target, planner="lieednn-shaped", options=ShapedOptions(encoded=False, neurons=(8,))).network
    assert isinstance(network, LieEDNN)
    assert network.n_neurons == 12
    following = follow(NetworkPolicy(arm, network), target, 7.0)
    times = following.step_time
    x = network.start(arm.encode(home)).ravel()
    field = np.median([seconds(partial(_repeat, 200, network.flat_vector_field, x)) / 200 for _ in range(5)])
    of = f"control step of follow with feedback, 12 neurons, {arm.name}"
    return [
        Row(f"{of} [us]", (1e6 * times).tolist()),
        Row(f"{of}, in evaluations of the field", (times / field).tolist()),
    ]


def policy_rows(arm: Arm) -> list[Row]:
    """Time of a step of every policy, over a run with its simulation."""
    target = draw_target(arm, 0)
    made = {name: make_policy(name, arm, target) for name in POLICIES}
    return [
        Row(f"step of policy {name}, {arm.name} [us]", (1e6 * follow(policy, target, 4.0).step_time).tolist())
        for name, policy in made.items()
    ]


def evaluation_row(arm: Arm, network: LieEDNN, instants: int, repeats: int) -> Row:
    """Time to evaluate xi(t) and joints at many instants, in that of SciPy's exponentials alone."""
    path = NetworkPath.integrate(arm, network, arm.keyframe("home"))
    assert path.trajectory is not None
    tau = np.linspace(0.0, path.trajectory[0].t[-1], instants)
    twists = network.visible(path.state(tau)).reshape(-1, 6)
    ratios = time_ratios(
        lambda: arm.decode(network.visible(path.state(tau))),
        lambda: RigidTransform.from_exp_coords(twists),
        repeats,
    )
    return Row(f"xi(t) and q(t) at {instants:,} instants, in SciPy's exponentials", ratios, "<= 3")


def retargeting_row(network: LieEDNN, repeats: int) -> Row:
    """Time to retarget, in that of a product W phi(x)."""
    xi, weight = 0.5 * network.visible(network.equilibrium().xi), network.weight
    ratios = time_ratios(
        partial(_repeat, 500, network.retarget, xi),
        partial(_repeat, 500, lambda: weight @ network.phi(xi).ravel()),
        repeats,
    )
    return Row("retargeting, in products W phi(x)", ratios, "<= 5")


def network_rows(
    arm: Arm, chosen: Plan, targets: list[np.ndarray], epochs: dict[str, list[float]], scale: int
) -> list[Row]:
    """All rows on networks; ``scale`` divides the numbers of instants and repetitions."""
    assert isinstance(chosen.network, LieEDNN)
    repeats = max(20 // scale, 1)
    synthesis = np.median([synthesize(xi, seed=seed).cpu_time for seed, xi in enumerate(targets)])
    goal = arm.keyframe("extended")
    plans = [seconds(partial(plan, arm, goal), time.perf_counter) for _ in range(repeats)]
    simulated = [simulate(arm, chosen.motion).t[-1] / seconds(partial(simulate, arm, chosen.motion)) for _ in plans]
    return [
        *learning_rows(targets, epochs),
        Row("planning with 24 candidates, in syntheses", (np.array(plans) / synthesis).tolist()),
        Row("real time, in simulations of it", simulated),
        *(row for name in arm_names() for row in control_step_rows(Arm.load(name))),
        *policy_rows(arm),
        retargeting_row(chosen.network, repeats),
        evaluation_row(arm, chosen.network, max(10_000 // scale, 10), repeats),
    ]


def start_rows(repeats: int) -> list[Row]:
    """Start-up times in those of the libraries that they need; processor times of a fresh Python."""

    def children() -> float:
        return sum(os.times()[2:4])

    def python(*arguments: str) -> Any:
        return partial(subprocess.run, [sys.executable, *arguments], check=True, capture_output=True)

    pairs = {
        "lieednn-sim --help, in starts of Python with NumPy": (("-m", "lieednn_sim", "--help"), "import numpy"),
        "import of lieednn_sim.arm, in imports of mujoco": (("-c", "import lieednn_sim.arm"), "import mujoco"),
    }
    return [
        Row(what, time_ratios(python(*ours), python("-c", floor), repeats, children), "<= 1.5")
        for what, (ours, floor) in pairs.items()
    ]
