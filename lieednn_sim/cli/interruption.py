"""Handling of Ctrl-C and SIGTERM: a clean end and the shell's exit code, whenever they arrive."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any


class Interruption:
    """Context, for the main thread, in which SIGINT and SIGTERM raise `KeyboardInterrupt` once.

    Python swallows exceptions that are raised in callbacks of weak references and in ``__del__``, and libraries may
    swallow others; therefore `check` raises the interruption again between the steps of a command.

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
            self._unraisable = sys.unraisablehook
            Interruption._current = self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if Interruption._current is self:
            Interruption._current = None
            if not self._last:
                sys.unraisablehook = self._unraisable
        for number, handler in self._before.items():
            signal.signal(number, _end if self._last else handler)

    def report(self) -> int:
        """Print that the command was interrupted; returns the exit code."""
        say("interrupted; files already reported are complete")
        return self.exit_code

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self.importing or self.received is not None:
            _end(number)
        self.received = number
        sys.unraisablehook = lambda _: None
        raise KeyboardInterrupt


def check() -> None:
    """Raise `KeyboardInterrupt` if the running command was interrupted but the exception was lost."""
    current = Interruption._current
    if current is not None and current.received is not None:
        raise KeyboardInterrupt


def say(message: str) -> None:
    """Print a line about the command to the standard error, if that can be written."""
    try:
        print(f"lieednn-sim: {message}", file=sys.stderr, flush=True)
    except OSError:
        # What waits there would fail again at exit, with another exit code.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def _end(number: int, _: FrameType | None = None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"lieednn-sim: interrupted\n")
    os._exit(128 + number)
