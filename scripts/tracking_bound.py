"""Compare tracking errors with the bound computed before the run, over random masses in the bound's range.

    python scripts/tracking_bound.py [--seeds 63] [--output results/tracking_bound.md]

The controller ``computed-torque`` follows motions to random targets in 1.5 s, two runs each, with masses or a payload
that it does not know. Writes a Markdown table (two minutes on one core); exits with status 1 if an error exceeds its
bound.
"""

from __future__ import annotations

import sys

import numpy as np
from common import options, spread, write

import lieednn_sim as ls
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.simulation import tracking_bound

ARMS = ("telescopic_pr", "telescopic_rrp")
# Scales of masses, and the largest payload [kg].
RANGES = {
    "masses 0.9 to 1.1": ((0.9, 1.1), 0.0),
    "masses 0.8 to 1.2": ((0.8, 1.2), 0.0),
    "payload up to 0.5 kg": ((1.0, 1.0), 0.5),
    "masses 0.9 to 1.1, payload up to 0.3 kg": ((0.9, 1.1), 0.3),
}


def compared(arm: ls.Arm, mass_scale: tuple[float, float], payload: float, seed: int) -> np.ndarray:
    """``(2, 2, n)`` tracking errors and bounds of two runs."""
    rng = np.random.default_rng([seed, 11])
    planner = ("minimum-jerk", "lieednn-shaped")[seed % 2]
    motion = ls.plan(arm, ls.draw_target(arm, seed), planner=planner, duration=1.5, seed=seed)
    bound, errors = tracking_bound(arm, motion, mass_scale=mass_scale, payload=payload), []
    for _ in range(2):
        changes = ls.Disturbances(mass_scale=rng.uniform(*mass_scale), payload=rng.uniform(0.0, payload))
        run = ls.simulate(arm, motion, controller="computed-torque", disturbances=changes)
        errors.append([np.abs(run.q - run.q_ref).max(axis=0), bound])
    return np.array(errors)


def main() -> int:
    """Run the study; returns the exit status."""
    given = options(None, __doc__, "results/tracking_bound.md", seeds=63)
    rows, runs, broken = [], 0, 0
    for name in ARMS:
        arm = ls.Arm.load(name)
        for what, span in RANGES.items():
            with one_blas_thread():
                pairs = np.concatenate([compared(arm, *span, seed) for seed in range(given.seeds)])
            error, bound = pairs.swapaxes(0, 1)
            beyond, most = int((error > bound).any(axis=1).sum()), error.max(axis=1)
            values = [len(most), beyond, *(f"{1e3 * np.median(each):.2g}" for each in (most, bound.max(axis=1)))]
            rows.append([name, what, *values, *spread(bound.max(axis=1) / most, 0.0, 0.5, 0.95)])
            print(*rows[-1], sep=", ", flush=True)
            runs, broken = runs + len(most), broken + beyond
    headings = ["arm", "range", "runs", "beyond", "error [1e-3]", "bound [1e-3]", "least ratio", "median", "95 %"]
    head = (
        f"`python scripts/tracking_bound.py --seeds {given.seeds}`: the controller `computed-torque` follows motions "
        "with masses and payloads that it does not know, drawn from the range that `simulation.tracking_bound` was "
        "given. The table has medians of the largest error of a joint and of its bound [rad, m], and the ratio of the "
        f"bound to the error. A joint was beyond its bound in {broken} of {runs} runs."
    )
    title = "# Tracking errors and their bound before the run"
    write(given.output, [title, "", head, *markdown_table(headings, rows)])
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
