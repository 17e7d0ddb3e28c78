"""How far joints can be off a motion under computed torque, if masses are not as the controller believes.

The controller exerts M' (a + w) + h' with the inertia M' and the bias h' of its own model, and the feedback
w = 2 f e' + f^2 e with the natural frequency f, where e is the planned position minus that of the joints and a the
planned acceleration. The plant has M = M' + dM and h = h' + dh. So

    e'' + 2 f e' + f^2 e = d,    d = A (a + w) + M^-1 dh,    A = M^-1 dM,

in each coordinate. Let D be the largest |d|. From rest, |e| <= D / f^2, |e'| <= r D and |w| <= c D: r and c are sums
of the impulse responses' magnitudes over MuJoCo's semi-implicit steps h, near 2 / (exp(1) f) and 1 + 2 / exp(2) for
small f h; above f h = 1/2, e' would oscillate from step to step. Hence, by entries, D <= |A a + M^-1 dh| + c |A| D,
which bounds D if the spectral radius of c |A| is below one (a small-gain condition). A and dh are evaluated where the
joints may be by the bound that results.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.planning import Plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.statics import needed_forces
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
    """Bound the tracking errors ``(n,)`` of a run by the controller ``computed-torque`` before it is made [rad, m].

    The bound is for every payload at the end effector up to the given one, and every scale in the given range of the
    masses and inertias that move, both unknown to controller and gravity compensation (`Disturbances`).
    `planning.tube.find_tube` takes it as ``tracking``.

    It assumes exact measurements, no pushes, that the controller knows all dampers, and that no other joints move. It
    is not for ``feedback-linearisation``, which has the feedback of servos, or further errors in each step.
    Inertias and forces are evaluated at 100 instants and peaks of acceleration, with joints and rates off by the bound,
    with random signs, for three scales and three payloads: the bound is not proved for what lies between these.

    Args:
        arm: the arm, as the controller believes it to be.
        motion: a plan, or a motion sampled at the model's time step.
        mass_scale: least and largest scale.
        payload: largest payload [kg].
        frequency: natural frequency of the critically damped feedback [rad/s].

    Raises:
        InputError: a value is malformed, the arm has what there is no bound for, or time steps exceed 0.5 / frequency.
        NotCertifiedError: it is not proved that the feedback holds the joints, or does so by 95 % of the force limits.
    """
    low, high = as_floats("mass_scale", mass_scale, (2,)).tolist()
    if not 0.0 < low <= high:
        raise InputError(f"mass_scale must be two positive numbers, the smaller first, got {low:g} and {high:g}")
    arm, rate, followed = as_loaded(arm, motion), as_positive("frequency", frequency), as_motion(arm, motion)
    dry = arm.model.dof_frictionloss[arm.dofs].any() or arm.model.tendon_frictionloss.any()
    if arm.dependents is not None or len(arm.space.balls) or dry:
        raise InputError(f"arm {arm.name!r} has ball joints, closed loops or dry friction, for which there is no bound")
    if rate * arm.timestep > 0.5 + 1e-9:
        enough = f"a feedback of {rate:g} rad/s needs time steps of at most {0.5 / rate:.3g} s"
        raise InputError(f"{enough}, the model's are {arm.timestep:g} s")
    bare = arm.without_visuals
    scales, loads = np.linspace(low, high, 3), np.linspace(0.0, as_nonnegative("payload", payload), 3)
    of_rate, of_feedback = _responses(rate, arm.timestep)
    error = np.zeros(arm.n_joints)
    for scale, load in sorted({*product(scales.tolist(), loads.tolist())}):
        plant = make_plant(bare, Disturbances(mass_scale=scale, payload=load))
        mismatch, largest = _Mismatch(bare, plant, followed), np.zeros(arm.n_joints)
        for _ in range(20):
            if largest.max() > 10.0 * rate**2:
                continue  # there is no bound
            share, forced, use = mismatch(largest / rate**2, of_rate * largest, of_feedback * largest)
            gain = np.abs(np.linalg.eigvals(of_feedback * share)).max()
            if gain >= 1.0:
                why = f"the gain of their mismatch is {gain:.3g}, not below 1; allow a smaller payload or mass_scale"
                raise NotCertifiedError(f"masses may be too far off for a proof that feedback holds the joints: {why}")
            before, largest = largest, 1.02 * np.linalg.solve(np.eye(len(share)) - of_feedback * share, forced)
            if (largest <= 1.02 * before).all():
                break
        else:
            raise NotCertifiedError("the tracking errors are not bounded: larger ones let the mismatch grow as much")
        if use.max() > 1.0:
            asked = f"joint {arm.joint_names[use.argmax()]!r} for {use.max():.3g} times 95 % of its force limit"
            raise NotCertifiedError(f"the feedback may ask {asked}; plan a slower motion, or allow for smaller changes")
        error = np.maximum(error, np.maximum(before, largest) / rate**2)
    return error


def _responses(frequency: float, timestep: float) -> Floats:
    """The largest |e'| [s] and |w| for disturbances |d| up to 1: r and c of the module."""
    h = max(timestep, 1e-3 / frequency)  # the sums grow with it, and take long for a tiny one
    error, rate, sums = h * h, h, np.zeros(2)
    for _ in range(round(40.0 / (frequency * h))):
        feedback = frequency * (2.0 * rate + frequency * error)
        sums += abs(rate), abs(feedback)
        rate -= h * feedback
        error += h * rate
    return sums


class _Mismatch:
    """The difference of a plant's accelerations from those that a controller asks for, along a motion."""

    def __init__(self, arm: Arm, plant: mujoco.MjModel, motion: Motion) -> None:
        self._arm, self._models = arm, [(model, mujoco.MjData(model)) for model in (plant, arm.model)]
        self._basis = tangent_basis(arm.space)
        acceleration = np.gradient(motion.qd, motion.timestep, axis=0)
        peaks = np.append(acceleration.argmax(axis=0), acceleration.argmin(axis=0))
        chosen = np.union1d(np.linspace(0, len(motion.t) - 1, 100).round().astype(int), peaks)
        self._q, self._qd, self._qdd = motion.q[chosen], motion.qd[chosen], acceleration[chosen]

    def __call__(self, off: Floats, rates_off: Floats, feedback: Floats) -> tuple[Floats, Floats, Floats]:
        """Largest |A| ``(n, n)``, |A a + M^-1 dh| and use of force limits for errors and |w|, each ``(n,)``."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (2, *self._q.shape))
        q, qd = self._q + signs[0] * off, self._qd + signs[1] * rates_off
        share, forced, use = [], [], []
        rows = self._arm.qpos(q), self._arm.qvel(q, qd), self._qdd
        needed, limits = needed_forces(self._arm, q, qd, rows[1], self._arm.qvel(q, self._qdd))[..., : len(off)]
        for qpos, qvel, wanted, force, limit in zip(*rows, np.abs(needed), limits, strict=True):
            parts, full = list[Floats](), np.zeros((len(qvel), len(qvel)))
            for model, data in self._models:
                data.qpos[:], data.qvel[:] = qpos, qvel
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                mujoco.mj_fullM(model, data, full)
                parts += self._basis.T @ full @ self._basis, self._basis.T @ data.qfrc_bias
            inertia, bias, known, expected = parts
            share.append(np.linalg.solve(inertia, inertia - known))
            forced.append(share[-1] @ wanted + np.linalg.solve(inertia, bias - expected))
            use.append((force + np.abs(known) @ feedback) / (0.95 * limit))  # a reserve for steps and between instants
        return np.abs(share).max(axis=0), np.abs(forced).max(axis=0), np.max(use, axis=0)
