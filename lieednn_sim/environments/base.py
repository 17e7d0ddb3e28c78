"""Episodes on a simulated arm: actions are joint velocities, observations are named arrays with bounds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import required_forces
from lieednn_sim.environments import observations
from lieednn_sim.environments.observations import Bounds, LinkFrames, Observation, Observations, State, Target
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.evaluation.evaluation import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.simulation import Simulation
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.simulation.simulation import make_plant
from lieednn_sim.validation import as_choice, as_floats, as_positive, as_seed
from lieednn_sim.values import Floats, StrPath


class Commands:
    """Turns actions into commanded positions, and these into controls of position servos, as `ArmTask` describes.

    `InputError` if the arm is not driven by position actuators on joints or fixed tendons, or moves closed loops.
    """

    def __init__(self, arm: Arm, substeps: int) -> None:
        if arm.dependents is not None:
            raise InputError(f"arm {arm.name!r} moves closed loops, through which servos do not follow commands")
        self._arm, self._actuators = arm, Actuators(arm)
        self._actuators.require_servos()
        self._damping = arm.model.dof_damping.copy()
        self._low, self._high = arm.position_limits.T
        self._timestep = substeps * arm.timestep
        # The largest motion of a control step.
        self._travel = self._timestep * arm.velocity_limits
        parts = np.arange(substeps + 1)[:, None] / substeps
        self._before, self._after = 1.0 - parts, parts
        self._alone = None if len(arm.space.balls) else self._coefficients()

    def moved(self, command: Floats, action: Floats) -> Floats:
        """Commanded positions ``(..., n)`` after actions ``(..., n)``, from the commanded positions before."""
        root = np.minimum(np.maximum(action, -1.0), 1.0)
        end = command + self._travel * root * np.abs(root)
        end = np.minimum(np.maximum(end, self._low), self._high)
        return self._arm.within_angles(end) if len(self._arm.space.balls) else end

    def towards(self, command: Floats, goal: Floats) -> Floats:
        """Actions ``(..., n)`` that move commanded positions ``(..., n)`` to a goal, or as far as one step can."""
        fraction = np.minimum(np.maximum((goal - command) / self._travel, -1.0), 1.0)
        return np.copysign(np.sqrt(np.abs(fraction)), fraction)

    def controls(self, start: Floats, end: Floats) -> Floats:
        """Controls ``(..., substeps, nu)`` that move the servos from commanded positions ``(..., n)`` to others."""
        load: Floats | float = 0.0
        if self._actuators.heavy:
            qpos = self._arm.qpos(np.stack([start, end]))
            forces = required_forces(self._arm.model, qpos.reshape(-1, qpos.shape[-1])).reshape(*qpos.shape[:-1], -1)
            held = np.matvec(self._actuators.allocation, forces)[..., None, :] / self._actuators.gain
            load = self._before[:-1] * held[0] + self._after[:-1] * held[1]
        if self._alone is None:
            return self._any_controls(start, end) + load
        columns, of_start, of_end, constant = self._alone
        start, end = start.take(columns, axis=-1)[..., None, :], end.take(columns, axis=-1)[..., None, :]
        return of_start * start + of_end * end + (constant + load)

    def _coefficients(self) -> tuple[NDArray[np.int_], Floats, Floats, Floats] | None:
        """`_any_controls` as coefficients, three times as fast; None if an actuator moves several joints."""
        n = self._arm.n_joints
        unit, zero = np.eye(n), np.zeros((n, n))
        constant = self._any_controls(zero[0], zero[0])
        factors = np.stack([self._any_controls(unit, zero), self._any_controls(zero, unit)]) - constant
        moves = (factors != 0.0).any(axis=(0, 2))
        if (moves.sum(axis=0) > 1).any():
            return None
        columns = moves.argmax(axis=0)
        of_start, of_end = factors[:, columns, :, np.arange(len(columns))].transpose(1, 2, 0)
        return columns, of_start, of_end, constant

    def _any_controls(self, start: Floats, end: Floats) -> Floats:
        # Not start + part * (end - start), which may exceed a limit by rounding.
        q = self._before * start[..., None, :] + self._after * end[..., None, :]
        space = self._arm.space
        # Generalised velocities depend on the configuration only with ball joints.
        configurations = q[..., 1:, :] if len(space.balls) else end[..., None, :]
        qvel = space.to_qvel(configurations, ((end - start) / self._timestep)[..., None, :])
        return self._actuators.servo_controls(space.to_qpos(q[..., :-1, :]), qvel, self._damping * qvel)


class ArmTask(ABC):
    """Base class of tasks in which joint velocities bring an arm to target positions that are observed.

    A task has two parts. Its definition is in `commands`, `draw`, `judge` and `look`, which work on arrays with any
    leading axes, so that `gymnasium.VectorEnvironment` can use them for many episodes. `begin` and `step` run one
    episode in the task's simulation.

    An action a in [-1, 1]^n gives the joint velocities a |a|, as fractions of their limits, so that slow motions, for
    which a learner needs precise actions, have a wide range of actions. During one control step the commanded position
    moves at this constant velocity, within the position limits; the arm's position servos follow it, with feedforward
    of velocity and weight, at every physics step. Actions outside this range are clipped.

    Observations, which are clipped to finite bounds:

    - ``position`` ``(n,)`` [rad, m], ``velocity`` ``(n,)`` [rad/s, m/s] of the joints,
    - ``command`` ``(n,)``: the commanded position,
    - ``position_error`` ``(n,)``: target minus position,
    - ``approach`` ``(n,)``: the action that brings the commanded position to the target, or as far as one step can,
    - ``pose_error`` ``(F, 6)``: for each goal frame, Log(T^-1 T_target) as a twist (omega, v) [rad, m].

    Args:
        arm: an arm, the name of one of the package, or a model file.
        scene: obstacles around it, a name of `arm.scenes.SCENES` or a file, see `Arm.with_scene`.
        scene_seed: seed of the obstacles' positions.
        control_timestep: time between actions [s], a whole number of physics steps.
        time_limit: duration of an episode [s].
        goal: ``"end-effector"``: its frame is the goal frame; ``"links"``: all link frames are, and the worst counts.
        position_tolerance, rotation_tolerance: tolerances of success [m, rad]; by default those of a settled frame in
            an `Evaluation`, unless a subclass has others.

    Attributes:
        arm, simulation: the arm, and its simulation.
        substeps, control_timestep: number of physics steps in a control step, and its duration [s].
        steps, episode: number of control steps in an episode, and of episodes begun.
        commands: computes commanded positions and controls from actions.
        frames: slice of the goal frames among the link frames.
        bounds: lower and upper bounds of the observations, by name.
        observations: computes rows of observations.

    Raises:
        InputError: an argument is malformed, or the arm has infinite position or velocity limits.
    """

    position_tolerance, rotation_tolerance = SETTLED_TRANSLATION, SETTLED_ROTATION

    def __init__(
        self,
        arm: StrPath | Arm = "telescopic_pr",
        *,
        scene: StrPath = "free",
        scene_seed: int = 0,
        control_timestep: float = 0.02,
        time_limit: float = 6.0,
        goal: str = "end-effector",
        position_tolerance: float | None = None,
        rotation_tolerance: float | None = None,
    ) -> None:
        seed = as_seed("scene_seed", scene_seed)
        self.arm = arm.with_scene(scene, seed) if isinstance(arm, Arm) else Arm.load(arm, scene, seed)
        if not np.isfinite([*self.arm.position_limits.T, self.arm.velocity_limits]).all():
            why = "finite limits, which scale the actions: give arm=Arm.load(..., limits={'JOINT': {'velocity': 2.0}})"
            raise InputError(f"arm {self.arm.name!r} needs {why}, or limits in a YAML file that describes it")
        timestep = self.arm.timestep
        ratio = as_positive("control_timestep", control_timestep) / timestep
        self.substeps = round(ratio)
        if ratio < 0.5 or abs(ratio - self.substeps) > 1e-6 * ratio:
            what = f"control_timestep must be a whole number of simulation steps of {timestep:g} s"
            raise InputError(f"{what}, got {control_timestep:g} s = {ratio:.6g} steps")
        self.control_timestep = dt = self.substeps * timestep
        self.time_limit = as_positive("time_limit", time_limit)
        # Moving targets are drawn for the whole time, which takes memory.
        if not dt <= time_limit <= 1000.0:
            raise InputError(f"time_limit must be between one control step of {dt:g} s and 1000 s, got {time_limit:g}")
        self.steps = int(np.ceil(self.time_limit / self.control_timestep - 1e-6))
        self.goal = as_choice("goal", goal, ("end-effector", "links"))
        for name, value in {"position_tolerance": position_tolerance, "rotation_tolerance": rotation_tolerance}.items():
            if value is not None:
                setattr(self, name, as_positive(name, value))
        self.commands = Commands(self.arm, self.substeps)
        self.frames = slice(-1, None) if self.goal == "end-effector" else slice(None)
        frames = len(range(self.arm.n_links)[self.frames])
        self.bounds: Bounds = observations.common_bounds(self.arm, frames) | self._more_bounds()
        self.observations = Observations(self.bounds)
        self.episode = 0
        self._state: State | None = None
        self._target: Target
        # Visual geoms would double the time of a step.
        self.run_in(Simulation(self.arm, make_plant(self.arm.without_visuals)))

    def run_in(self, simulation: Simulation) -> None:
        """Use another simulation of the arm from the next episode on."""
        self.simulation, data = simulation, simulation.data
        # Views are kept, since getting one from MuJoCo takes as long as reading it.
        self._qpos, self._qvel, self._warm_start = data.qpos, data.qvel, data.qacc_warmstart
        self._link_frames = LinkFrames(self.arm, simulation.model, data, self.frames)

    def _more_bounds(self) -> Bounds:
        """Bounds of the task's additional observations."""
        return {}

    @abstractmethod
    def draw(self, rng: np.random.Generator, options: dict[str, Any]) -> Target:
        """Draw the target of an episode, or take it from the options; raises as `begin`."""

    @abstractmethod
    def judge(self, distance: Floats, angle: Floats, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Rewards in [0, 1] and successes, each ``(...)``, by joint velocities ``(..., n)``; arguments are unchecked.

        Distances ``(...)`` [m] and angles ``(...)`` [rad] are the largest ones between goal frames and their targets.
        """

    def look(self, steps: Any, command: Floats, qpos: Floats, qvel: Floats, frames: Floats, *target: Floats) -> State:
        """The states ``(...)`` after numbers ``(...)`` of control steps; arguments are unchecked.

        The arguments are commanded positions ``(..., n)``, MuJoCo's positions ``(..., nq)`` and velocities
        ``(..., nv)``, goal frames ``(..., F, 16)`` (`LinkFrames`) and the arrays of `Target.after`, with leading axes.
        """
        q = self.arm.space.from_qpos(qpos)
        qd = self.arm.space.from_qvel(q, qvel)
        desired, goals, *more = target
        twist, distance, angle = observations.pose_error_twists(frames, goals)
        approach, pose_error = self.commands.towards(command, desired), twist.reshape(*q.shape[:-1], -1)
        row = self.observations.rows(q, qd, command, desired - q, approach, pose_error, *more)
        return State(steps, command, row, *self.judge(distance, angle, qd), distance, angle)

    @property
    def state(self) -> State:
        """The present state; after a failure, the state before it, without success or reward."""
        if self._state is None:
            raise InputError("no episode has begun: reset first")
        return self._state

    @property
    def over(self) -> bool:
        """Whether the episode is over, or none has begun."""
        return self._state is None or bool(self._state.over(self.steps))

    @property
    def time(self) -> float:
        """Present time of the episode [s]."""
        return self.state.steps * self.control_timestep

    @property
    def command(self) -> Floats:
        """The commanded joint position ``(n,)``."""
        return self.state.command.copy()

    def target(self, time: float) -> Floats:
        """Joint target ``(n,)`` at a time of the episode [s]."""
        if self.episode == 0:
            raise InputError("no episode has begun: reset first")
        return self._target.position(float(as_floats("time", time, ())))

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None = None) -> Observation:
        """Begin an episode: the arm rests at ``home``, and the target is drawn from the generator.

        Nothing remains of earlier episodes: an episode is a function of the generator's state, options and actions.

        Raises:
            InputError: unknown or malformed options.
            NoSolutionError: no target or motion was found for this arm in its scene.
        """
        self._state = None
        self._target = self.draw(rng, dict(options or {}))
        home = self.arm.keyframe("home")
        self.simulation.reset(home)
        self._look(0, home)
        self.episode += 1
        return self.observe()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Do one control step with an action ``(n,)``, as Gymnasium's environments do.

        Returns:
            The observations, named as in `bounds`; the reward in [0, 1]; whether the simulation failed, so that there
            is no state to continue from; whether the time limit is reached; and `State.info`.

        Raises:
            InputError: the action is malformed or not finite, or no episode is running.
        """
        before = self._state
        if before is None or self.over:
            raise InputError("the episode is over, or none has begun: reset first")
        command = self.commands.moved(before.command, as_floats("action", action, (self.arm.n_joints,)))
        failure = self.simulate(self.commands.controls(before.command, command))
        if failure:
            state = self._state = before._replace(reward=np.zeros(()), success=np.zeros((), bool), failure=failure)
        else:
            state = self._look(before.steps + 1, command)
        truncated = not failure and self.over
        return self.observe(), float(state.reward), bool(failure), truncated, state.info()

    def simulate(self, controls: Floats) -> str:
        """Do the physics steps of a control step with controls ``(substeps, nu)``; returns the reason if one fails."""
        # No warm start of the solver, so that the result of a control step depends on the state alone.
        self._warm_start[:] = 0.0
        try:
            self.simulation.advance(self.substeps, controls)
        except SimulationError as error:
            return str(error)
        return ""

    def _look(self, steps: int, command: Floats) -> State:
        frames, target = self._link_frames(), self._target.after(steps)
        self._state = state = self.look(steps, command, self._qpos, self._qvel, frames, *target)
        return state

    def observe(self) -> Observation:
        """Present observations, as new arrays; after a failure, the observations before it."""
        return self.observations.split(self.state.row.copy())
