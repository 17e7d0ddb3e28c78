"""What a motion leaves swinging and bending, and how near a hanging load came to anything."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import rounded

_SETTLED = np.deg2rad(1.0), 5e-3  # swing [rad] and bending [m]


@dataclass(frozen=True)
class LoadMetrics:
    """What the passive joints of an arm (`arm.oscillation.PassiveJoints`) did in a run.

    Attributes:
        swing_deg: largest angle of joints without a spring from their rest, after the motion.
        bending_mm: largest distance by which joints with a spring move the end effector from its rest, likewise.
        settling_s: time after the motion from which both stay below 1 degree and 5 mm, for a period or more, if ever.
        clearance_mm: least distance of what hangs from what does not move, at the samples of the simulation, between
            the geoms of `PassiveJoints.load_model`; None if it was not computed, or nothing hangs.
        nearest: names of the two geoms, the load's first.
        nearest_s: the time at which they are nearest.
    """

    swing_deg: float
    bending_mm: float
    settling_s: float | None
    clearance_mm: float | None = None
    nearest: tuple[str, ...] = ()
    nearest_s: float | None = None

    def __str__(self) -> str:
        settled, near = "does not settle" if self.settling_s is None else f"settles in {self.settling_s:.2f} s", ""
        if self.clearance_mm is not None:
            load, other = self.nearest
            near = f"; {load!r}, which hangs, stays {self.clearance_mm:.0f} mm from {other!r} ({self.nearest_s:.2f} s)"
        swing, bending = rounded(self.swing_deg), rounded(self.bending_mm)
        return f"swings by {swing} degrees and bends by {bending} mm, {settled}{near}"


def load_metrics(rollout: Rollout, *, clearance: bool = True) -> LoadMetrics | None:
    """The metrics of a run; None for an arm without passive joints, or if these have no position of rest."""
    arm, passive = rollout.arm, PassiveJoints(rollout.arm)
    if not len(passive.dofs):
        return None
    try:
        rest = passive.at_rest(arm.qpos(rollout.q[-1:]))[0]
        modes = passive.modes_at(rest)
    except NoSolutionError:
        return None
    after = rollout.t >= rollout.motion_end - 0.5 * rollout.timestep
    off = passive.away(rollout.qpos[after], rest)
    turning = arm.model.jnt_type[arm.model.dof_jntid[passive.dofs]] != int(mujoco.mjtJoint.mjJNT_SLIDE)
    swing = np.linalg.norm(off[:, ~passive.sprung & turning], axis=1)
    data = kinematics_at(arm.model, rest)
    mujoco.mj_comPos(arm.model, data)
    slopes, _ = arm.frames.jacobian(arm.model, data, -1)
    bending = np.linalg.norm(off[:, passive.sprung] @ slopes[:, passive.dofs[passive.sprung]].T, axis=1)
    late = np.flatnonzero((swing > _SETTLED[0]) | (bending > _SETTLED[1]))
    calm = float(rollout.t[after][late[-1]] - rollout.motion_end) if len(late) else 0.0
    # A load that swings through its position of rest has not settled there.
    settled = not len(late) or calm + sum(1.0 / mode.frequency for mode in modes[:1]) < rollout.hold
    return LoadMetrics(
        swing_deg=float(np.rad2deg(swing.max(initial=0.0))),
        bending_mm=float(1e3 * bending.max(initial=0.0)),
        settling_s=calm if settled else None,
        **(_clearance(rollout, passive) if clearance else {}),
    )


def _clearance(rollout: Rollout, passive: PassiveJoints) -> dict[str, Any]:
    """The last attributes of `LoadMetrics`."""
    collisions = Collisions(replace(rollout.arm, collision_model=passive.load_model))
    least, row, pair = collisions.nearest_at(rollout.qpos)
    if not pair:
        return {}
    ordered = sorted(pair, key=lambda geom: not passive.bodies[rollout.arm.model.geom_bodyid[geom]])
    return {"clearance_mm": 1e3 * least, "nearest": collisions.names(ordered), "nearest_s": float(rollout.t[row])}
