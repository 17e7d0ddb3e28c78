"""The command ``learn --arm``, which makes a run from demonstrations of an arm's joints, with a report and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from lieednn_sim import io
from lieednn_sim.cli.arguments import ChosenArm
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.learning.demonstrations.family import describe, ridges_of
from lieednn_sim.planning.demonstrated import JointDemonstrations, JointMotion
from lieednn_sim.studies.demonstrations.joints import joints_table, motion_to, study_joints
from lieednn_sim.studies.demonstrations.plots import plot_joint_paths
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.validation import as_count, as_seed


@dataclass(frozen=True)
class Fitting:
    """What is learned from demonstrations.

    Attributes:
        sample_rate: sampling rate of files without times [Hz].
        phase: average demonstrations at equal fractions of their path, 'length', or of their duration, 'time'.
        goals: 'aligned': express each path relative to its own goal; 'kept': learn how the path depends on its goal.
        deviation: largest deviation of the network from the mean demonstration [m] (default: 0.002 of the extent of the
            demonstrations, or with --arm 0.001 of the length of their path).
        clock_rate: rate rho of the network's clock: at 1 the path moves along with the start; below 1 the motion
            returns to the learned path, 1/rho times as fast.
        starts: number of random starts from which to run each model (default: 1000; with --arm 20).
        family: learn how the path depends on its start.
        leave_one_out: fit the models again with each demonstration left out.
        seed: seed of random draws.
    """

    sample_rate: float = 100.0
    phase: str = "length"
    goals: str = "aligned"
    deviation: float | None = None
    clock_rate: float = 1.0
    starts: int | None = None
    family: bool = True
    leave_one_out: bool = True
    seed: int = 0


def learn_joints(files: Sequence[str], chosen: ChosenArm, fitting: Fitting, run: RunDirectory) -> None:
    """Read, fit, measure, and write a run with network and motion, ``report.json`` and two plots."""
    starts = as_count("starts", 20 if fitting.starts is None else fitting.starts)
    seed = as_seed("seed", fitting.seed)
    options = ShapingOptions(rate=fitting.clock_rate)
    arm = chosen.load()
    shown = JointDemonstrations.load(arm, files, rate=fitting.sample_rate, phase=fitting.phase, goals=fitting.goals)
    with run.at_work():
        learned = JointMotion.fit(shown, fitting.deviation, options, family=fitting.family)
        motion, refusal = learned.planned(shown.mean[0])
        with progress("learn") as bar:
            study, paths = study_joints(
                shown,
                learned,
                starts=starts,
                leave_one_out=fitting.leave_one_out,
                seed=seed,
                progress=bar,
            )
        duration = float(motion.t[-1])
        asked = {"files": list(files), **asdict(fitting)}
        about = {"planner": "learn", "reason": "demonstrated", "options": asked}
        task = chosen.task(arm, shown.mean[0], shown.mean[-1], duration, seed, **about)
        written = run.save_network(task, learned.network, motion)
        found = {
            **asked,
            "arm": arm.name,
            "joints": list(arm.joint_names),
            "demonstrations": len(shown),
            "demonstrated_duration_s": learned.duration,
            "duration_s": duration,
            "spread_m": float(shown.spread.max()),
            "network_message": learned.shaping.message,
            "network_deviation_m": learned.shaping.deviation,
            "network_within_deviation": learned.shaping.success,
            "network_certified": learned.network.certified,
            "ridges": ridges_of(learned.response),
            "mechanism_gap_mm": 1e3 * float(motion.gap_translation.max()),
            "mechanism_gap_deg": float(np.rad2deg(motion.gap_rotation.max())),
            "limits_kept": not refusal,
            "limit_broken": refusal,
            **asdict(study),
        }
        reproduced = learned.run(shown.mean[0]).q
        fan = [motion_to(learned, shown, one[-1]).run(one[0]).q for one in shown.q] if learned.response else []
        results = [run.report, run.demonstrations_plot, run.starts_plot]
        with io.atomic_paths(results) as (report, demonstrations_plot, starts_plot):
            io.save_json(report, found)
            plot_joint_paths(shown, reproduced, demonstrations_plot, fan=fan)
            plot_joint_paths(shown, reproduced, starts_plot, paths)
    print_import_report(arm)
    console.print(
        f"{len(shown)} demonstrations of {arm.n_joints} joints of {arm.name}, {learned.duration:.3g} s; "
        f"{learned.shaping.message}; {describe(learned.response)}"
    )
    console.print(joints_table(study, arm))
    console.print(f"limits: not kept, {refusal}" if refusal else f"limits and clearance: kept, in {duration:.3g} s")
    console.print(f"stability: {learned.network.certificate}")
    wrote(*written, *results)
