"""Episodes on a simulated arm: actions are joint velocities, observations are named arrays with bounds."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.environments.bounds import Bounds, common_bounds, reach
from lieednn_sim.environments.commands import Commands
from lieednn_sim.environments.frames import SiteFrames
from lieednn_sim.environments.observations import Observations
from lieednn_sim.environments.rewards import Closeness
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.evaluation.frame_errors import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.planning.motion import steps_in
from lieednn_sim.simulation import Simulation
from lieednn_sim.simulation.plant import make_plant
from lieednn_sim.simulation.quaternions import quaternions
from lieednn_sim.validation import as_choice, as_floats, as_positive, as_seed
from lieednn_sim.values import Floats

Observation = dict[str, Floats]

# Which frames must reach their targets.
GOALS = ("end-effector", "links")
# Longest episode [s]; targets that move are drawn for all of it.
_MAX_TIME_LIMIT = 1000.0


class Transition(NamedTuple):
    """The result of an action.

    Attributes:
        observation: arrays by name, those of `ArmTask.bounds`.
        reward: reward in [0, 1].
        terminated: whether the simulation failed, so that there is no state to continue from.
        truncated: whether the time limit is reached.
        info: ``success``, ``distance`` [m], ``angle`` [rad]; and ``failure``, the reason if the simulation failed.
    """

    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


class ArmTask(ABC):
    """Tasks in which joint velocities bring an arm to target positions that are among the observations.

    An action in [-1, 1]^n is a joint velocity as a share of the limits. It moves the commanded position, which stays
    within the position limits, at constant velocity for one control step; the arm's position servos follow it, with
    velocity feedforward, at every physics step. Actions outside this range are clipped.

    Observations, each with finite bounds, to which it is clipped:

    - ``position`` ``(n,)`` [rad, m], ``velocity`` ``(n,)`` [rad/s, m/s] of the joints,
    - ``command`` ``(n,)``: the commanded position,
    - ``position_error`` ``(n,)``: target minus position,
    - ``pose_error`` ``(F, 6)``: for each goal frame, Log(T^-1 T_target) as a twist (omega, v) [rad, m].

    Args:
        arm: name of an arm of the package, or an arm.
        scene: obstacles around it, a name of `arm.scenes.SCENES` or a file, see `Arm.among`.
        scene_seed: seed of the obstacles' positions.
        control_timestep: time between actions [s], a whole number of physics steps.
        time_limit: duration of an episode [s].
        goal: ``"end-effector"``: its frame is the goal frame; ``"links"``: all link frames are, and the worst counts.
        position_tolerance: tolerance of success [m]; by default that of a settled frame in an `Evaluation`.
        rotation_tolerance: the same [rad].

    Attributes:
        arm: the arm.
        simulation: its simulation.
        substeps: number of physics steps in a control step.
        commands: computes commanded positions and controls from actions.
        frames: slice of the goal frames among the link frames.
        bounds: lower and upper bounds of the observations, by name.
        observations: computes rows of observations.
        closeness: reward of distance and angle.
        row: present observations; after a failure, those before it.
        episode: number of episodes begun.
        distance: largest distance of a goal frame from its target at present [m].
        angle: the same as an angle [rad].
        failure: reason why the simulation failed in this episode, or empty.

    Raises:
        InputError: an argument is malformed, or the arm has infinite position or velocity limits.
    """

    # Tolerances and margins of further errors that are rewarded besides distance and angle.
    _more_errors: tuple[tuple[float, float], ...] = ()

    def __init__(
        self,
        arm: str | os.PathLike[str] | Arm = "telescopic_pr",
        *,
        scene: str | os.PathLike[str] = "free",
        scene_seed: int = 0,
        control_timestep: float = 0.02,
        time_limit: float = 6.0,
        goal: str = "end-effector",
        position_tolerance: float = SETTLED_TRANSLATION,
        rotation_tolerance: float = SETTLED_ROTATION,
    ) -> None:
        if isinstance(arm, Arm):
            self.arm = arm.among(scene, scene_seed)
        else:
            self.arm = Arm.load(arm, scene, as_seed("scene_seed", scene_seed))
        if not (np.isfinite(self.arm.position_limits).all() and np.isfinite(self.arm.velocity_limits).all()):
            raise InputError(f"arm {self.arm.name!r} needs finite position and velocity limits: they scale the actions")
        timestep = self.arm.timestep
        self.substeps = steps_in("control_timestep", control_timestep, timestep)
        self.control_timestep = self.substeps * timestep
        self.time_limit = as_positive("time_limit", time_limit)
        if not self.control_timestep <= time_limit <= _MAX_TIME_LIMIT:
            raise InputError(
                f"time_limit must be between one control step of {self.control_timestep:g} s and "
                f"{_MAX_TIME_LIMIT:g} s, got {time_limit:g} s"
            )
        self.steps = int(np.ceil(self.time_limit / self.control_timestep - 1e-6))
        self.goal = as_choice("goal", goal, GOALS)
        self.position_tolerance = as_positive("position_tolerance", position_tolerance)
        self.rotation_tolerance = as_positive("rotation_tolerance", rotation_tolerance)
        self.commands = Commands(self.arm, self.substeps)
        self._command = np.zeros(self.arm.n_joints)
        self.frames = slice(-1, None) if self.goal == "end-effector" else slice(None)
        frames = len(range(self.arm.n_links)[self.frames])
        self.bounds: Bounds = common_bounds(self.arm, frames) | self._more_bounds()
        self.observations = Observations(self.bounds)
        # Visual geoms would double the time of a step.
        self.run_in(Simulation(self.arm, make_plant(self.arm.without_visuals)))
        self.episode = 0
        self.distance, self.angle = float("inf"), float(np.pi)
        self.failure = ""
        self._controls: Floats | None = None
        self._over = True
        self._step = 0
        self.row = np.zeros(self.observations.size)
        self._velocity = np.zeros(self.arm.n_joints)
        tolerances = self.position_tolerance, self.rotation_tolerance
        self.closeness = Closeness(*tolerances, reach(self.arm), *self._more_errors)

    def run_in(self, simulation: Simulation) -> None:
        """Use another simulation of the arm from the next episode on."""
        self.simulation = simulation
        # Views are kept, since asking MuJoCo for one takes as long as reading it.
        data = simulation.data
        self._qpos, self._qvel, self._warm_start = data.qpos, data.qvel, data.qacc_warmstart
        self._site_frames = SiteFrames(self.arm, data, self.frames)

    @abstractmethod
    def _draw(self, rng: np.random.Generator, options: dict[str, Any]) -> None:
        """Draw the target of the episode that begins, or take it from the options; raise on unknown options."""

    @abstractmethod
    def target(self, time: float) -> Floats:
        """Joint target ``(n,)`` at a time of the episode [s]."""

    @abstractmethod
    def here(self) -> tuple[Floats, ...]:
        """Present target for `Observations.rows`: position ``(n,)``, frames ``(F, 16)``, additional observations."""

    def _require_episode(self) -> None:
        if self.episode == 0:
            raise InputError("no episode has begun: reset first")

    def _more_bounds(self) -> Bounds:
        """Bounds of the task's additional observations."""
        return {}

    @abstractmethod
    def judge(self, distance: Floats | float, angle: Floats | float, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Rewards ``(...)`` in [0, 1] and successes ``(...)`` at errors ``(...)`` and joint velocities ``(..., n)``.

        Unchecked.
        """

    def reward(self) -> float:
        """Reward at the present time, in [0, 1]."""
        return float(self._judged(self._joints()[1])[0])

    def success(self) -> bool:
        """Whether the arm is at its target at the present time."""
        return bool(self._judged(self._joints()[1])[1])

    def _judged(self, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        return self.judge(self.distance, self.angle, qd)

    @property
    def over(self) -> bool:
        """Whether the episode is over, or none has begun."""
        return self._over

    @property
    def time(self) -> float:
        """Present time of the episode [s]."""
        return self._step * self.control_timestep

    @property
    def command(self) -> Floats:
        """The commanded joint position ``(n,)``."""
        return self._command.copy()

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None = None) -> Observation:
        """Begin an episode: the arm rests at ``home``, and the target is drawn from the generator.

        Nothing remains of earlier episodes: an episode is a function of the generator's state, options and actions.

        Raises:
            InputError: unknown or malformed options.
            NoSolutionError: no target or motion was found for this arm in its scene.
        """
        self._over = True
        self._draw(rng, dict(options or {}))
        home = self.arm.keyframe("home")
        self.simulation.reset(home)
        self._command = home
        self._step, self._over, self.failure = 0, False, ""
        self.episode += 1
        self._look()
        return self.observe()

    def step(self, action: ArrayLike) -> Transition:
        """Do one control step with an action ``(n,)``.

        Raises:
            InputError: the action is malformed or not finite, or no episode is running.
        """
        self.before_step(action)
        self.advance(self.substeps)
        self.after_step()
        failed = bool(self.failure)
        reward, success = (0.0, False) if failed else self._judged(self._velocity)
        return Transition(self.observe(), float(reward), failed, self._over and not failed, self._info(bool(success)))

    def before_step(self, action: ArrayLike) -> None:
        """Move the command by an action ``(n,)``; raises as `step`."""
        if self._over:
            raise InputError("the episode is over, or none has begun: reset first")
        start = self._command
        end = self.commands.moved(start, as_floats("action", action, (self.arm.n_joints,)))
        self._controls, self._command = self.commands.controls(start, end), end
        # Without a warm start of the solver, a control step is a function of the state.
        self._warm_start[:] = 0.0

    def advance(self, steps: int) -> None:
        """Do physics steps, with the controls of the last `before_step`, used once; sets `failure` if one fails."""
        controls, self._controls = self._controls, None
        try:
            self.simulation.advance(steps, controls)
        except SimulationError as error:
            self.failure = str(error)

    def after_step(self, *, current: bool = False) -> None:
        """Update the observations, unless the simulation failed.

        Args:
            current: whether MuJoCo has computed the poses of the present time.
        """
        self.took(self._command, self.failure)
        if not self.failure:
            self._look(current)

    def took(self, command: Floats, failure: str = "") -> None:
        """Count a control step to a commanded position ``(n,)``, with the reason if it failed."""
        self._command, self.failure = command, failure
        self._step += not failure
        self._over = bool(failure) or self._step >= self.steps

    def failure_of(self, controls: Floats) -> str:
        """The reason for which physics steps with controls ``(substeps, nu)`` fail from the present state."""
        controls = as_floats("controls", controls, (self.substeps, self.arm.model.nu))
        self.simulation.steps, self._controls = self._step * self.substeps, controls
        self._warm_start[:] = 0.0
        self.advance(self.substeps)
        return self.failure or "the state is not finite"

    def observe(self) -> Observation:
        """Present observations, as new arrays; after a failure, those before it."""
        return self.observations.split(self.row.copy())

    def info(self) -> dict[str, Any]:
        """Success and errors at the present time; see `Transition`."""
        return self._info(self.success() and not self.failure)

    def _info(self, success: bool) -> dict[str, Any]:
        info = {"success": success, "distance": self.distance, "angle": self.angle}
        return info | ({"failure": self.failure} if self.failure else {})

    def _look(self, current: bool = False) -> None:
        """Update observations and errors to the present time."""
        if not current:
            mujoco.mj_kinematics(self.simulation.model, self.simulation.data)
        q, self._velocity = self._joints()
        frames = self._site_frames()
        self.row, distance, angle = self.observations.rows(frames, q, self._velocity, self._command, self.here())
        self.distance, self.angle = float(distance), float(angle)

    def _goals(self, q: Floats) -> Floats:
        """Goal frames ``(..., F, 16)`` at joint targets ``(..., n)``."""
        matrices = self.arm.link_poses(q).as_matrix()[..., self.frames, :, :]
        rotation = matrices[..., :3, :3]
        parts = matrices[..., :3, 3], rotation.reshape(*rotation.shape[:-2], 9), quaternions(rotation)
        return np.concatenate(parts, axis=-1)

    def _joints(self) -> tuple[Floats, Floats]:
        """Joint positions and velocities ``(n,)`` of the simulation, without checks."""
        space = self.arm.space
        q = space.from_qpos(self._qpos)
        return q, space.from_qvel(q, self._qvel)
