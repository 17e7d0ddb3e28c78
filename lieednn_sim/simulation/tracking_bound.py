"""How far joints can be off a motion under feedback linearisation, if masses are not as the controller believes.

The controller exerts M' (a + w) + h' with the inertia M' and the bias h' of its own model, and the feedback
w = 2 f e' + f^2 e with the natural frequency f, where e is the planned position minus that of the joints and a the
planned acceleration. The plant has M = M' + dM and h = h' + dh. So

    e'' + 2 f e' + f^2 e = d,    d = A (a + w) + M^-1 dh,    A = M^-1 dM,

in each coordinate. Let D be the largest |d|, and c = 1 + 2 / exp(2). From rest, |e| <= D / f^2,
|e'| <= 2 / (exp(1) f) D and |w| <= c D: these are integrals of the impulse responses' magnitudes. Hence, by entries,
D <= |A a + M^-1 dh| + c |A| D, which bounds D if the spectral radius of c |A| is below one (a small-gain condition).
A and dh are evaluated where the joints may be by the bound that results.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.planning import Plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.simulation import make_plant
from lieednn_sim.simulation.tracking import as_loaded, as_motion
from lieednn_sim.validation import as_floats, as_nonnegative, as_positive
from lieednn_sim.values import Floats


def tracking_bound(
    arm: Arm,
    motion: Plan | Motion,
    *,
    mass_scale: tuple[float, float] = (1.0, 1.0),
    payload: float = 0.0,
    frequency: float = NATURAL_FREQUENCY,
) -> Floats:
    """Bound the tracking errors ``(n,)`` of a run by feedback linearisation before it is made [rad, m].

    The bound is for every payload at the end effector up to the given one, and every scale in the given range of the
    masses and inertias that move, both unknown to controller and gravity compensation (`Disturbances`).
    `planning.tube.find_tube` takes it as ``tracking``.

    It assumes the controllers ``computed-torque`` or ``feedback-linearisation`` with torques that stay within their
    limits, exact measurements, a time step far below 1 / frequency, no friction that the controller does not know, and
    no pushes. Inertias and forces are evaluated at 100 instants of the motion, with joints and rates off it by the
    bound, with random signs, for three scales and three payloads: the bound is not proved for what lies between these.

    Args:
        arm: the arm, as the controller believes it to be.
        motion: a plan, or a motion sampled at the model's time step.
        mass_scale: least and largest scale.
        payload: largest payload [kg].
        frequency: natural frequency of the critically damped feedback [rad/s].

    Raises:
        InputError: a value is malformed, or the arm has ball joints or moves closed loops.
        NotCertifiedError: masses may be off by so much that there is no proof that the feedback holds the joints.
    """
    low, high = as_floats("mass_scale", mass_scale, (2,)).tolist()
    if not 0.0 < low <= high:
        raise InputError(f"mass_scale must be two positive numbers, the smaller first, got {low:g} and {high:g}")
    arm, rate, followed = as_loaded(arm, motion), as_positive("frequency", frequency), as_motion(arm, motion)
    if arm.dependents is not None or len(arm.space.balls):
        raise InputError(f"arm {arm.name!r} has ball joints or moves closed loops, for which there is no bound")
    bare = arm.without_visuals
    loads = np.linspace(0.0, as_nonnegative("payload", payload), 3)
    heavier = {(scale, load) for scale in np.linspace(low, high, 3) for load in loads}
    changes = [Disturbances(mass_scale=scale, payload=load) for scale, load in sorted(heavier)]
    of_rate, of_feedback = 2.0 / np.e / rate, 1.0 + 2.0 * np.exp(-2.0)
    error = np.zeros(arm.n_joints)
    for plant in [make_plant(bare, each) for each in changes]:
        mismatch, largest = _Mismatch(bare, plant, followed), np.zeros(arm.n_joints)
        for _ in range(20):
            share, forced = mismatch(largest / rate**2, of_rate * largest)
            gain = np.abs(np.linalg.eigvals(of_feedback * share)).max()
            if gain >= 1.0:
                raise NotCertifiedError(
                    f"masses may be off by so much that the feedback is not proved to hold the joints: the gain of "
                    f"their mismatch is {gain:.3g}, it must be below 1; allow for a smaller payload or mass_scale"
                )
            before, largest = largest, 1.02 * np.linalg.solve(np.eye(len(share)) - of_feedback * share, forced)
            if (largest <= 1.02 * before).all():
                break
        else:
            raise NotCertifiedError("the tracking errors are not bounded: larger ones let the mismatch grow as much")
        error = np.maximum(error, np.maximum(before, largest) / rate**2)
    return error


class _Mismatch:
    """The difference of a plant's accelerations from those that a controller asks for, along a motion."""

    def __init__(self, arm: Arm, plant: mujoco.MjModel, motion: Motion) -> None:
        self._arm, self._models = arm, (plant, arm.model)
        self._data = tuple(map(mujoco.MjData, self._models))
        self._basis = tangent_basis(arm.space)
        chosen = np.unique(np.linspace(0, len(motion.t) - 1, 100).round().astype(int))
        acceleration = np.gradient(motion.qd, motion.timestep, axis=0)
        self._q, self._qd, self._qdd = motion.q[chosen], motion.qd[chosen], acceleration[chosen]

    def __call__(self, off: Floats, rates_off: Floats) -> tuple[Floats, Floats]:
        """Largest |A| ``(n, n)`` and |A a + M^-1 dh| ``(n,)`` for errors ``(n,)`` of positions and of rates."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (2, *self._q.shape))
        q, qd = self._q + signs[0] * off, self._qd + signs[1] * rates_off
        share, forced = [], []
        for qpos, qvel, wanted in zip(self._arm.qpos(q), self._arm.qvel(q, qd), self._qdd, strict=True):
            (inertia, bias), (known, expected) = (
                self._dynamics(*each, qpos, qvel) for each in zip(self._models, self._data, strict=True)
            )
            share.append(np.linalg.solve(inertia, inertia - known))
            forced.append(share[-1] @ wanted + np.linalg.solve(inertia, bias - expected))
        return np.abs(share).max(axis=0), np.abs(forced).max(axis=0)

    def _dynamics(
        self, model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats, qvel: Floats
    ) -> tuple[Floats, Floats]:
        """Inertia ``(n, n)`` and bias ``(n,)`` in the arm's coordinates."""
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        return self._basis.T @ inertia @ self._basis, self._basis.T @ data.qfrc_bias
