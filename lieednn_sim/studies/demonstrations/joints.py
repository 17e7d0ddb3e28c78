"""Evaluation of a network of joints shaped by demonstrations: errors at the effector and of joints, other starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.table import Table

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.budget import one_blas_thread, report
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.evaluation.display import table
from lieednn_sim.learning.demonstrations import Demonstration
from lieednn_sim.learning.demonstrations.alignment import warp
from lieednn_sim.planning.demonstrated import JointDemonstrations, JointMotion
from lieednn_sim.studies.demonstrations.models import PathErrors, mean_of, path_errors
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class JointErrors:
    """A joint motion against the one it should follow, with samples paired by dynamic time warping."""

    effector: PathErrors  #: of the end effector's path
    joints_rms: tuple[float, ...]  #: root mean square error of each joint [rad, m]
    worst_percent: float  #: the largest of these, in percent of its joint's range
    gap_mm: float  #: largest mechanism gap of the network's states; 0 for demonstrations
    gap_deg: float  #: the same as an angle


@dataclass(frozen=True)
class JointStudy:
    """Errors of a network of joints against its demonstrations, as in `ModelRow`; and how many random starts arrive."""

    mean: JointErrors
    training: JointErrors
    left_out: JointErrors | None
    starts: int
    arrived: int


def study_joints(
    demonstrations: JointDemonstrations,
    learned: JointMotion,
    *,
    starts: int = 20,
    leave_one_out: bool = True,
    seed: int = 0,
) -> tuple[JointStudy, list[Floats]]:
    """Measure a network shaped by demonstrations, also from random contact-free configurations (`draw_target`).

    Each left-out demonstration is compared with a network that is shaped without it, with as many hidden neurons.
    Returns the study, and the joints' paths ``(K, n)`` from the starts that arrive.
    """
    arm, n = demonstrations.arm, len(demonstrations)
    folds = n if leave_one_out and n > 1 else 0
    without, paths = list[JointErrors](), list[Floats]()
    with one_blas_thread():
        for k in range(folds):
            report(k, folds + 1)
            options, family = learned.shaping.options, learned.response is not None
            model = JointMotion.fit(demonstrations.without(k), options=options, family=family)
            without.append(_errors(motion_to(model, demonstrations, demonstrations.q[k, -1]), demonstrations.q[k]))
        report(folds, folds + 1)
        for k in range(starts):
            try:
                motion = learned.run(draw_target(arm, seed + k))
            except NoSolutionError:
                continue
            if np.abs(motion.q[-1] - learned.goal).max() < 1e-3:
                paths.append(motion.q)
        study = JointStudy(
            mean=_errors(learned, demonstrations.mean),
            training=mean_of([_errors(motion_to(learned, demonstrations, q[-1]), q) for q in demonstrations.q]),
            left_out=mean_of(without) if without else None,
            starts=starts,
            arrived=len(paths),
        )
    return study, paths


def motion_to(model: JointMotion, demonstrations: JointDemonstrations, goal: Floats) -> JointMotion:
    """The motion to a demonstration's goal ``(n,)`` if demonstrations keep their goals; else to the common goal."""
    return model.toward(goal) if demonstrations.goals_kept else model


def joint_errors(arm: Arm, result: Floats, shown: Floats, gap: tuple[float, float]) -> JointErrors:
    """Compare joint positions ``(K, n)`` and ``(L, n)``; ``gap`` [m, rad] is the mechanism gap of the former."""
    poses = [arm.link_poses(q).as_matrix()[:, -1] for q in (result, shown)]
    each = "the end effector"
    effector = [Demonstration(np.arange(float(len(at))), at[:, :3, 3], at[:, :3, :3], 6, each) for at in poses]
    pairs = warp(result / arm.ranges, shown / arm.ranges).pairs
    rms = np.sqrt(np.mean((result[pairs[:, 0]] - shown[pairs[:, 1]]) ** 2, axis=0))
    errors = path_errors(effector[0].twists_from(poses[1][-1, :3, 3], poses[1][-1, :3, :3]), effector[1].twists)
    worst, turn = float(100.0 * (rms / arm.ranges).max()), float(np.rad2deg(gap[1]))
    return JointErrors(errors, tuple(rms.tolist()), worst, 1e3 * gap[0], turn)


def joints_table(study: JointStudy, arm: Arm) -> Table:
    """The table of a study for the terminal."""
    rows = table("reproduction", "path", "effector RMS mm", "deg", "Frechet mm", "joints %", "gap mm", "gap deg")
    for path, result in (("mean", study.mean), ("training", study.training), ("left out", study.left_out)):
        if result is None:
            continue
        end = result.effector
        cells = (f"{end.rms_mm:.2f}", f"{end.rms_deg:.2f}", f"{end.frechet_mm:.2f}", f"{result.worst_percent:.2g}")
        rows.add_row(path, *cells, f"{result.gap_mm:.2g}", f"{result.gap_deg:.2g}")
    joints = ", ".join(
        f"{name} {value:.2g} {arm.unit(j)}"
        for j, (name, value) in enumerate(zip(arm.joint_names, study.mean.joints_rms, strict=True))
    )
    rows.caption = (
        "From the start of the mean and of each demonstration; left out: shaped without the one compared with. "
        f"joints: largest RMS of a joint, in percent of its range; for the mean: {joints}. "
        f"{study.arrived} of {study.starts} random starts arrive."
    )
    return rows


def _errors(model: JointMotion, shown: Floats) -> JointErrors:
    motion = model.run(shown[0])
    gap = float(motion.gap_translation.max()), float(motion.gap_rotation.max())
    return joint_errors(model.arm, motion.q, shown, gap)
