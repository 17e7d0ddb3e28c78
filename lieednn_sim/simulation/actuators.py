"""The actuators of an arm: position servos and direct-drive ones, on joints or fixed tendons, with any gear.

With l and v the length and velocity of its transmission an actuator exerts f = g ctrl + b0 + b1 l + b2 v, which moves
the joints with moment^T f. On hinges, slides, ball joints and fixed tendons the moment is a constant matrix, and
l = moment x, v = moment qvel, where x holds angles, displacements and rotation vectors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import SCALAR
from lieednn_sim.arm.forces import DRIVABLE, actuator_moments, actuator_ranges, control_ranges, drivable, driving
from lieednn_sim.errors import InputError
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.values import Floats


class Actuators:
    """The actuators that move an arm in a model, and their controls for desired states and forces.

    With ``complete`` they must be able to move all of the arm's joints.

    Attributes:
        driving: ``(nu,)`` whether actuators move the arm's joints. The others keep their controls: those of a view's
            state, of the keyframe ``home``, or zero.
        servos: ``(nu,)`` which of the driving ones are position servos; the others exert forces alone.
        servoed: ``(n,)`` which coordinates position servos act on.
        transmission: ``(nu, n)`` rates of lengths at unit rates of the coordinates; zero for those not driving.
        moment: ``(nu, nv)`` generalised force per unit force; zero for those not driving.
        allocation: ``(nu, nv)`` forces of least norm with the effect of generalised forces on the arm.
        gain: ``(nu,)`` g of those that drive.
        bias: ``(3, nu)`` their b0, b1 and b2.
        heavy: whether servos bear the arm's weight; that of the package's arms is compensated, but for a payload.

    Raises:
        InputError: an actuator that moves the arm is not `forces.DRIVABLE`, or the actuators cannot move the arm.
    """

    def __init__(self, arm: Arm, *, complete: bool = True) -> None:
        # Closed loops are evaluated with the arm at home.
        model, basis = arm.model, arm.unit_rates()
        moments = actuator_moments(model)
        self.driving = driving(moments, basis)
        self.moment = np.where(self.driving[:, None], moments, 0.0)
        self.transmission = transmission = self.moment @ basis
        if len(unknown := np.flatnonzero(self.driving & ~drivable(model))):
            name = model.actuator(int(unknown[0])).name or f"number {unknown[0]}"
            raise InputError(
                f"actuator {name!r} moves the arm in a way the controllers do not know: they need {DRIVABLE}"
            )
        driven: NDArray[np.bool_] = np.asarray(transmission.any(axis=0))
        if np.linalg.matrix_rank(transmission) < (arm.n_joints if complete else driven.sum()):
            bare = ", ".join(repr(name) for name, moved in zip(arm.joint_names, driven, strict=True) if not moved)
            lacks = f"no actuator moves {bare}" if bare and complete else ""
            why = lacks or "its actuators cannot move all joints independently"
            raise InputError(f"arm {arm.name!r} cannot be driven: {why}")
        # Forces f of least norm with basis^T moment^T f = basis^T tau: components of tau that do no work on the arm,
        # such as forces on other joints and between coupled stages, are left out.
        self.allocation = np.linalg.pinv(transmission.T) @ basis.T
        self.gain = np.where(self.driving, model.actuator_gainprm[:, 0], 1.0)
        self.bias = np.where(self.driving, model.actuator_biasprm[:, :3].T, 0.0)
        self.servos = self.driving & (self.bias[1] / self.gain < 0.0)
        self.servoed = np.abs(transmission[self.servos]).max(axis=0, initial=0.0) > 1e-9
        self.heavy = arm.qpos_home is not None or arm.payload > 0.0
        self._idle = np.where(self.driving, 0.0, arm.data().ctrl)
        # In a model with more than an arm, the user may change the controls of the other actuators.
        self._written: Any = True if arm.state is None else self.driving
        # The positions at which all lengths are zero: those of quaternions are their references.
        self._model, self._zero, self._made = model, model.qpos0.copy(), arm.qpos_home is None
        self._zero[model.jnt_qposadr[np.isin(model.jnt_type, SCALAR)]] = 0.0

    def require_servos(self) -> None:
        """Raise `InputError` unless every driving actuator is a position servo."""
        if not self.servos[self.driving].all():
            raise InputError(
                "this controller needs position actuators on the arm's joints (biasprm[1] < 0); "
                "the controller computed-torque does without"
            )

    def lengths(self, qpos: Floats) -> Floats:
        """Lengths ``(..., nu)`` at positions ``(..., nq)``; zero for actuators that do not move the arm."""
        if self._model.nq == self._model.nv:
            # Without quaternions both have the same layout.
            return np.matvec(self.moment, qpos)
        x = np.zeros((*qpos.shape[:-1], self._model.nv))
        for index in np.ndindex(qpos.shape[:-1]):
            mujoco.mj_differentiatePos(self._model, x[index], 1.0, self._zero, qpos[index])
        return np.matvec(self.moment, x)

    def servo_controls(self, qpos: Floats, qvel: Floats, generalised: Floats | None = None) -> Floats:
        """Controls ``(..., nu)`` for which servos exert given forces at given states: (f - b0 - b1 l - b2 v) / g.

        At other states they add b1 and b2 times the differences, their feedback.
        """
        forces = 0.0 if generalised is None else np.matvec(self.allocation, generalised)
        return self.affine_controls(qpos, qvel, forces)

    def affine_controls(self, qpos: Floats, qvel: Floats, forces: Floats | float) -> Floats:
        """Controls ``(..., nu)`` for which the actuators exert given forces ``(..., nu)`` at given states."""
        constant, stiffness, damping = self.bias
        drive = forces - (constant + stiffness * self.lengths(qpos) + damping * np.matvec(self.moment, qvel))
        return drive / self.gain + self._idle

    def measurement_error(self, noise: Noise) -> Floats:
        """Change ``(..., nu)`` of the controls with the effect of measurement errors on the servos' feedback.

        f = g ctrl + b0 + b1 (l + e_l) + b2 (v + e_v) = g (ctrl + (b1 e_l + b2 e_v) / g) + b0 + b1 l + b2 v; for a
        position actuator that is ctrl - e_l - (kv / kp) e_v. For a ball joint, e_l is that of its rotation vector.
        """
        length, velocity = (np.matvec(self.moment, error) for error in (noise.position, noise.velocity))
        return (self.bias[1] * length + self.bias[2] * velocity) / self.gain

    def direct_controls(self, generalised: Floats, out: Floats | None = None) -> Floats:
        """Controls ``(nu,)`` of direct-drive actuators (`make_direct`) for generalised forces ``(nv,)``."""
        return np.add(np.matvec(self.allocation, generalised), self._idle, out, where=self._written)

    def write(self, controls: Floats, out: Floats) -> None:
        """Write controls ``(nu,)``, in a view only those of the driving actuators."""
        np.copyto(out, controls, where=self._written)

    def free_controls(self, model: mujoco.MjModel) -> None:
        """Remove the control ranges of the servos in the model of an arm that is made for the package.

        They are ranges of positions, and feedforward shifts the control by tau / kp, out of this range near a joint
        limit. In a user's model they are kept.
        """
        model.actuator_ctrllimited[self.servos & self._made] = 0

    def make_direct(self, model: mujoco.MjModel) -> None:
        """Make the driving actuators of a model direct-drive ones, which exert their controls; force limits stay.

        So do the force limits that motors have by their control ranges.
        """
        ranges = actuator_ranges(model)
        limited = self.driving & np.isfinite(ranges).all(axis=1)
        model.actuator_forcerange[limited], model.actuator_forcelimited[limited] = ranges[limited], 1
        model.actuator_ctrllimited[self.driving] = 0
        model.actuator_gainprm[self.driving, 0] = 1.0
        model.actuator_biasprm[self.driving, :3] = 0.0

    def own_controls(self, direct: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """Controls ``(..., nu)`` with which the arm's own actuators exert what direct-drive ones do at given states."""
        own = self.affine_controls(qpos, qvel, np.clip(direct, *actuator_ranges(self._model).T))
        return np.clip(np.where(self.driving, own, direct), *control_ranges(self._model).T)


def has_servos(arm: Arm) -> bool:
    """Whether each coordinate is driven by position servos alone, without a closed loop in between."""
    model, basis = arm.model, arm.unit_rates()
    moments = actuator_moments(model)
    mine = driving(moments, basis)
    servos = model.actuator_biasprm[mine, 1] / model.actuator_gainprm[mine, 0] < 0.0
    return arm.dependents is None and bool((moments @ basis).any(axis=0).all() and servos.all())
