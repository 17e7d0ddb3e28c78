"""Model-predictive path integral control over joint velocities, as a policy with a model of its own.

At every control period, velocities over a horizon T are sampled around those of the previous period, u_i = u + e_i,
rolled out from the present configuration, and averaged with weights from their costs S_i (Williams et al., ICRA 2017),

    u <- sum_i w_i u_i,    w_i = exp(-(S_i - min S) / lambda) / sum_j exp(-(S_j - min S) / lambda).

Noise is sampled around u, so changes of u itself cost nothing (their gamma = lambda (1 - alpha) is zero).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from mujoco import rollout
from scipy.special import softmax

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import move_bodies, moving_geoms
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, JointPolicy
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.validation import Seed, as_positive, as_seed
from lieednn_sim.values import Floats

_KNOTS = 4  # of velocities, over the horizon


@dataclass(frozen=True)
class PathIntegralOptions(PlannerOptions):
    """Options of the policy ``mppi``.

    Attributes:
        pairs: half the number of samples, which are drawn in pairs of opposite noise.
        steps: number of steps of the horizon.
        step: length of a step [s].
        noise: standard deviation of velocities, over the convergence rate times the largest distance to the target.
        temperature: lambda, as a fraction of the median cost minus the least cost.
        near: distance kept from the surroundings where the target allows it [m].
        nearness: cost rate where the arm is nearer than `near` [1/s].
    """

    pairs: int = field(default=12, metadata={"range": (1, 10_000)})
    steps: int = field(default=10, metadata={"range": (2, 1000)})
    step: float = 0.06
    noise: float = 0.4
    temperature: float = 0.3
    near: float = 0.03
    nearness: float = 2.0


class VelocityRollouts:
    """An arm whose joints have commanded velocities, in its scene, rolled out by `mujoco.rollout` in steps [s].

    This is the arm as policies see it: under inverse dynamics its actuators follow a reference up to rounding.
    Surroundings are detected if they are nearer than ``near`` [m], parts of the arm only if they overlap.
    """

    def __init__(self, arm: Arm, step: float, near: float) -> None:
        self._arm, self._model = arm, _kinematic(arm, step, near)
        self._data = mujoco.MjData(self._model)
        self._scene = self._model.body_pos.copy()
        self._kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._state = np.zeros((1, mujoco.mj_stateSize(self._model, self._kind)))

    def move(self, places: Mapping[str, Floats]) -> None:
        """Put obstacles where they are now, and all others back where the scene has them; see `Policy.see`."""
        self._model.body_pos[:] = self._scene
        move_bodies(self._model, places)

    def __call__(self, q: Floats, velocities: Floats) -> tuple[Floats, Floats]:
        """Configurations ``(S, H, n)`` after each step, and clearances ``(S, H)`` [m] before it.

        These are infinite where nothing is near. All samples start at ``q`` ``(n,)``; velocities are ``(S, H, n)``.
        """
        model, data, first = self._model, self._data, self._arm.qpos(q)
        mujoco.mj_resetData(model, data)
        data.qpos[:] = first
        mujoco.mj_getState(model, data, self._state[0], self._kind)
        controls = self._arm.qvel(np.broadcast_to(q, velocities.shape), velocities)
        with QuietWarnings():
            states, sensed = rollout.rollout(model, data, self._state, controls)
        configurations = self._arm.coordinates(states[:, :, 1 : 1 + model.nq])
        return configurations, np.where(sensed[:, :, 0] > 0.0, sensed[:, :, 1], np.inf)


def _kinematic(arm: Arm, step: float, near: float) -> mujoco.MjModel:
    spec = arm.copied_spec()
    # Masses do not matter here, and geoms that do not collide only cost time.
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-3, 1e-6
    for geom, moves in zip(list(spec.geoms), moving_geoms(arm.model), strict=True):
        if not (geom.contype or geom.conaffinity):
            spec.delete(geom)
        elif not moves:
            geom.margin, geom.gap = 0.0, near
    for element in [*spec.actuators, *spec.sensors]:
        spec.delete(element)
    for joint, kind in enumerate(arm.model.jnt_type):
        name = arm.model.joint(joint).name
        for gear in np.eye(6)[: 3 if kind == mujoco.mjtJoint.mjJNT_BALL else 1].tolist():
            spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name, gear=gear).set_to_velocity(kv=1e9)
    fields = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND) | 1 << int(mujoco.mjtConDataField.mjCONDATA_DIST)
    # The sensor reports one contact: that of the least distance.
    spec.add_sensor(name="nearest", type=mujoco.mjtSensor.mjSENS_CONTACT, intprm=[fields, 1, 1])
    model = spec.compile()
    model.jnt_actfrclimited[:] = 0  # limits of force from a URDF's efforts, or from an MJCF
    for off in ("GRAVITY", "EQUALITY", "LIMIT", "FRICTIONLOSS", "SPRING"):
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{off}"))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With this inertia, far above the arm's own, and the gain, joints take their commanded velocities at once.
    model.opt.timestep, model.dof_armature[:] = step, 1e4
    return model


def weights(costs: Floats, temperature: float) -> Floats:
    """Weights of samples from their costs ``(S,)``; the temperature is relative to the median minus the least cost."""
    above = costs - costs.min()
    return np.asarray(softmax(-above / max(temperature * float(np.median(above)), 1e-300)))


class PathIntegral(JointPolicy):
    """Model predictive path integral control (MPPI) in joint space, which reaches a target and avoids obstacles.

    With joints in units of their range and e = g - y, the cost of a sample is the integral over time of
    |e|^2 + |u|^2 / c^2 + near + touching, plus |e|^2 / c at its end. Where nothing is near, the linear attractor
    u = c e minimises it. Noise shrinks with the distance from the target, so that the arm comes to rest there.

    Args:
        arm, rate, feedback: as for `JointPolicy`; the arm is in its scene.
        convergence_rate: c [1/s].
        seed: seed of the noise.
    """

    def __init__(
        self,
        arm: Arm,
        rate: float = 100.0,
        *,
        convergence_rate: float = 2.0,
        options: PathIntegralOptions | None = None,
        feedback: Feedback | None = FEEDBACK,
        seed: Seed = 0,
    ) -> None:
        super().__init__(arm, rate, feedback=feedback)
        self._options = options = options or PathIntegralOptions()
        self._convergence_rate, self._seed = as_positive("convergence_rate", convergence_rate), as_seed("seed", seed)
        self._rollouts = VelocityRollouts(arm, options.step, options.near)
        self._knots: Floats = options.step * np.linspace(0.0, options.steps - 1.0, _KNOTS)
        # Linear interpolation from knots to steps.
        self._between = self._at(options.step * np.arange(float(options.steps)))
        self._fastest = arm.velocity_limits / self.range

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._rollouts.move({})
        self._rng = np.random.default_rng([self._seed, 17])
        self._plan = np.zeros((_KNOTS, len(q)))
        self._goal, self._near = np.full_like(q, np.nan), self._options.near

    def see(self, places: Mapping[str, Floats]) -> None:
        """See `Policy`; raises `InputError` for names of no obstacles."""
        super().see(places)
        self._rollouts.move(places)

    def velocity(self, target: Floats, waiting: float) -> Floats:
        """See `JointPolicy`; unchecked."""
        options = self._options
        if (target != self._goal).any():
            _, clearance = self._rollouts(target, np.zeros((1, 1, len(target))))
            self._goal, self._near = target.copy(), min(options.near, max(0.5 * float(clearance[0, 0]), 1e-3))
        scale = options.noise * self._convergence_rate * float(np.abs((target - self.y) / self.range).max())
        noise = scale * self._rng.standard_normal((options.pairs, *self._plan.shape))
        plans = self._plan + np.concatenate([np.zeros((1, *self._plan.shape)), noise, -noise])
        plans = np.clip(plans, -self._fastest, self._fastest)
        costs = self._costs(target, self._between @ plans)
        self._plan = np.tensordot(weights(costs, options.temperature), plans, axes=1)
        return np.asarray(self._plan[0] * self.range)

    def elapse(self, time: float) -> None:
        """See `JointPolicy`; unchecked."""
        self._plan = self._at(self._knots + time) @ self._plan

    def _costs(self, target: Floats, velocities: Floats) -> Floats:
        """Costs ``(S,)`` of velocities ``(S, H, n)`` in units of the ranges."""
        options, c = self._options, self._convergence_rate
        configurations, clearance = self._rollouts(self.y, velocities * self.range)
        off = (((target - configurations) / self.range) ** 2).sum(axis=2)
        near = np.maximum(1.0 - clearance / self._near, 0.0)
        rate = off + (velocities**2).sum(axis=2) / c**2 + options.nearness * near**2 + 1e3 * (clearance < 0.0)
        return np.asarray(options.step * rate.sum(axis=1) + off[:, -1] / c)

    def _at(self, times: Floats) -> Floats:
        """Interpolation matrix from the knots to times ``(m,)``, constant after the last knot."""
        return np.array([np.interp(times, self._knots, unit) for unit in np.eye(_KNOTS)]).T


def path_integral(task: PolicyTask, options: PathIntegralOptions) -> PathIntegral:
    """The controller of a task, which needs no motion."""
    rate, feedback = task.convergence_rate, task.feedback
    return PathIntegral(task.arm, task.rate, convergence_rate=rate, options=options, feedback=feedback, seed=task.seed)
