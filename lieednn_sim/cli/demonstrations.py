"""The command ``learn``, which makes a certified network from demonstrations, with a report and plots."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim.cli.arguments import import_options
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.joint_demonstrations import learn_joints
from lieednn_sim.cli.run_directory import PLOT_KINDS
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstrations, align, load_demonstrations
from lieednn_sim.learning.demonstrations.alignment import goal_distance
from lieednn_sim.learning.demonstrations.family import describe, ridges_of
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.demonstrations.models import ModelRow, compare_models, family_deviation, models_table
from lieednn_sim.studies.demonstrations.plots import plot_field, plot_paths
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.validation import as_choice, as_count, as_seed

# Distance of goals from their mean that is told, in extents of the demonstrations.
_GOALS_APART = 0.01


def learn(arguments: argparse.Namespace) -> None:
    """Read, fit, compare, and write ``network.npz``, ``report.json`` and two plots."""
    if arguments.arm is not None:
        learn_joints(arguments)
        return
    # Check values before any work.
    if given := import_options(arguments):
        raise InputError(f"--{next(iter(given))} needs --arm FILE.xml")
    kind = as_choice("kind of plots", arguments.plots, PLOT_KINDS)
    rivals = [] if arguments.rivals in ("", "none") else arguments.rivals.split(",")
    for name in rivals:
        RIVALS.find(name)
    starts = as_count("starts", 1000 if arguments.starts is None else arguments.starts)
    seed = as_seed("seed", arguments.seed)
    options = ShapingOptions(rate=arguments.clock_rate)
    shown = load_demonstrations(
        arguments.files, unit=arguments.unit, quaternion=arguments.quaternion, rate=arguments.sample_rate
    )
    demonstrations = align(shown, phase=arguments.phase, goals=arguments.goals)
    aligned = align(shown, phase=arguments.phase) if demonstrations.goals_kept else None
    apart = goal_distance(shown)
    if demonstrations.extent <= 0.0:
        raise InputError("the mean of the demonstrations does not move")
    with io.output_folder(arguments.output, "demonstrations") as directory:
        outputs = [directory / name for name in ("network.npz", "report.json", f"paths.{kind}", f"field.{kind}")]
        shaped = ShapedMotion.fit(demonstrations, arguments.deviation, options, family=not arguments.no_family)
        with progress("learn") as bar:
            rows, models = compare_models(
                demonstrations,
                shaped,
                rivals=rivals,
                aligned=aligned,
                starts=starts,
                leave_one_out=not arguments.no_leave_one_out,
                seed=seed,
                progress=bar,
            )
        with io.atomic_paths(outputs) as (network, report, paths, field):
            shaped.network.save(network)
            found = _report(arguments, demonstrations, shaped, rows)
            io.save_json(report, {**found, "goal_distance_m": apart})
            drawn = {shaped.name: shaped} if demonstrations.goals_kept else models
            plot_paths(drawn, demonstrations, paths)
            plot_field(shaped, demonstrations, field, seed)
    console.print(
        f"{len(shown)} demonstrations, {shown[0].shown}, {demonstrations.extent:.3g} m across, "
        f"{demonstrations.duration:.3g} s; {shaped.shaping.message}; {describe(shaped.response)}"
    )
    if apart > _GOALS_APART * demonstrations.extent:
        seen = "kept" if demonstrations.goals_kept else "aligned: each path is seen from its own (see --goals)"
        console.print(f"goals are up to {apart:.3g} m from their mean, and {seen}")
    console.print(models_table(rows, turns=demonstrations.dof == 6))
    console.print(f"stability: {shaped.network.certificate}")
    wrote(*outputs)


def _report(
    arguments: argparse.Namespace, demonstrations: Demonstrations, shaped: ShapedMotion, rows: list[ModelRow]
) -> dict[str, Any]:
    """All settings, the meaning of the network's coordinates, and the table."""
    goal = demonstrations.goal
    return {
        "files": [str(name) for name in arguments.files],
        "unit": arguments.unit,
        "quaternion": arguments.quaternion,
        "sample_rate_hz": arguments.sample_rate,
        "phase": arguments.phase,
        "goals": arguments.goals,
        "clock_rate": arguments.clock_rate,
        "seed": arguments.seed,
        "family": not arguments.no_family,
        "demonstrations": len(demonstrations),
        "dof": demonstrations.dof,
        "extent_m": demonstrations.extent,
        "spread_m": float(np.linalg.norm(demonstrations.spread[:, 3:], axis=1).max()),
        "lever_m": demonstrations.lever,
        "goal_position_m": goal.translation.tolist(),
        "goal_quaternion_wxyz": goal.rotation.as_quat(scalar_first=True).tolist(),
        "network_state": ["turn from the goal [rad]"] * 3 + ["position from the goal [m]"] * 3,
        "network_message": shaped.shaping.message,
        "network_deviation_m": shaped.shaping.deviation,
        "network_within_deviation": shaped.shaping.success,
        "network_certified": shaped.network.certified,
        "ridges": ridges_of(shaped.response),
        "family_deviation_m": family_deviation(shaped, demonstrations),
        # The time law: at t [s] the network is at its own time tau.
        "t_s": shaped.t.tolist(),
        "tau": shaped.tau.tolist(),
        "models": [asdict(row) for row in rows],
    }
