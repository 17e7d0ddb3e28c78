"""The tasks: reach a target and stay there, and track one that moves."""

from __future__ import annotations

import os
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.bounds import Bounds
from lieednn_sim.environments.trajectories import JointTrajectory, band_limited, planned
from lieednn_sim.errors import InputError, NoSolutionError, NotCertifiedError, PlanError
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_choice, as_count, quoted
from lieednn_sim.values import Floats

__all__ = ["REFERENCES", "TASKS", "Reach", "Track", "make_task"]

# Joints are at rest below this share of their velocity limits.
REST = 0.01
# Sources of moving targets.
REFERENCES = ("band-limited", "plan")
# Share of the velocity limits, beyond `REST`, at which the reward for resting falls to a tenth.
_REST_MARGIN = 0.5
_ATTEMPTS = 10
# Control steps that a preview may hold: their targets must fit into the memory of a learner.
_LONGEST_PREVIEW = 10_000


class Reach(ArmTask):
    """Come to rest at a random target that the arm can reach, drawn for each episode by `arm.targets.draw_target`.

    Success: the goal frames are within the tolerances, and no joint moves faster than `REST` of its limit. The reward
    is the closeness of distance and angle, reduced in motion by up to a half; it is 1 exactly at success.

    To choose the target of an episode, begin it with the option ``target``, a joint position ``(n,)``.
    """

    _more_errors = ((REST, _REST_MARGIN),)

    def _draw(self, rng: np.random.Generator, options: dict[str, Any]) -> None:
        chosen = options.pop("target", None)
        _refuse(options, "target")
        # Drawn in any case, so that the generator's state does not depend on the options.
        seed = int(rng.integers(2**32))
        self._target = draw_target(self.arm, seed) if chosen is None else self.arm.check_position(chosen, "target")
        self._here = self._target, self._goals(self._target)

    def target(self, time: float) -> Floats:
        """See `ArmTask`; the target does not move."""
        self._require_episode()
        return self._target.copy()

    def here(self) -> tuple[Floats, ...]:
        """See `ArmTask`."""
        self._require_episode()
        return self._here

    def judge(self, distance: Floats | float, angle: Floats | float, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """See `ArmTask`; unchecked."""
        speed = np.maximum.reduce(np.abs(qd / self.arm.velocity_limits), axis=-1)
        close, resting = self.closeness(distance, angle, speed)
        return close * 0.5 * (1.0 + resting), self.closeness.within(distance, angle) & (speed <= REST)


class Track(ArmTask):
    """Keep up with a target that moves from ``home`` within the arm's limits, free of contact.

    Additional observations are ``target_velocity`` ``(n,)`` and ``preview`` ``(P, n)``, the target positions at the
    ends of this and the following control steps. Success: the goal frames are within the tolerances now. The reward is
    the closeness, 1 exactly at success.

    Args:
        arm: as in `ArmTask`.
        reference: ``"band-limited"``, a random endless joint trajectory; or ``"plan"``, a LieEDNN plan to a random
            target, which takes a second for each episode.
        preview: P.
        position_tolerance: tolerance of success [m]; half a centimetre by default, since no servo tracks exactly.
        rotation_tolerance: the same [rad].
        options: further options of `ArmTask`.
    """

    def __init__(
        self,
        arm: str | Arm = "telescopic_pr",
        *,
        reference: str = "band-limited",
        preview: int = 5,
        position_tolerance: float = 5e-3,
        rotation_tolerance: float = float(np.deg2rad(0.5)),
        **options: Any,
    ) -> None:
        self.reference = as_choice("reference", reference, REFERENCES)
        self.preview = as_count("preview", preview, most=_LONGEST_PREVIEW)
        super().__init__(arm, position_tolerance=position_tolerance, rotation_tolerance=rotation_tolerance, **options)

    def _more_bounds(self) -> Bounds:
        velocity = self.arm.velocity_limits
        low, high = (np.tile(limit, (self.preview, 1)) for limit in self.arm.position_limits.T)
        return {"target_velocity": (-velocity, velocity), "preview": (low, high)}

    def _draw(self, rng: np.random.Generator, options: dict[str, Any]) -> None:
        _refuse(options)
        if self.reference == "band-limited":
            self._trajectory = band_limited(self.arm, rng, (self.steps + self.preview) * self.control_timestep)
        else:
            self._trajectory = self._draw_plan(rng)
        times = self.control_timestep * np.arange(self.steps + self.preview + 1)
        self._wanted, self._rates = self._trajectory.position(times), self._trajectory.velocity(times)
        self._goal_frames = self._goals(self._wanted[: self.steps + 1])

    def here(self) -> tuple[Floats, ...]:
        """See `ArmTask`."""
        self._require_episode()
        now, k = self._wanted, self._step
        return now[k], self._goal_frames[k], self._rates[k], now[k + 1 : k + 1 + self.preview].ravel()

    def _draw_plan(self, rng: np.random.Generator) -> JointTrajectory:
        refusal = ""
        for _ in range(_ATTEMPTS):
            seed = int(rng.integers(2**32))
            try:
                return planned(self.arm, draw_target(self.arm, seed), seed=seed)
            except (PlanError, NotCertifiedError) as error:
                refusal = str(error)
        raise NoSolutionError(f"no plan was found for {_ATTEMPTS} random targets; the last one: {refusal}")

    def target(self, time: float) -> Floats:
        """See `ArmTask`."""
        self._require_episode()
        return self._trajectory.position(time)

    def judge(self, distance: Floats | float, angle: Floats | float, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """See `ArmTask`; unchecked."""
        return self.closeness(distance, angle)[0], self.closeness.within(distance, angle)


TASKS: dict[str, type[ArmTask]] = {"reach": Reach, "track": Track}


def make_task(task: str, arm: str | os.PathLike[str] | Arm = "telescopic_pr", **options: Any) -> ArmTask:
    """A task of `TASKS` by name, with its options; `InputError` lists the names."""
    kind = TASKS[as_choice("task", task, TASKS)]
    # Options of the task itself, and of every task.
    known = {*signature(kind).parameters, *signature(ArmTask).parameters} - {"arm", "options"}
    unknown = sorted(set(options) - known)
    if unknown:
        raise InputError(
            f"unknown options of task {task!r}: {', '.join(map(quoted, unknown))}; known: {', '.join(sorted(known))}"
        )
    return kind(arm, **options)


def _refuse(options: dict[str, Any], *known: str) -> None:
    if options:
        raise InputError(
            f"unknown reset options: {', '.join(map(quoted, options))}; known: {', '.join(known) or 'none'}"
        )


typecheck_public(globals())
