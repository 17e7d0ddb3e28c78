"""The stepwise simulation of one arm in MuJoCo, on which rollouts and environments are based."""

from __future__ import annotations

import copy
from collections.abc import Callable
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import fixed_body
from lieednn_sim.arm.grasp import load_body
from lieednn_sim.arm.step_stability import step_remedy
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.simulation.disturbances import Disturbances, Noise, Pushes, Sensors
from lieednn_sim.validation import as_count, as_floats
from lieednn_sim.values import Floats


class Simulation:
    """A simulated arm for the user's own loops; `simulate` and `follow` are based on it.

    Its state is a function of the arguments, the last reset, and the controls since then. The user or a `Controller`
    sets ``data.ctrl``; `advance` or a `Log` does the steps.

    Args:
        arm: the arm; its model is not changed.
        plant: the model to simulate; by default that of `make_plant` for the arm and the disturbances.
        disturbances: pushes, sensor noise and moving obstacles; without ``plant``, also the changes of `make_plant`.

    Raises:
        InputError: a pushed body or obstacle does not exist, or an obstacle has joints, carries an arm, or moves twice.

    Attributes:
        model: the plant.
        data: its state.
        pushes: the forces of the pushes of the disturbances.
        sensors: draws the measurement errors.
        steps: number of steps since the last reset.
        noise: measurement errors at the present time, to be added to qpos (by `mj_integratePos`) and qvel.
    """

    def __init__(
        self, arm: Arm, plant: mujoco.MjModel | None = None, *, disturbances: Disturbances | None = None
    ) -> None:
        self.arm = arm
        self.disturbances = Disturbances() if disturbances is None else disturbances
        self.model = make_plant(arm, self.disturbances) if plant is None else plant
        self.data = mujoco.MjData(self.model)
        # Views are kept, since asking for one takes as long as reading it.
        self._warnings, self._velocity, self._control = self.data.warning.number, self.data.qvel, self.data.ctrl
        self.pushes = Pushes(arm, self.model, self.disturbances.pushes)
        self._moving = [(each, fixed_body(self.model, each.body)) for each in self.disturbances.obstacles]
        names = [each.body for each in self.disturbances.obstacles]
        if twice := {name for name in names if names.count(name) > 1}:
            raise InputError(f"an obstacle can move in one way only, got more than one for {', '.join(sorted(twice))}")
        self.sensors = Sensors(arm, self.disturbances)
        self.steps = 0
        self.noise: Noise
        self.reset(arm.coordinates(arm.model.qpos0 if arm.qpos_home is None else arm.qpos_home))

    def __getstate__(self) -> object:
        # The views of a copy would belong to other data.
        raise InputError("a Simulation, and what holds one, can neither be copied nor pickled: make another one")

    @property
    def timestep(self) -> float:
        """Simulation step [s]."""
        return float(self.model.opt.timestep)

    @property
    def time(self) -> float:
        """Present time [s]: the steps done times the time step, without the rounding of a sum."""
        return self.steps * self.timestep

    @property
    def q(self) -> Floats:
        """Joint coordinates ``(n,)`` [rad, m]."""
        return self.arm.coordinates(self.data.qpos)

    @property
    def qd(self) -> Floats:
        """Their rates ``(n,)`` [rad/s, m/s]."""
        return self.arm.rates(self.q, self.data.qvel)

    def measured(self) -> tuple[Floats, Floats]:
        """Joint coordinates and rates ``(n,)`` as the sensors see them."""
        qpos = self.data.qpos.copy()
        mujoco.mj_integratePos(self.model, qpos, self.noise.position, 1.0)
        q = self.arm.coordinates(qpos)
        return q, self.arm.rates(q, self.data.qvel + self.noise.velocity)

    def move_obstacles(self) -> dict[str, Floats]:
        """Put moving obstacles where they are at the present time; returns positions ``(3,)`` by names of bodies."""
        places = {obstacle.body: obstacle.at(self.time) for obstacle, _ in self._moving}
        for obstacle, body in self._moving:
            if (mocap := self.model.body_mocapid[body]) >= 0:
                self.data.mocap_pos[mocap] = places[obstacle.body]
            self.model.body_pos[body] = places[obstacle.body]
        return places

    def reset(self, q: ArrayLike, qd: ArrayLike | None = None) -> None:
        """Start again at time 0 from joint coordinates ``(n,)`` and their rates, by default zero.

        This also resets controls, mocap poses, warm starts, warnings, and the generator of the noise. What is not part
        of the arm begins as in a view's state, or at the model's reference, at rest.
        """
        position = as_floats("q", q, (self.arm.n_joints,))
        velocity = np.zeros_like(position) if qd is None else as_floats("qd", qd, position.shape)
        mujoco.mj_resetData(self.model, self.data)
        if self.arm.state is None:
            self.data.qvel[:] = self.arm.qvel(position, velocity)
        else:
            mujoco.mj_setState(self.model, self.data, self.arm.state, mujoco.mjtState.mjSTATE_INTEGRATION)
            mine = self.arm.space.rate_addresses
            self.data.qvel[mine] = self.arm.qvel(position, velocity)[mine]
        self.data.qpos[:] = self._begin = self.arm.qpos(position)
        self.steps = 0
        self.move_obstacles()
        self.sensors.reset()
        self.noise = self.sensors.draw()

    def advance(self, steps: int = 1, controls: Floats | None = None) -> None:
        """Do steps without logging them.

        Args:
            steps: number of steps to do.
            controls: ``(steps, nu)`` controls of each step; by default the present ones for all.

        Raises:
            SimulationError: MuJoCo warns, or the state is not finite; the message has the time.
        """
        # A larger number is an error of units.
        count = as_count("steps", steps, most=10**7)
        rows = None if controls is None else as_floats("controls", controls, (count, self.model.nu))
        with QuietWarnings():
            for k in range(count):
                if rows is not None:
                    self._control[:] = rows[k]
                self.advance_once()

    def advance_once(self) -> None:
        """Do one step as `advance` does, within the caller's `QuietWarnings`, which is entered once for many steps."""
        if self.disturbances.pushes:
            self.data.xfrc_applied[:] = self.pushes.forces(range(self.steps, self.steps + 1))[0]
        if self.disturbances.obstacles:
            self.move_obstacles()
        mujoco.mj_step(self.model, self.data)
        # Positions follow from velocities. A finite sum has finite terms; otherwise it may have overflowed, so the
        # terms are checked one by one. For a few numbers a list is faster than an array.
        finite = isfinite(sum(self._velocity.tolist())) or np.isfinite(self._velocity).all()
        if not finite or any(self._warnings.tolist()):
            raise failure(self.data, repr(self.arm.name), self.time, step_remedy(self.model, self._begin))
        self.steps += 1
        if self.sensors.noisy:
            self.noise = self.sensors.draw()


def failure(data: mujoco.MjData, what: str, time: float, remedy: str = "") -> SimulationError:
    """The error for a step after which there is a warning of MuJoCo, or the state is not finite."""
    problem = "the state is not finite"
    if data.warning.number.any():
        index = int(np.flatnonzero(data.warning.number)[0])
        problem = str(mujoco.mju_warningText(index, int(data.warning.lastinfo[index])))
    message = f"the simulation of {what} failed at t = {time:.4f} s: {problem}"
    return SimulationError(f"{message.rstrip('.')}; {remedy}" if remedy else message)


def make_plant(
    arm: Arm, disturbances: Disturbances | None = None, add_bodies: Callable[[Any], None] | None = None
) -> mujoco.MjModel:
    """A model to simulate; neither the arm's model nor its spec is changed.

    Only disturbances that change the arm itself are used; gravity compensation stays that of the undisturbed arm.
    ``add_bodies`` is called with a copy of the arm's spec, to add bodies after the arm's. `InputError` if bodies are to
    be added to a view of a compiled model, or a payload to a body of one that MuJoCo compensates for gravity, at its
    centre of mass.
    """
    changes = Disturbances() if disturbances is None else disturbances
    view = arm.spec is None
    loaded = arm if view else arm.with_payload(changes.payload)
    if add_bodies is None:
        plant = copy.deepcopy(loaded.model)
    else:
        spec = loaded.copied_spec()
        add_bodies(spec)
        plant = spec.compile()
        plant.actuator_gainprm[:], plant.actuator_biasprm[:] = arm.model.actuator_gainprm, arm.model.actuator_biasprm
    if changes.mass_scale != 1.0:
        own = np.flatnonzero(moved_together(arm.model, arm.dofs))
        if plant.nbody > arm.model.nbody:
            own = np.array([plant.body(arm.model.body(k).name).id for k in own.tolist()])
        plant.body_mass[own] *= changes.mass_scale
        plant.body_inertia[own] *= changes.mass_scale
        plant.body_gravcomp[own] /= changes.mass_scale
    if view and changes.payload > 0.0:
        load_body(plant, arm, changes.payload)
    elif changes.mass_scale != 1.0:
        mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant
