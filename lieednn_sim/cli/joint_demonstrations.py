"""The command ``learn --arm``, which makes a run from demonstrations of an arm's joints, with a report and plots."""

from __future__ import annotations

import argparse
from dataclasses import asdict

import numpy as np

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import import_options, make_task
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import DEMONSTRATED
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.family import describe, ridges_of
from lieednn_sim.planning.demonstrated import JointDemonstrations, JointMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.demonstrations.joints import joints_table, motion_to, study_joints
from lieednn_sim.studies.demonstrations.plots import plot_joint_paths
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.validation import as_count, as_seed

# Options for positions and poses, with their defaults.
_OF_POSES = {"unit": "m", "quaternion": "wxyz", "rivals": ",".join(RIVALS)}


def learn_joints(arguments: argparse.Namespace) -> None:
    """Read, fit, measure, and write a run with network and motion, ``report.json`` and two plots."""
    for name, usual in _OF_POSES.items():
        if getattr(arguments, name) != usual:
            raise InputError(
                f"--{name} is for positions and poses; with --arm the columns are joints [rad, m], without rivals"
            )
    run = RunDirectory(arguments.output, arguments.plots)
    starts = as_count("starts", 20 if arguments.starts is None else arguments.starts)
    seed = as_seed("seed", arguments.seed)
    options = ShapingOptions(rate=arguments.clock_rate)
    arm = Arm.load(arguments.arm, **import_options(arguments))
    shown = JointDemonstrations.load(
        arm, arguments.files, rate=arguments.sample_rate, phase=arguments.phase, goals=arguments.goals
    )
    with run.at_work():
        learned = JointMotion.fit(shown, arguments.deviation, options, family=not arguments.no_family)
        motion, refusal = learned.planned(shown.mean[0])
        with progress("learn") as bar:
            study, paths = study_joints(
                shown,
                learned,
                starts=starts,
                leave_one_out=not arguments.no_leave_one_out,
                seed=seed,
                progress=bar,
            )
        arguments.duration, arguments.scene, arguments.scene_seed = float(motion.t[-1]), "free", 0
        asked = {
            "files": [str(name) for name in arguments.files],
            "sample_rate_hz": arguments.sample_rate,
            "phase": arguments.phase,
            "goals": arguments.goals,
            "clock_rate": arguments.clock_rate,
            "deviation_m": arguments.deviation,
            "family": not arguments.no_family,
        }
        task = make_task(
            arm, shown.mean[0], shown.mean[-1], arguments, planner=DEMONSTRATED, reason="demonstrated", options=asked
        )
        written = run.save_network(task, learned.network, motion)
        found = {
            **asked,
            "arm": arm.name,
            "joints": list(arm.joint_names),
            "seed": seed,
            "demonstrations": len(shown),
            "demonstrated_duration_s": learned.duration,
            "duration_s": arguments.duration,
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
    console.print(
        f"limits: not kept, {refusal}" if refusal else f"limits and clearance: kept, in {arguments.duration:.3g} s"
    )
    console.print(f"stability: {learned.network.certificate}")
    wrote(*written, *results)
