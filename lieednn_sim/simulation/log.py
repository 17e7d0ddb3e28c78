"""What is known of a simulation's instants, collected at little cost while it runs and worked out for all at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.simulation.controllers.mocap import ghost_name
from lieednn_sim.simulation.quaternions import quaternions

if TYPE_CHECKING:
    from lieednn_sim.simulation.simulation import Simulation

Floats = NDArray[np.float64]

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)


class Instant(NamedTuple):
    """What is true at one time, or at K along a first axis; the forces are those of the step that begins there.

    Attributes:
        t: [s].
        qpos: ``(nq,)``.
        qvel: ``(nv,)``.
        ctrl: ``(nu,)``.
        drive_force: ``(nv,)`` of actuators, gravity compensation included [N m, N].
        constraint_force: ``(nv,)`` of contacts, joint limits, couplings and welds [N m, N].
        link_position: ``(N, 3)`` link frames, world [m].
        link_quaternion: ``(N, 4)`` the same, (w, x, y, z).
        contacts: number of contacts.
        contact_force: largest normal force among them [N].
        weld_force: ``(N,)`` force of each link's weld to its ghost [N].
        weld_torque: ``(N,)`` its torque [N m].
    """

    t: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    drive_force: Floats
    constraint_force: Floats
    link_position: Floats
    link_quaternion: Floats
    contacts: NDArray[np.int_]
    contact_force: Floats
    weld_force: Floats
    weld_torque: Floats


class Log:
    """Steps a simulation, from where it is, and keeps the instants before each step.

    The forces and link frames that MuJoCo computes in a step belong to the instant at which it begins, and stay in its
    data until the next one.

    Args:
        simulation: to be stepped by nothing else meanwhile.
        rows: steps for which there is room.
    """

    def __init__(self, simulation: Simulation, rows: int) -> None:
        self._simulation, self._rows = simulation, 0
        arm, model, data = simulation.arm, simulation.model, simulation.data
        self._data, self._first = data, simulation.steps
        # Of all sites in a block: a slice of it is copied ten times as fast as picked rows.
        low, high = int(arm.site_ids.min()), int(arm.site_ids.max()) + 1
        self._sites = arm.site_ids - low
        before = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl}
        after = {
            "actuators": data.qfrc_actuator,
            "compensation": data.qfrc_gravcomp,
            "constraints": data.qfrc_constraint,
            "positions": data.site_xpos[low:high],
            "rotations": data.site_xmat[low:high],
        }
        self._log = {name: np.zeros((rows, *view.shape)) for name, view in {**before, **after}.items()}
        self._before = [(self._log[name], view) for name, view in before.items()]
        self._after = [(self._log[name], view) for name, view in after.items()]
        self._contacts, self._contact_force = np.zeros(rows, dtype=int), np.zeros(rows)
        found = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, ghost_name(i)) for i in range(arm.n_links)]
        self._welds = np.array(found) if found[0] >= 0 else None
        self._weld_wrench = np.zeros((rows if found[0] >= 0 else 0, arm.n_links, 6))
        self._equalities = -1

    def __len__(self) -> int:
        """Return the number of instants."""
        return self._rows

    def step(self) -> None:
        """Do one step, within `quiet_warnings`, and keep the instant before it; nothing of a step that fails."""
        k, data = self._rows, self._data
        for log, view in self._before:
            log[k] = view
        self._simulation.advance_once()
        for log, view in self._after:
            log[k] = view
        if data.ncon:
            self._contacts[k], self._contact_force[k] = data.ncon, self._largest_contact()
        if self._welds is not None:
            self._keep_welds(self._welds, k)
        self._rows += 1

    def instants(self) -> Instant:
        """All instants so far, along the first axis of every array."""
        rows = slice(self._rows)
        log = {name: values[rows] for name, values in self._log.items()}
        rotations = log["rotations"][:, self._sites].reshape(self._rows, -1, 3, 3)
        return Instant(
            t=self._simulation.timestep * np.arange(self._first, self._first + self._rows, dtype=float),
            qpos=log["qpos"],
            qvel=log["qvel"],
            ctrl=log["ctrl"],
            drive_force=log["actuators"] + self._compensated * log["compensation"],
            constraint_force=log["constraints"],
            link_position=log["positions"][:, self._sites],
            link_quaternion=quaternions(rotations),
            contacts=self._contacts[rows],
            contact_force=self._contact_force[rows],
            weld_force=self._weld_norms(slice(3)),
            # The angular rows measure half the angle's sine: what they exert is half a torque.
            weld_torque=0.5 * self._weld_norms(slice(3, 6)),
        )

    @property
    def _compensated(self) -> NDArray[np.bool_]:
        """Gravity compensation that is not routed through the actuators still has to come from the drives."""
        model = self._simulation.model
        return ~model.jnt_actgravcomp[model.dof_jntid].astype(bool)

    def _largest_contact(self) -> float:
        wrench, largest = np.zeros(6), 0.0
        for i in range(self._data.ncon):
            mujoco.mj_contactForce(self._simulation.model, self._data, i, wrench)
            largest = max(largest, float(wrench[0]))
        return largest

    def _keep_welds(self, welds: NDArray[np.int_], k: int) -> None:
        data = self._data
        # Equalities come first among the constraints, and stay where they are while none is switched on or off.
        if data.ne != self._equalities:
            self._equalities = data.ne
            of_weld = (data.efc_type == _EQUALITY) & (data.efc_id == welds[:, None])
            self._pulling, self._weld_rows = of_weld.any(axis=1), np.flatnonzero(of_weld.any(axis=0))
        self._weld_wrench[k, self._pulling] = data.efc_force[self._weld_rows].reshape(-1, 6)

    def _weld_norms(self, part: slice) -> Floats:
        if self._welds is None:
            return np.zeros((self._rows, len(self._sites)))
        wrench = self._weld_wrench[: self._rows, :, part]
        return np.asarray(np.sqrt(np.vecdot(wrench, wrench)))
