"""Handling of Ctrl-C and SIGTERM: a clean end and the shell's exit code, whenever they arrive."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any


class Interruption:
    """Context, for the main thread, in which the first SIGINT or SIGTERM raises `KeyboardInterrupt`.

    A second signal ends the process at once. Objects that an interruption leaves half released, such as an OpenGL
    context, may raise when Python disposes of them; these errors are not printed in the block, nor after the ``last``
    one, at whose end the process ends. ``received`` is the signal, if any: libraries may swallow the exception, or make
    another one of it.
    """

    def __init__(self, *, last: bool = False) -> None:
        self.received: int | None = None
        self._last = last
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        self._unraisable = sys.unraisablehook
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A shell's background job ignores Ctrl-C.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if not self._last:
            sys.unraisablehook = self._unraisable

    def report(self) -> int:
        """Print that the command was interrupted; returns 128 plus the signal's number, as shells do: 130 or 143."""
        say("interrupted; files already reported are complete")
        return 128 + int(self.received or signal.SIGINT)

    def _handle(self, number: int, _: FrameType | None) -> None:
        self.received = number
        sys.unraisablehook = lambda _: None
        for each in self._before:
            signal.signal(each, signal.SIG_DFL)
        raise KeyboardInterrupt


def say(message: str) -> None:
    """Print a line about the command to the standard error, if that can be written."""
    try:
        print(f"lieednn-sim: {message}", file=sys.stderr, flush=True)
    except OSError:
        # What waits there would fail again at exit, with another exit code.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
