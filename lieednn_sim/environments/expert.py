"""An expert for all interfaces, which turns the references of a policy into actions."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.tasks import Track, slowdown
from lieednn_sim.errors import InputError
from lieednn_sim.planning import plan
from lieednn_sim.policies import MotionTracker, Policy, make_policy
from lieednn_sim.registry import PLANNERS, POLICIES
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats

__all__ = ["Expert"]

# Duration with which plans are made before they are sped up [s]; minimum jerk gives the same path in any duration.
_PLANNING_DURATION = 10.0


class Expert:
    """An expert policy for imitation learning, which has access to the arm and the task.

    In `Reach` it plans a motion from ``home`` to each episode's target, by default with a certified network and around
    any obstacles, and commands the positions of the motion, as fast as 90 % of the limits allow. In `Track` it commands
    the target's next position. With ``policy`` it follows that policy, which is made anew for each episode and sees the
    measured joints and the target. The expert's actions are within [-1, 1].

    Args:
        environment: an `ArmTask`, an environment of `suite.load`, or a Gymnasium one, wrapped or not.
        policy: a name of `policies.POLICIES`.
        planner: a name of `planning.PLANNERS`; by default the `default_planner` of the task's arm.
        seed: seed of the draws.

    Attributes:
        certificate: in an episode of `Reach`, the proof of stability of the network that moves the arm, in words;
            empty before the first action, and where no network moves the arm.

    Raises:
        InputError: the environment is of another kind, there is no such policy or planner, or both are given.
        LieEDNNError: a library that the planner needs is not installed.
    """

    def __init__(
        self, environment: Any, *, policy: str | None = None, planner: str | None = None, seed: Seed = 0
    ) -> None:
        inner = getattr(environment, "unwrapped", environment)
        task = inner if isinstance(inner, ArmTask) else getattr(inner, "task", None)
        # A vector environment has a task too, but does not run the task's own episode.
        if not isinstance(task, ArmTask) or hasattr(inner, "num_envs"):
            raise InputError(
                "environment must be an ArmTask, or made by suite.load or gymnasium.make from one of this package's, "
                f"got {type(environment).__name__}"
            )
        if policy is not None:
            if planner is not None:
                raise InputError(f"give a policy or a planner, got {policy!r} and {planner!r}")
            POLICIES.find(policy)
        if planner is not None:
            PLANNERS.require(planner)
        self._task, self._kind, self._planner, self._seed = task, policy, planner, as_seed("seed", seed)
        self._episode, self._periods = 0, 0
        self._policy: Policy
        self.certificate = ""

    def act(self) -> Floats:
        """Action ``(n,)`` for the present time, from the arm and the task, which hold more than the observations.

        Raises:
            PlanError: no plan was found for the episode's target.
            NotCertifiedError: no network could be certified for it.
        """
        task = self._task
        if task.episode == 0:
            raise InputError("the environment has not been reset")
        target = task.target(task.time + task.control_timestep)
        if self._kind is None and isinstance(task, Track):
            return task.commands.towards(task.command, target)
        if self._episode != task.episode:
            self.certificate = ""
            self._policy = self._make(task)
            self._episode = task.episode
            # A plan begins at the beginning of the episode, while a named policy begins at the present state.
            self._periods = 0 if self._kind is None else task.state.steps
            self._policy.reset(task.arm.keyframe("home") if self._kind is None else task.command)
        measured = task.observe()["position"]
        # Catch up on steps that others have done; a second call at the same time returns the same action.
        while self._periods <= task.state.steps:
            self._policy.step(measured, target)
            self._periods += 1
        return task.commands.towards(task.command, self._policy.q)

    def _make(self, task: ArmTask) -> Policy:
        arm, rate, target = task.arm, 1.0 / task.control_timestep, task.target(0.0)
        if self._kind is not None:
            return make_policy(self._kind, arm, target, rate=rate, start=task.command, seed=self._seed)
        motion, self.certificate = planned(arm, target, planner=self._planner, seed=self._seed)
        return MotionTracker(arm, motion, rate)


def planned(
    arm: Arm, target: ArrayLike | str, *, planner: str | None = None, seed: Seed = 0
) -> tuple[CubicHermiteSpline, str]:
    """A planned motion from the keyframe ``home``, as fast as 90 % of the velocity and acceleration limits allow.

    Also returns the proof of stability of the motion's network, in words; empty without one. Raises as `plan`.
    """
    result = plan(arm, target, planner=planner, duration=_PLANNING_DURATION, seed=seed)
    motion, certificate = result.motion, "" if result.network is None else str(result.network.certificate)
    # The servos need the rest of the limits. The factor is 0 if nothing moves, as the arm is already at the target.
    factor = slowdown(arm, motion.t, motion.qd, 0.9) or 1.0
    return CubicHermiteSpline(motion.t * factor, motion.q, motion.qd / factor), certificate


typecheck_public(globals())
