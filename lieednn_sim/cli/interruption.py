"""Handling of Ctrl-C and SIGTERM: a clean end and the shell's exit code, whenever they arrive."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any

# Time until an interruption that Python had to swallow is raised again [s].
_AGAIN = 0.01
# Whether the system can do so.
_TIMED = hasattr(signal, "setitimer")


class Interruption:
    """Context, for the main thread, in which SIGINT and SIGTERM raise `KeyboardInterrupt` once.

    Python swallows exceptions that are raised in callbacks of weak references and in ``__del__``; therefore the
    interruption is raised again a moment later, and `check` raises it between the steps of a command. Windows has no
    timer for the former.

    A second signal ends the process at once. So does the first one while modules are still being imported: they might
    turn the exception into another one, and there is nothing to clean up yet. Objects that an interruption leaves half
    released, such as an OpenGL context, may raise when Python disposes of them; these errors are not printed.

    Args:
        last: the process ends after the block; a signal that arrives later ends it at once.

    Attributes:
        importing: whether the first modules are still being imported.
        received: the signal received, if any.
    """

    _current: Interruption | None = None

    def __init__(self, *, last: bool = False) -> None:
        self.importing = True
        self.received: int | None = None
        self._last = last
        self._before: dict[int, Any] = {}

    @property
    def exit_code(self) -> int:
        """128 plus the number of the signal, as in shells: 130 or 143."""
        return 128 + int(self.received or signal.SIGINT)

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A shell's background job ignores Ctrl-C.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
            if _TIMED:
                self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._raise)
            self._unraisable, sys.unraisablehook = sys.unraisablehook, self._swallowed
            Interruption._current = self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if Interruption._current is self:
            Interruption._current = None
            _alarm(0.0)
            quiet = self._last and self.received is not None
            sys.unraisablehook = _ignore if quiet else self._unraisable
        for number, handler in self._before.items():
            signal.signal(number, _end if self._last and number in (signal.SIGINT, signal.SIGTERM) else handler)

    def report(self) -> int:
        """Print that the command was interrupted; returns the exit code."""
        _alarm(0.0)
        say("interrupted; files already reported are complete")
        return self.exit_code

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self.importing or self.received is not None:
            _end(number)
        self.received = number
        raise KeyboardInterrupt

    def _raise(self, *_: object) -> None:
        if self.received is not None:
            raise KeyboardInterrupt

    def _swallowed(self, error: Any) -> None:
        if self.received is not None and issubclass(error.exc_type, KeyboardInterrupt):
            _alarm(_AGAIN)
        elif self.received is None:
            self._unraisable(error)


def check() -> None:
    """Raise `KeyboardInterrupt` if the running command was interrupted but the exception was lost."""
    current = Interruption._current
    if current is not None and current.received is not None:
        _alarm(0.0)
        raise KeyboardInterrupt


def _alarm(seconds: float) -> None:
    """Raise the interruption again in so many seconds; with 0 never, since its exception is under way."""
    if _TIMED:
        signal.setitimer(signal.ITIMER_REAL, seconds)


def say(message: str) -> None:
    """Print a line about the command to the standard error, if that can be written."""
    try:
        print(f"lieednn-sim: {message}", file=sys.stderr, flush=True)
    except OSError:
        # What waits there would fail again at exit, with another exit code.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def _ignore(_: object) -> None:
    pass


def _end(number: int, _: FrameType | None = None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"lieednn-sim: interrupted\n")
    os._exit(128 + number)
