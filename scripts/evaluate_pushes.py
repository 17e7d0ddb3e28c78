"""Push arms off the path of a shaped network by a tenth of their range, and measure their return.

    python scripts/evaluate_pushes.py [--pushes 50] [--rates 0.1 0.3 1] [--arms NAME ...] [--output results/pushes]

For each arm and rho, the arm follows the network with feedback (`NetworkPolicy`) in MuJoCo, without obstacles. A force
acts for 0.2 s on a random link in a random direction, after 20 to 50 % of the path. It is as large as needed for a
joint to deviate by 8 to 12 % of its range. Writes ``pushes.md``; an interrupted run goes on.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any

import numpy as np
from common import options, saved_rows, write

import lieednn_sim as ls
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.simulation import Following
from lieednn_sim.studies.reactions.disturbing import PUSH_DEVIATION, PUSH_TIME, UndisturbedPath, pushing_force

# Speed of motions [1/s]: rho times the network's own; time simulated [s]; pushes for one target.
PACE, DURATION, EACH = 2.0, 5.0, 10


@lru_cache(maxsize=2)
def prepared(name: str, rate: float, problem: int) -> tuple[ls.NetworkPolicy, np.ndarray, Following, UndisturbedPath]:
    """Policy, target, the undisturbed run, and its path."""
    arm = ls.Arm.load(name)
    target = ls.draw_target(arm, problem)
    network = ls.plan(arm, target, planner="lieednn-shaped", options=ShapedOptions(rate=rate), seed=problem).network
    assert isinstance(network, ls.LieEDNN)
    policy = ls.NetworkPolicy(arm, network, speed=PACE / rate, feedback=ls.Feedback())
    nominal = ls.follow(policy, target, DURATION)
    return policy, target, nominal, UndisturbedPath(arm, nominal.rollout.q)


def pushed(arm: str, rate: float, seed: int) -> dict[str, Any]:
    """The row of one push, whose force [N] is found by a search."""
    policy, target, nominal, path = prepared(arm, rate, seed // EACH)
    robot, rng = policy.arm, np.random.default_rng([seed, 7])
    _, gone = path.nearest(nominal.rollout.q)
    start = float(nominal.rollout.t[np.argmax(gone >= rng.uniform(0.2, 0.5))])
    link = robot.link_names[int(rng.integers(robot.n_links))]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)

    def run(force: float, duration: float) -> Any:
        push = ls.Push(link, (*(force * direction),), start, PUSH_TIME)
        rollout = ls.follow(policy, target, duration, disturbances=ls.Disturbances(pushes=(push,))).rollout
        return rollout, path.recovery(rollout.t, rollout.q, start, start + PUSH_TIME)

    force = pushing_force(lambda force: run(force, start + 2.0 * PUSH_TIME)[1].deviation)
    rollout, recovery = run(force, DURATION)
    tip = rollout.link_position[-1, -1] - np.asarray(robot.link_poses(target).translation)[-1]
    return {
        "deviation": round(recovery.deviation, 4),
        "time_s": "" if recovery.time_s is None else round(recovery.time_s, 3),
        "fraction": "" if recovery.fraction is None else round(recovery.fraction, 4),
        "velocity": round(float(np.abs(rollout.qd / robot.velocity_limits).max()), 3),
        "force": round(float(np.abs(rollout.force / robot.force_limits).max()), 3),
        "arrived_mm": round(1e3 * float(np.linalg.norm(tip)), 3),
    }


def summary(rows: list[dict[str, Any]], command: str) -> list[str]:
    """The table in Markdown, of the pushes whose force was found."""
    cells = []
    rows = [row for row in rows if not row["reason"]]
    for (name, rate), group in itertools.groupby(rows, key=lambda row: (row["arm"], row["rate"])):
        own = list(group)
        fractions = [row["fraction"] for row in own if row["fraction"] != ""]
        times = [row["time_s"] for row in own if row["time_s"] != ""]
        missed = sum(not 0.08 <= row["deviation"] <= 0.12 for row in own)
        velocity, force = (np.median([row[what] for row in own]) for what in ("velocity", "force"))
        cells.append([name, f"{rate:g}", len(own), len(fractions), f"{np.median(fractions):.0%}"])
        cells[-1] += [f"{max(fractions):.0%}", f"{sum(one < 0.4 for one in fractions)} of {len(own)}"]
        cells[-1] += [f"{np.median(times):.2f}", f"{velocity:.2f}", f"{force:.2f}", missed]
        cells[-1].append(f"{max(row['arrived_mm'] for row in own):.2g}")
    headings = ["arm", "rho", "pushes", "back", "fraction of what is left, median", "worst", "before 40 %"]
    headings += ["time after the push [s], median", "peak velocity / limit", "peak force / limit", "not 8 to 12 %"]
    return [
        "# Pushed by a tenth of the range",
        "",
        f"`{command}`: `follow(NetworkPolicy(...))` moves an arm in MuJoCo. A force of {PUSH_TIME:g} s on a random "
        f"link moves a joint off the undisturbed path by {100 * PUSH_DEVIATION:g} % (8 to 12) of its range.\n\n- "
        "**back**: from some time on, all joints stay within a tenth of this deviation.\n- **fraction of what is "
        "left**: the part of the path left at the push that has passed when the arm is back.\n- **peak velocity**: "
        "mostly that of the push itself.\n- **not 8 to 12 %**: pushes for which the search for the force gave up "
        f"outside this range.\n- **end**: distance of the end effector from its target after {DURATION:g} s. The clock "
        "waits after a push, so some of the path may be left.\n\nThe default coupling moves the network's state along "
        "with most of a push. The table therefore measures the network's own return, which decays as e^-t, while the "
        "clock runs at the rate rho.",
        *markdown_table([*headings, "end [mm], worst"], cells),
    ]


def main(arguments: list[str] | None = None) -> None:
    given = options(arguments, __doc__, "results/pushes", pushes=50, rates=(0.1, 0.3, 1.0), arms=DEFAULT_ARMS)
    asked = itertools.product(given.arms, given.rates, range(given.pushes))
    cases = [{"arm": arm, "rate": rate, "seed": seed} for arm, rate, seed in asked]
    rows = saved_rows(given.output / "runs", cases, pushed)
    rows.sort(key=lambda row: (row["arm"], row["rate"], row["seed"]))
    rates = " ".join(f"{rate:g}" for rate in given.rates)
    text = summary(rows, f"python scripts/evaluate_pushes.py --pushes {given.pushes} --rates {rates}")
    write(given.output / "pushes.md", text)


if __name__ == "__main__":
    main()
