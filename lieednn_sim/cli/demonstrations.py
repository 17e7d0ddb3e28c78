"""The command ``learn``: a certified network from demonstrations of poses or of joints, a report and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from lieednn_sim import io
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.cli.arguments import ChosenArm
from lieednn_sim.cli.console import console, print_import_report, progress, wrote
from lieednn_sim.cli.kinds import Directory, File
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import align, load_demonstrations
from lieednn_sim.learning.demonstrations.alignment import goal_distance
from lieednn_sim.learning.demonstrations.family import describe
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.planning.demonstrated import JointDemonstrations, JointMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.demonstrations.joints import joints_table, motion_to, study_joints
from lieednn_sim.studies.demonstrations.models import compare_models, family_deviation, models_table
from lieednn_sim.studies.demonstrations.plots import plot_field, plot_joint_paths, plot_paths
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.validation import as_count, as_seed


@dataclass(frozen=True)
class Reading:
    """How positions and poses are read, and with what the network is compared.

    Attributes:
        unit: unit of the positions in the files: m, cm or mm.
        quaternion: order of the components of quaternions: wxyz or xyzw.
        rivals: models to compare the network with, or none (default: all of: a name of `RIVALS`).
    """

    unit: str = "m"
    quaternion: str = "wxyz"
    rivals: Sequence[str] | None = None


@dataclass(frozen=True)
class Fitting:
    """What is learned from demonstrations.

    Attributes:
        sample_rate: sampling rate of files without times [Hz].
        time_unit: unit of the times in the files: s, ms, us or ns.
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
    time_unit: str = "s"
    phase: str = "length"
    goals: str = "aligned"
    deviation: float | None = None
    clock_rate: float = 1.0
    starts: int | None = None
    family: bool = True
    leave_one_out: bool = True
    seed: int = 0


def learn(
    files: list[File],
    *,
    arm: str | None = None,
    reading: Reading,
    fitting: Fitting,
    output: Directory = "results/learned-motion",
    plots: str = "png",
    imported: Annotated[ImportOptions, "*"],
) -> None:
    """Learn a certified network from recorded motions of an end effector or of an arm's joints.

    The files are .npy, .npz, .csv, .txt, .tsv, .tum or LASA's .mat. Each row is a position x y or x y z, or a pose
    with a unit quaternion, and the network is compared with other models. With --arm each row holds the joints of the
    arm; continue with 'simulate'.

    Args:
        files: files with demonstrations of one motion, each of which ends at its goal.
        arm: a name of `ARMS`, or an MJCF, URDF or YAML file: learn the motion of its joints, which the columns of the
            demonstrations are [rad, m].
        reading: positions and poses, without --arm.
        fitting: what is learned.
        output: directory for the results.
        plots: format of the plots: png, pdf or svg.
        imported: how a model file is imported.
    """
    run = RunDirectory(output, plots)
    # Check values before any work.
    usual = 1000 if arm is None else 20
    starts = as_count("starts", usual if fitting.starts is None else fitting.starts)
    how = {"starts": starts, "leave_one_out": fitting.leave_one_out, "seed": as_seed("seed", fitting.seed)}
    if arm is not None:
        if reading != Reading():
            raise InputError(
                "--unit, --quaternion and --rivals are for positions and poses; with --arm the columns are joints "
                "[rad, m], without rivals"
            )
        _learn_joints(files, ChosenArm(arm, imported=imported), fitting, run, **how)
        return
    if imported:
        raise InputError(f"--{next(iter(imported))} needs --arm FILE.xml")
    _learn_poses(files, reading, fitting, run, **how)


def _learn_poses(files: Sequence[str], reading: Reading, fitting: Fitting, run: RunDirectory, **how: Any) -> None:
    """Read, fit and compare with rivals; write network, ``report.json`` and two plots."""
    rivals = list(RIVALS) if reading.rivals is None else [name for name in reading.rivals if name != "none"]
    for name in rivals:
        RIVALS.find(name)
    options = ShapingOptions(rate=fitting.clock_rate)
    rate, time_unit = fitting.sample_rate, fitting.time_unit
    shown = load_demonstrations(files, unit=reading.unit, quaternion=reading.quaternion, rate=rate, time_unit=time_unit)
    demonstrations = align(shown, phase=fitting.phase, goals=fitting.goals)
    aligned = align(shown, phase=fitting.phase) if demonstrations.goals_kept else None
    apart = goal_distance(shown)
    if demonstrations.extent <= 0.0:
        raise InputError("the mean of the demonstrations does not move")
    outputs = [run.network, run.report, run.plot("paths"), run.plot("field")]
    with io.output_folder(run.path, "demonstrations"):
        shaped = ShapedMotion.fit(demonstrations, fitting.deviation, options, family=fitting.family)
        with progress("learn"):
            rows, models = compare_models(demonstrations, shaped, rivals=rivals, aligned=aligned, **how)
        with io.atomic_paths(outputs) as (network, report, paths, field):
            shaped.network.save(network)
            goal = demonstrations.goal
            results = {
                "files": files,
                "unit": reading.unit,
                "quaternion": reading.quaternion,
                **asdict(fitting),
                **_learned(shaped),
                "demonstrations": len(demonstrations),
                "dof": demonstrations.dof,
                "extent_m": demonstrations.extent,
                "spread_m": float(np.linalg.norm(demonstrations.spread[:, 3:], axis=1).max()),
                "lever_m": demonstrations.lever,
                "goal_distance_m": apart,
                "goal_position_m": goal.translation.tolist(),
                "goal_quaternion_wxyz": goal.rotation.as_quat(scalar_first=True).tolist(),
                "start_twist": shaped.start.tolist(),
                "network_state": ["turn from the goal [rad]"] * 3 + ["position from the goal [m]"] * 3,
                "family_deviation_m": family_deviation(shaped, demonstrations),
                # The time law: at t [s] the network is at its own time tau.
                "t_s": shaped.t.tolist(),
                "tau": shaped.tau.tolist(),
                "models": [asdict(row) for row in rows],
            }
            io.save_json(report, results)
            drawn = {shaped.name: shaped} if demonstrations.goals_kept else models
            plot_paths(drawn, demonstrations, paths)
            plot_field(shaped, demonstrations, field, fitting.seed)
    _print_verdict(shaped)
    console.print(
        f"{len(shown)} demonstrations, {shown[0].shown}, {demonstrations.extent:.3g} m across, "
        f"{demonstrations.duration:.3g} s; {describe(shaped.response)}"
    )
    if apart > 0.01 * demonstrations.extent:
        seen = "kept" if demonstrations.goals_kept else "aligned: each path is seen from its own (see --goals)"
        console.print(f"goals are up to {apart:.3g} m from their mean, and {seen}")
    console.print(models_table(rows, turns=demonstrations.dof == 6))
    wrote(*outputs)


def _learn_joints(files: Sequence[str], chosen: ChosenArm, fitting: Fitting, run: RunDirectory, **how: Any) -> None:
    """Read, fit and measure; write a run with network and motion, ``report.json`` and two plots."""
    options = ShapingOptions(rate=fitting.clock_rate)
    arm = chosen.load()
    rate, unit = fitting.sample_rate, fitting.time_unit
    shown = JointDemonstrations.load(arm, files, rate=rate, phase=fitting.phase, goals=fitting.goals, time_unit=unit)
    with run.at_work():
        learned = JointMotion.fit(shown, fitting.deviation, options, family=fitting.family)
        motion, refusal = learned.planned(shown.mean[0])
        with progress("learn"):
            study, paths = study_joints(shown, learned, **how)
        duration = float(motion.t[-1])
        asked = {"files": list(files), **asdict(fitting)}
        about = {"planner": "learn", "reason": "demonstrated", "options": asked}
        task = chosen.task(arm, shown.mean[0], shown.mean[-1], duration, fitting.seed, **about)
        written = run.save_network(task, learned.network, motion)
        result = {
            **asked,
            **_learned(learned),
            "arm": arm.name,
            "joints": list(arm.joint_names),
            "demonstrations": len(shown),
            "demonstrated_duration_s": learned.duration,
            "duration_s": duration,
            "spread_m": float(shown.spread.max()),
            "mechanism_gap_mm": 1e3 * float(motion.gap_translation.max()),
            "mechanism_gap_deg": float(np.rad2deg(motion.gap_rotation.max())),
            "limits_kept": not refusal,
            "limit_broken": refusal,
            **asdict(study),
        }
        reproduced = learned.run(shown.mean[0]).q
        fan = [motion_to(learned, shown, item[-1]).run(item[0]).q for item in shown.q] if learned.response else []
        results = [run.report, run.plot("demonstrations"), run.plot("starts")]
        with io.atomic_paths(results) as (report, demonstrations_plot, starts_plot):
            io.save_json(report, result)
            plot_joint_paths(shown, reproduced, demonstrations_plot, fan=fan)
            plot_joint_paths(shown, reproduced, starts_plot, paths)
    _print_verdict(learned)
    console.print(f"limits: not kept, {refusal}" if refusal else f"limits and clearance: kept, in {duration:.3g} s")
    console.print(
        f"{len(shown)} demonstrations of {arm.n_joints} joints of {arm.name}, {learned.duration:.3g} s; "
        f"{describe(learned.response)}"
    )
    print_import_report(arm)
    console.print(joints_table(study, arm))
    wrote(*written, *results)


def _print_verdict(learned: ShapedMotion | JointMotion) -> None:
    network = learned.network
    console.print(f"{'certified' if network.certified else 'no certificate'}; {learned.shaping.message}")
    console.print(f"certificate: {network.certificate}")


def _learned(learned: ShapedMotion | JointMotion) -> dict[str, Any]:
    """The entries of a report about the network."""
    response = learned.response
    return {
        "network_message": learned.shaping.message,
        "network_deviation_m": learned.shaping.deviation,
        "network_within_deviation": learned.shaping.success,
        "network_certified": learned.network.certified,
        # JSON has no infinity.
        "ridges": response and [ridge if np.isfinite(ridge) else None for ridge in response.ridges],
    }
