"""What Ctrl-C and SIGTERM do to a command: a clean end and the shell's exit code, whenever they come."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any


class Interruption:
    """While it is entered, in the main thread, SIGINT and SIGTERM raise `KeyboardInterrupt` once.

    What they do not get that way ends at once: a process whose first modules are still being imported, which would turn
    the exception into one of their own and has nothing to clean up, and one that is told a second time.

    Attributes:
        importing: whether the first modules are still being imported.
        received: the signal that came.
    """

    def __init__(self) -> None:
        self.importing = True
        self.received: int | None = None
        self._before: dict[int, Any] = {}

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal, as shells have it: 130 or 143."""
        return 128 + int(self.received or signal.SIGINT)

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A shell's job in the background ignores Ctrl-C, which is meant for others.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def report(self) -> int:
        """Say that the command was stopped; returns the exit code."""
        print("lieednn-sim: interrupted; files already reported are complete", file=sys.stderr)
        return self.exit_code

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self.importing or self.received is not None:
            os.write(2, b"lieednn-sim: interrupted\n")
            os._exit(128 + number)
        self.received = number
        raise KeyboardInterrupt
