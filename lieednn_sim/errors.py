"""The exceptions of the package; each message says what was given, what is allowed and what to do."""

from __future__ import annotations

from typing import Any


class LieEDNNError(Exception):
    """Base class of all exceptions raised by the package."""


class InputError(LieEDNNError, ValueError):
    """A value has the wrong shape, type or range. All functions raise it for this; docstrings name further reasons."""


class FileError(LieEDNNError, OSError):
    """A file is missing, unreadable, corrupt or cannot be written."""


class NoSolutionError(LieEDNNError):
    """Base class for searches that failed on valid input; another seed, target or planner may succeed."""


class NotCertifiedError(NoSolutionError):
    """No network with a proof of global stability could be made for the target."""


class PlanError(NoSolutionError):
    """A planned motion breaks a limit of the arm, or does not reach its target."""


class TooFastError(PlanError):
    """A planned motion breaks a limit of velocity, acceleration, jerk or force that a slower motion would keep.

    Attributes:
        duration: a duration that is long enough [s].
    """

    def __init__(self, message: str, duration: float = float("inf")) -> None:  # unpickled from its message alone
        super().__init__(message)
        self.duration = duration


class OutOfTimeError(NoSolutionError):
    """A planner used up its time budget before it found a motion; see `time_limit`."""


class SimulationError(LieEDNNError):
    """The physics diverged or MuJoCo raised a warning.

    Attributes:
        rollout: the run up to there, a `Rollout`; None where nothing was logged.
    """

    rollout: Any = None


class RenderingUnavailableError(LieEDNNError):
    """There is no working headless OpenGL on this machine."""
