"""Push arms off the path of a shaped network by a tenth of their range, and measure where they return to it.

    python scripts/evaluate_pushes.py [--pushes 50] [--rates 0.1,0.3,1] [--arms ...] [--output results/pushes]

For each arm and rho, the arm follows the network with feedback (`NetworkPolicy`) in MuJoCo, without
obstacles. A force acts for 0.2 s on a random link in a random direction, after 20 to 50 % of the path. Its size is
chosen so that the largest joint deviation from the undisturbed path is 8 to 12 % of the range. Writes ``pushes.csv``
with a row for each push, and ``pushes.md``; an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import itertools
from functools import lru_cache

import numpy as np
from csv_rows import read_rows, write_rows

from lieednn_sim import io
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.network import ComponentwiseNetwork, LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.policies import Feedback, NetworkPolicy
from lieednn_sim.simulation import Disturbances, Following, Push, follow
from lieednn_sim.studies.reactions.recovery import PUSH_DEVIATION, PUSH_TIME, UndisturbedPath, pushing_force

# Speed of motions [1/s]: rho times the network's own; time simulated [s]; pushes for one target.
PACE, DURATION, EACH = 2.0, 5.0, 10
FIELDS = (
    "arm",
    "rate",
    "seed",
    "link",
    "force_n",
    "deviation",
    "time_s",
    "fraction",
    "velocity",
    "force",
    "arrived_mm",
)


@lru_cache(maxsize=2)
def prepared(
    name: str, rate: float, problem: int
) -> tuple[Arm, ComponentwiseNetwork, np.ndarray, Following, UndisturbedPath]:
    """Arm, network, target, the undisturbed run, and its path."""
    arm = Arm.load(name)
    target = draw_target(arm, problem)
    network = plan(arm, target, planner="lieednn-shaped", options=ShapedOptions(rate=rate), seed=problem).network
    assert network is not None
    nominal = run(arm, network, target, rate, DURATION)
    return arm, network, target, nominal, UndisturbedPath(arm, nominal.rollout.q)


def run(
    arm: Arm,
    network: ComponentwiseNetwork,
    target: np.ndarray,
    rate: float,
    duration: float,
    *pushes: Push,
    feedback: Feedback | None = None,
) -> Following:
    """Follow the network, with a push."""
    assert isinstance(network, LieEDNN)
    policy = NetworkPolicy(arm, network, speed=PACE / rate, feedback=feedback or Feedback())
    return follow(policy, target, duration, disturbances=Disturbances(pushes=pushes))


def pushed(name: str, rate: float, seed: int, feedback: Feedback | None = None) -> dict[str, object]:
    """The row of one push, whose force [N] is found by a search."""
    arm, network, target, nominal, path = prepared(name, rate, seed // EACH)
    rng = np.random.default_rng([seed, 7])
    _, gone = path.nearest(nominal.rollout.q)
    start = float(nominal.rollout.t[np.argmax(gone >= rng.uniform(0.2, 0.5))])
    link = int(rng.integers(arm.n_links))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)

    def push(force: float) -> Push:
        return Push(arm.link_names[link], (*(force * direction),), start, PUSH_TIME)

    def deviation_under(force: float) -> float:
        rollout = run(arm, network, target, rate, start + 2.0 * PUSH_TIME, push(force), feedback=feedback).rollout
        return path.recovery(rollout.t, rollout.q, start, start + PUSH_TIME).deviation

    force = pushing_force(deviation_under)
    rollout = run(arm, network, target, rate, DURATION, push(force), feedback=feedback).rollout
    recovery = path.recovery(rollout.t, rollout.q, start, start + PUSH_TIME)
    tip = rollout.link_position[-1, -1] - np.asarray(arm.link_poses(target).translation)[-1]
    values = (
        name,
        rate,
        seed,
        arm.link_names[link],
        round(force, 1),
        round(recovery.deviation, 4),
        recovery.time_s if recovery.time_s is None else round(recovery.time_s, 3),
        recovery.fraction if recovery.fraction is None else round(recovery.fraction, 4),
        round(float(np.abs(rollout.qd / arm.velocity_limits).max()), 3),
        round(float(np.abs(rollout.force / arm.force_limits).max()), 3),
        round(1e3 * float(np.linalg.norm(tip)), 3),
    )
    return dict(zip(FIELDS, values, strict=True))


def summary(rows: list[dict[str, str]], command: str) -> str:
    """The table in Markdown."""
    lines = [
        "# Pushed by a tenth of the range",
        "",
        f"`{command}`. In MuJoCo, with `follow(NetworkPolicy(...))`: a force of {PUSH_TIME:g} s on a random link "
        f"takes a joint {100 * PUSH_DEVIATION:g} % (8 to 12) of its range off the undisturbed path. Back is "
        "within a tenth of that, for good; the fraction is of the path that was left when the push began. For some "
        "pushes the search for the force gave up outside 8 to 12 %; the last column is the distance of the end "
        f"effector from its target after {DURATION:g} s, since after a push the clock waits and some of the path may "
        "be left. The peak velocity is mostly the push's own. The default coupling takes most of a push along to the "
        "network's state, so that what is measured is the network's own return, as e^-t, while the clock goes on rho "
        "as fast.",
        "",
        "| arm | rho | pushes | back | fraction of what is left, median | worst | before 40 % | time after the push "
        "[s], median | peak velocity / limit | peak force / limit | not 8 to 12 % | end [mm], worst |",
        "|" + " --- |" * 12,
    ]
    for (name, rate), group in itertools.groupby(rows, key=lambda row: (row["arm"], row["rate"])):
        own = list(group)
        fractions = [float(row["fraction"]) for row in own if row["fraction"]]
        times = [float(row["time_s"]) for row in own if row["time_s"]]
        peaks = [np.median([float(row[what]) for row in own]) for what in ("velocity", "force")]
        missed = sum(not 0.08 <= float(row["deviation"]) <= 0.12 for row in own)
        lines.append(
            f"| {name} | {rate} | {len(own)} | {len(fractions)} | {np.median(fractions):.0%} | {max(fractions):.0%} | "
            f"{sum(one < 0.4 for one in fractions)} of {len(own)} | {np.median(times):.2f} | {peaks[0]:.2f} | "
            f"{peaks[1]:.2f} | {missed} | {max(float(row['arrived_mm']) for row in own):.2g} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pushes", type=int, default=50, help="for each arm and rho (default: %(default)s)")
    parser.add_argument("--rates", default="0.1,0.3,1", help="rho (default: %(default)s)")
    parser.add_argument("--arms", default=",".join(arm_names()), help="(default: all)")
    parser.add_argument("--output", default="results/pushes", help="directory (default: %(default)s)")
    options = parser.parse_args(arguments)
    directory = io.make_directory(options.output)
    table = directory / "pushes.csv"
    rows = read_rows(table)
    done = {(row["arm"], row["rate"], row["seed"]) for row in rows}
    wanted = itertools.product(options.arms.split(","), options.rates.split(","), range(options.pushes))
    for name, rate, seed in wanted:
        if (name, rate, str(seed)) in done:
            continue
        try:
            with one_blas_thread():
                row = pushed(name, float(rate), seed)
        except LieEDNNError as error:
            print(f"{name}, rho {rate}, push {seed}: {error}", flush=True)
            continue
        rows.append({name: "" if value is None else str(value) for name, value in row.items()} | {"rate": rate})
        print(rows[-1], flush=True)
        write_rows(table, FIELDS, rows)
    rows.sort(key=lambda row: (row["arm"], float(row["rate"]), int(row["seed"])))
    text = summary(rows, f"python scripts/evaluate_pushes.py --pushes {options.pushes} --rates {options.rates}")
    with io.atomic_text(directory / "pushes.md") as stream:
        stream.write(text)
    print(text)


if __name__ == "__main__":
    main()
