"""The arm led by ghosts: one mocap body for each link frame, welded to it, in place of the drives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.actuators import driving_actuators
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.quaternions import quaternions
from lieednn_sim.simulation.reference import Foreseen, Reference

Floats = NDArray[np.float64]

# Reference acceleration of the welds: time constant T [s] and damping ratio zeta; impedance d of the soft constraint.
_TIME_CONSTANT = 0.01
_DAMPING_RATIO = 1.0
_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class MocapWelds:
    """Mocap bodies on the reference's link frames, welded to the arm's; the drives are idle.

    The reference's poses are those of joint positions, so the welds ask for nothing that the joints cannot do. A mocap
    body has no velocity, and a weld with time constant T and damping ratio zeta follows it 2 T zeta^2 late: the ghosts
    run ahead by as much. There is no feedback of joints, so no sensor noise either.
    """

    adds_bodies = True

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._arm, self._reference = arm, reference
        self._solref, self._lead = self._weld(reference)
        self._scratch = mujoco.MjData(arm.model)
        self._foreseen = Foreseen(reference, self.ghosts)
        self._ids: NDArray[np.int_] = np.zeros(0, dtype=int)

    def _weld(self, reference: Reference) -> tuple[tuple[float, float], float]:
        """Parameters solref of the welds, and the time [s] by which the ghosts run ahead."""
        return (_TIME_CONSTANT, _DAMPING_RATIO), 2.0 * _TIME_CONSTANT * _DAMPING_RATIO**2

    def add_bodies(self, spec: Any) -> None:
        """See `Controller`."""
        for i, site in enumerate(self._arm.site_ids):
            ghost = spec.worldbody.add_body(name=ghost_name(i), mocap=True)
            ghost.add_site(name=f"{ghost_name(i)}_frame")
            weld = spec.add_equality(
                name=ghost_name(i),
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=f"{ghost_name(i)}_frame",
                name2=self._arm.model.site(int(site)).name,
            )
            weld.solref[:2], weld.solimp[:] = self._solref, _IMPEDANCE

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        ghosts = [plant.body(ghost_name(i)).id for i in range(self._arm.n_links)]
        self._ids = plant.body_mocapid[ghosts]
        idle = driving_actuators(self._arm)
        plant.actuator_gainprm[idle], plant.actuator_biasprm[idle] = 0.0, 0.0

    def ghosts(self, steps: range) -> Floats:
        """Where the reference will be after the lead: positions and quaternions ``(m, N, 7)`` at some steps."""
        model, scratch, sites = self._arm.model, self._scratch, self._arm.site_ids
        position, rotation = np.empty((len(steps), len(sites), 3)), np.empty((len(steps), len(sites), 9))
        for i, step in enumerate(steps):
            scratch.qpos[:] = self._reference.ahead(step, self._lead)
            mujoco.mj_kinematics(model, scratch)
            position[i], rotation[i] = scratch.site_xpos[sites], scratch.site_xmat[sites]
        return np.concatenate([position, quaternions(rotation.reshape(*rotation.shape[:2], 3, 3))], axis=-1)

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """Place the ghosts where the reference will be after the lead."""
        ghosts = self._foreseen[step]
        data.mocap_pos[self._ids], data.mocap_quat[self._ids] = ghosts[:, :3], ghosts[:, 3:]


class DeadbeatWelds(MocapWelds):
    """The same with welds that reach their ghosts within one step.

    With solref (2 h, 1/2) a weld's reference acceleration is -r/h^2 - v/h at the distance r, so the step
    v' = v + h a = -r/h ends on the ghost, which stands where the reference is one step later. A jump of the ghosts
    is followed at once, with forces of its size: a reference that is held between samples is refused.

    Raises:
        InputError: the reference is held.
    """

    def _weld(self, reference: Reference) -> tuple[tuple[float, float], float]:
        if reference.hold > 1:
            raise InputError(
                "the controller mocap-deadbeat follows every jump of its reference within one step, so it takes none "
                f"that is held for {reference.hold} steps; use mocap, or leave reference_rate out"
            )
        return (2.0 * reference.timestep, 0.5), reference.timestep


def ghost_name(link: int) -> str:
    """Name of a link's ghost, and of the weld between them."""
    return f"ghost{link + 1}"
