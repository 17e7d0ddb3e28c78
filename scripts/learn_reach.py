# /// script
# requires-python = ">=3.11,<3.14"
# dependencies = ["lieednn_sim[gymnasium]", "stable-baselines3>=2.9,<3", "gymnasium-robotics>=1.4,<2"]
# ///
"""Learn LieEDNN/TelescopicReach-v0 with common learners, against the expert and random actions.

    pip install 'stable-baselines3>=2.9,<3' 'gymnasium-robotics>=1.4,<2'
    python scripts/learn_reach.py [--seeds 3] [--jobs 2] [--output results/learning]

The learners are behaviour cloning of the expert, and SAC and PPO of Stable-Baselines3 with default settings (PPO's
batch of 2048 steps comes from eight environments) on observations normalised by `VecNormalize`. They act ten times a
second. `LEARNERS` has their budgets, and each run is a process of one thread. Finished runs are kept in
``OUTPUT/runs``, so an interrupted study goes on. Writes ``learning.md`` and ``learning.png``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
from common import BATCH, options, perceptron, saved_runs, write

from lieednn_sim import io
from lieednn_sim.environments.expert import Expert
from lieednn_sim.environments.gymnasium import ENVIRONMENTS, Environment
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.evaluation.figure_layout import drawn
from lieednn_sim.values import Floats

NAME = next(iter(ENVIRONMENTS))
PERIOD = 0.1  # time between actions [s]
# Names and budgets of learners: control steps, those of the expert for behaviour cloning.
LEARNERS = {"behaviour cloning": 120_000, "SAC": 20_000, "PPO": 400_000}
EXPERT, RANDOM = "expert", "random actions"
EPOCHS = 50
# Evaluations during training; episodes of each, and of the last one; the first of their seeds.
POINTS, FEW, MANY, FIRST_SEED = 5, 20, 100, 10**6
Act = Callable[[Floats], Any]


def environment() -> Environment:
    """The environment of all learners; observations are one vector."""
    return Environment("reach", flat=True, control_timestep=PERIOD)


def evaluate(act: Act, episodes: int, where: Environment | None = None) -> dict[str, list[Any]]:
    """Final success and errors, and smoothness and time to the goal, of each of the fixed evaluation episodes."""
    where = where or environment()
    rows: dict[str, list[Any]] = {"success": [], "mm": [], "deg": [], "jerk": [], "goal_s": []}
    for episode in range(episodes):
        seen, info = where.reset(seed=FIRST_SEED + episode)
        velocities, successes, over = [where.task.simulation.qd], [False], False
        while not over:
            seen, _, failed, late, info = where.step(act(seen))
            over = failed or late
            velocities.append(where.task.simulation.qd)
            successes.append(info["success"])
        rows["success"].append(successes[-1])
        rows["mm"].append(1e3 * info["distance"])
        rows["deg"].append(float(np.rad2deg(info["angle"])))
        rows["jerk"].append(jerk(np.array(velocities) / where.task.arm.ranges, PERIOD))
        rows["goal_s"].append(arrival(successes))
    return rows


def jerk(velocities: Floats, period: float) -> float:
    """Root mean square of the second differences of velocities ``(K, n)``, as `evaluation.metrics.motion_metrics`."""
    return float(np.sqrt(np.mean((np.diff(velocities, n=2, axis=0) / period**2) ** 2)))


def arrival(successes: Sequence[bool]) -> float | None:
    """Time from which on all are true [s]; None if the last one is not."""
    failures = np.flatnonzero(~np.array(successes))
    first = int(failures[-1]) + 1 if len(failures) else 0
    return PERIOD * first if first < len(successes) else None


def expert_of(where: Environment) -> Act:
    """The expert of an environment, which knows more than the observations."""
    expert = Expert(where, policy="lieednn-certified")
    return lambda _: expert.act()


def demonstrations(path: Path) -> tuple[Floats, Floats]:
    """Observations and actions of the expert, from a file if it is there."""
    if not path.exists():
        where = environment()
        act, seen, pairs = expert_of(where), np.empty(0), []
        for step in range(LEARNERS["behaviour cloning"]):
            if step % where.task.steps == 0:
                seen, _ = where.reset(seed=step)
            pairs.append((seen, act(seen)))
            seen = where.step(pairs[-1][1])[0]
        with io.atomic_path(path) as temporary, temporary.open("wb") as stream:
            observations, actions = (np.array(values, dtype=np.float32) for values in zip(*pairs, strict=True))
            np.savez_compressed(stream, observations=observations, actions=actions)
    with np.load(path) as stored:
        return stored["observations"], stored["actions"]


def cloned(seed: int, path: Path) -> Iterator[tuple[int, Act]]:
    """Now and then, the expert steps seen and the policy, a network like SAC's that is fitted by least squares."""
    torch, (observations, actions) = import_module("torch"), demonstrations(path)
    mean, deviation = observations.mean(axis=0), observations.std(axis=0) + 1e-6
    total = EPOCHS * (len(actions) // BATCH)

    def act(network: Any, seen: Floats) -> Floats:
        with torch.no_grad():
            return network(torch.as_tensor((seen - mean) / deviation, dtype=torch.float32)).double().numpy()

    steps = perceptron((observations - mean) / deviation, actions, 1e-3, EPOCHS, seed)
    for done, network in enumerate(steps, 1):
        if done % (total // POINTS) == 0:
            yield round(done / total * len(actions)), partial(act, network)


def reinforced(learner: str, seed: int) -> Iterator[tuple[int, Act]]:
    """Now and then, the steps done and the deterministic policy of a learner of Stable-Baselines3."""
    vectors = import_module("stable_baselines3.common.vec_env")
    count = 8 if learner == "PPO" else 1
    environments = vectors.VecNormalize(vectors.DummyVecEnv([environment] * count))
    options = {"n_steps": 2048 // count} if learner == "PPO" else {}
    model = getattr(import_module("stable_baselines3"), learner)(
        "MlpPolicy", environments, seed=seed, device="cpu", **options
    )

    def act(seen: Floats) -> Floats:
        return np.asarray(model.predict(environments.normalize_obs(seen), deterministic=True)[0], dtype=float)

    for point in range(1, POINTS + 1):
        more = LEARNERS[learner] * point // POINTS - model.num_timesteps
        if more > 0:
            model.learn(more, reset_num_timesteps=False)
        yield model.num_timesteps, act


def run(learner: str, seed: int, folder: Path) -> dict[str, Any]:
    """Train and evaluate one learner with one seed."""
    if learner == EXPERT:
        where = environment()
        return {"last": evaluate(expert_of(where), MANY, where)}
    if learner == RANDOM:
        rng, size = np.random.default_rng(seed), environment().action_space.shape
        return {"last": evaluate(lambda _: rng.uniform(-1.0, 1.0, size), MANY)}
    import_module("torch").set_num_threads(1)
    spent, start, curve, act = 0.0, time.process_time(), [], None
    data = folder / "demonstrations.npz"
    for steps, act in cloned(seed, data) if learner == "behaviour cloning" else reinforced(learner, seed):
        spent += time.process_time() - start
        curve.append((steps, float(np.mean(evaluate(act, FEW)["success"]))))
        print(f"{learner} {seed}: {steps} steps, {spent:.0f} s, success {curve[-1][1]:.2f}", flush=True)
        start = time.process_time()
    if act is None:
        raise LieEDNNError(f"{learner} made no policy")
    return {"curve": curve, "cpu_s": spent, "last": evaluate(act, MANY)}


def report(runs: dict[str, list[dict[str, Any]]], libraries: str = "") -> list[str]:
    """Markdown table of all learners; rates as means with their range over the seeds."""
    rows = []
    for learner, found in runs.items():
        rates = [100.0 * float(np.mean(one["last"]["success"])) for one in found]
        keys = ("mm", "deg", "jerk", "goal_s")
        every = {key: np.array([one["last"][key] for one in found], dtype=float) for key in keys}
        cells = [learner, f"{found[0]['curve'][-1][0]:,}" if "curve" in found[0] else ""]
        cells.append(f"{np.mean(rates):.0f} ({min(rates):.0f} to {max(rates):.0f})")
        cells += [f"{np.quantile(every[key], part):.3g}" for key in ("mm", "deg") for part in (0.5, 0.95)]
        times = every["goal_s"][np.isfinite(every["goal_s"])]
        cells += [f"{np.median(every['jerk']):.3g}", f"{np.median(times):.1f}" if len(times) else ""]
        rows.append([*cells, f"{np.mean([one['cpu_s'] for one in found]) / 60.0:.1f}" if "cpu_s" in found[0] else ""])
    headings = ["", "steps", "success % (range)", "mm, median", "mm, 95 %", "deg, median", "deg, 95 %", "jerk [1/s^3]"]
    return [
        "# Learning to reach",
        "",
        f"The environment is `{NAME}` with ten actions a second. With each of {max(map(len, runs.values()))} seeds a "
        f"policy is evaluated in {MANY} fixed episodes of 6 s. An episode succeeds if it ends at rest within 1 mm and "
        "0.1 degrees of the target. Errors are those at the end. Jerk is that of the joints in units of their ranges, "
        f"and the column goal is the time after which the arm stays at the target; both are medians.{libraries}",
        *markdown_table([*headings, "goal [s]", "CPU min per seed"], rows),
    ]


def plot(runs: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Success over the budgets, as means and ranges, and the expert's as a line."""
    with drawn(path, 6.5, 3.4) as figure:
        axes = figure.subplots()
        for learner, found in runs.items():
            if "curve" in found[0]:
                steps = np.array([point[0] for point in found[0]["curve"]])
                label = f"{learner}, {steps[-1]:,} steps{' of the expert' if learner.startswith('behaviour') else ''}"
                rates = 100.0 * np.array([[point[1] for point in one["curve"]] for one in found])
                (line,) = axes.plot(
                    share := 100.0 * steps / steps[-1], rates.mean(axis=0), "-o", markersize=4, label=label
                )
                axes.fill_between(share, rates.min(axis=0), rates.max(axis=0), color=line.get_color(), alpha=0.2, lw=0)
        rate = 100.0 * np.mean(runs[EXPERT][0]["last"]["success"])
        axes.axhline(rate, color="black", linestyle="--", label=EXPERT)
        axes.set(ylim=(-4, 104), xlabel="share of the budget of steps, or of updates [%]", ylabel="success [%]")
        axes.legend(loc="center", bbox_to_anchor=(0.65, 0.3))


def main(arguments: Sequence[str] | None = None) -> None:
    """Do the runs that are missing, each in a process of its own, and write table and picture."""
    given = options(arguments, __doc__, "results/learning", seeds=3, jobs=2)
    folder = io.make_directory(given.output / "runs")
    # All clones learn from the same demonstrations, which are made first.
    demonstrations(folder / "demonstrations.npz")
    seeds = {EXPERT: 1} | dict.fromkeys((*LEARNERS, RANDOM), given.seeds)
    asked = {f"{name}-{seed}": (name, seed, folder) for name, count in seeds.items() for seed in range(count)}
    made = iter(saved_runs(folder, asked, run, given.jobs))
    runs = {name: [next(made) for _ in range(count)] for name, count in seeds.items()}
    used = [f"{name} {metadata.version(name)}" for name in ("stable-baselines3", "torch", "gymnasium")]
    write(given.output / "learning.md", report(runs, f" Versions: {', '.join(used)}."))
    plot(runs, given.output / "learning.png")


if __name__ == "__main__":
    main()
