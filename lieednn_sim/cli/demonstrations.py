"""The command ``learn``, which makes a certified network from demonstrations, with a report and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from lieednn_sim import io
from lieednn_sim.arm.importer.importing import ImportOptions, import_arm
from lieednn_sim.cli.arguments import ChosenArm
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.joint_demonstrations import Fitting, learn_joints
from lieednn_sim.cli.kinds import Directory, File
from lieednn_sim.cli.run_directory import PLOT_KINDS, RunDirectory
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


def learn(
    files: list[File],
    *,
    arm: str | None = None,
    reading: Reading,
    fitting: Fitting,
    output: Directory = "results/learned-motion",
    plots: str = "png",
    imported: Annotated[ImportOptions, import_arm],
) -> None:
    """Learn a certified network from recorded motions of an end effector or of an arm's joints.

    The files are .npy, .npz, .csv or LASA's .mat. Each row is a position x y or x y z, or a pose with a unit
    quaternion, and the network is compared with other models. With --arm each row holds the joints of the arm;
    continue with 'simulate'.

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
    if arm is not None:
        if reading != Reading():
            raise InputError(
                "--unit, --quaternion and --rivals are for positions and poses; with --arm the columns are joints "
                "[rad, m], without rivals"
            )
        learn_joints(files, ChosenArm(arm, imported=imported), fitting, RunDirectory(output, plots))
        return
    # Check values before any work.
    if imported:
        raise InputError(f"--{next(iter(imported))} needs --arm FILE.xml")
    kind = as_choice("kind of plots", plots, PLOT_KINDS)
    rivals = list(RIVALS) if reading.rivals is None else [name for name in reading.rivals if name != "none"]
    for name in rivals:
        RIVALS.find(name)
    starts = as_count("starts", 1000 if fitting.starts is None else fitting.starts)
    seed = as_seed("seed", fitting.seed)
    options = ShapingOptions(rate=fitting.clock_rate)
    shown = load_demonstrations(files, unit=reading.unit, quaternion=reading.quaternion, rate=fitting.sample_rate)
    demonstrations = align(shown, phase=fitting.phase, goals=fitting.goals)
    aligned = align(shown, phase=fitting.phase) if demonstrations.goals_kept else None
    apart = goal_distance(shown)
    if demonstrations.extent <= 0.0:
        raise InputError("the mean of the demonstrations does not move")
    with io.output_folder(output, "demonstrations") as directory:
        outputs = [directory / name for name in ("network.npz", "report.json", f"paths.{kind}", f"field.{kind}")]
        shaped = ShapedMotion.fit(demonstrations, fitting.deviation, options, family=fitting.family)
        with progress("learn") as bar:
            rows, models = compare_models(
                demonstrations,
                shaped,
                rivals=rivals,
                aligned=aligned,
                starts=starts,
                leave_one_out=fitting.leave_one_out,
                seed=seed,
                progress=bar,
            )
        with io.atomic_paths(outputs) as (network, report, paths, field):
            shaped.network.save(network)
            asked = {"files": files, "unit": reading.unit, "quaternion": reading.quaternion, **asdict(fitting)}
            found = _report(demonstrations, shaped, rows)
            io.save_json(report, asked | found | {"goal_distance_m": apart})
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


def _report(demonstrations: Demonstrations, shaped: ShapedMotion, rows: list[ModelRow]) -> dict[str, Any]:
    """What was shown, the meaning of the network's coordinates, and the table."""
    goal = demonstrations.goal
    return {
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
