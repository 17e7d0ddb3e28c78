"""What a motion leaves swinging and bending, and how near what hangs came to anything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import PassiveJoints
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.simulation import Rollout

_DRAWN = 3  # geom groups below it are drawn by default
_FAR = 10.0  # distances beyond it are not told apart [m]
_LOOKS = 100  # instants at which distances are measured
_SETTLED = np.deg2rad(1.0), 5e-3  # of swing [rad] and bending [m]


@dataclass(frozen=True)
class LoadMetrics:
    """What the passive joints of an arm (`arm.PassiveJoints`) did in a run.

    Attributes:
        swing_deg: largest angle after the motion by which joints without a spring are off their rest.
        bending_mm: largest distance after the motion by which joints with a spring move the end effector from its rest.
        settling_s: time after the motion from which these stay below 1 degree and 5 mm, for a period at least;
            None if they do not.
        clearance_mm: least distance of what hangs from what the arm does not move, at 100 instants of the simulation,
            between geoms of the groups that MuJoCo draws, whether or not they collide; None without one.
    """

    swing_deg: float
    bending_mm: float
    settling_s: float | None
    clearance_mm: float | None

    def __str__(self) -> str:
        settled = "does not settle" if self.settling_s is None else f"settles in {self.settling_s:.2f} s"
        near = "" if self.clearance_mm is None else f"; the load stays {self.clearance_mm:.0f} mm from all else"
        return f"swings by {self.swing_deg:.3g} degrees and bends by {self.bending_mm:.3g} mm, {settled}{near}"


def load_metrics(rollout: Rollout, *, clearance: bool = True) -> LoadMetrics | None:
    """The metrics of a run, None for an arm whose passive joints rest nowhere, or that has none."""
    arm, passive = rollout.arm, PassiveJoints(rollout.arm)
    if not len(passive.dofs):
        return None
    try:
        rest = passive.at_rest(arm.qpos(rollout.q[-1:]))[0]
    except NoSolutionError:
        return None
    after = rollout.t >= rollout.motion_end - 0.5 * rollout.timestep
    off = passive.away(rollout.qpos[after], rest)
    turning = arm.model.jnt_type[arm.model.dof_jntid[passive.dofs]] != int(mujoco.mjtJoint.mjJNT_SLIDE)
    swing = np.linalg.norm(off[:, ~passive.sprung & turning], axis=1)
    data = mujoco.MjData(arm.model)
    data.qpos[:] = rest
    mujoco.mj_kinematics(arm.model, data)
    mujoco.mj_comPos(arm.model, data)
    slopes, _ = arm.frames.jacobian(arm.model, data, -1)
    bending = np.linalg.norm(off[:, passive.sprung] @ slopes[:, passive.dofs[passive.sprung]].T, axis=1)
    late = np.flatnonzero((swing > _SETTLED[0]) | (bending > _SETTLED[1]))
    calm = rollout.t[after][int(late[-1])] - rollout.motion_end if len(late) else 0.0
    # What swings through its rest has not settled there.
    periods = [1.0 / mode.frequency for mode in passive.modes(rollout.q[-1])[:1]]
    settled = not len(late) or calm + sum(periods) < rollout.hold
    return LoadMetrics(
        swing_deg=float(np.rad2deg(swing.max(initial=0.0))),
        bending_mm=float(1e3 * bending.max(initial=0.0)),
        settling_s=float(calm) if settled else None,
        clearance_mm=_clearance(rollout, passive) if clearance else None,
    )


def _clearance(rollout: Rollout, passive: PassiveJoints) -> float | None:
    model = rollout.arm.model
    drawn, body = model.geom_group < _DRAWN, model.geom_bodyid
    load = np.flatnonzero(drawn & passive.bodies[body])
    still = moved_together(model, np.append(rollout.arm.dofs, passive.dofs))[body] == 0
    others, data, least = np.flatnonzero(drawn & still), mujoco.MjData(model), _FAR
    for row in np.unique(np.linspace(0, len(rollout.t) - 1, _LOOKS).astype(int)):
        data.qpos[:] = rollout.qpos[row]
        mujoco.mj_kinematics(model, data)
        for pair in ((int(one), int(other)) for one in load for other in others):
            least = min(least, mujoco.mj_geomDistance(model, data, *pair, _FAR, None))
    return 1e3 * least if least < _FAR else None
