"""The arm led by ghosts: one mocap body for each link frame, welded to it, in place of the drives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import RigidTransform

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.simulate.control import Reference

Floats = NDArray[np.float64]

# Reference acceleration of the welds: time constant T [s] and damping ratio zeta; impedance d of the soft constraint.
_TIME_CONSTANT = 0.01
_DAMPING_RATIO = 1.0
_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class MocapWelds:
    """Mocap bodies on the reference's link frames, welded to the arm's; the drives are idle.

    The reference's poses are those of joint positions, so the welds ask for nothing that the joints cannot do. A mocap
    body has no velocity, and a weld with time constant T and damping ratio zeta follows it 2 T zeta^2 late: the ghosts
    run ahead by as much. The forces of the welds are in the rollout's `constraint_force`.
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        times = reference.timestep * np.arange(len(reference.q))
        path = CubicHermiteSpline(times, reference.q, reference.qd)
        lead = 2.0 * _TIME_CONSTANT * _DAMPING_RATIO**2
        poses = arm.link_poses(path(np.minimum(times + lead, times[-1])))
        self._position, self._quaternion = poses.translation, poses.rotation.as_quat(scalar_first=True)
        self.plant = _with_ghosts(arm, poses[0])
        ghosts = [self.plant.body(_ghost(i)).id for i in range(arm.n_links)]
        self._ids = self.plant.body_mocapid[ghosts]

    def act(self, data: mujoco.MjData, step: int) -> None:
        """Place the ghosts for the next step, whose constraints are made before this is called again."""
        ahead = min(step + 1, len(self._position) - 1)
        data.mocap_pos[self._ids], data.mocap_quat[self._ids] = self._position[ahead], self._quaternion[ahead]


def _with_ghosts(arm: Arm, start: RigidTransform) -> mujoco.MjModel:
    spec: Any = arm.spec.copy()
    for i, site in enumerate(arm.site_ids):
        pose = start[i]
        ghost = spec.worldbody.add_body(
            name=_ghost(i), mocap=True, pos=pose.translation, quat=pose.rotation.as_quat(scalar_first=True)
        )
        ghost.add_site(name=f"{_ghost(i)}_frame")
        weld = spec.add_equality(
            name=_ghost(i),
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{_ghost(i)}_frame",
            name2=arm.model.site(int(site)).name,
        )
        weld.solref[:2], weld.solimp[:] = (_TIME_CONSTANT, _DAMPING_RATIO), _IMPEDANCE
    model = spec.compile()
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    return model


def _ghost(link: int) -> str:
    return f"ghost{link + 1}"
